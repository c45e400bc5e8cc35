//! The part of the world that one of several nodes paints.
//!
//! Regions are boxes that hold their lower faces and not their upper ones, and a triangle belongs
//! where its centroid lies: of regions that tile space, exactly one has it. A region is painted
//! together with what lies within a halo around it, which hides what it hides and has a say in which
//! frame paints its neighbours, and what the halo shows is then left to the neighbour.

use std::cmp::Ordering;

use nalgebra::Point3;

use super::{TriMesh, TriangleId};

/// Why a box is no region.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RegionError {
    /// A side is empty, or a bound is not a number.
    #[error("along axis {axis} a region cannot reach from {min_m} m to {max_m} m")]
    Bounds {
        /// 0 for x, 1 for y, 2 for z.
        axis: usize,
        /// Lower bound.
        min_m: f64,
        /// Upper bound.
        max_m: f64,
    },
}

/// A box of the world frame, its lower faces included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    min_m: [f64; 3],
    max_m: [f64; 3],
}

impl Region {
    /// The box from `min_m` to `max_m`, metres in the world frame; bounds may be infinite.
    ///
    /// # Errors
    /// [`RegionError`] unless each lower bound is less than its upper one.
    pub fn new(min_m: [f64; 3], max_m: [f64; 3]) -> Result<Self, RegionError> {
        let is_side = |axis: usize| min_m[axis].partial_cmp(&max_m[axis]) == Some(Ordering::Less);
        match (0..3).find(|&axis| !is_side(axis)) {
            Some(axis) => Err(RegionError::Bounds {
                axis,
                min_m: min_m[axis],
                max_m: max_m[axis],
            }),
            None => Ok(Self { min_m, max_m }),
        }
    }

    /// Lower bounds, metres.
    pub fn min_m(&self) -> [f64; 3] {
        self.min_m
    }

    /// Upper bounds, metres.
    pub fn max_m(&self) -> [f64; 3] {
        self.max_m
    }

    /// Whether the point lies in the box.
    pub fn contains(&self, point_m: &Point3<f64>) -> bool {
        (0..3).all(|axis| (self.min_m[axis]..self.max_m[axis]).contains(&point_m[axis]))
    }

    /// Whether the triangle is this region's.
    pub fn owns(&self, mesh: &TriMesh, triangle: TriangleId) -> bool {
        let [a, b, c] = mesh.corners_m(triangle);
        self.contains(&Point3::from((a.coords + b.coords + c.coords) / 3.0))
    }

    /// Whether the triangle's bounding box comes within `halo_m` of the region.
    pub fn is_near(&self, mesh: &TriMesh, triangle: TriangleId, halo_m: f64) -> bool {
        let corners = mesh.corners_m(triangle);
        (0..3).all(|axis| {
            let along = corners.map(|corner| corner[axis]);
            let low = along.iter().copied().fold(f64::INFINITY, f64::min);
            let high = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            low < self.max_m[axis] + halo_m && high >= self.min_m[axis] - halo_m
        })
    }

    /// The triangles that come within `halo_m` of the region ([`Self::is_near`]), in their order.
    #[must_use]
    pub fn with_halo(&self, mesh: &TriMesh, halo_m: f64) -> TriMesh {
        mesh.filtered(|triangle| self.is_near(mesh, triangle, halo_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles of a seeded soup in the cube from −1 to 1, some with corners on the planes at 0.
    fn soup(num_triangles: usize) -> TriMesh {
        let mut state = 7u64;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        };
        let positions = (0..3 * num_triangles)
            .map(|i| {
                let point = Point3::new(next(), next(), next());
                if i % 7 == 0 {
                    Point3::new(0.0, point.y, point.z)
                } else {
                    point
                }
            })
            .collect();
        let triangles = (0..num_triangles)
            .map(|i| [3 * i, 3 * i + 1, 3 * i + 2].map(|v| u32::try_from(v).expect("small")))
            .collect();
        TriMesh::from_soup(positions, triangles).expect("valid").0
    }

    #[test]
    fn of_regions_that_tile_space_one_owns_each_triangle() {
        let mesh = soup(300);
        let (low, high) = (f64::NEG_INFINITY, f64::INFINITY);
        let halves = [[low, 0.0], [0.0, high]];
        let mut regions = Vec::new();
        for x in halves {
            for y in halves {
                let made = Region::new([x[0], y[0], low], [x[1], y[1], high]);
                regions.push(made.expect("not empty"));
            }
        }
        for triangle in mesh.triangle_ids() {
            let num_owners = regions.iter().filter(|r| r.owns(&mesh, triangle)).count();
            assert_eq!(num_owners, 1, "{triangle:?}");
        }
    }

    #[test]
    fn a_plane_belongs_to_the_upper_side() {
        let upper = Region::new([0.0, -1.0, -1.0], [1.0; 3]).expect("not empty");
        let lower = Region::new([-1.0; 3], [0.0, 1.0, 1.0]).expect("not empty");
        let on_plane = Point3::new(0.0, 0.0, 0.0);
        assert!(upper.contains(&on_plane) && !lower.contains(&on_plane));
    }

    #[test]
    fn the_halo_has_all_that_the_region_owns_and_what_is_near() {
        let mesh = soup(300);
        let region = Region::new([0.0, -0.3, -0.2], [0.5, 0.4, 0.6]).expect("not empty");
        let num_owned = |mesh: &TriMesh| {
            mesh.triangle_ids()
                .filter(|&t| region.owns(mesh, t))
                .count()
        };
        let near = region.with_halo(&mesh, 0.1);
        assert!(num_owned(&near) > 10);
        assert_eq!(num_owned(&near), num_owned(&mesh));
        assert!(near.num_triangles() > num_owned(&near));
        assert!(near.num_triangles() < mesh.num_triangles());
        let far = region.with_halo(&mesh, 10.0);
        assert_eq!(far.num_triangles(), mesh.num_triangles());
    }

    #[test]
    fn empty_boxes_are_refused() {
        let refused = Region::new([0.0, 2.0, 0.0], [1.0, 2.0, 1.0]);
        assert_eq!(
            refused,
            Err(RegionError::Bounds {
                axis: 1,
                min_m: 2.0,
                max_m: 2.0
            })
        );
        assert!(Region::new([f64::NAN, 0.0, 0.0], [1.0; 3]).is_err());
    }
}
