//! Which frame paints which triangle.
//!
//! Input: a mesh of N triangles in the world frame and F posed frames. Output: per triangle the
//! frame with the best score ψ = ω1·C1 + ω2·C2 + ω3·C3 + our own terms, or none (Zhao, Zhao,
//! Schwing, ECCV 2022, Eq. MRFTex; the appendix' pairwise cue C4 is [`AssignParams::pairwise`]).
//!
//! - Validity: the three vertices lie inside the image with positive depth; the centroid, a convex
//!   combination, then does too.
//! - C1: area of the projected triangle in px². As the paper has it, its weight against the other
//!   cues grows with the resolution of the images; [`AssignParams::reference_width_px`] counts
//!   pixels as if each image were that wide.
//! - C2: the difference between the measured and the predicted depth at the vertices and the
//!   centroid, metres, at the nearest depth pixel: the largest of the four differences of range, or
//!   their sum along the axis ([`DepthCue`]). Depths under 1 mm are none. A frame without a depth
//!   image says nothing: 0.
//! - C3: distance in RGB ([0, 1] per channel, sRGB) between the mean colour at the vertices
//!   (nearest pixel) in this frame and its mean over the frames ([`ColorCue`]).
//! - Ours: occlusion by the mesh itself, depth edges, image border, grazing views, back faces,
//!   sharpness and exposure of the frame, and the resolution as pixels per metre, which C1 loses
//!   when triangles are small.
//!
//! Scores separate per (triangle, frame); what couples frames is one colour sum per triangle, in
//! integers, and one median per quality figure. Frames may therefore come one by one, in any order,
//! and go again ([`FrameTable`]), with the result of the batch to the last bit.
//!
//! Memory: 16 bytes per (triangle, frame) in view and not beaten by the empty label: a frame costs
//! about what its JPEG costs.

pub(crate) mod adjacency;
pub(crate) mod chart_table;
pub(crate) mod comparison;
pub mod cues;
pub mod label;
pub mod pairwise;
pub(crate) mod quality;
mod steady;
mod table;
pub mod validity;

pub use table::FrameTable;

use std::sync::Arc;

use rayon::prelude::*;

use crate::atlas::AtlasLayout;
use crate::geom::{ImageError, RigidTransform};
use crate::keyframe::{DecodedFrame, FrameQuality, Keyframe};
use crate::mesh::TriMesh;
use crate::render::{MeshRuns, VisibilityParams};

use cues::FrameCandidates;
use label::CandidateTable;
use pairwise::PairwiseParams;

/// The form of C2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthCue {
    /// The largest of the four differences, of distances from the camera; past
    /// [`AssignParams::max_depth_difference_m`] it is a rejection (the authors' program).
    LargestRange,
    /// The sum of the four differences, of depths along the camera's axis, however large (the
    /// paper's text).
    DepthSum,
}

/// The form of C3: which frames the mean colour runs over, and how colours are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColorCue {
    /// Mean per triangle over the frames that see it; Euclidean distance.
    SeeingFrames,
    /// Mean per vertex over the frames that are valid for any triangle at it, occluded or not;
    /// Euclidean distance (the authors' program).
    ValidAtVertex,
    /// Mean per triangle over the frames that are valid for it, occluded or not; sum of absolute
    /// differences (the paper's text).
    ValidForTriangle,
}

/// How frames are scored. Scores are dimensionless; larger is better.
#[derive(Clone, Debug, PartialEq)]
pub struct AssignParams {
    /// ω1 of C1, per px² (≥ 0).
    pub area_weight: f32,
    /// ω2 of C2, per metre (≤ 0).
    pub depth_weight: f32,
    /// ω3 of C3, per unit of RGB distance (≤ 0).
    pub color_weight: f32,
    /// Score of painting nothing.
    pub empty_score: f32,
    /// C1 counts pixels of an image of this width; `None` takes the image's own.
    pub reference_width_px: Option<u32>,
    /// C2 from here on is a rejection, metres.
    pub max_depth_difference_m: f32,
    /// C2 of a rejection, metres.
    pub rejected_depth_difference_m: f32,
    /// C2 where nothing was measured, metres.
    pub unmeasured_depth_difference_m: f32,
    /// The form of C2.
    pub depth_cue: DepthCue,
    /// The form of C3.
    pub color_cue: ColorCue,
    /// The mesh hides what lies behind it; `None` trusts the measured depth alone.
    pub visibility: Option<VisibilityParams>,
    /// Taken off for a depth edge nearby (≥ 0).
    pub depth_edge_penalty: f32,
    /// Taken off in proportion to the hidden share of a large triangle (≥ 0).
    pub hidden_penalty: f32,
    /// Vertices keep this distance from the border of the image, share of its width (0–0.2).
    pub border_margin: f32,
    /// Views flatter than this to the surface are grazing, rad (0–π/2).
    pub min_elevation_rad: f32,
    /// Taken off grazing views (≥ 0).
    pub grazing_penalty: f32,
    /// Taken off views of a triangle's back (≥ 0).
    pub back_face_penalty: f32,
    /// Per doubling of the pixels per metre (≥ 0). On real captures held-out views come out worse
    /// with it: nearer views win whose poses fit less well.
    pub resolution_weight: f32,
    /// Per halving of the sharpness against the median frame (≥ 0).
    pub sharpness_weight: f32,
    /// Per unit of mean luma away from the median frame, and of share clipped (≥ 0).
    pub exposure_weight: f32,
    /// Reward for equal frames on adjacent triangles (C4); `None` decides each triangle alone.
    pub pairwise: Option<PairwiseParams>,
}

impl Default for AssignParams {
    fn default() -> Self {
        Self {
            reference_width_px: Some(640),
            unmeasured_depth_difference_m: 0.1,
            color_cue: ColorCue::SeeingFrames,
            visibility: Some(VisibilityParams::default()),
            depth_edge_penalty: 2.0,
            hidden_penalty: 4.0,
            border_margin: 0.005,
            min_elevation_rad: 0.2,
            grazing_penalty: 3.0,
            back_face_penalty: 5.0,
            resolution_weight: 0.0,
            sharpness_weight: 0.1,
            exposure_weight: 0.2,
            pairwise: Some(PairwiseParams::default()),
            ..Self::paper()
        }
    }
}

impl AssignParams {
    /// The paper's cues and weights, with the published program's choices where the text is
    /// silent, and nothing of ours.
    pub fn paper() -> Self {
        Self {
            area_weight: 1e-3,
            depth_weight: -10.0,
            color_weight: -1.0,
            empty_score: -15.0,
            reference_width_px: None,
            max_depth_difference_m: 0.25,
            rejected_depth_difference_m: 5.0,
            unmeasured_depth_difference_m: 5.0,
            depth_cue: DepthCue::LargestRange,
            color_cue: ColorCue::ValidAtVertex,
            visibility: None,
            depth_edge_penalty: 0.0,
            hidden_penalty: 0.0,
            border_margin: 0.0,
            min_elevation_rad: 0.0,
            grazing_penalty: 0.0,
            back_face_penalty: 0.0,
            resolution_weight: 0.0,
            sharpness_weight: 0.0,
            exposure_weight: 0.0,
            pairwise: None,
        }
    }

    /// The cues word for word as the paper prints them, where the published program differs: C2 a
    /// sum of differences in depth without a cut, C3 over each triangle's own valid frames. What
    /// the text does not say is the program's.
    pub fn paper_as_printed() -> Self {
        Self {
            depth_cue: DepthCue::DepthSum,
            color_cue: ColorCue::ValidForTriangle,
            ..Self::paper()
        }
    }

    /// Depth of what a frame may paint, metres; infinite where the mesh hides nothing.
    pub(crate) fn far_m(&self) -> f64 {
        let visibility = self.visibility.as_ref();
        visibility.map_or(f64::INFINITY, |visibility| visibility.far_m)
    }

    pub(crate) fn check(&self) -> Result<(), AssignError> {
        let rules = [
            ("area_weight", self.area_weight, self.area_weight >= 0.0),
            ("depth_weight", self.depth_weight, self.depth_weight <= 0.0),
            ("color_weight", self.color_weight, self.color_weight <= 0.0),
            ("empty_score", self.empty_score, self.empty_score <= 0.0),
            (
                "max_depth_difference_m",
                self.max_depth_difference_m,
                self.max_depth_difference_m > 0.0,
            ),
            (
                "border_margin",
                self.border_margin,
                (0.0..=0.2).contains(&self.border_margin),
            ),
            (
                "min_elevation_rad",
                self.min_elevation_rad,
                (0.0..=std::f32::consts::FRAC_PI_2).contains(&self.min_elevation_rad),
            ),
            (
                "resolution_weight",
                self.resolution_weight,
                self.resolution_weight >= 0.0,
            ),
        ];
        let non_negative = [
            (
                "rejected_depth_difference_m",
                self.rejected_depth_difference_m,
            ),
            (
                "unmeasured_depth_difference_m",
                self.unmeasured_depth_difference_m,
            ),
            ("depth_edge_penalty", self.depth_edge_penalty),
            ("hidden_penalty", self.hidden_penalty),
            ("grazing_penalty", self.grazing_penalty),
            ("back_face_penalty", self.back_face_penalty),
            ("sharpness_weight", self.sharpness_weight),
            ("exposure_weight", self.exposure_weight),
        ]
        .map(|(name, value)| (name, value, value >= 0.0));
        let refused = rules
            .into_iter()
            .chain(non_negative)
            .find(|(_, value, is_fine)| !is_fine || !value.is_finite());
        match refused {
            Some((name, value, _)) => Err(AssignError::Param { name, value }),
            None => Ok(()),
        }
    }
}

/// Why no assignment was made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AssignError {
    /// A weight or limit has the wrong sign or is not finite.
    #[error("assignment parameter {name} = {value} is out of range")]
    Param {
        /// Which one.
        name: &'static str,
        /// Its value.
        value: f32,
    },
    /// Labels by chart, with a colour cue that couples charts at their common vertices.
    #[error("labels by chart need a colour cue per triangle, not per vertex")]
    CoupledAtVertices,
    /// More frames than labels can name.
    #[error("{0} frames are more than labels can name")]
    TooManyFrames(usize),
}

/// A frame that could not be used.
#[derive(Clone, Debug, PartialEq)]
pub struct FailedFrame {
    /// Index into the frames.
    pub frame: u32,
    /// Why, in words.
    pub reason: String,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct AssignReport {
    /// Frames that were scored.
    pub num_frames: usize,
    /// Frames that could not be decoded; the others went on.
    pub failed_frames: Vec<FailedFrame>,
    /// (triangle, frame) pairs that were compared.
    pub num_candidates: usize,
    /// Triangles that a frame paints.
    pub num_labelled: usize,
    /// Triangles that a frame may paint, yet none better than the empty label; always 0 when no
    /// candidate is kept below it.
    pub num_unlabelled: usize,
    /// Frames that paint at least one triangle.
    pub num_frames_used: usize,
    /// Edges between triangles of different frames, each triangle decided alone; with labels by
    /// chart, those within charts.
    pub num_seams_unary: usize,
    /// The same in the final labels.
    pub num_seams: usize,
    /// Edges between two labelled triangles.
    pub num_inner_edges: usize,
}

/// Which frame paints each triangle, and what the frames say of it.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Assignment {
    /// Per triangle: index into the frames.
    pub label: Vec<Option<u32>>,
    /// Per triangle: pixels per metre of surface of the third-best resolved view (of fewer views,
    /// the worst), the resolution that its texels are worth; 0 where no frame sees it.
    pub best_texels_per_m: Vec<f32>,
    /// Per triangle: mean colour over the frames that see it (sRGB mean); black where none does.
    pub mean_srgb: Vec<[u8; 3]>,
    /// Per triangle: how many frames may paint it.
    pub num_views: Vec<u32>,
    /// Per triangle: whether part of it is hidden in the frame that paints it.
    pub is_partly_hidden: Vec<bool>,
    /// What happened.
    pub report: AssignReport,
}

impl Assignment {
    /// Keeps the triangles that `keep` says yes to by their index; the report stays that of all.
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        fn retained<T>(values: &mut Vec<T>, keep: &impl Fn(usize) -> bool) {
            let mut index = 0;
            values.retain(|_| {
                index += 1;
                keep(index - 1)
            });
        }
        retained(&mut self.label, &keep);
        retained(&mut self.best_texels_per_m, &keep);
        retained(&mut self.mean_srgb, &keep);
        retained(&mut self.num_views, &keep);
        retained(&mut self.is_partly_hidden, &keep);
    }
}

/// What scoring needs to know of a frame besides its pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FramePose {
    /// Number of the keyframe.
    pub(crate) id: u32,
    pub(crate) world_from_camera: RigidTransform,
    pub(crate) quality: FrameQuality,
}

impl From<&Keyframe> for FramePose {
    fn from(keyframe: &Keyframe) -> Self {
        Self {
            id: keyframe.id.0,
            world_from_camera: keyframe.world_from_camera,
            quality: keyframe.quality,
        }
    }
}

/// Scores every frame against every triangle and keeps the best. `decode` is called once per
/// frame, from many threads; `progress` with the number of frames that each step finished.
///
/// # Errors
/// [`AssignError`]. A frame that does not decode is no error: it goes to the report.
pub fn assign(
    mesh: &TriMesh,
    frames: &[Arc<Keyframe>],
    decode: &(dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &AssignParams,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Assignment, AssignError> {
    let poses: Vec<FramePose> = frames.iter().map(|frame| (&**frame).into()).collect();
    let decode_at = |frame: usize| decode(&frames[frame]);
    assign_poses(mesh, &poses, &decode_at, params, progress)
}

/// [`assign`] chart by chart ([`super::Coupling::Chart`]).
///
/// # Errors
/// [`AssignError`]. A frame that does not decode is no error: it goes to the report.
pub fn assign_in_charts(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    frames: &[Arc<Keyframe>],
    decode: &(dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &AssignParams,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Assignment, AssignError> {
    if params.color_cue == ColorCue::ValidAtVertex {
        return Err(AssignError::CoupledAtVertices);
    }
    let poses: Vec<FramePose> = frames.iter().map(|frame| (&**frame).into()).collect();
    let decode_at = |frame: usize| decode(&frames[frame]);
    let scored = ScoredFrames::new(mesh, &poses, &decode_at, params, progress)?;
    Ok(scored.assign_in_charts(mesh, layout, params))
}

pub(crate) fn assign_poses(
    mesh: &TriMesh,
    frames: &[FramePose],
    decode: &(dyn Fn(usize) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &AssignParams,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Assignment, AssignError> {
    let scored = ScoredFrames::new(mesh, frames, decode, params, progress)?;
    Ok(scored.assign(mesh, params))
}

/// What all frames say of all triangles.
pub(crate) struct ScoredFrames {
    columns: Vec<(u32, FrameQuality, FrameCandidates)>,
    failed: Vec<FailedFrame>,
}

impl ScoredFrames {
    /// Scores every frame against every triangle.
    ///
    /// # Errors
    /// [`AssignError`].
    pub(crate) fn new(
        mesh: &TriMesh,
        frames: &[FramePose],
        decode: &(dyn Fn(usize) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
        params: &AssignParams,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Result<Self, AssignError> {
        params.check()?;
        let num_frames =
            u32::try_from(frames.len()).map_err(|_| AssignError::TooManyFrames(frames.len()))?;
        let runs = MeshRuns::new(mesh);
        let scored: Vec<Result<FrameCandidates, FailedFrame>> = (0..num_frames)
            .into_par_iter()
            .map_init(cues::FrameWorkspace::default, |workspace, frame| {
                let pose = &frames[frame as usize];
                let candidates = decode(frame as usize)
                    .map_err(|error| error.to_string())
                    .and_then(|decoded| {
                        cues::score_frame(mesh, &runs, pose, &decoded, params, workspace)
                            .map_err(|error| error.to_string())
                    })
                    .map_err(|reason| FailedFrame { frame, reason });
                progress(1);
                candidates
            })
            .collect();
        let mut all = Self {
            columns: Vec::with_capacity(scored.len()),
            failed: Vec::new(),
        };
        for (frame, candidates) in (0u32..).zip(scored) {
            match candidates {
                Ok(candidates) => {
                    let quality = frames[frame as usize].quality;
                    all.columns.push((frame, quality, candidates));
                }
                Err(failed) => all.failed.push(failed),
            }
        }
        Ok(all)
    }

    /// The labels that all triangles get together.
    pub(crate) fn assign(self, mesh: &TriMesh, params: &AssignParams) -> Assignment {
        let mut table = CandidateTable::new(mesh.num_triangles(), mesh.num_vertices());
        for failed in self.failed {
            table.fail(failed);
        }
        table.add_all(self.columns);
        let typical = table.typical_quality();
        table.assign(mesh, params, typical)
    }
}

#[cfg(test)]
pub(crate) mod capture;

#[cfg(test)]
mod measure;

#[cfg(test)]
mod tests;
