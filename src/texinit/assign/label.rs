//! The table of candidates, and the best one per triangle.

use crate::keyframe::FrameQuality;
use crate::mesh::TriMesh;

use super::cues::{Candidate, FrameCandidates, TripleColor};
use super::pairwise::{self, PairwiseParams, Ranked};
use super::{AssignParams, AssignReport, Assignment, ColorReference};

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
    candidates: Vec<Candidate>,
}

/// All candidates seen so far. The order in which frames were added leaves no trace.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CandidateTable {
    /// By frame, ascending.
    columns: Vec<Column>,
    triangle_colors: Vec<ColorSum>,
    vertex_colors: Vec<ColorSum>,
}

impl CandidateTable {
    pub(crate) fn new(num_triangles: usize, num_vertices: usize) -> Self {
        Self {
            columns: vec![],
            triangle_colors: vec![ColorSum::default(); num_triangles],
            vertex_colors: vec![ColorSum::default(); num_vertices],
        }
    }

    /// Adds a frame's column; a frame is added once.
    pub(crate) fn add(&mut self, frame: u32, quality: FrameQuality, scored: FrameCandidates) {
        for candidate in &scored.candidates {
            if let Some(sum) = self.triangle_colors.get_mut(candidate.triangle as usize) {
                sum.add(candidate.colors.sums(), 3);
            }
        }
        for (vertex, srgb) in scored.vertex_colors {
            if let Some(sum) = self.vertex_colors.get_mut(vertex as usize) {
                sum.add(srgb.map(u32::from), 1);
            }
        }
        let position = self.columns.partition_point(|column| column.frame < frame);
        self.columns.insert(
            position,
            Column {
                frame,
                quality,
                candidates: scored.candidates,
            },
        );
    }

    /// The labels for the frames so far.
    pub(crate) fn assign(&self, mesh: &TriMesh, params: &AssignParams) -> Assignment {
        let num_triangles = self.triangle_colors.len();
        let reference = self.reference_colors(mesh, params.color_reference);
        let frame_scores = frame_scores(&self.columns, params);
        let num_ranked = params
            .pairwise
            .as_ref()
            .map_or(1, PairwiseParams::num_ranked);
        let mut ranked = Ranked::new(num_triangles, num_ranked);
        let mut resolutions = vec![[0.0f32; NUM_RESOLUTION_VIEWS]; num_triangles];
        let mut num_views = vec![0u32; num_triangles];
        for (column, frame_score) in self.columns.iter().zip(frame_scores) {
            for candidate in &column.candidates {
                let triangle = candidate.triangle as usize;
                num_views[triangle] += 1;
                keep_largest(&mut resolutions[triangle], candidate.area_px2);
                let difference = color_difference(candidate.colors, reference[triangle]);
                let score = candidate.score + frame_score + params.color_weight * difference;
                if score > params.empty_score {
                    ranked.offer(triangle, column.frame, score);
                }
            }
        }

        let adjacency = pairwise::adjacent_pairs(mesh);
        let unary: Vec<Option<u32>> = ranked.best_labels();
        let label = match &params.pairwise {
            Some(pairwise) => pairwise::solve(&ranked, &adjacency, pairwise),
            None => unary.clone(),
        };
        let is_partly_hidden = self.partly_hidden(&label);
        let (num_seams_unary, _) = count_seams(&unary, &adjacency);
        let (num_seams, num_inner_edges) = count_seams(&label, &adjacency);
        let mut is_used = vec![false; self.columns.last().map_or(0, |c| c.frame as usize + 1)];
        for &frame in label.iter().flatten() {
            is_used[frame as usize] = true;
        }
        let num_labelled = label.iter().flatten().count();
        let report = AssignReport {
            num_frames: self.columns.len(),
            failed_frames: vec![],
            num_candidates: self
                .columns
                .iter()
                .map(|column| column.candidates.len())
                .sum(),
            num_labelled,
            num_unlabelled: num_views.iter().filter(|&&n| n > 0).count() - num_labelled,
            num_frames_used: is_used.iter().filter(|used| **used).count(),
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

    fn partly_hidden(&self, label: &[Option<u32>]) -> Vec<bool> {
        let mut is_partly_hidden = vec![false; label.len()];
        for column in &self.columns {
            for candidate in &column.candidates {
                let triangle = candidate.triangle as usize;
                if candidate.is_partly_hidden() && label[triangle] == Some(column.frame) {
                    is_partly_hidden[triangle] = true;
                }
            }
        }
        is_partly_hidden
    }

    /// Per triangle: the colour that C3 compares with.
    fn reference_colors(&self, mesh: &TriMesh, reference: ColorReference) -> Vec<Option<[f32; 3]>> {
        match reference {
            ColorReference::SeeingFrames => {
                self.triangle_colors.iter().map(ColorSum::mean).collect()
            }
            ColorReference::ValidFrames => mesh
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

/// C3.
fn color_difference(colors: TripleColor, reference: Option<[f32; 3]>) -> f32 {
    let Some(reference) = reference else {
        return 0.0;
    };
    let sums = colors.sums();
    let squares: [f32; 3] = std::array::from_fn(|c| {
        // Sums of three bytes are exact in f32.
        let difference = sums[c] as f32 / 765.0 - reference[c];
        difference * difference
    });
    (squares[0] + squares[1] + squares[2]).sqrt()
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

/// Per frame: what its sharpness and exposure take off all its scores, ≤ 0.
fn frame_scores(columns: &[Column], params: &AssignParams) -> Vec<f32> {
    let median = |value: fn(&FrameQuality) -> f32| {
        let mut values: Vec<f32> = columns
            .iter()
            .map(|column| value(&column.quality))
            .collect();
        values.sort_by(f32::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    let median_sharpness = median(|quality| quality.sharpness);
    let median_luma = median(|quality| quality.mean_luma);
    columns
        .iter()
        .map(|column| {
            let FrameQuality {
                sharpness,
                mean_luma,
                clipped,
            } = column.quality;
            let halvings = if median_sharpness > 0.0 && sharpness > 0.0 {
                (median_sharpness / sharpness).log2().clamp(0.0, 4.0)
            } else {
                0.0
            };
            let exposure = (mean_luma - median_luma).abs() + clipped;
            let exposure = if exposure.is_finite() { exposure } else { 0.0 };
            -params.sharpness_weight * halvings - params.exposure_weight * exposure
        })
        .collect()
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
fn count_seams(label: &[Option<u32>], adjacency: &[[u32; 2]]) -> (usize, usize) {
    let both = adjacency
        .iter()
        .filter_map(|&[i, j]| Some((label[i as usize]?, label[j as usize]?)));
    let num_inner = both.clone().count();
    (both.filter(|(a, b)| a != b).count(), num_inner)
}
