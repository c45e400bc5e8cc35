//! Binary PLY, as MeshLab writes textured ones: per face its corners' texture coordinates (v up)
//! and the number of its page, per vertex a colour.
//!
//! Vertices and faces keep the mesh's numbering. A vertex's colour is the mean, in linear light,
//! of the texels at its corners; grey where no triangle uses it.

use std::io::{self, Write};

use crate::geom::color::{linear_from_srgb, srgb_from_linear};

use super::glb::MAX_ABSOLUTE_COORDINATE_M;
use super::{TexturedMesh, page_path};

const UNUSED_SRGB: [u8; 3] = [128; 3];

/// Bytes of one face: a count and three indices, a count and six coordinates, the page.
const FACE_BYTES: usize = 1 + 3 * 4 + 1 + 6 * 4 + 4;

/// Writes the PLY.
///
/// # Errors
/// Those of `out`.
pub fn write(textured: &TexturedMesh<'_>, out: &mut dyn Write) -> io::Result<()> {
    let mesh = textured.mesh();
    let is_far = mesh
        .positions_m()
        .iter()
        .any(|p| p.coords.amax() > MAX_ABSOLUTE_COORDINATE_M);
    write_header(textured, is_far, out)?;
    for (position, color) in mesh.positions_m().iter().zip(vertex_srgb(textured)) {
        for coordinate in [position.x, position.y, position.z] {
            if is_far {
                out.write_all(&coordinate.to_le_bytes())?;
            } else {
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
                out.write_all(&(coordinate as f32).to_le_bytes())?;
            }
        }
        out.write_all(&color)?;
    }
    let mut face = Vec::with_capacity(FACE_BYTES);
    for (triangle, corners) in mesh.triangle_ids().zip(mesh.triangles()) {
        face.clear();
        face.push(3);
        face.extend(corners.iter().flat_map(|v| v.to_le_bytes()));
        face.push(6);
        for [u, v] in textured.corners_uv(triangle) {
            face.extend_from_slice(&u.to_le_bytes());
            face.extend_from_slice(&(1.0 - v).to_le_bytes());
        }
        face.extend_from_slice(&textured.layout().page_of(triangle).to_le_bytes());
        out.write_all(&face)?;
    }
    Ok(())
}

fn write_header(textured: &TexturedMesh<'_>, is_far: bool, out: &mut dyn Write) -> io::Result<()> {
    let mesh = textured.mesh();
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    writeln!(out, "comment veneer; metres, z up")?;
    for page in 0..textured.texture().pages.len() {
        writeln!(out, "comment TextureFile {}", page_path(page))?;
    }
    writeln!(out, "element vertex {}", mesh.num_vertices())?;
    for axis in ["x", "y", "z"] {
        writeln!(
            out,
            "property {} {axis}",
            if is_far { "double" } else { "float" }
        )?;
    }
    for channel in ["red", "green", "blue"] {
        writeln!(out, "property uchar {channel}")?;
    }
    writeln!(out, "element face {}", mesh.num_triangles())?;
    writeln!(out, "property list uchar int vertex_indices")?;
    writeln!(out, "property list uchar float texcoord")?;
    writeln!(out, "property int texnumber\nend_header")
}

/// sRGB colour per mesh vertex.
pub fn vertex_srgb(textured: &TexturedMesh<'_>) -> Vec<[u8; 3]> {
    let mesh = textured.mesh();
    let mut sums = vec![([0f32; 3], 0u32); mesh.num_vertices()];
    for (triangle, corners) in mesh.triangle_ids().zip(mesh.triangles()) {
        let page = &textured.texture().pages[textured.layout().page_of(triangle) as usize];
        let texels = textured.corner_texels(triangle);
        for (&vertex, [x, y]) in corners.iter().zip(texels) {
            let srgb = page.srgb[y as usize * page.width as usize + x as usize];
            let (sum, count) = &mut sums[vertex as usize];
            for (total, byte) in sum.iter_mut().zip(srgb) {
                *total += linear_from_srgb(byte);
            }
            *count += 1;
        }
    }
    sums.iter()
        .map(|&(sum, count)| match count {
            0 => UNUSED_SRGB,
            _ => sum.map(|total| srgb_from_linear(total / count as f32)),
        })
        .collect()
}
