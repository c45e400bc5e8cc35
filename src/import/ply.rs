//! PLY files: the triangle mesh in them.
//!
//! Reads `ascii`, `binary_little_endian` and `binary_big_endian` 1.0. Of the element `vertex` the
//! scalar properties `x`, `y`, `z` are used (any scalar type, metres), of the element `face` the
//! list `vertex_indices` or `vertex_index`; everything else is walked over. Polygons are cut into
//! a fan around their first corner; faces of fewer than three corners are counted and left out.
//! Triangle strips are not read. Memory grows with the bytes that are there, never with a count
//! that the file claims. Format: Turk, "The PLY Polygon File Format", 1994.

use nalgebra::Point3;

use super::mesh_file::Polygons;

mod body;
mod header;
mod textured;

pub use textured::{TexturedPolygons, parse_textured};

use body::{Body, Stop};
use header::{Element, Property};

/// Why a PLY file was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlyError {
    /// The file does not start with `ply`.
    #[error("not a PLY file: it does not start with 'ply'")]
    Magic,
    /// There is no `end_header` line, or a line of the header is longer than any real one.
    #[error("the PLY header does not end")]
    HeaderUnfinished,
    /// A header line cannot be understood.
    #[error("PLY header line {line}: '{text}': {reason}")]
    Header {
        /// Line number from 1.
        line: usize,
        /// The line, shortened.
        text: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// A needed element or property is not declared.
    #[error("the PLY header declares no {0}")]
    Missing(&'static str),
    /// The file ends inside an element.
    #[error("the PLY file ends in {element} {row} of {count}")]
    Ended {
        /// Name of the element.
        element: String,
        /// Which row, from 0.
        row: u64,
        /// How many rows the header promises.
        count: u64,
    },
    /// A value is not a number, or not one that its place allows.
    #[error("the PLY file has '{value}' for {what} in {element} {row}")]
    Value {
        /// Name of the element.
        element: String,
        /// Which row, from 0.
        row: u64,
        /// Which property.
        what: &'static str,
        /// The value as read.
        value: String,
    },
}

impl Element {
    fn stop(&self, row: u64, what: &'static str, stop: Stop) -> PlyError {
        match stop {
            Stop::Ended => PlyError::Ended {
                element: self.name.clone(),
                row,
                count: self.count,
            },
            Stop::NotANumber(value) => PlyError::Value {
                element: self.name.clone(),
                row,
                what,
                value,
            },
        }
    }

    /// Rows that `num_bytes` can hold, at most the promised ones: each value takes a byte or more.
    fn plausible_rows(&self, num_bytes: usize) -> usize {
        usize::try_from(self.count)
            .unwrap_or(usize::MAX)
            .min(num_bytes / self.properties.len().max(1))
    }

    fn scalar_position(&self, wanted: &str) -> Option<usize> {
        self.properties
            .iter()
            .position(|p| matches!(p, Property::Scalar(name, _) if name == wanted))
    }

    fn read_vertices(&self, body: &mut Body<'_>) -> Result<Vec<Point3<f64>>, PlyError> {
        let axis = |name, missing| self.scalar_position(name).ok_or(PlyError::Missing(missing));
        let axes = [
            axis("x", "vertex property x")?,
            axis("y", "vertex property y")?,
            axis("z", "vertex property z")?,
        ];
        let mut positions_m = Vec::with_capacity(self.plausible_rows(body.bytes.len()));
        let mut ignored = Vec::new();
        for row in 0..self.count {
            let mut position_m = [0.0; 3];
            for (index, property) in self.properties.iter().enumerate() {
                let stop = |stop| self.stop(row, "a vertex property", stop);
                match *property {
                    Property::Scalar(_, scalar) => {
                        let value = body.next(scalar).map_err(stop)?;
                        if let Some(axis) = axes.iter().position(|&a| a == index) {
                            position_m[axis] = value;
                        }
                    }
                    Property::List { length, item, .. } => {
                        ignored.clear();
                        body.next_list(length, item, &mut ignored).map_err(stop)?;
                    }
                }
            }
            positions_m.push(Point3::from(position_m));
        }
        Ok(positions_m)
    }

    fn read_faces(&self, body: &mut Body<'_>, polygons: &mut Polygons) -> Result<(), PlyError> {
        let corners_at = self
            .properties
            .iter()
            .position(|p| {
                matches!(p, Property::List { name, .. }
                    if name == "vertex_indices" || name == "vertex_index")
            })
            .ok_or(PlyError::Missing("face list vertex_indices"))?;
        polygons.reserve(self.plausible_rows(body.bytes.len()));
        let mut items = Vec::new();
        let mut corners = Vec::new();
        for row in 0..self.count {
            for (index, property) in self.properties.iter().enumerate() {
                let stop = |stop| self.stop(row, "a face property", stop);
                match *property {
                    Property::Scalar(_, scalar) => {
                        body.next(scalar).map_err(stop)?;
                    }
                    Property::List { length, item, .. } => {
                        items.clear();
                        body.next_list(length, item, &mut items).map_err(stop)?;
                        if index == corners_at {
                            corners.clear();
                            for &item in &items {
                                corners.push(self.vertex_index(row, item)?);
                            }
                        }
                    }
                }
            }
            polygons.push(&corners);
        }
        Ok(())
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked to be an integer in the range of u32"
    )]
    fn vertex_index(&self, row: u64, value: f64) -> Result<u32, PlyError> {
        if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
            Ok(value as u32)
        } else {
            Err(PlyError::Value {
                element: self.name.clone(),
                row,
                what: "a vertex index",
                value: value.to_string(),
            })
        }
    }

    fn skip(&self, body: &mut Body<'_>) -> Result<(), PlyError> {
        // Rows without a property take no bytes: a loop over them could be endless.
        if self.properties.is_empty() {
            return Ok(());
        }
        let mut ignored = Vec::new();
        for row in 0..self.count {
            for property in &self.properties {
                let skipped = match *property {
                    Property::Scalar(_, scalar) => body.next(scalar).map(|_| ()),
                    Property::List { length, item, .. } => {
                        ignored.clear();
                        body.next_list(length, item, &mut ignored)
                    }
                };
                skipped.map_err(|stop| self.stop(row, "a property", stop))?;
            }
        }
        Ok(())
    }
}

/// The polygons of a PLY file.
///
/// # Errors
/// [`PlyError`] when the file is damaged or has no vertices with faces. Indices are checked
/// against `u32` only; [`crate::mesh::TriMesh::from_soup`] checks them against the vertices.
pub fn parse(bytes: &[u8]) -> Result<Polygons, PlyError> {
    let header = header::parse(bytes)?;
    let mut body = Body {
        bytes: bytes.get(header.body_offset..).unwrap_or_default(),
        encoding: header.encoding,
    };
    let mut polygons = Polygons::default();
    let (mut has_vertices, mut has_faces) = (false, false);
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" if !has_vertices => {
                has_vertices = true;
                polygons.positions_m = element.read_vertices(&mut body)?;
            }
            "face" if !has_faces => {
                has_faces = true;
                element.read_faces(&mut body, &mut polygons)?;
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
    Ok(polygons)
}

#[cfg(test)]
#[expect(
    clippy::cast_possible_truncation,
    reason = "the sample's values are small"
)]
mod tests {
    use super::header::Scalar;
    use super::*;
    use proptest::prelude::*;

    /// Two triangles and a quad with extra properties of every kind, in the asked encoding.
    fn sample(format: &str) -> Vec<u8> {
        let mut file = format!(
            "ply\r\nformat {format} 1.0\ncomment made by hand\nelement vertex 5\n\
             property uchar red\nproperty double x\nproperty float y\nproperty short z\n\
             property list uchar ushort tags\nelement extra 2\nproperty int a\n\
             element face 3\nproperty float quality\nproperty list uchar int vertex_indices\n\
             element nothing 18446744073709551615\nend_header\n"
        )
        .into_bytes();
        let big = format == "binary_big_endian";
        let ascii = format == "ascii";
        let mut put = |value: f64, scalar: Scalar| {
            if ascii {
                file.extend(format!("{value} ").bytes());
                return;
            }
            let mut le = match scalar {
                Scalar::U8 => vec![value as u8],
                Scalar::I16 => (value as i16).to_le_bytes().to_vec(),
                Scalar::U16 => (value as u16).to_le_bytes().to_vec(),
                Scalar::I32 => (value as i32).to_le_bytes().to_vec(),
                Scalar::F32 => (value as f32).to_le_bytes().to_vec(),
                Scalar::F64 => value.to_le_bytes().to_vec(),
                _ => unreachable!("not used by the sample"),
            };
            if big {
                le.reverse();
            }
            file.extend(le);
        };
        for i in 0..5u32 {
            let i = f64::from(i);
            put(200.0, Scalar::U8);
            put(i * 0.125 - 1.0, Scalar::F64);
            put(i * 0.25, Scalar::F32);
            put(-300.0 * i, Scalar::I16);
            put(i, Scalar::U8);
            for tag in 0..i as u32 {
                put(f64::from(tag), Scalar::U16);
            }
        }
        put(-7.0, Scalar::I32);
        put(9.0, Scalar::I32);
        for face in [&[0, 1, 2][..], &[1, 2, 3, 4], &[3, 4]] {
            put(0.5, Scalar::F32);
            put(face.len() as f64, Scalar::U8);
            for &v in face {
                put(f64::from(v), Scalar::I32);
            }
        }
        file
    }

    #[test]
    fn the_three_encodings_say_the_same() {
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            let polygons = parse(&sample(format)).unwrap();
            assert_eq!(polygons.positions_m[3], Point3::new(-0.625, 0.75, -900.0));
            assert_eq!(polygons.positions_m.len(), 5);
            assert_eq!(
                polygons.triangles,
                vec![[0, 1, 2], [1, 2, 3], [1, 3, 4]],
                "{format}"
            );
            assert_eq!(polygons.num_incomplete_faces, 1);
            assert_eq!(polygons.num_cut_polygons, 1);
        }
    }

    #[test]
    fn every_truncation_is_an_error() {
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            let file = sample(format);
            // The last blank of the text form may go: nothing is lost with it.
            let end = file.trim_ascii_end().len();
            let end = if format == "ascii" { end } else { file.len() };
            for length in 0..end {
                assert!(parse(&file[..length]).is_err(), "{format} cut at {length}");
            }
        }
    }

    #[test]
    fn a_claimed_size_allocates_nothing() {
        let claims = b"ply\nformat binary_little_endian 1.0\n\
            element vertex 18446744073709551615\nproperty float x\nproperty float y\n\
            property float z\nelement face 18446744073709551615\n\
            property list uint int vertex_indices\nend_header\n0123456789abcdef";
        assert_eq!(
            parse(claims).unwrap_err(),
            PlyError::Ended {
                element: "vertex".to_owned(),
                row: 1,
                count: u64::MAX
            }
        );
    }

    #[test]
    fn what_is_not_a_mesh_is_named() {
        assert_eq!(parse(b"solid x").unwrap_err(), PlyError::Magic);
        assert_eq!(
            parse(b"ply\nformat ascii 1.0\n").unwrap_err(),
            PlyError::HeaderUnfinished
        );
        let cloud = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n\
            property float y\nproperty float z\nend_header\n1 2 3\n";
        assert!(matches!(parse(cloud), Err(PlyError::Missing(_))));
        let negative = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n\
            property float y\nproperty float z\nelement face 1\n\
            property list uchar int vertex_indices\nend_header\n1 2 3\n3 0 -1 0\n";
        assert!(matches!(
            parse(negative),
            Err(PlyError::Value { row: 0, ref value, .. }) if value == "-1"
        ));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 600, ..ProptestConfig::default() })]
        #[test]
        fn mutated_files_never_panic(
            format in prop::sample::select(vec!["ascii", "binary_little_endian", "binary_big_endian"]),
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3u8), 1..12),
            cut in any::<prop::sample::Index>(),
            is_cut in any::<bool>(),
        ) {
            let mut file = sample(format);
            for (at, byte, kind) in edits {
                let at = at.index(file.len());
                match kind {
                    0 => file[at] = byte,
                    1 => file.insert(at, byte),
                    _ => { file.remove(at); }
                }
            }
            if is_cut {
                file.truncate(cut.index(file.len()));
            }
            if let Ok(polygons) = parse(&file) {
                // Whatever is accepted fits into the bytes it came from.
                prop_assert!(polygons.positions_m.len() + polygons.triangles.len() <= file.len());
                drop(polygons.into_mesh());
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic(body in prop::collection::vec(any::<u8>(), 0..400)) {
            drop(parse(&body));
            let mut file = b"ply\n".to_vec();
            file.extend(&body);
            drop(parse(&file));
        }
    }
}
