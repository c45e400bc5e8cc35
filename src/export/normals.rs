//! Vertex normals for shading, area-weighted.
//!
//! Vertices at the same place share one normal, so that neither texture seams nor vertices that
//! were duplicated to make the mesh manifold show as creases.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::mesh::{TriMesh, TriangleId};

/// Which normals a file carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NormalMode {
    /// One per place: the area-weighted mean of the triangles that meet there.
    Smooth,
    /// One per triangle; vertices are not shared.
    Flat,
}

/// Where triangles have no area, or cancel out.
const FALLBACK: [f32; 3] = [0.0, 0.0, 1.0];

/// Unit normals per mesh vertex; vertices that no triangle gives a direction get +z.
pub fn smooth_normals(mesh: &TriMesh) -> Vec<[f32; 3]> {
    let place_of_vertex = weld_by_position(mesh);
    let mut sums = vec![Vector3::<f64>::zeros(); mesh.num_vertices()];
    for (triangle, corners) in mesh.triangle_ids().zip(mesh.triangles()) {
        let scaled_normal = mesh.scaled_normal(triangle);
        for &vertex in corners {
            sums[place_of_vertex[vertex as usize] as usize] += scaled_normal;
        }
    }
    place_of_vertex
        .iter()
        .map(|&place| unit(&sums[place as usize]))
        .collect()
}

/// Unit normal of a triangle; +z where it has no area.
pub fn flat_normal(mesh: &TriMesh, triangle: TriangleId) -> [f32; 3] {
    unit(&mesh.scaled_normal(triangle))
}

#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
fn unit(sum: &Vector3<f64>) -> [f32; 3] {
    sum.try_normalize(f64::MIN_POSITIVE)
        .filter(|n| n.iter().all(|c| c.is_finite()))
        .map_or(FALLBACK, |n| [n.x as f32, n.y as f32, n.z as f32])
}

/// Per vertex: the first vertex with bit for bit the same position.
fn weld_by_position(mesh: &TriMesh) -> Vec<u32> {
    let mut keyed: Vec<([u64; 3], u32)> = mesh
        .positions_m()
        .iter()
        .zip(0u32..)
        .map(|(p, vertex)| ([p.x, p.y, p.z].map(|c| (c + 0.0).to_bits()), vertex))
        .collect();
    keyed.par_sort_unstable();
    let mut place_of_vertex = vec![0; keyed.len()];
    for group in keyed.chunk_by(|a, b| a.0 == b.0) {
        for &(_, vertex) in group {
            place_of_vertex[vertex as usize] = group[0].1;
        }
    }
    place_of_vertex
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn a_duplicated_vertex_has_the_normal_of_its_place() {
        // A ridge of two faces at a right angle; the ridge's vertices exist twice.
        let positions = [
            [0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, -1.0],
        ];
        let positions = positions.map(|[x, y, z]| Point3::new(x, y, z)).to_vec();
        let (mesh, _) = TriMesh::from_soup(positions, vec![[0, 2, 1], [3, 4, 5]]).unwrap();
        let normals = smooth_normals(&mesh);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        for vertex in [0, 1, 3, 4] {
            let [x, y, z] = normals[vertex];
            assert!((x + half).abs() < 1e-6 && y.abs() < 1e-6 && (z - half).abs() < 1e-6);
        }
        assert_eq!(normals[2], [0.0, 0.0, 1.0]);
        assert_eq!(flat_normal(&mesh, TriangleId(1)), [-1.0, 0.0, 0.0]);
    }

    #[test]
    fn zero_area_and_tiny_triangles_still_have_unit_normals() {
        let positions = [[0.0; 3], [1e-150, 0.0, 0.0], [0.0, 1e-150, 0.0], [2.0; 3]];
        let positions = positions.map(|[x, y, z]| Point3::new(x, y, z)).to_vec();
        let (mesh, _) = TriMesh::from_soup(positions, vec![[0, 1, 2], [3, 3, 0]]).unwrap();
        for [x, y, z] in smooth_normals(&mesh) {
            assert!(((x * x + y * y + z * z) - 1.0).abs() < 1e-6);
        }
    }
}
