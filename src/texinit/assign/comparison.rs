//! Frames compared for each triangle: the best few, with scores.

use std::ops::Range;

use rayon::prelude::*;

use crate::mesh::{TriMesh, TriangleId};

use super::adjacency::Adjacency;
use super::cues::{Candidate, TripleColor};
use super::label::{CandidateTable, ColorSum};
use super::pairwise::{self, PairwiseParams, Ranked};
use super::quality::TypicalQuality;
use super::steady::Steadying;
use super::{AssignParams, ColorCue};

/// How many of the best resolved views the texel density is taken from.
const NUM_RESOLUTION_VIEWS: usize = 3;

/// Triangles that one task compares frames for.
pub(super) const TASK_SIZE: usize = 4096;

/// What the frames say of a range of triangles.
#[derive(Clone, Debug)]
pub(crate) struct Comparison {
    pub(super) ranked: Ranked,
    resolutions: Vec<[f32; NUM_RESOLUTION_VIEWS]>,
    pub(super) num_views: Vec<u32>,
}

/// Scores that a frame has for all triangles, and what its colours are compared with.
struct Scores<'a> {
    /// Per column of the table.
    frame_scores: Vec<f32>,
    params: &'a AssignParams,
}

impl Comparison {
    /// Nothing is said of any triangle.
    pub(crate) fn empty(num_triangles: usize, params: &AssignParams) -> Self {
        let ranked = params.pairwise.as_ref();
        let num_ranked = ranked.map_or(1, PairwiseParams::num_ranked);
        Self {
            ranked: Ranked::new(num_triangles, num_ranked),
            resolutions: vec![[0.0; NUM_RESOLUTION_VIEWS]; num_triangles],
            num_views: vec![0; num_triangles],
        }
    }

    /// Compares the frames of every triangle.
    pub(super) fn of(
        table: &CandidateTable,
        mesh: &TriMesh,
        params: &AssignParams,
        typical: TypicalQuality,
    ) -> Self {
        let reference = reference_colors(table, mesh, params.color_cue);
        let scores = Scores::new(table, params, typical);
        let num_triangles = table.triangle_colors.len();
        let tasks: Vec<Range<usize>> = (0..num_triangles)
            .step_by(TASK_SIZE)
            .map(|start| start..(start + TASK_SIZE).min(num_triangles))
            .collect();
        let parts: Vec<Self> = tasks
            .into_par_iter()
            .map(|triangles| {
                let mut part = Self::empty(triangles.len(), params);
                for (column, frame_score) in table.columns.iter().zip(&scores.frame_scores) {
                    for candidate in column.within(&triangles) {
                        let triangle = candidate.triangle as usize;
                        let score = scores.of(candidate, *frame_score, reference[triangle]);
                        part.offer(triangle - triangles.start, column.frame, candidate, score);
                    }
                }
                part
            })
            .collect();
        let mut all = Self::empty(0, params);
        for part in parts {
            all.ranked.append(part.ranked);
            all.resolutions.extend(part.resolutions);
            all.num_views.extend(part.num_views);
        }
        all
    }

    /// Compares the frames of some triangles anew; whether the best few of one of them are others than
    /// before. Colours must not be compared with those at vertices ([`ColorCue::ValidAtVertex`]).
    pub(crate) fn renew(
        &mut self,
        table: &CandidateTable,
        is_stale: &[bool],
        params: &AssignParams,
        typical: TypicalQuality,
    ) -> bool {
        let scores = Scores::new(table, params, typical);
        let before = self.ranked.clone();
        let mut reference = vec![None; is_stale.len()];
        for row in (0..is_stale.len()).filter(|&row| is_stale[row]) {
            self.ranked.clear(row);
            self.resolutions[row] = [0.0; NUM_RESOLUTION_VIEWS];
            self.num_views[row] = 0;
            let colors = match params.color_cue {
                ColorCue::ValidForTriangle => &table.valid_colors,
                ColorCue::SeeingFrames | ColorCue::ValidAtVertex => &table.triangle_colors,
            };
            reference[row] = colors[row].mean();
        }
        for (column, frame_score) in table.columns.iter().zip(&scores.frame_scores) {
            for candidate in &column.scored.candidates {
                let row = candidate.triangle as usize;
                if is_stale[row] {
                    let score = scores.of(candidate, *frame_score, reference[row]);
                    self.offer(row, column.frame, candidate, score);
                }
            }
        }
        self.ranked != before
    }

    fn offer(&mut self, row: usize, frame: u32, candidate: &Candidate, score: Option<f32>) {
        self.num_views[row] += 1;
        keep_largest(&mut self.resolutions[row], candidate.area_px2);
        if let Some(score) = score {
            self.ranked.offer(row, frame, score);
        }
    }

    /// The labels of best total score found.
    pub(crate) fn solve(&self, adjacency: &Adjacency, params: &AssignParams) -> Vec<Option<u32>> {
        match &params.pairwise {
            Some(pairwise) => pairwise::solve(&self.ranked, adjacency, pairwise),
            None => self.ranked.best_labels(),
        }
    }

    /// The same with labels that stay as they were where others score hardly better: they are worth less
    /// than those of [`Self::solve`] by at most `hysteresis` times the number of triangles.
    pub(crate) fn solve_steadily(
        &self,
        before: &[Option<u32>],
        hysteresis: f32,
        adjacency: &Adjacency,
        params: &AssignParams,
    ) -> Vec<Option<u32>> {
        let steadying = Steadying {
            ranked: &self.ranked,
            adjacency,
            weight: pairwise_weight(params),
            before,
        };
        steadying.steadied(self.solve(adjacency, params), hysteresis)
    }

    /// What labels earn together.
    #[cfg(test)]
    pub(crate) fn value_of(
        &self,
        label: &[Option<u32>],
        adjacency: &Adjacency,
        params: &AssignParams,
    ) -> f64 {
        self.ranked
            .value_of(label, adjacency.pairs(), pairwise_weight(params))
    }

    /// Per triangle: its best resolved views' texels per metre.
    pub(super) fn texels_per_m(&self, area_m2: impl Fn(TriangleId) -> f64) -> Vec<f32> {
        let rows = self.resolutions.iter().zip(&self.num_views);
        (0_u32..)
            .zip(rows)
            .map(|(triangle, (areas_px2, &num_views))| {
                let rank = (num_views as usize).clamp(1, NUM_RESOLUTION_VIEWS) - 1;
                let area_m2 = area_m2(TriangleId(triangle));
                let density = (f64::from(areas_px2[rank]) / area_m2).sqrt();
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
                let density = density as f32;
                // A triangle without area has no resolution.
                if density.is_finite() { density } else { 0.0 }
            })
            .collect()
    }
}

fn pairwise_weight(params: &AssignParams) -> f32 {
    let pairwise = params.pairwise.as_ref();
    pairwise.map_or(0.0, |pairwise| pairwise.weight)
}

impl<'a> Scores<'a> {
    fn new(table: &CandidateTable, params: &'a AssignParams, typical: TypicalQuality) -> Self {
        let columns = table.columns.iter();
        Self {
            frame_scores: columns
                .map(|column| typical.score(&column.quality, params))
                .collect(),
            params,
        }
    }

    /// The score of a candidate; `None` where painting nothing is better.
    fn of(
        &self,
        candidate: &Candidate,
        frame_score: f32,
        reference: Option<[f32; 3]>,
    ) -> Option<f32> {
        let params = self.params;
        let difference = color_difference(candidate.colors, reference, params.color_cue);
        let score = candidate.score + frame_score + params.color_weight * difference;
        (score > params.empty_score).then_some(score)
    }
}

/// Per triangle: the colour that C3 compares with.
fn reference_colors(
    table: &CandidateTable,
    mesh: &TriMesh,
    cue: ColorCue,
) -> Vec<Option<[f32; 3]>> {
    let num_triangles = table.triangle_colors.len();
    match cue {
        ColorCue::SeeingFrames => table.triangle_colors.iter().map(ColorSum::mean).collect(),
        ColorCue::ValidForTriangle => (0..num_triangles)
            .map(|triangle| table.valid_colors.get(triangle).and_then(ColorSum::mean))
            .collect(),
        ColorCue::ValidAtVertex => mesh
            .triangles()
            .iter()
            .map(|corners| {
                let mut mean = [0.0f32; 3];
                for &vertex in corners {
                    let color = table.vertex_colors[vertex as usize].mean()?;
                    for (mean, value) in mean.iter_mut().zip(color) {
                        *mean += value / 3.0;
                    }
                }
                Some(mean)
            })
            .collect(),
    }
}

/// C3.
fn color_difference(colors: TripleColor, reference: Option<[f32; 3]>, cue: ColorCue) -> f32 {
    let Some(reference) = reference else {
        return 0.0;
    };
    let sums = colors.sums();
    // Sums of three bytes are exact in f32.
    let [r, g, b]: [f32; 3] = std::array::from_fn(|c| sums[c] as f32 / 765.0 - reference[c]);
    match cue {
        ColorCue::SeeingFrames | ColorCue::ValidAtVertex => (r * r + g * g + b * b).sqrt(),
        ColorCue::ValidForTriangle => r.abs() + g.abs() + b.abs(),
    }
}

/// Keeps the largest values, descending.
fn keep_largest(largest: &mut [f32; NUM_RESOLUTION_VIEWS], mut value: f32) {
    for kept in largest {
        if value > *kept {
            std::mem::swap(kept, &mut value);
        }
    }
}
