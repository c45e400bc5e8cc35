//! From corners to vertices that carry one texture coordinate each.
//!
//! glTF has one coordinate per vertex, so a mesh vertex on a seam becomes several. The order is
//! fixed: by mesh vertex, then by the bits of u and v (then by triangle, when normals are flat).

use rayon::prelude::*;

use crate::mesh::TriangleId;

use super::TexturedMesh;

/// The part of a mesh that lies on one page.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct PagePart {
    /// Mesh vertex that each split vertex stands for.
    pub vertex: Vec<u32>,
    /// Its coordinate in [0, 1] of the page, v down.
    pub uv: Vec<[f32; 2]>,
    /// Triangles of this page, as indices into the two lists above.
    pub triangles: Vec<[u32; 3]>,
    /// The mesh triangle of each.
    pub triangle_ids: Vec<TriangleId>,
}

/// What split vertices may share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// One per (vertex, uv).
    ByUv,
    /// One per corner: nothing is shared, so that each triangle has its own normal.
    PerTriangle,
}

/// Splits the mesh by page; pages without a triangle give an empty part.
pub fn split_by_page(textured: &TexturedMesh<'_>, sharing: Sharing) -> Vec<PagePart> {
    let num_pages = textured.layout().num_pages as usize;
    let mut triangles_of_page: Vec<Vec<TriangleId>> = vec![Vec::new(); num_pages];
    for triangle in textured.mesh().triangle_ids() {
        triangles_of_page[textured.layout().page_of(triangle) as usize].push(triangle);
    }
    triangles_of_page
        .into_par_iter()
        .map(|triangle_ids| split(textured, triangle_ids, sharing))
        .collect()
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Corner {
    vertex: u32,
    uv_bits: [u32; 2],
    owner: u32,
    position_in_list: u32,
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a mesh has at most 2^32 - 1 triangles; more than 2^32 corners need 100 GB first"
)]
fn split(textured: &TexturedMesh<'_>, triangle_ids: Vec<TriangleId>, sharing: Sharing) -> PagePart {
    let mut corners: Vec<Corner> = Vec::with_capacity(triangle_ids.len() * 3);
    for (in_part, &triangle) in triangle_ids.iter().enumerate() {
        let vertices = textured.mesh().triangles()[triangle.index()];
        let owner = match sharing {
            Sharing::ByUv => 0,
            Sharing::PerTriangle => in_part as u32,
        };
        for (corner, uv) in textured.corners_uv(triangle).iter().enumerate() {
            corners.push(Corner {
                vertex: vertices[corner],
                uv_bits: uv.map(f32::to_bits),
                owner,
                position_in_list: (in_part * 3 + corner) as u32,
            });
        }
    }
    corners.par_sort_unstable();
    let mut part = PagePart {
        triangles: vec![[0; 3]; triangle_ids.len()],
        triangle_ids,
        ..PagePart::default()
    };
    let mut previous: Option<Corner> = None;
    for corner in corners {
        let is_new = previous.is_none_or(|p| {
            (p.vertex, p.uv_bits, p.owner) != (corner.vertex, corner.uv_bits, corner.owner)
        });
        if is_new {
            part.vertex.push(corner.vertex);
            part.uv.push(corner.uv_bits.map(f32::from_bits));
        }
        let place = corner.position_in_list as usize;
        part.triangles[place / 3][place % 3] = part.vertex.len() as u32 - 1;
        previous = Some(corner);
    }
    part
}
