//! The table of candidates, and the best one per triangle.

use std::ops::Range;

use rayon::prelude::*;

use crate::keyframe::FrameQuality;
use crate::mesh::TriMesh;

use super::cues::{Candidate, FrameCandidates, TripleColor};
use super::pairwise::{self, PairwiseParams, Ranked};
use super::quality::TypicalQuality;
use super::{AssignParams, AssignReport, Assignment, ColorCue, FailedFrame};

/// How many of the best resolved views the texel density is taken from.
const NUM_RESOLUTION_VIEWS: usize = 3;

/// Sum of colours, exact and therefore in any order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct ColorSum {
    sum: [u64; 3],
    num_bytes: u64,
}

impl ColorSum {
    fn add(&mut self, bytes: [u32; 3], num_bytes: u64) {
        for (sum, byte) in self.sum.iter_mut().zip(bytes) {
            *sum += u64::from(byte);
        }
        self.num_bytes += num_bytes;
    }

    fn subtract(&mut self, bytes: [u32; 3], num_bytes: u64) {
        for (sum, byte) in self.sum.iter_mut().zip(bytes) {
            *sum -= u64::from(byte);
        }
        self.num_bytes -= num_bytes;
    }

    /// Mean in [0, 1].
    fn mean(&self) -> Option<[f32; 3]> {
        let scale = 1.0 / (self.num_bytes as f64 * 255.0);
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let mean = self.sum.map(|sum| (sum as f64 * scale) as f32);
        (self.num_bytes > 0).then_some(mean)
    }
}

/// A frame's column of the table.
#[derive(Clone, Debug, PartialEq)]
struct Column {
    frame: u32,
    quality: FrameQuality,
    scored: FrameCandidates,
}

impl Column {
    /// The candidates for a range of triangles.
    fn within(&self, triangles: &Range<usize>) -> &[Candidate] {
        let candidates = &self.scored.candidates;
        let before = |end: usize| candidates.partition_point(|c| (c.triangle as usize) < end);
        &candidates[before(triangles.start)..before(triangles.end)]
    }
}

/// All candidates seen so far. The order in which frames were added, and frames that were removed
/// again, leave no trace.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CandidateTable {
    /// By frame, ascending.
    columns: Vec<Column>,
    /// Over the frames that see the triangle.
    triangle_colors: Vec<ColorSum>,
    /// Over the frames that are valid for a triangle at the vertex.
    vertex_colors: Vec<ColorSum>,
    /// Over the frames that are valid for the triangle.
    valid_colors: Vec<ColorSum>,
    /// By frame, ascending.
    failed: Vec<FailedFrame>,
}

/// Triangles that one task compares frames for.
const TASK_SIZE: usize = 4096;

/// What the frames say of a range of triangles.
struct Comparison {
    ranked: Ranked,
    resolutions: Vec<[f32; NUM_RESOLUTION_VIEWS]>,
    num_views: Vec<u32>,
}

impl CandidateTable {
    pub(crate) fn new(num_triangles: usize, num_vertices: usize) -> Self {
        Self {
            columns: vec![],
            triangle_colors: vec![ColorSum::default(); num_triangles],
            vertex_colors: vec![ColorSum::default(); num_vertices],
            valid_colors: vec![ColorSum::default(); num_triangles],
            failed: vec![],
        }
    }

    /// Adds a frame's column, in place of the one that it may have already.
    pub(crate) fn add(&mut self, frame: u32, quality: FrameQuality, scored: FrameCandidates) {
        self.remove(frame);
        self.sum_colors(&scored, ColorSum::add);
        let column = Column {
            frame,
            quality,
            scored,
        };
        self.columns.insert(self.position(frame), column);
    }

    /// Adds many columns at once, on all cores; frames ascending and new to the table.
    pub(crate) fn add_all(&mut self, columns: Vec<(u32, FrameQuality, FrameCandidates)>) {
        let first_new = self.columns.len();
        let new = columns.into_iter().map(|(frame, quality, scored)| Column {
            frame,
            quality,
            scored,
        });
        self.columns.extend(new);
        let new = &self.columns[first_new..];
        self.triangle_colors
            .par_chunks_mut(TASK_SIZE)
            .enumerate()
            .for_each(|(task, colors)| {
                let start = task * TASK_SIZE;
                for column in new {
                    for candidate in column.within(&(start..start + colors.len())) {
                        let row = candidate.triangle as usize - start;
                        colors[row].add(candidate.colors.sums(), 3);
                    }
                }
            });
        let (triangles, vertices) = (&mut self.valid_colors, &mut self.vertex_colors);
        for column in new {
            sum_valid_colors(&column.scored, triangles, vertices, ColorSum::add);
        }
    }

    /// Notes that a frame could not be used.
    pub(crate) fn fail(&mut self, failed: FailedFrame) {
        self.remove(failed.frame);
        let position = self.failed.partition_point(|f| f.frame < failed.frame);
        self.failed.insert(position, failed);
    }

    /// Takes a frame out; whether it was there.
    pub(crate) fn remove(&mut self, frame: u32) -> bool {
        let num_failed = self.failed.len();
        self.failed.retain(|failed| failed.frame != frame);
        let position = self.position(frame);
        let is_there = self.columns.get(position).is_some_and(|c| c.frame == frame);
        if is_there {
            let column = self.columns.remove(position);
            self.sum_colors(&column.scored, ColorSum::subtract);
        }
        is_there || self.failed.len() < num_failed
    }

    /// What all frames say, by frame, ascending.
    pub(crate) fn columns(&self) -> impl Iterator<Item = (u32, FrameQuality, &FrameCandidates)> {
        let columns = self.columns.iter();
        columns.map(|column| (column.frame, column.quality, &column.scored))
    }

    /// Forgets what is said of some triangles.
    pub(crate) fn retain(&mut self, is_kept: impl Fn(u32) -> bool) {
        let num_triangles = self.triangle_colors.len();
        let before = std::mem::replace(self, Self::new(num_triangles, self.vertex_colors.len()));
        for column in before.columns {
            let same_number = |triangle: u32| is_kept(triangle).then_some(triangle);
            let scored = column.scored.renumbered(same_number);
            if !scored.is_empty() {
                self.add(column.frame, column.quality, scored);
            }
        }
        self.failed = before.failed;
    }

    /// What a frame's column says, where it has one.
    pub(crate) fn column(&self, frame: u32) -> Option<&FrameCandidates> {
        let column = self.columns.get(self.position(frame))?;
        (column.frame == frame).then_some(&column.scored)
    }

    /// Bytes that the columns take.
    pub(crate) fn num_bytes(&self) -> usize {
        self.columns
            .iter()
            .map(|column| column.scored.num_bytes())
            .sum()
    }

    fn position(&self, frame: u32) -> usize {
        self.columns.partition_point(|column| column.frame < frame)
    }

    fn sum_colors(&mut self, scored: &FrameCandidates, sum: fn(&mut ColorSum, [u32; 3], u64)) {
        for candidate in &scored.candidates {
            if let Some(colors) = self.triangle_colors.get_mut(candidate.triangle as usize) {
                sum(colors, candidate.colors.sums(), 3);
            }
        }
        let (triangles, vertices) = (&mut self.valid_colors, &mut self.vertex_colors);
        sum_valid_colors(scored, triangles, vertices, sum);
    }

    /// Where the frames so far stand.
    pub(crate) fn typical_quality(&self) -> TypicalQuality {
        TypicalQuality::of(self.columns.iter().map(|column| &column.quality))
    }

    /// The labels for the frames so far, whose quality is held against the typical one.
    pub(crate) fn assign(
        &self,
        mesh: &TriMesh,
        params: &AssignParams,
        typical: TypicalQuality,
    ) -> Assignment {
        let (comparison, adjacency) = rayon::join(
            || self.compare(mesh, params, typical),
            || pairwise::adjacent_pairs(mesh.triangles()),
        );
        let Comparison {
            ranked,
            resolutions,
            num_views,
        } = comparison;
        let unary: Vec<Option<u32>> = ranked.best_labels();
        let label = match &params.pairwise {
            Some(pairwise) => pairwise::solve(&ranked, &adjacency, pairwise),
            None => unary.clone(),
        };
        let is_partly_hidden = self.partly_hidden(&label);
        let (num_seams_unary, _) = count_seams(&unary, &adjacency);
        let (num_seams, num_inner_edges) = count_seams(&label, &adjacency);
        let mut used: Vec<u32> = label.iter().copied().flatten().collect();
        used.sort_unstable();
        used.dedup();
        let num_labelled = label.iter().flatten().count();
        let report = AssignReport {
            num_frames: self.columns.len(),
            failed_frames: self.failed.clone(),
            num_candidates: self
                .columns
                .iter()
                .map(|column| column.scored.candidates.len())
                .sum(),
            num_labelled,
            num_unlabelled: num_views.iter().filter(|&&n| n > 0).count() - num_labelled,
            num_frames_used: used.len(),
            num_seams_unary,
            num_seams,
            num_inner_edges,
        };
        Assignment {
            best_texels_per_m: texels_per_m(mesh, &resolutions, &num_views),
            mean_srgb: self.triangle_colors.iter().map(mean_byte).collect(),
            label,
            num_views,
            is_partly_hidden,
            report,
        }
    }

    /// Ranks the frames of every triangle.
    fn compare(
        &self,
        mesh: &TriMesh,
        params: &AssignParams,
        typical: TypicalQuality,
    ) -> Comparison {
        let reference = self.reference_colors(mesh, params.color_cue);
        let columns = self.columns.iter();
        let frame_scores: Vec<f32> = columns
            .map(|column| typical.score(&column.quality, params))
            .collect();
        let num_ranked = params
            .pairwise
            .as_ref()
            .map_or(1, PairwiseParams::num_ranked);
        let parts: Vec<Comparison> = self
            .tasks()
            .into_par_iter()
            .map(|triangles| {
                let num_triangles = triangles.len();
                let mut part = Comparison {
                    ranked: Ranked::new(num_triangles, num_ranked),
                    resolutions: vec![[0.0; NUM_RESOLUTION_VIEWS]; num_triangles],
                    num_views: vec![0; num_triangles],
                };
                for (column, frame_score) in self.columns.iter().zip(&frame_scores) {
                    for candidate in column.within(&triangles) {
                        let triangle = candidate.triangle as usize;
                        let row = triangle - triangles.start;
                        part.num_views[row] += 1;
                        keep_largest(&mut part.resolutions[row], candidate.area_px2);
                        let difference = color_difference(
                            candidate.colors,
                            reference[triangle],
                            params.color_cue,
                        );
                        let score =
                            candidate.score + frame_score + params.color_weight * difference;
                        if score > params.empty_score {
                            part.ranked.offer(row, column.frame, score);
                        }
                    }
                }
                part
            })
            .collect();
        let mut all = Comparison {
            ranked: Ranked::new(0, num_ranked),
            resolutions: vec![],
            num_views: vec![],
        };
        for part in parts {
            all.ranked.append(part.ranked);
            all.resolutions.extend(part.resolutions);
            all.num_views.extend(part.num_views);
        }
        all
    }

    fn tasks(&self) -> Vec<Range<usize>> {
        let num_triangles = self.triangle_colors.len();
        (0..num_triangles)
            .step_by(TASK_SIZE)
            .map(|start| start..(start + TASK_SIZE).min(num_triangles))
            .collect()
    }

    fn partly_hidden(&self, label: &[Option<u32>]) -> Vec<bool> {
        let is_hidden_in = |triangle: usize, frame: u32| {
            let column = self.columns.get(self.position(frame));
            column.is_some_and(|column| {
                let candidates = column.within(&(triangle..triangle + 1));
                candidates.iter().any(Candidate::is_partly_hidden)
            })
        };
        label
            .par_iter()
            .enumerate()
            .map(|(triangle, frame)| frame.is_some_and(|frame| is_hidden_in(triangle, frame)))
            .collect()
    }

    /// Per triangle: the colour that C3 compares with.
    fn reference_colors(&self, mesh: &TriMesh, cue: ColorCue) -> Vec<Option<[f32; 3]>> {
        let num_triangles = self.triangle_colors.len();
        match cue {
            ColorCue::SeeingFrames => self.triangle_colors.iter().map(ColorSum::mean).collect(),
            ColorCue::ValidForTriangle => (0..num_triangles)
                .map(|triangle| self.valid_colors.get(triangle).and_then(ColorSum::mean))
                .collect(),
            ColorCue::ValidAtVertex => mesh
                .triangles()
                .iter()
                .map(|corners| {
                    let mut mean = [0.0f32; 3];
                    for &vertex in corners {
                        let color = self.vertex_colors[vertex as usize].mean()?;
                        for (mean, value) in mean.iter_mut().zip(color) {
                            *mean += value / 3.0;
                        }
                    }
                    Some(mean)
                })
                .collect(),
        }
    }
}

/// Adds to, or takes from, the sums over valid frames.
fn sum_valid_colors(
    scored: &FrameCandidates,
    triangles: &mut [ColorSum],
    vertices: &mut [ColorSum],
    sum: fn(&mut ColorSum, [u32; 3], u64),
) {
    for &(triangle, colors) in &scored.valid_colors {
        if let Some(all) = triangles.get_mut(triangle as usize) {
            sum(all, colors.sums(), 3);
        }
    }
    for &(vertex, srgb) in &scored.vertex_colors {
        if let Some(all) = vertices.get_mut(vertex as usize) {
            sum(all, srgb.map(u32::from), 1);
        }
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

fn mean_byte(sum: &ColorSum) -> [u8; 3] {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a mean of bytes is a byte"
    )]
    sum.mean().map_or([0; 3], |mean| {
        mean.map(|value| (value * 255.0).round() as u8)
    })
}

/// Keeps the largest values, descending.
fn keep_largest(largest: &mut [f32; NUM_RESOLUTION_VIEWS], mut value: f32) {
    for kept in largest {
        if value > *kept {
            std::mem::swap(kept, &mut value);
        }
    }
}

fn texels_per_m(
    mesh: &TriMesh,
    areas_px2: &[[f32; NUM_RESOLUTION_VIEWS]],
    num_views: &[u32],
) -> Vec<f32> {
    mesh.triangle_ids()
        .zip(areas_px2.iter().zip(num_views))
        .map(|(triangle, (areas_px2, &num_views))| {
            let rank = (num_views as usize).clamp(1, NUM_RESOLUTION_VIEWS) - 1;
            let density = (f64::from(areas_px2[rank]) / mesh.area_m2(triangle)).sqrt();
            #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
            let density = density as f32;
            // A triangle without area has no resolution.
            if density.is_finite() { density } else { 0.0 }
        })
        .collect()
}

/// Pairs of adjacent triangles with different labels, and pairs that are both labelled.
pub(crate) fn count_seams(label: &[Option<u32>], adjacency: &[[u32; 2]]) -> (usize, usize) {
    let both = adjacency
        .iter()
        .filter_map(|&[i, j]| Some((label[i as usize]?, label[j as usize]?)));
    let num_inner = both.clone().count();
    (both.filter(|(a, b)| a != b).count(), num_inner)
}
