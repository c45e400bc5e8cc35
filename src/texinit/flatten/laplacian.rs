//! Edge lengths, angles and the cotangent Laplacian of a disk.
//!
//! The Laplacian `A` is the positive semi-definite one with the factor ½:
//! `A_ij = -½ (cot α_ij + cot β_ij)` for an edge with opposite angles α and β (one of them at the
//! boundary), `A_ii = -Σ_j A_ij`; so `½ xᵀ A x` is the Dirichlet energy of `x`, and `A x` is
//! `-∫ φ_i Δx` inside.
//!
//! Everything is intrinsic and in units of the mean edge length. Slivers are made safe by
//! mollification (Sharp and Crane 2020, "A Laplacian for nonmanifold triangle meshes", §4.5): one
//! length ε is added to all edges, the least one with which every triangle inequality holds by
//! [`MIN_SLACK`]. It is zero unless some triangle is nearly collinear. Weights may be negative;
//! `A` stays semi-definite since every triangle is a true one.

use nalgebra::Point3;

use crate::mesh::adjacency::NO_HALF_EDGE;

/// Least excess of two sides over the third, in mean edge lengths.
const MIN_SLACK: f64 = 1e-5;

/// Lengths and angles of a disk; corner `k` of a triangle is opposite to its side `(k + 1) % 3`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Metric {
    /// Metres per unit of length below.
    pub(crate) unit_m: f64,
    /// Per triangle the length of side `k`, from corner `k` to the next.
    pub(crate) lengths: Vec<[f64; 3]>,
    /// Per triangle the angle at corner `k`, radians.
    pub(crate) angles: Vec<[f64; 3]>,
    /// Per triangle the cotangent at corner `k`.
    pub(crate) cotangents: Vec<[f64; 3]>,
}

impl Metric {
    /// None when lengths are not finite or all zero.
    pub(crate) fn new(corners_m: &[[Point3<f64>; 3]]) -> Option<Self> {
        let mut lengths: Vec<[f64; 3]> = corners_m
            .iter()
            .map(|[a, b, c]| [(b - a).norm(), (c - b).norm(), (a - c).norm()])
            .collect();
        let num_sides = 3.0 * lengths.len() as f64;
        let unit_m = lengths.iter().flatten().map(|l| l / num_sides).sum::<f64>();
        if !unit_m.is_normal() {
            return None;
        }
        let mut added: f64 = 0.0;
        for sides in &mut lengths {
            *sides = sides.map(|l| l / unit_m);
            let perimeter: f64 = sides.iter().sum();
            for side in sides {
                added = added.max(MIN_SLACK - (perimeter - 2.0 * *side));
            }
        }
        let mut metric = Self {
            unit_m,
            angles: Vec::with_capacity(lengths.len()),
            cotangents: Vec::with_capacity(lengths.len()),
            lengths,
        };
        for sides in &mut metric.lengths {
            *sides = sides.map(|l| l + added);
            let [ab, bc, ca] = *sides;
            let four_areas = 4.0 * heron_area([ab, bc, ca]);
            let dots = [
                ca * ca + ab * ab - bc * bc,
                ab * ab + bc * bc - ca * ca,
                bc * bc + ca * ca - ab * ab,
            ];
            metric.angles.push(dots.map(|dot| four_areas.atan2(dot)));
            metric.cotangents.push(dots.map(|dot| dot / four_areas));
        }
        metric
            .cotangents
            .iter()
            .flatten()
            .all(|c| c.is_finite())
            .then_some(metric)
    }
}

/// Area by Kahan's stable form of Heron's formula.
fn heron_area(mut sides: [f64; 3]) -> f64 {
    sides.sort_unstable_by(|x, y| y.total_cmp(x));
    let [a, b, c] = sides;
    let product = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c));
    0.25 * product.max(0.0).sqrt()
}

/// The off-diagonal weights of `A`: each edge once, as (vertex, vertex, ½ Σ cot).
pub(crate) fn edge_weights(
    mates: &[u32],
    vertices: &[[u32; 3]],
    metric: &Metric,
) -> Vec<(u32, u32, f64)> {
    let opposite = |h: u32| metric.cotangents[h as usize / 3][(h as usize % 3 + 2) % 3];
    let mut weights = Vec::with_capacity(mates.len() / 2 + 1);
    for (h, &mate) in (0_u32..).zip(mates) {
        let across = match mate {
            NO_HALF_EDGE => 0.0,
            mate if mate < h => continue,
            mate => opposite(mate),
        };
        let corners = vertices[h as usize / 3];
        let k = h as usize % 3;
        let [a, b] = [corners[k], corners[(k + 1) % 3]];
        if a != b {
            weights.push((a, b, 0.5 * (opposite(h) + across)));
        }
    }
    weights
}
