//! Merging of vertices at one place, so that block meshes and triangle soups become connected.
//!
//! Triangles keep their order and number; a triangle two of whose vertices merge stays, with a
//! repeated index. Kept vertices stay in the order of their first occurrence. O(n log n).

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::tri_mesh::{MeshError, TriMesh};

/// Why a weld was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WeldError {
    /// The tolerance is negative or not finite.
    #[error("weld tolerance of {tolerance_m} m is not a finite length")]
    InvalidTolerance {
        /// As given.
        tolerance_m: f64,
    },
    /// The welded mesh was refused.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// A welded mesh and where the old vertices went.
#[derive(Debug, Clone, PartialEq)]
pub struct Welded {
    /// The mesh with merged vertices.
    pub mesh: TriMesh,
    /// Per old vertex: its index in the new mesh.
    pub new_from_old: Vec<u32>,
    /// How many vertices were merged into another.
    pub num_merged: usize,
}

/// Merges vertices closer than `tolerance_m` (0: of equal position, `-0.0` being `0.0`).
///
/// With a tolerance, vertices are taken in order and each joins the nearest earlier kept vertex
/// within reach, else is kept: no chain longer than the tolerance forms.
///
/// # Errors
/// [`WeldError`] when the tolerance is not a finite length.
pub fn weld(mesh: &TriMesh, tolerance_m: f64) -> Result<Welded, WeldError> {
    if !tolerance_m.is_finite() || tolerance_m < 0.0 {
        return Err(WeldError::InvalidTolerance { tolerance_m });
    }
    let new_from_old = if has_room_for_grid(mesh.positions_m(), tolerance_m) {
        near_representatives(mesh.positions_m(), tolerance_m)
    } else {
        equal_representatives(mesh.positions_m())
    };
    let (new_from_old, kept) = compact(&new_from_old);
    let positions_m: Vec<_> = kept
        .iter()
        .map(|&v| mesh.positions_m()[v as usize])
        .collect();
    let num_merged = mesh.num_vertices() - positions_m.len();
    let triangles = mesh
        .triangles()
        .iter()
        .map(|corners| corners.map(|v| new_from_old[v as usize]))
        .collect();
    let (mesh, _) = TriMesh::from_soup(positions_m, triangles)?;
    Ok(Welded {
        mesh,
        new_from_old,
        num_merged,
    })
}

/// Per vertex, the first vertex of equal position.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a mesh has fewer than 2^32 vertices"
)]
pub(crate) fn equal_representatives(positions_m: &[Point3<f64>]) -> Vec<u32> {
    // Adding zero turns -0.0 into 0.0.
    let mut order: Vec<([u64; 3], u32)> = positions_m
        .iter()
        .enumerate()
        .map(|(v, p)| ([p.x, p.y, p.z].map(|c| (c + 0.0).to_bits()), v as u32))
        .collect();
    order.sort_unstable();
    let mut representative = vec![0; positions_m.len()];
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        for &(_, vertex) in group {
            representative[vertex as usize] = group[0].1;
        }
    }
    representative
}

/// A grid of this pitch resolves the coordinates; otherwise the tolerance is below their rounding.
fn has_room_for_grid(positions_m: &[Point3<f64>], tolerance_m: f64) -> bool {
    const MAX_CELL: f64 = 4.0e15;
    tolerance_m > 0.0
        && positions_m
            .iter()
            .all(|p| p.coords.amax() / tolerance_m < MAX_CELL)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "has_room_for_grid bounds the cells, TriMesh the vertices"
)]
fn near_representatives(positions_m: &[Point3<f64>], tolerance_m: f64) -> Vec<u32> {
    let mut kept_in_cell: BTreeMap<[i64; 3], Vec<u32>> = BTreeMap::new();
    let mut representative = Vec::with_capacity(positions_m.len());
    for (vertex, position) in positions_m.iter().enumerate() {
        let cell = [position.x, position.y, position.z].map(|c| (c / tolerance_m).floor() as i64);
        let mut nearest: Option<(f64, u32)> = None;
        for dx in -1..=1 {
            for dy in -1..=1 {
                let low = [cell[0] + dx, cell[1] + dy, cell[2] - 1];
                let high = [low[0], low[1], cell[2] + 1];
                for &other in kept_in_cell.range(low..=high).flat_map(|(_, kept)| kept) {
                    let distance = (positions_m[other as usize] - position).norm();
                    if distance <= tolerance_m
                        && nearest.is_none_or(|best| (distance, other) < best)
                    {
                        nearest = Some((distance, other));
                    }
                }
            }
        }
        representative.push(if let Some((_, other)) = nearest {
            other
        } else {
            kept_in_cell.entry(cell).or_default().push(vertex as u32);
            vertex as u32
        });
    }
    representative
}

/// Numbers the representatives in order: (new index per old vertex, old index per new vertex).
#[expect(
    clippy::cast_possible_truncation,
    reason = "a mesh has fewer than 2^32 vertices"
)]
fn compact(representative: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let mut kept = Vec::new();
    let mut new_from_old = vec![0; representative.len()];
    for (vertex, &first) in representative.iter().enumerate() {
        if first as usize == vertex {
            new_from_old[vertex] = kept.len() as u32;
            kept.push(first);
        } else {
            new_from_old[vertex] = new_from_old[first as usize];
        }
    }
    (new_from_old, kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn soup(positions: &[[f64; 3]], triangles: Vec<[u32; 3]>) -> TriMesh {
        let positions = positions.iter().map(|&p| Point3::from(p)).collect();
        TriMesh::from_soup(positions, triangles).unwrap().0
    }

    #[test]
    fn two_triangles_of_a_soup_share_an_edge_afterwards() {
        let mesh = soup(
            &[
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [1.0, 0.0, -0.0],
                [1.0, 1.0, 0.0],
                [-0.0, 1.0, 0.0],
            ],
            vec![[0, 1, 2], [3, 4, 5]],
        );
        let welded = weld(&mesh, 0.0).unwrap();
        assert_eq!(welded.mesh.triangles(), &[[0, 1, 2], [1, 3, 2]]);
        assert_eq!(welded.new_from_old, vec![0, 1, 2, 1, 3, 2]);
        assert_eq!(welded.num_merged, 2);
    }

    #[test]
    fn tolerance_does_not_chain() {
        let line: Vec<[f64; 3]> = (0..10).map(|i| [0.6 * f64::from(i), 0.0, 0.0]).collect();
        let welded = weld(&soup(&line, vec![]), 1.0).unwrap();
        for (old, &new) in welded.new_from_old.iter().enumerate() {
            let moved = (welded.mesh.positions_m()[new as usize] - Point3::from(line[old])).norm();
            assert!(moved <= 1.0);
        }
        assert_eq!(welded.mesh.num_vertices(), 5);
    }

    #[test]
    fn a_tolerance_that_is_no_length_is_refused() {
        for tolerance_m in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(weld(&TriMesh::default(), tolerance_m).is_err());
        }
    }

    proptest! {
        /// Against all pairs: kept vertices are pairwise apart, merged ones within reach.
        #[test]
        fn agrees_with_all_pairs(
            points in proptest::collection::vec(proptest::array::uniform3(0_i32..8), 1..60),
            tolerance_m in prop_oneof![Just(0.0), Just(0.15), Just(0.3)],
        ) {
            let points: Vec<[f64; 3]> = points
                .iter()
                .map(|p| p.map(|c| 0.1 * f64::from(c)))
                .collect();
            let welded = weld(&soup(&points, vec![]), tolerance_m).unwrap();
            let kept = welded.mesh.positions_m();
            for (i, a) in kept.iter().enumerate() {
                for b in &kept[..i] {
                    prop_assert!((a - b).norm() > tolerance_m);
                }
            }
            for (old, &new) in welded.new_from_old.iter().enumerate() {
                let moved = (kept[new as usize] - Point3::from(points[old])).norm();
                prop_assert!(moved <= tolerance_m);
            }
        }
    }
}
