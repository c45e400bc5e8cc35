//! A gain per keyframe and channel.
//!
//! Unknowns: the logarithm of each frame's gain g_f and of each surface point's albedo a_p, per
//! channel. A frame shows the point in a_p + g_f, in linear light. Robust least squares: Cauchy's
//! weights, one per observation for its three channels, whose scale narrows from sweep to sweep;
//! albedos are eliminated, and the frames' normal equations solved by conjugate gradients. What
//! binds the solution that a common factor leaves open is a weak pull to gain 1; then gains have
//! mean logarithm 0.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::geom::color::{linear_table, srgb_from_linear};
use crate::geom::{ColorImage, ImageError};
use crate::keyframe::{DecodedFrame, Keyframe, KeyframeId};
use crate::mesh::TriMesh;
use crate::render::VisibilityParams;

use super::conjugate::{self, Stop};
use super::points::{Observation, observe, spread_points};
use super::{PhotometricError, check};

/// How gains are estimated.
#[derive(Clone, Debug, PartialEq)]
pub struct GainParams {
    /// Points of the surface that frames are compared at.
    pub num_points: usize,
    /// Half-width of the window whose mean is a point's colour, as a share of the image's width, in
    /// [0, 0.1].
    pub window_share: f64,
    /// Pixels with a darker channel are not used.
    pub min_byte: u8,
    /// Pixels with a brighter channel are not used.
    pub max_byte: u8,
    /// Least cosine between the view and the surface's normal, in (0, 1].
    pub min_cosine: f64,
    /// Differences of log light beyond this hardly count at the end (> 0).
    pub robust_scale: f64,
    /// Rounds of reweighting (≥ 1).
    pub num_sweeps: usize,
    /// How many samples at gain 1 each frame is given (> 0).
    pub prior_samples: f64,
    /// Largest logarithm of a gain, either way (≥ 0).
    pub max_log_gain: f64,
    /// Which points a frame sees.
    pub visibility: VisibilityParams,
}

impl Default for GainParams {
    fn default() -> Self {
        Self {
            num_points: 20_000,
            window_share: 0.004,
            min_byte: 8,
            max_byte: 247,
            min_cosine: 0.35,
            robust_scale: 0.05,
            num_sweeps: 12,
            prior_samples: 4.0,
            max_log_gain: std::f64::consts::LN_2,
            visibility: VisibilityParams::default(),
        }
    }
}

impl GainParams {
    fn check(&self) -> Result<(), PhotometricError> {
        check("gain points", self.num_points as f64, 1.0..=1e7)?;
        check("gain window share", self.window_share, 0.0..=0.1)?;
        check("gain least cosine", self.min_cosine, 1e-3..=1.0)?;
        check("gain robust scale", self.robust_scale, 1e-6..=1e3)?;
        check("gain sweeps", self.num_sweeps as f64, 1.0..=1000.0)?;
        check("gain prior", self.prior_samples, 1e-6..=1e9)?;
        check("gain bound", self.max_log_gain, 0.0..=10.0)
    }
}

/// What a photo's linear light is multiplied with, by keyframe and channel.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct GainTable {
    factors: BTreeMap<KeyframeId, [f32; 3]>,
}

impl GainTable {
    /// From factors by keyframe.
    pub fn new(factors: impl IntoIterator<Item = (KeyframeId, [f32; 3])>) -> Self {
        Self {
            factors: factors.into_iter().collect(),
        }
    }

    /// The factors of a keyframe; 1 for one that is not known.
    pub fn factors(&self, id: KeyframeId) -> [f32; 3] {
        self.factors.get(&id).copied().unwrap_or([1.0; 3])
    }

    /// Sets the factors of a keyframe.
    pub fn insert(&mut self, id: KeyframeId, factors: [f32; 3]) {
        self.factors.insert(id, factors);
    }

    /// Whether the keyframe's factors were set.
    pub fn contains(&self, id: KeyframeId) -> bool {
        self.factors.contains_key(&id)
    }

    /// Forgets the factors of keyframes that `keep` says no to.
    pub fn retain(&mut self, keep: impl Fn(KeyframeId) -> bool) {
        self.factors.retain(|id, _| keep(*id));
    }

    /// All factors, by keyframe.
    pub fn iter(&self) -> impl Iterator<Item = (KeyframeId, [f32; 3])> + '_ {
        self.factors.iter().map(|(id, factors)| (*id, *factors))
    }

    /// The photo of a keyframe with its gain.
    #[must_use]
    pub fn corrected(&self, id: KeyframeId, photo: &ColorImage) -> ColorImage {
        let linear = linear_table();
        let tables = self
            .factors(id)
            .map(|factor| linear.map(|value| srgb_from_linear(value * factor)));
        photo.mapped(|pixel| std::array::from_fn(|c| tables[c][usize::from(pixel[c])]))
    }
}

/// How the estimate went.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct GainReport {
    /// Points that at least two frames see.
    pub num_points: usize,
    /// Colours of them that were compared.
    pub num_samples: usize,
    /// Frames that share no point with another; their gain is 1.
    pub num_unlinked: usize,
    /// Frames that did not decode.
    pub num_failed: usize,
    /// Median absolute difference of log light to the point's mean, before.
    pub median_before: f64,
    /// The same after.
    pub median_after: f64,
    /// Smallest and largest factor.
    pub factor_range: [f32; 2],
}

/// Estimates the gains of `frames`. `progress` is told of each frame that was looked at.
///
/// # Errors
/// [`PhotometricError::Parameter`]. Frames that do not decode are counted.
pub fn estimate_gains(
    mesh: &TriMesh,
    frames: &[Arc<Keyframe>],
    decode: &(dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &GainParams,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<(GainTable, GainReport), PhotometricError> {
    params.check()?;
    let points = spread_points(mesh, params.num_points);
    let (observations, num_failed) = observe(mesh, &points, frames, decode, params, progress);
    let problem = Problem::new(observations, frames.len());
    let (log_gains, mut report) = problem.solve(params);
    report.num_failed = num_failed;
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let factors = log_gains.iter().map(|log| log.map(|g| (-g).exp() as f32));
    let table = GainTable::new(frames.iter().map(|frame| frame.id).zip(factors));
    report.factor_range = [1.0; 2];
    for factor in table.iter().flat_map(|(_, factors)| factors) {
        report.factor_range[0] = report.factor_range[0].min(factor);
        report.factor_range[1] = report.factor_range[1].max(factor);
    }
    Ok((table, report))
}

/// Observations of points that two frames or more see, grouped by point.
struct Problem {
    observations: Vec<Observation>,
    point_starts: Vec<usize>,
    num_frames: usize,
}

impl Problem {
    fn new(mut observations: Vec<Observation>, num_frames: usize) -> Self {
        observations.sort_by_key(|seen| (seen.point, seen.frame));
        let mut shared = Vec::with_capacity(observations.len());
        let mut point_starts = vec![0];
        for same in observations.chunk_by(|a, b| a.point == b.point) {
            if same.len() >= 2 {
                shared.extend_from_slice(same);
                point_starts.push(shared.len());
            }
        }
        Self {
            observations: shared,
            point_starts,
            num_frames,
        }
    }

    fn points(&self) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        self.point_starts.windows(2).map(|range| range[0]..range[1])
    }

    /// The logarithm of each frame's gain: what its photo shows too much.
    fn solve(&self, params: &GainParams) -> (Vec<[f64; 3]>, GainReport) {
        let mut log_gains = vec![[0.0; 3]; self.num_frames];
        let mut weights = vec![1.0; self.observations.len()];
        let mut residuals = self.residuals(&log_gains, &mut weights, f64::INFINITY);
        let mut report = GainReport {
            num_points: self.point_starts.len() - 1,
            num_samples: self.observations.len(),
            median_before: median_size(&residuals),
            ..GainReport::default()
        };
        for sweep in 0..params.num_sweeps {
            // Gains differ by up to two or so at first; the last third is at the full narrowness.
            let progress = (1.5 * sweep as f64 / params.num_sweeps as f64).min(1.0);
            let scale =
                params.robust_scale * (0.5 / params.robust_scale).max(1.0).powf(1.0 - progress);
            residuals = self.residuals(&log_gains, &mut weights, scale);
            for (weight, residual) in weights.iter_mut().zip(&residuals) {
                let square = residual.iter().map(|r| r * r).sum::<f64>() / 3.0;
                *weight = 1.0 / (1.0 + square / (scale * scale));
            }
            self.solve_frames(&weights, params.prior_samples, &mut log_gains);
        }
        let mut is_linked = vec![false; self.num_frames];
        for seen in &self.observations {
            is_linked[seen.frame as usize] = true;
        }
        let num_linked = is_linked.iter().filter(|linked| **linked).count();
        report.num_unlinked = self.num_frames - num_linked;
        for c in 0..3 {
            let sum: f64 = log_gains.iter().map(|gain| gain[c]).sum();
            let mean = sum / num_linked.max(1) as f64;
            for (gain, _) in log_gains
                .iter_mut()
                .zip(&is_linked)
                .filter(|(_, linked)| **linked)
            {
                gain[c] = (gain[c] - mean).clamp(-params.max_log_gain, params.max_log_gain);
            }
        }
        residuals = self.residuals(&log_gains, &mut weights, f64::INFINITY);
        report.median_after = median_size(&residuals);
        (log_gains, report)
    }

    /// What each observation differs by from its point's weighted mean. The mean is found anew from
    /// the median when `scale` is finite: an outlier among few would draw it along.
    fn residuals(&self, log_gains: &[[f64; 3]], weights: &mut [f64], scale: f64) -> Vec<[f64; 3]> {
        let mut residuals = vec![[0.0; 3]; self.observations.len()];
        let mut values = Vec::new();
        for range in self.points() {
            let seen = &self.observations[range.clone()];
            let corrected = |seen: &Observation, c: usize| {
                seen.log_linear[c] - log_gains[seen.frame as usize][c]
            };
            let centre: [f64; 3] = std::array::from_fn(|c| {
                values.clear();
                values.extend(seen.iter().map(|seen| corrected(seen, c)));
                values.sort_by(f64::total_cmp);
                let half = values.len() / 2;
                if values.len().is_multiple_of(2) {
                    0.5 * (values[half - 1] + values[half])
                } else {
                    values[half]
                }
            });
            let near = |seen: &Observation, centre: &[f64; 3]| {
                let square: f64 = (0..3)
                    .map(|c| (corrected(seen, c) - centre[c]).powi(2))
                    .sum();
                1.0 / (1.0 + square / (3.0 * scale * scale))
            };
            for (weight, seen) in weights[range.clone()].iter_mut().zip(seen) {
                *weight = near(seen, &centre);
            }
            let total: f64 = weights[range.clone()].iter().sum();
            let mean: [f64; 3] = std::array::from_fn(|c| {
                let parts = weights[range.clone()].iter().zip(seen);
                parts.map(|(w, seen)| w * corrected(seen, c)).sum::<f64>() / total
            });
            for (residual, seen) in residuals[range].iter_mut().zip(seen) {
                *residual = std::array::from_fn(|c| corrected(seen, c) - mean[c]);
            }
        }
        residuals
    }

    /// Weighted least squares over gains and albedos, with the albedos eliminated.
    fn solve_frames(&self, weights: &[f64], prior: f64, log_gains: &mut [[f64; 3]]) {
        let mut diagonal = vec![prior; self.num_frames];
        let mut rhs = vec![[0.0; 3]; self.num_frames];
        let totals: Vec<f64> = self
            .points()
            .map(|range| weights[range].iter().sum())
            .collect();
        for (range, total) in self.points().zip(&totals) {
            let parts = || {
                self.observations[range.clone()]
                    .iter()
                    .zip(&weights[range.clone()])
            };
            let mut mean = [0.0; 3];
            for (seen, weight) in parts() {
                for (mean, log_linear) in mean.iter_mut().zip(&seen.log_linear) {
                    *mean += weight * log_linear / total;
                }
            }
            for (seen, weight) in parts() {
                let frame = seen.frame as usize;
                diagonal[frame] += weight * (1.0 - weight / total);
                for c in 0..3 {
                    rhs[frame][c] += weight * (seen.log_linear[c] - mean[c]);
                }
            }
        }
        let apply = |x: &[[f64; 3]], out: &mut [[f64; 3]]| {
            for (out, x) in out.iter_mut().zip(x) {
                *out = x.map(|value| prior * value);
            }
            for (range, total) in self.points().zip(&totals) {
                let parts = || {
                    self.observations[range.clone()]
                        .iter()
                        .zip(&weights[range.clone()])
                };
                let mut mean = [0.0; 3];
                for (seen, weight) in parts() {
                    for (mean, x) in mean.iter_mut().zip(&x[seen.frame as usize]) {
                        *mean += weight * x / total;
                    }
                }
                for (seen, weight) in parts() {
                    let frame = seen.frame as usize;
                    for c in 0..3 {
                        out[frame][c] += weight * (x[frame][c] - mean[c]);
                    }
                }
            }
        };
        let stop = Stop {
            tolerance: 1e-5,
            max_steps: 2 * self.num_frames.min(200),
        };
        conjugate::solve(apply, &diagonal, &rhs, log_gains, &stop);
    }
}

/// Median over observations of the mean absolute residual of the channels.
fn median_size(residuals: &[[f64; 3]]) -> f64 {
    let mut sizes: Vec<f64> = residuals
        .iter()
        .map(|residual| residual.iter().map(|r| r.abs()).sum::<f64>() / 3.0)
        .collect();
    let half = sizes.len() / 2;
    if sizes.is_empty() {
        return 0.0;
    }
    *sizes.select_nth_unstable_by(half, f64::total_cmp).1
}

#[cfg(test)]
mod tests;
