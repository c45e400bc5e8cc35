//! What step is left, halved onto both sides within a narrow band.

use nalgebra::Point3;

use crate::atlas::AtlasTexture;
use crate::mesh::TriangleId;

use super::SeamParams;
use super::nodes::{NO_NODE, Nodes};
use super::samples::{Seam, Side};
use super::surface::Surface;

/// The band is at most this share of the mean edge: triangles that touch no seam are not looked at.
const MAX_BAND_SHARE: f64 = 0.6;

/// A seam as one of its sides is corrected along it.
struct Stretch {
    start_m: Point3<f64>,
    end_m: Point3<f64>,
    /// What is added at (k + ½) / n of the way.
    added: Vec<[f32; 3]>,
}

impl Stretch {
    /// A side that stands has what was added to it; one beside such a side makes up for the whole of
    /// what is left; others for half of the step.
    fn new(surface: &Surface<'_>, seam: &Seam, side: usize) -> Option<Self> {
        let taken = |side: usize| taken(surface, seam, side);
        let added = match (surface.standing(seam.sides[side].triangle), taken(1 - side)) {
            (Some(_), _) => {
                let is_any = |added: &Vec<[f32; 3]>| added.iter().flatten().any(|a| *a != 0.0);
                taken(side).filter(is_any)?
            }
            (None, None) => {
                let sign = if side == 0 { 0.5 } else { -0.5 };
                smoothed(&filled(&seam.steps)?, sign)
            }
            (None, Some(others)) => {
                let sign = if side == 0 { 1.0 } else { -1.0 };
                let mut added = smoothed(&filled(&seam.steps)?, sign);
                for (added, other) in added.iter_mut().flatten().zip(others.iter().flatten()) {
                    *added += other;
                }
                added
            }
        };
        let positions_m = surface.mesh.positions_m();
        let [start_m, end_m] = seam.ends.map(|v| positions_m[v as usize]);
        Some(Self {
            start_m,
            end_m,
            added,
        })
    }

    /// Squared distance, and what is added at the nearest point.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and the number of samples"
    )]
    fn nearest(&self, point_m: &Point3<f64>) -> (f64, [f32; 3]) {
        let along = self.end_m - self.start_m;
        let length_m2 = along.norm_squared().max(f64::MIN_POSITIVE);
        let share = ((point_m - self.start_m).dot(&along) / length_m2).clamp(0.0, 1.0);
        let distance_m2 = (self.start_m + along * share - point_m).norm_squared();
        let last = self.added.len() - 1;
        let at = (share * self.added.len() as f64 - 0.5).clamp(0.0, last as f64);
        let before = at as usize;
        let after = (before + 1).min(last);
        let part = (at - before as f64) as f32;
        let mix = |c: usize| self.added[before][c] * (1.0 - part) + self.added[after][c] * part;
        (distance_m2, std::array::from_fn(mix))
    }
}

/// What was added to a side that stands, at the seam's samples in its direction; `None` for one that
/// does not stand.
fn taken(surface: &Surface<'_>, seam: &Seam, side: usize) -> Option<Vec<[f32; 3]>> {
    let Side { triangle, corners } = seam.sides[side];
    let levelled = surface.standing(triangle)?;
    let num_samples = seam.steps.len();
    let along = levelled.map_or(&[][..], |levelled| levelled.along(corners));
    let is_forward = corners[1] == (corners[0] + 1) % 3;
    let sample = |k: usize| {
        let k = if is_forward { k } else { num_samples - 1 - k };
        // The number of samples follows the longer of two sides, whose texels may be others by now.
        let nearest = (2 * k + 1) * along.len() / (2 * num_samples);
        along.get(nearest).copied().unwrap_or([0.0; 3])
    };
    Some((0..num_samples).map(sample).collect())
}

/// Each step mixed with those beside it, times `sign`.
fn smoothed(steps: &[[f32; 3]], sign: f32) -> Vec<[f32; 3]> {
    let last = steps.len() - 1;
    let mixed = |k: usize| {
        let (before, after) = (&steps[k.saturating_sub(1)], &steps[(k + 1).min(last)]);
        std::array::from_fn(|c| sign * 0.25 * (before[c] + 2.0 * steps[k][c] + after[c]))
    };
    (0..steps.len()).map(mixed).collect()
}

/// Unknown steps taken from the nearest known one; `None` when all are unknown.
fn filled(steps: &[Option<[f32; 3]>]) -> Option<Vec<[f32; 3]>> {
    let mut current = *steps.iter().flatten().next()?;
    let forward = steps.iter().map(|step| {
        current = step.unwrap_or(current);
        current
    });
    Some(forward.collect())
}

/// Levels the bands; returns how many texels changed. `keep` is shown what is added along a side: the
/// triangle, its corners at the ends, and the colours from the first corner on.
pub(super) fn level(
    surface: &Surface<'_>,
    nodes: &Nodes,
    seams: &[Seam],
    params: &SeamParams,
    keep: &mut dyn FnMut(&Side, &[[f32; 3]]),
    texture: &mut AtlasTexture,
) -> usize {
    let mesh = surface.mesh;
    let mut stretches = Vec::with_capacity(2 * seams.len());
    // (node, stretch), so that a triangle finds the seams at its corners.
    let mut at_node: Vec<(u32, u32)> = Vec::with_capacity(4 * seams.len());
    for seam in seams {
        for (index, side) in seam.sides.iter().enumerate() {
            let Some(stretch) = Stretch::new(surface, seam, index) else {
                continue;
            };
            keep(side, &stretch.added);
            #[expect(clippy::cast_possible_truncation, reason = "fewer than half-edges")]
            let number = stretches.len() as u32;
            stretches.push(stretch);
            let corners = nodes.of(side.triangle);
            at_node.extend(side.corners.map(|k| (corners[k], number)));
        }
    }
    at_node.sort_unstable();
    let band_m = band_m(surface, params);
    surface.paint(texture, |triangle| {
        let corners = nodes.of(triangle);
        let mut near: Vec<u32> = corners
            .into_iter()
            .filter(|node| *node != NO_NODE)
            .flat_map(|node| {
                let first = at_node.partition_point(|entry| entry.0 < node);
                at_node[first..]
                    .iter()
                    .take_while(move |entry| entry.0 == node)
            })
            .map(|entry| entry.1)
            .collect();
        near.sort_unstable();
        near.dedup();
        if near.is_empty() {
            return None;
        }
        let corners_m = mesh.corners_m(TriangleId(triangle));
        let near: Vec<&Stretch> = near.iter().map(|n| &stretches[*n as usize]).collect();
        Some(move |weights: [f32; 3]| {
            let [a, b, c] = weights.map(f64::from);
            let point_m = Point3::from(
                corners_m[0].coords * a + corners_m[1].coords * b + corners_m[2].coords * c,
            );
            faded(&near, &point_m, band_m)
        })
    })
}

/// What is added at a point: the stretches' corrections, weighted by nearness, fading with the
/// distance to the nearest.
fn faded(stretches: &[&Stretch], point_m: &Point3<f64>, band_m: f64) -> Option<[f32; 3]> {
    let softness_m2 = (0.05 * band_m).powi(2);
    let mut nearest_m2 = f64::INFINITY;
    let mut total = 0.0;
    let mut sum = [0.0; 3];
    for stretch in stretches {
        let (distance_m2, added) = stretch.nearest(point_m);
        nearest_m2 = nearest_m2.min(distance_m2);
        let weight = 1.0 / (distance_m2 + softness_m2);
        total += weight;
        for c in 0..3 {
            sum[c] += weight * f64::from(added[c]);
        }
    }
    let left = 1.0 - nearest_m2.sqrt() / band_m;
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    (left > 0.0).then(|| {
        let fade = left * left * (3.0 - 2.0 * left);
        sum.map(|sum| (fade * sum / total) as f32)
    })
}

fn band_m(surface: &Surface<'_>, params: &SeamParams) -> f64 {
    let mesh = surface.mesh;
    let texels_per_m = surface.layout.texels_per_m.max(f64::MIN_POSITIVE);
    let mut area_m2 = 0.0;
    for triangle in mesh.triangle_ids() {
        area_m2 += mesh.area_m2(triangle);
    }
    // The side of an equilateral triangle of mean area.
    let side_m = (4.0 / 3.0_f64.sqrt() * area_m2 / mesh.num_triangles().max(1) as f64).sqrt();
    (params.band_texel / texels_per_m)
        .min(MAX_BAND_SHARE * side_m)
        .max(f64::MIN_POSITIVE)
}
