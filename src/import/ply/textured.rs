//! The mesh of a PLY file with what it is painted with.

use super::body::Body;
use super::header::{Element, Property};
use super::{PlyError, Polygons, header};

/// Vertices, triangles, and their colours or texture coordinates.
#[derive(Debug, Default)]
pub struct TexturedPolygons {
    /// Vertices and triangles.
    pub polygons: Polygons,
    /// Per vertex: sRGB bytes; empty without the properties `red`, `green` and `blue`.
    pub vertex_srgb: Vec<[u8; 3]>,
    /// Names of the textures (`comment TextureFile NAME`).
    pub texture_files: Vec<String>,
    /// Per triangle: which texture (`texnumber`), 0 without; within the textures where there are
    /// any.
    pub texture_of_triangles: Vec<u32>,
    /// Per triangle: its corners' `texcoord`, v down; NaN without.
    pub corners_uv: Vec<[[f32; 2]; 3]>,
}

/// One row of an element: the value of each scalar property (0 for lists), the items of each list.
struct Row {
    scalars: Vec<f64>,
    lists: Vec<Vec<f64>>,
}

impl Element {
    fn list_position(&self, wanted: &[&str]) -> Option<usize> {
        self.properties.iter().position(
            |p| matches!(p, Property::List { name, .. } if wanted.contains(&name.as_str())),
        )
    }

    /// Calls with each row in turn.
    fn for_each_row(
        &self,
        body: &mut Body<'_>,
        mut call: impl FnMut(u64, &Row) -> Result<(), PlyError>,
    ) -> Result<(), PlyError> {
        let num_properties = self.properties.len();
        let mut values = Row {
            scalars: vec![0.0; num_properties],
            lists: vec![Vec::new(); num_properties],
        };
        for row in 0..self.count {
            for (index, property) in self.properties.iter().enumerate() {
                let stop = |stop| self.stop(row, "a property", stop);
                match *property {
                    Property::Scalar(_, scalar) => {
                        values.scalars[index] = body.next(scalar).map_err(stop)?;
                    }
                    Property::List { length, item, .. } => {
                        values.lists[index].clear();
                        body.next_list(length, item, &mut values.lists[index])
                            .map_err(stop)?;
                    }
                }
            }
            call(row, &values)?;
        }
        Ok(())
    }

    fn wrong(&self, row: u64, what: &'static str, value: impl ToString) -> PlyError {
        PlyError::Value {
            element: self.name.clone(),
            row,
            what,
            value: value.to_string(),
        }
    }

    fn read_colored_vertices(
        &self,
        body: &mut Body<'_>,
        out: &mut TexturedPolygons,
    ) -> Result<(), PlyError> {
        let axis = |name, missing| self.scalar_position(name).ok_or(PlyError::Missing(missing));
        let axes = [
            axis("x", "vertex property x")?,
            axis("y", "vertex property y")?,
            axis("z", "vertex property z")?,
        ];
        let channels = ["red", "green", "blue"].map(|name| self.scalar_position(name));
        self.for_each_row(body, |_, row| {
            let position = axes.map(|axis| row.scalars[axis]);
            out.polygons.positions_m.push(position.into());
            if let [Some(r), Some(g), Some(b)] = channels {
                // Whole numbers are bytes; floats are in [0, 1].
                let byte = |at: usize| {
                    let is_byte = matches!(
                        &self.properties[at],
                        Property::Scalar(_, scalar) if scalar.is_integer()
                    );
                    let value = row.scalars[at] * if is_byte { 1.0 } else { 255.0 };
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "clamped; NaN becomes 0"
                    )]
                    let byte = value.clamp(0.0, 255.0).round() as u8;
                    byte
                };
                out.vertex_srgb.push([byte(r), byte(g), byte(b)]);
            }
            Ok(())
        })
    }

    fn read_textured_faces(
        &self,
        body: &mut Body<'_>,
        out: &mut TexturedPolygons,
    ) -> Result<(), PlyError> {
        let corners_at = self
            .list_position(&["vertex_indices", "vertex_index"])
            .ok_or(PlyError::Missing("face list vertex_indices"))?;
        let uv_at = self.list_position(&["texcoord"]);
        let number_at = self.scalar_position("texnumber");
        let num_textures = out.texture_files.len();
        self.for_each_row(body, |row, values| {
            let corners = values.lists[corners_at]
                .iter()
                .map(|&item| self.vertex_index(row, item))
                .collect::<Result<Vec<u32>, PlyError>>()?;
            let uv =
                self.texture_coordinates(row, corners.len(), uv_at.map(|at| &*values.lists[at]))?;
            let texture = number_at.map_or(Ok(0), |at| self.vertex_index(row, values.scalars[at]));
            let texture = match texture {
                Ok(number) if num_textures == 0 || (number as usize) < num_textures => number,
                _ => {
                    let number = number_at.map_or(0.0, |at| values.scalars[at]);
                    return Err(self.wrong(row, "a texture's number", number));
                }
            };
            let first = out.polygons.triangles.len();
            out.polygons.push(&corners);
            let num_new = out.polygons.triangles.len() - first;
            out.corners_uv
                .extend((1..=num_new).map(|i| [uv[0], uv[i], uv[i + 1]]));
            out.texture_of_triangles
                .extend((0..num_new).map(|_| texture));
            Ok(())
        })
    }

    /// Per corner, v down.
    fn texture_coordinates(
        &self,
        row: u64,
        num_corners: usize,
        values: Option<&[f64]>,
    ) -> Result<Vec<[f32; 2]>, PlyError> {
        let Some(values) = values.filter(|values| !values.is_empty()) else {
            return Ok(vec![[f32::NAN; 2]; num_corners]);
        };
        if values.len() != 2 * num_corners {
            return Err(self.wrong(row, "the number of texture coordinates", values.len()));
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let uv = |pair: &[f64]| [pair[0] as f32, 1.0 - pair[1] as f32];
        Ok(values.chunks_exact(2).map(uv).collect())
    }
}

/// The polygons of a PLY file with their colours and texture coordinates.
///
/// # Errors
/// [`PlyError`] when the file is damaged or has no vertices with faces.
pub fn parse_textured(bytes: &[u8]) -> Result<TexturedPolygons, PlyError> {
    let header = header::parse(bytes)?;
    let mut body = Body {
        bytes: bytes.get(header.body_offset..).unwrap_or_default(),
        encoding: header.encoding,
    };
    let mut out = TexturedPolygons {
        texture_files: header.texture_files,
        ..TexturedPolygons::default()
    };
    let (mut has_vertices, mut has_faces) = (false, false);
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" if !has_vertices => {
                has_vertices = true;
                element.read_colored_vertices(&mut body, &mut out)?;
            }
            "face" if !has_faces => {
                has_faces = true;
                element.read_textured_faces(&mut body, &mut out)?;
            }
            _ => element.skip(&mut body)?,
        }
    }
    if !has_vertices {
        return Err(PlyError::Missing("element vertex"));
    }
    if !has_faces {
        return Err(PlyError::Missing(
            "element face (a point cloud has no surface)",
        ));
    }
    Ok(out)
}
