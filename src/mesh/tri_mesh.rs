//! An indexed triangle mesh whose indices are in range and whose positions are finite.
//!
//! Nothing else is promised: it may be non-manifold, have duplicate, reversed or zero-area
//! triangles, and vertices that no triangle uses.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use super::ids::TriangleId;

/// Why a mesh was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// A triangle names a vertex that is not there.
    #[error("triangle {triangle} uses vertex {index}, but the mesh has {num_vertices} vertices")]
    IndexOutOfRange {
        /// Which triangle.
        triangle: usize,
        /// The index as given.
        index: i64,
        /// How many vertices there are.
        num_vertices: usize,
    },
    /// The number of indices is not a multiple of three.
    #[error("{num_indices} triangle indices are not a multiple of 3")]
    IncompleteTriangle {
        /// How many indices there are.
        num_indices: usize,
    },
    /// More vertices or triangles than 32-bit indices can name.
    #[error("mesh of {num_vertices} vertices and {num_triangles} triangles is too large")]
    TooLarge {
        /// How many vertices there are.
        num_vertices: usize,
        /// How many triangles there are.
        num_triangles: usize,
    },
}

/// What [`TriMesh::from_soup`] left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SoupReport {
    /// Vertices with a NaN or infinite coordinate.
    pub num_non_finite_vertices: usize,
    /// Triangles that used one of them.
    pub num_dropped_triangles: usize,
}

/// An indexed triangle mesh, positions in metres in one frame that its owner names.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct TriMesh {
    /// Meshes of one surface may share them.
    positions_m: Arc<Vec<Point3<f64>>>,
    triangles: Vec<[u32; 3]>,
}

impl TriMesh {
    /// A mesh of finite vertices from any soup: triangles at a vertex that is not finite are left
    /// out and counted (the vertex itself stays, at the origin, so that indices keep their
    /// meaning). Triangle order is kept.
    ///
    /// # Errors
    /// [`MeshError`] when an index is out of range or the mesh is too large.
    pub fn from_soup(
        mut positions_m: Vec<Point3<f64>>,
        mut triangles: Vec<[u32; 3]>,
    ) -> Result<(Self, SoupReport), MeshError> {
        let num_vertices = positions_m.len();
        let num_triangles = triangles.len();
        if u32::try_from(num_vertices).is_err() || u32::try_from(num_triangles).is_err() {
            return Err(MeshError::TooLarge {
                num_vertices,
                num_triangles,
            });
        }
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&index) = corners.iter().find(|&&v| v as usize >= num_vertices) {
                return Err(MeshError::IndexOutOfRange {
                    triangle,
                    index: i64::from(index),
                    num_vertices,
                });
            }
        }
        let is_finite: Vec<bool> = positions_m
            .iter()
            .map(|p| p.coords.iter().all(|v| v.is_finite()))
            .collect();
        triangles.retain(|corners| corners.iter().all(|&v| is_finite[v as usize]));
        for (position, _) in positions_m
            .iter_mut()
            .zip(&is_finite)
            .filter(|(_, ok)| !**ok)
        {
            *position = Point3::origin();
        }
        let report = SoupReport {
            num_non_finite_vertices: is_finite.iter().filter(|ok| !**ok).count(),
            num_dropped_triangles: num_triangles - triangles.len(),
        };
        Ok((
            Self {
                positions_m: Arc::new(positions_m),
                triangles,
            },
            report,
        ))
    }

    /// A mesh of finite positions and of indices that are known to be in range.
    pub(super) fn of_parts(positions_m: Vec<Point3<f64>>, triangles: Vec<[u32; 3]>) -> Self {
        debug_assert!(
            triangles
                .as_flattened()
                .iter()
                .all(|&vertex| (vertex as usize) < positions_m.len()),
            "an index is out of range"
        );
        Self {
            positions_m: Arc::new(positions_m),
            triangles,
        }
    }

    /// Makes this a mesh of the vertices of another, which they share: the first triangles stay, `others` of
    /// the other mesh come after them. Those that stay name vertices of the other mesh.
    pub(crate) fn relist(
        &mut self,
        of: &Self,
        num_staying: usize,
        others: impl Iterator<Item = [u32; 3]>,
    ) {
        self.positions_m = Arc::clone(&of.positions_m);
        self.triangles.truncate(num_staying);
        self.triangles.extend(others);
        debug_assert!(
            (self.triangles.as_flattened().iter())
                .all(|&vertex| (vertex as usize) < self.positions_m.len()),
            "an index is out of range"
        );
    }

    /// Whether both are known, without a look at them, to have the same vertices.
    pub(super) fn shares_vertices(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.positions_m, &other.positions_m)
    }

    /// Vertex positions in metres.
    pub fn positions_m(&self) -> &[Point3<f64>] {
        &self.positions_m
    }

    /// Vertex indices of each triangle, counter-clockwise seen from outside.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// How many vertices there are.
    pub fn num_vertices(&self) -> usize {
        self.positions_m.len()
    }

    /// How many triangles there are.
    pub fn num_triangles(&self) -> usize {
        self.triangles.len()
    }

    /// All triangle ids, in order.
    pub fn triangle_ids(&self) -> impl ExactSizeIterator<Item = TriangleId> + use<> {
        #[expect(clippy::cast_possible_truncation, reason = "checked at construction")]
        let num_triangles = self.triangles.len() as u32;
        (0..num_triangles).map(TriangleId)
    }

    /// The corners of a triangle in metres.
    pub fn corners_m(&self, triangle: TriangleId) -> [Point3<f64>; 3] {
        self.triangles[triangle.index()].map(|v| self.positions_m[v as usize])
    }

    /// Normal of a triangle scaled by twice its area, m².
    pub fn scaled_normal(&self, triangle: TriangleId) -> Vector3<f64> {
        let [a, b, c] = self.corners_m(triangle);
        (b - a).cross(&(c - a))
    }

    /// Area of a triangle in m².
    pub fn area_m2(&self, triangle: TriangleId) -> f64 {
        0.5 * self.scaled_normal(triangle).norm()
    }

    /// The triangles that `keep` says yes to, and the vertices that they use, in their order.
    #[must_use]
    pub fn filtered(&self, keep: impl Fn(TriangleId) -> bool) -> Self {
        const UNUSED: u32 = u32::MAX;
        let kept: Vec<[u32; 3]> = self
            .triangle_ids()
            .filter(|&triangle| keep(triangle))
            .map(|triangle| self.triangles[triangle.index()])
            .collect();
        let mut new_of_old = vec![UNUSED; self.positions_m.len()];
        for &vertex in kept.iter().flatten() {
            new_of_old[vertex as usize] = 0;
        }
        let mut positions_m = Vec::new();
        for (new, position_m) in new_of_old.iter_mut().zip(&*self.positions_m) {
            if *new != UNUSED {
                #[expect(clippy::cast_possible_truncation, reason = "checked at construction")]
                let index = positions_m.len() as u32;
                *new = index;
                positions_m.push(*position_m);
            }
        }
        let renumbered = |corners: [u32; 3]| corners.map(|v| new_of_old[v as usize]);
        Self {
            positions_m: Arc::new(positions_m),
            triangles: kept.into_iter().map(renumbered).collect(),
        }
    }

    /// The same mesh in another frame.
    #[must_use]
    pub fn transformed(&self, dst_from_src: &crate::geom::RigidTransform) -> Self {
        let positions_m = self.positions_m.iter();
        let moved = positions_m.map(|p| dst_from_src.transform_point(p));
        Self {
            positions_m: Arc::new(moved.collect()),
            triangles: self.triangles.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Vec<Point3<f64>> {
        [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
            .map(|[x, y]| Point3::new(x, y, 0.0))
            .to_vec()
    }

    #[test]
    fn filtering_drops_vertices_that_nothing_uses() {
        let (mesh, _) = TriMesh::from_soup(square(), vec![[0, 1, 2], [0, 2, 3]]).expect("valid");
        let second = mesh.filtered(|triangle| triangle.0 == 1);
        assert_eq!(second.triangles(), [[0, 1, 2]]);
        assert_eq!(second.num_vertices(), 3);
        assert_eq!(
            second.corners_m(TriangleId(0)),
            mesh.corners_m(TriangleId(1))
        );
        assert_eq!(mesh.filtered(|_| true), mesh);
        assert_eq!(mesh.filtered(|_| false), TriMesh::default());
    }

    #[test]
    fn index_out_of_range_is_named() {
        let error = TriMesh::from_soup(square(), vec![[0, 1, 2], [0, 2, 4]]).unwrap_err();
        assert_eq!(
            error,
            MeshError::IndexOutOfRange {
                triangle: 1,
                index: 4,
                num_vertices: 4
            }
        );
    }

    #[test]
    fn triangles_at_a_nan_vertex_are_dropped_and_counted() {
        let mut positions = square();
        positions[3].y = f64::NAN;
        let (mesh, report) = TriMesh::from_soup(positions, vec![[0, 2, 3], [0, 1, 2]]).unwrap();
        assert_eq!(mesh.triangles(), &[[0, 1, 2]]);
        assert_eq!(mesh.area_m2(TriangleId(0)), 0.5);
        assert_eq!(
            report,
            SoupReport {
                num_non_finite_vertices: 1,
                num_dropped_triangles: 1
            }
        );
    }
}
