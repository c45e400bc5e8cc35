//! Loop subdivision: each triangle becomes four, and vertices move to where the limit surface is
//! smooth (Loop 1987, "Smooth subdivision surfaces based on triangles"; borders as in Hoppe et al.
//! 1994, "Piecewise smooth surface reconstruction").
//!
//! The published program of the paper subdivides its meshes once before it flattens them, and the
//! paper's face counts are those after it. It rounds the scan's corners, so it is off by default.
//!
//! Vertices are shared where triangles name the same index. An edge with other than two faces is a
//! border: its new vertex is its middle, and a vertex between two borders follows the border's
//! curve; a vertex with one border or more than two stays where it is. So any soup can be
//! subdivided, and what hangs together keeps doing so.

use nalgebra::{Point3, Vector3};

use super::adjacency::EdgeTable;
use super::tri_mesh::{MeshError, TriMesh};

/// `mesh` after `num_rounds` of subdivision. Triangle `t` of a round becomes `4 t … 4 t + 3`: its
/// three corners, then its middle; orientation is kept. Time and memory are linear in the result.
///
/// # Errors
/// [`MeshError::TooLarge`] when 32 bits cannot number the result.
pub fn subdivide(mesh: &TriMesh, num_rounds: u32) -> Result<TriMesh, MeshError> {
    let mut fine = mesh.clone();
    for _ in 0..num_rounds {
        fine = subdivide_once(&fine)?;
    }
    Ok(fine)
}

fn subdivide_once(mesh: &TriMesh) -> Result<TriMesh, MeshError> {
    let (old, triangles) = (mesh.positions_m(), mesh.triangles());
    let table = EdgeTable::new(triangles, old.len())?;
    let num_vertices = old.len() + table.num_edges();
    let too_large = MeshError::TooLarge {
        num_vertices,
        num_triangles: triangles.len().saturating_mul(4),
    };
    let first_new = u32::try_from(old.len()).map_err(|_| too_large.clone())?;
    u32::try_from(num_vertices).map_err(|_| too_large)?;

    let mut neighborhoods = vec![Neighborhood::default(); old.len()];
    let mut middle_of_side: Vec<[u32; 3]> = triangles.to_vec();
    let mut positions_m = old.to_vec();
    for (middle, half_edges) in (first_new..).zip(table.edges()) {
        let (triangle, k) = side(half_edges[0]);
        let [a, b] = [triangles[triangle][k], triangles[triangle][(k + 1) % 3]];
        let [start, end] = [a, b].map(|v| old[v as usize]);
        let is_border = half_edges.len() != 2;
        neighborhoods[a as usize].add(end, is_border);
        neighborhoods[b as usize].add(start, is_border);
        let ends = start.coords + end.coords;
        let position = if is_border {
            0.5 * ends
        } else {
            let tips = half_edges.iter().map(|&h| {
                let (triangle, k) = side(h);
                old[triangles[triangle][(k + 2) % 3] as usize].coords
            });
            0.375 * ends + 0.125 * tips.sum::<Vector3<f64>>()
        };
        positions_m.push(Point3::from(position));
        for &h in half_edges {
            let (triangle, k) = side(h);
            middle_of_side[triangle][k] = middle;
        }
    }
    for (position, neighborhood) in positions_m.iter_mut().zip(&neighborhoods) {
        *position = neighborhood.smooth(*position);
    }
    let fine = triangles
        .iter()
        .zip(&middle_of_side)
        .flat_map(|(&[a, b, c], &[ab, bc, ca])| {
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        })
        .collect();
    Ok(TriMesh::from_soup(positions_m, fine)?.0)
}

/// Triangle and corner that a half-edge starts at.
fn side(half_edge: u32) -> (usize, usize) {
    (half_edge as usize / 3, half_edge as usize % 3)
}

/// What lies around a vertex.
#[derive(Clone, Copy, Default)]
struct Neighborhood {
    sum_m: Vector3<f64>,
    num_neighbors: u32,
    border_sum_m: Vector3<f64>,
    num_borders: u32,
}

impl Neighborhood {
    fn add(&mut self, neighbor: Point3<f64>, is_border: bool) {
        self.sum_m += neighbor.coords;
        self.num_neighbors += 1;
        if is_border {
            self.border_sum_m += neighbor.coords;
            self.num_borders += 1;
        }
    }

    fn smooth(&self, position: Point3<f64>) -> Point3<f64> {
        match self.num_borders {
            0 if self.num_neighbors > 2 => {
                let num = f64::from(self.num_neighbors);
                let turn = 0.375 + 0.25 * (std::f64::consts::TAU / num).cos();
                let share = 0.625 - turn * turn;
                Point3::from((1.0 - share) * position.coords + share / num * self.sum_m)
            }
            2 => Point3::from(0.75 * position.coords + 0.125 * self.border_sum_m),
            _ => position,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mesh(positions: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> TriMesh {
        let positions = positions.into_iter().map(Point3::from).collect();
        TriMesh::from_soup(positions, triangles).unwrap().0
    }

    /// A tetrahedron's vertices have three neighbours: β·3 = 5/8 − (3/8 − 1/8)² = 9/16.
    #[test]
    fn a_tetrahedron_has_loops_weights() {
        let corners = vec![
            [1.0, 1.0, 1.0],
            [1.0, -1.0, -1.0],
            [-1.0, 1.0, -1.0],
            [-1.0, -1.0, 1.0],
        ];
        let faces = vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]];
        let fine = subdivide(&mesh(corners, faces), 1).unwrap();
        assert_eq!((fine.num_vertices(), fine.num_triangles()), (10, 16));
        // 7/16 of the vertex, and the neighbours' mean is minus a third of it.
        let expected = 7.0 / 16.0 - 9.0 / 16.0 / 3.0;
        assert!((fine.positions_m()[0].x - expected).abs() < 1e-15);
        // The edge 0–1: 3/8 of (2, 0, 0), 1/8 of the other two, which are (−2, 0, 0).
        let middle = fine.positions_m()[4];
        assert!(
            (middle.x - 0.5).abs() < 1e-15 && middle.y.abs() < 1e-15,
            "{middle}"
        );
    }

    #[test]
    fn a_plane_stays_a_plane_and_its_border_a_line() {
        let n = 5_u32;
        let positions = (0..n * n)
            .map(|i| [f64::from(i % n), f64::from(i / n), 0.5])
            .collect();
        let faces = (0..n - 1)
            .flat_map(|j| (0..n - 1).map(move |i| (n * j + i, n * j + i + 1)))
            .flat_map(|(a, b)| [[a, b, b + n], [a, b + n, a + n]])
            .collect();
        let coarse = mesh(positions, faces);
        let fine = subdivide(&coarse, 2).unwrap();
        assert_eq!(fine.num_triangles(), 16 * coarse.num_triangles());
        assert!(fine.positions_m().iter().all(|p| p.z == 0.5));
        let lowest = fine.positions_m().iter().map(|p| p.y).fold(1.0, f64::min);
        assert_eq!(lowest, 0.0);
        assert!(fine.triangle_ids().all(|t| fine.scaled_normal(t).z > 0.0));
    }

    proptest! {
        #[test]
        fn any_soup_is_subdivided(
            triangles in proptest::collection::vec(proptest::array::uniform3(0_u32..7), 0..40)
        ) {
            let positions = (0..7)
                .map(|i| [f64::from(i).sin(), f64::from(2 * i).cos(), f64::from(i * i).sin()])
                .collect();
            let coarse = mesh(positions, triangles);
            let fine = subdivide(&coarse, 1).unwrap();
            prop_assert_eq!(fine.num_triangles(), 4 * coarse.num_triangles());
            // Every new vertex is an average of old ones.
            let extent = |m: &TriMesh| m.positions_m().iter().map(|p| p.coords.amax()).fold(0.0, f64::max);
            prop_assert!(extent(&fine) <= extent(&coarse) + 1e-12);
        }
    }
}
