//! GLB 2.0: one self-contained file (Khronos glTF 2.0, section 4.4).
//!
//! One mesh of one primitive per page, each with its own material and image. Materials are
//! `KHR_materials_unlit`: the photographs hold the light already; viewers without the extension
//! see a rough non-metal with the same picture. The root node turns z up (ROS) to y up (glTF);
//! when coordinates are too large for f32 the positions are relative to an origin that the mesh's
//! node adds. Limits: 4 GiB for the whole file.

use std::io::{self, Write};

use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};

use crate::mesh::TriMesh;

use super::TexturedMesh;
use super::normals::{NormalMode, flat_normal, smooth_normals};
use super::pages::EncodedPages;
use super::split::{PagePart, Sharing, split_by_page};

/// Up to this distance from the frame's origin f32 resolves 0.06 mm; beyond it positions are
/// relative to the middle of the mesh.
pub const MAX_ABSOLUTE_COORDINATE_M: f64 = 1000.0;

// Enumerations of glTF 2.0, section 5.
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP_TO_EDGE: u32 = 33071;

/// Rotation by −90° about x: (x, y, z) of the z-up world becomes (x, z, −y).
const Y_UP_FROM_Z_UP_XYZW: [f64; 4] = [
    -std::f64::consts::FRAC_1_SQRT_2,
    0.0,
    0.0,
    std::f64::consts::FRAC_1_SQRT_2,
];

const JSON_CHUNK: [u8; 4] = *b"JSON";
const BIN_CHUNK: [u8; 4] = *b"BIN\0";

/// Writes the mesh with its pages; `name` names the mesh and the scene.
///
/// # Errors
/// Those of `out`, and one that says so when the file would pass 4 GiB or `pages` are not the
/// pages of the mesh.
pub fn write(
    textured: &TexturedMesh<'_>,
    pages: &EncodedPages,
    name: &str,
    normals: NormalMode,
    out: &mut dyn Write,
) -> io::Result<()> {
    if pages.pages().len() != textured.texture().pages.len() {
        return Err(io::Error::other(format!(
            "{} encoded pages for an atlas of {}",
            pages.pages().len(),
            textured.texture().pages.len()
        )));
    }
    let geometry = Geometry::new(textured, normals);
    let document = Document::new(&geometry, pages, name);
    document.write(&geometry, pages, out)
}

/// Vertex and index data of every page that has triangles.
struct Geometry {
    origin_m: Point3<f64>,
    primitives: Vec<Primitive>,
    bytes: Vec<u8>,
}

struct Primitive {
    page: usize,
    indices: View,
    positions: View,
    normals: View,
    uvs: View,
    num_vertices: usize,
    num_indices: usize,
    index_type: u32,
    min_m: [f32; 3],
    max_m: [f32; 3],
}

#[derive(Clone, Copy)]
struct View {
    offset: usize,
    length: usize,
}

impl Geometry {
    fn new(textured: &TexturedMesh<'_>, mode: NormalMode) -> Self {
        let mesh = textured.mesh();
        let origin_m = origin_for(mesh);
        let (sharing, smooth) = match mode {
            NormalMode::Smooth => (Sharing::ByUv, smooth_normals(mesh)),
            NormalMode::Flat => (Sharing::PerTriangle, Vec::new()),
        };
        let mut geometry = Self {
            origin_m,
            primitives: Vec::new(),
            bytes: Vec::new(),
        };
        for (page, part) in split_by_page(textured, sharing).iter().enumerate() {
            if !part.triangles.is_empty() {
                let normals = match mode {
                    NormalMode::Smooth => part.vertex.iter().map(|&v| smooth[v as usize]).collect(),
                    NormalMode::Flat => flat_normals(mesh, part),
                };
                geometry.push(mesh, page, part, &normals);
            }
        }
        geometry
    }

    fn push(&mut self, mesh: &TriMesh, page: usize, part: &PagePart, normals: &[[f32; 3]]) {
        let positions: Vec<[f32; 3]> = part
            .vertex
            .iter()
            .map(|&vertex| relative_m(&mesh.positions_m()[vertex as usize], &self.origin_m))
            .collect();
        let (min_m, max_m) = bounds(&positions);
        let (indices, index_type) = self.push_indices(&part.triangles, part.vertex.len());
        let primitive = Primitive {
            page,
            indices,
            positions: self.push_floats(positions.as_flattened()),
            normals: self.push_floats(normals.as_flattened()),
            uvs: self.push_floats(part.uv.as_flattened()),
            num_vertices: part.vertex.len(),
            num_indices: part.triangles.len() * 3,
            index_type,
            min_m,
            max_m,
        };
        self.primitives.push(primitive);
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "16 bits are chosen only when every index fits"
    )]
    fn push_indices(&mut self, triangles: &[[u32; 3]], num_vertices: usize) -> (View, u32) {
        let offset = self.bytes.len();
        // 65535 restarts primitives, so it cannot name a vertex.
        let index_type = if num_vertices < usize::from(u16::MAX) {
            for &index in triangles.as_flattened() {
                self.bytes.extend_from_slice(&(index as u16).to_le_bytes());
            }
            UNSIGNED_SHORT
        } else {
            for &index in triangles.as_flattened() {
                self.bytes.extend_from_slice(&index.to_le_bytes());
            }
            UNSIGNED_INT
        };
        (self.finish_view(offset), index_type)
    }

    fn push_floats(&mut self, values: &[f32]) -> View {
        let offset = self.bytes.len();
        self.bytes.reserve(values.len() * 4);
        for value in values {
            self.bytes.extend_from_slice(&value.to_le_bytes());
        }
        self.finish_view(offset)
    }

    fn finish_view(&mut self, offset: usize) -> View {
        let length = self.bytes.len() - offset;
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        View { offset, length }
    }
}

fn flat_normals(mesh: &TriMesh, part: &PagePart) -> Vec<[f32; 3]> {
    let mut normals = vec![[0.0; 3]; part.vertex.len()];
    for (corners, &triangle) in part.triangles.iter().zip(&part.triangle_ids) {
        let normal = flat_normal(mesh, triangle);
        for &vertex in corners {
            normals[vertex as usize] = normal;
        }
    }
    normals
}

/// The frame's origin, or for far meshes the middle of the mesh in whole metres.
fn origin_for(mesh: &TriMesh) -> Point3<f64> {
    let mut min = Vector3::repeat(f64::INFINITY);
    let mut max = Vector3::repeat(f64::NEG_INFINITY);
    for corners in mesh.triangles() {
        for &vertex in corners {
            let coords = mesh.positions_m()[vertex as usize].coords;
            min = min.inf(&coords);
            max = max.sup(&coords);
        }
    }
    if mesh.triangles().is_empty() || min.abs().sup(&max.abs()).max() <= MAX_ABSOLUTE_COORDINATE_M {
        return Point3::origin();
    }
    // Halved before the sum, so that it cannot overflow.
    Point3::from((min * 0.5 + max * 0.5).map(f64::round))
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "rounding to f32 is meant; what is beyond its range is brought back into it"
)]
fn relative_m(position_m: &Point3<f64>, origin_m: &Point3<f64>) -> [f32; 3] {
    let relative = (position_m - origin_m).map(|c| (c as f32).clamp(f32::MIN, f32::MAX));
    relative.into()
}

fn bounds(positions: &[[f32; 3]]) -> ([f32; 3], [f32; 3]) {
    let mut min = [f32::INFINITY; 3];
    let mut max = [f32::NEG_INFINITY; 3];
    for position in positions {
        for axis in 0..3 {
            min[axis] = min[axis].min(position[axis]);
            max[axis] = max[axis].max(position[axis]);
        }
    }
    (min, max)
}

/// The JSON half.
struct Document {
    json: Vec<u8>,
    bin_length: usize,
}

impl Document {
    fn new(geometry: &Geometry, pages: &EncodedPages, name: &str) -> Self {
        let used: Vec<usize> = geometry.primitives.iter().map(|p| p.page).collect();
        let mut views = Vec::new();
        let mut accessors = Vec::new();
        let mut primitives = Vec::new();
        for (material, primitive) in geometry.primitives.iter().enumerate() {
            primitives.push(push_primitive(
                primitive,
                material,
                &mut views,
                &mut accessors,
            ));
        }
        let mut offset = geometry.bytes.len();
        let mut images = Vec::new();
        for &page in &used {
            let length = pages.pages()[page].len();
            images.push(json!({
                "bufferView": views.len(),
                "mimeType": pages.format().mime_type(),
                "name": format!("page_{page}"),
            }));
            views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": length}));
            offset += length.next_multiple_of(4);
        }
        let mut root = json!({
            "asset": {
                "version": "2.0",
                "generator": concat!("veneer ", env!("CARGO_PKG_VERSION")),
            },
            "scene": 0,
        });
        if used.is_empty() {
            root["scenes"] = json!([{"name": name}]);
        } else {
            root["scenes"] = json!([{"name": name, "nodes": [0]}]);
            root["extensionsUsed"] = json!(["KHR_materials_unlit"]);
            root["nodes"] = nodes(name, &geometry.origin_m);
            root["meshes"] = json!([{"name": name, "primitives": primitives}]);
            root["materials"] = used.iter().enumerate().map(material).collect();
            root["textures"] = (0..used.len())
                .map(|source| json!({"sampler": 0, "source": source}))
                .collect();
            root["samplers"] = json!([{
                "magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR,
                "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE,
            }]);
            root["images"] = Value::Array(images);
            root["bufferViews"] = Value::Array(views);
            root["accessors"] = Value::Array(accessors);
            root["buffers"] = json!([{"byteLength": offset}]);
        }
        let mut json = root.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        Self {
            json,
            bin_length: offset,
        }
    }

    fn write(
        &self,
        geometry: &Geometry,
        pages: &EncodedPages,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        let has_bin = self.bin_length > 0;
        let total = 12 + 8 + self.json.len() + if has_bin { 8 + self.bin_length } else { 0 };
        out.write_all(b"glTF")?;
        out.write_all(&2u32.to_le_bytes())?;
        out.write_all(&length_u32(total)?)?;
        out.write_all(&length_u32(self.json.len())?)?;
        out.write_all(&JSON_CHUNK)?;
        out.write_all(&self.json)?;
        if !has_bin {
            return Ok(());
        }
        out.write_all(&length_u32(self.bin_length)?)?;
        out.write_all(&BIN_CHUNK)?;
        out.write_all(&geometry.bytes)?;
        for primitive in &geometry.primitives {
            let page = &pages.pages()[primitive.page];
            out.write_all(page)?;
            let padding = page.len().next_multiple_of(4) - page.len();
            out.write_all(&[0; 3][..padding])?;
        }
        Ok(())
    }
}

fn length_u32(length: usize) -> io::Result<[u8; 4]> {
    u32::try_from(length)
        .map(u32::to_le_bytes)
        .map_err(|_| io::Error::other(format!("{length} bytes, and a GLB holds 4 GiB at most")))
}

fn nodes(name: &str, origin_m: &Point3<f64>) -> Value {
    let mut mesh_node = json!({"name": name, "mesh": 0});
    if *origin_m != Point3::origin() {
        mesh_node["translation"] = json!([origin_m.x, origin_m.y, origin_m.z]);
    }
    json!([
        {"name": "y_up_from_z_up", "rotation": Y_UP_FROM_Z_UP_XYZW, "children": [1]},
        mesh_node,
    ])
}

fn material((texture, page): (usize, &usize)) -> Value {
    json!({
        "name": format!("page_{page}"),
        "doubleSided": true,
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": texture},
            "metallicFactor": 0,
            "roughnessFactor": 1,
        },
        "extensions": {"KHR_materials_unlit": {}},
    })
}

fn push_primitive(
    primitive: &Primitive,
    material: usize,
    views: &mut Vec<Value>,
    accessors: &mut Vec<Value>,
) -> Value {
    let mut push = |view: View, target: u32, mut accessor: Value| {
        accessor["bufferView"] = json!(views.len());
        views.push(json!({
            "buffer": 0, "byteOffset": view.offset, "byteLength": view.length, "target": target,
        }));
        accessors.push(accessor);
        accessors.len() - 1
    };
    let floats =
        |kind: &str| json!({"componentType": FLOAT, "count": primitive.num_vertices, "type": kind});
    let indices = push(
        primitive.indices,
        ELEMENT_ARRAY_BUFFER,
        json!({
            "componentType": primitive.index_type,
            "count": primitive.num_indices,
            "type": "SCALAR",
        }),
    );
    // As f64 the bounds print every digit of the f32 that is in the buffer.
    let mut position = floats("VEC3");
    position["min"] = json!(primitive.min_m.map(f64::from));
    position["max"] = json!(primitive.max_m.map(f64::from));
    let position = push(primitive.positions, ARRAY_BUFFER, position);
    let normal = push(primitive.normals, ARRAY_BUFFER, floats("VEC3"));
    let uv = push(primitive.uvs, ARRAY_BUFFER, floats("VEC2"));
    json!({
        "attributes": {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv},
        "indices": indices,
        "material": material,
        "mode": 4,
    })
}
