//! What chart growing asks of a triangle: centroid, area, and a normal without the sensor's noise.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::mesh::adjacency::NO_HALF_EDGE;
use crate::mesh::{Manifold, TriMesh, TriangleId};

/// Per triangle of the mesh.
pub(crate) struct Faces {
    /// Metres.
    pub(crate) centroids_m: Vec<Point3<f64>>,
    /// m².
    pub(crate) areas_m2: Vec<f64>,
    /// Unit normal averaged over the neighbourhood; zero where there is none.
    pub(crate) normals: Vec<Vector3<f64>>,
    /// Per triangle, lengths of its oriented sides, metres.
    pub(crate) side_lengths_m: Vec<[f64; 3]>,
}

impl Faces {
    /// Normals are weighted by area and averaged with the neighbours' `num_smoothing_rounds` times.
    pub(crate) fn new(mesh: &TriMesh, manifold: &Manifold, num_smoothing_rounds: u32) -> Self {
        let ids: Vec<TriangleId> = mesh.triangle_ids().collect();
        let corners: Vec<[Point3<f64>; 3]> = ids
            .par_iter()
            .map(|&t| manifold.oriented_corners_m(mesh, t))
            .collect();
        let area_vectors: Vec<Vector3<f64>> = corners
            .par_iter()
            .map(|[a, b, c]| finite_or_zero(0.5 * (b - a).cross(&(c - a))))
            .collect();
        let mut smooth = area_vectors.clone();
        for _ in 0..num_smoothing_rounds {
            smooth = (0..smooth.len())
                .into_par_iter()
                .map(|t| {
                    let mut sum = smooth[t];
                    for &mate in &manifold.mates()[3 * t..3 * t + 3] {
                        if mate != NO_HALF_EDGE {
                            sum += smooth[mate as usize / 3];
                        }
                    }
                    0.25 * sum
                })
                .collect();
        }
        Self {
            centroids_m: corners
                .iter()
                .map(|[a, b, c]| {
                    Point3::from(finite_or_zero((a.coords + b.coords + c.coords) / 3.0))
                })
                .collect(),
            areas_m2: area_vectors.iter().map(Vector3::norm).collect(),
            normals: smooth
                .iter()
                .map(|n| finite_or_zero(n.try_normalize(0.0).unwrap_or_default()))
                .collect(),
            side_lengths_m: corners
                .iter()
                .map(|[a, b, c]| [(b - a).norm(), (c - b).norm(), (a - c).norm()])
                .collect(),
        }
    }
}

fn finite_or_zero(v: Vector3<f64>) -> Vector3<f64> {
    if v.iter().all(|c| c.is_finite()) {
        v
    } else {
        Vector3::zeros()
    }
}
