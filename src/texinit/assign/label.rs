//! The table of candidates, and the best one per triangle.

use std::ops::Range;

use rayon::prelude::*;

use crate::keyframe::FrameQuality;
use crate::mesh::{TriMesh, TriangleId};

use super::adjacency::Adjacency;
use super::comparison::{Comparison, TASK_SIZE};
use super::cues::{Candidate, FrameCandidates};
use super::quality::TypicalQuality;
use super::{AssignParams, AssignReport, Assignment, FailedFrame};

/// Sum of colours, exact and therefore in any order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct ColorSum {
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
    pub(super) fn mean(&self) -> Option<[f32; 3]> {
        let scale = 1.0 / (self.num_bytes as f64 * 255.0);
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let mean = self.sum.map(|sum| (sum as f64 * scale) as f32);
        (self.num_bytes > 0).then_some(mean)
    }
}

/// A frame's column of the table.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Column {
    pub(super) frame: u32,
    pub(super) quality: FrameQuality,
    pub(super) scored: FrameCandidates,
}

impl Column {
    /// The candidates for a range of triangles.
    pub(super) fn within(&self, triangles: &Range<usize>) -> &[Candidate] {
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
    pub(super) columns: Vec<Column>,
    /// Over the frames that see the triangle.
    pub(super) triangle_colors: Vec<ColorSum>,
    /// Over the frames that are valid for a triangle at the vertex.
    pub(super) vertex_colors: Vec<ColorSum>,
    /// Over the frames that are valid for the triangle.
    pub(super) valid_colors: Vec<ColorSum>,
    /// By frame, ascending.
    failed: Vec<FailedFrame>,
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
            || Comparison::of(self, mesh, params, typical),
            || Adjacency::of(mesh.triangles()),
        );
        let label = comparison.solve(&adjacency, params);
        let area_m2 = |triangle| mesh.area_m2(triangle);
        self.assignment(&comparison, label, &adjacency, area_m2)
    }

    /// What is reported of labels that a comparison led to.
    pub(crate) fn assignment(
        &self,
        comparison: &Comparison,
        label: Vec<Option<u32>>,
        adjacency: &Adjacency,
        area_m2: impl Fn(TriangleId) -> f64,
    ) -> Assignment {
        let (num_seams_unary, _) = count_seams(&comparison.ranked.best_labels(), adjacency.pairs());
        let (num_seams, num_inner_edges) = count_seams(&label, adjacency.pairs());
        let mut used: Vec<u32> = label.iter().copied().flatten().collect();
        used.sort_unstable();
        used.dedup();
        let num_labelled = label.iter().flatten().count();
        let num_seen = comparison.num_views.iter().filter(|&&n| n > 0).count();
        let columns = self.columns.iter();
        let report = AssignReport {
            num_frames: self.columns.len(),
            failed_frames: self.failed.clone(),
            num_candidates: columns.map(|column| column.scored.candidates.len()).sum(),
            num_labelled,
            num_unlabelled: num_seen - num_labelled,
            num_frames_used: used.len(),
            num_seams_unary,
            num_seams,
            num_inner_edges,
        };
        Assignment {
            best_texels_per_m: comparison.texels_per_m(area_m2),
            mean_srgb: self.triangle_colors.iter().map(mean_byte).collect(),
            num_views: comparison.num_views.clone(),
            is_partly_hidden: self.partly_hidden(&label),
            label,
            report,
        }
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

/// Pairs of adjacent triangles with different labels, and pairs that are both labelled.
pub(crate) fn count_seams(label: &[Option<u32>], adjacency: &[[u32; 2]]) -> (usize, usize) {
    let both = adjacency
        .iter()
        .filter_map(|&[i, j]| Some((label[i as usize]?, label[j as usize]?)));
    let num_inner = both.clone().count();
    (both.filter(|(a, b)| a != b).count(), num_inner)
}
