//! Colour transfer: T(u, v) = I(F(u, v, t, p)) for every texel that a triangle owns.
//!
//! Input: the placed charts, one label per triangle, and the frames. Output: the pages, with the
//! frame and a confidence per texel. A texel's centre goes to its point on the triangle and from
//! there to the pixel of the chosen frame, perspective-correct: homogeneous pixel coordinates are
//! linear in the texel. Where the image is finer than the texels, a grid of samples over the texel
//! is averaged in linear light; else one bilinear sample is taken in sRGB.
//!
//! Texels without a frame of their own — triangles without a label, and the parts of large
//! triangles that something hides in the chosen frame — get the mean in linear light over all
//! frames that see them, by the z-buffer of the mesh and the measured depth
//! ([`crate::atlas::TexelSource::MEAN`]); views beside a depth edge count for an eighth. What nobody sees stays
//! [`crate::atlas::TexelSource::NONE`]. [`TransferMode::L2Avg`] paints every texel with the mean over the frames
//! that see it; with [`crate::render::VisibilityParams::edge_margin_px`] 0 all of them count alike.
//!
//! [`TransferParams::paper`] is the published program's form of it: the nearest pixel, affine in the
//! image plane, and means over every frame that a texel projects into.
//!
//! Each frame is decoded once. Frames are worked on in groups of a fixed size; every texel is
//! written by one frame, and means are integer sums, so the bytes do not depend on threads.
//!
//! Confidence: 255 for a head-on view with at least one pixel per texel, falling with the pixels
//! per texel and with the sine of the angle to the surface; means have [`MEAN_CONFIDENCE`].
mod mean;
mod painter;
mod params;
mod sampler;

use std::sync::Arc;

use crate::atlas::{AtlasLayout, AtlasTexture, SharedPage, TexturePage};
use crate::geom::ImageError;
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::{TriMesh, TriangleId};
use crate::render::MeshRuns;

use super::assign::{Assignment, FailedFrame, FramePose};
pub(crate) use mean::{MAX_FRAMES_IN_ANY_ORDER, MeanTexels, TexelSum};
pub(crate) use painter::{KnownSight, MeanJob, PaintBuffers, PaintJob, Painter};
pub use params::{Lookup, MeanForm, TransferMode, TransferParams};

/// Confidence of texels that show a mean over frames.
pub const MEAN_CONFIDENCE: u8 = 48;

/// Why no texture was made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TransferError {
    /// The layout or the assignment is for another mesh.
    #[error("mesh has {num_triangles} triangles, layout {num_in_layout}, assignment {num_labels}")]
    Mismatch {
        /// Triangles of the mesh.
        num_triangles: usize,
        /// Triangles of the layout.
        num_in_layout: usize,
        /// Labels of the assignment.
        num_labels: usize,
    },
    /// A label names a frame that is not there.
    #[error("triangle {triangle} is assigned to frame {frame} of {num_frames}")]
    Label {
        /// Which triangle.
        triangle: usize,
        /// Its label.
        frame: u32,
        /// How many frames there are.
        num_frames: usize,
    },
    /// A triangle lies on a page or in a chart that is not there.
    #[error("triangle {triangle} lies in a chart or on a page that the layout does not have")]
    Page {
        /// Which triangle.
        triangle: usize,
    },
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct TransferReport {
    /// Texels painted by one frame.
    pub num_assigned: usize,
    /// Texels painted with a mean over frames.
    pub num_mean: usize,
    /// Texels that a triangle owns and no frame sees.
    pub num_unseen: usize,
    /// Frames that could not be decoded; the others went on.
    pub failed_frames: Vec<FailedFrame>,
}

/// Paints the pages. `decode` is called once per frame that something needs, from many threads;
/// `progress` with the number of frames that each step finished.
///
/// # Errors
/// [`TransferError`]. A frame that does not decode is no error: it goes to the report.
pub fn transfer(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    assignment: &Assignment,
    frames: &[Arc<Keyframe>],
    decode: &(dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &TransferParams,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<(AtlasTexture, TransferReport), TransferError> {
    let poses: Vec<FramePose> = frames.iter().map(|frame| (&**frame).into()).collect();
    let decode_at = |frame: usize| decode(&frames[frame]);
    transfer_poses(
        mesh, layout, assignment, &poses, &decode_at, params, progress,
    )
}

pub(crate) fn transfer_poses(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    assignment: &Assignment,
    frames: &[FramePose],
    decode: &(dyn Fn(usize) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &TransferParams,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<(AtlasTexture, TransferReport), TransferError> {
    check(mesh, layout, assignment, frames.len())?;
    let [width, height] = layout.page_size_texel;
    let mut pages: Vec<SharedPage> = (0..layout.num_pages)
        .map(|_| TexturePage::blank(width, height).into())
        .collect();
    let is_assigned = params.mode == TransferMode::Assigned;
    let mut by_frame = vec![vec![]; frames.len()];
    if is_assigned {
        by_frame = triangles_by_frame(&assignment.label, frames.len());
    }
    let needs_mean = |triangle: &TriangleId| {
        !is_assigned
            || assignment.label[triangle.index()].is_none()
            || assignment.is_partly_hidden[triangle.index()]
    };
    let means = MeanTexels::new(mesh, layout, mesh.triangle_ids().filter(needs_mean));
    let painter = Painter {
        mesh,
        runs: &MeshRuns::new(mesh),
        layout,
        params,
        is_partly_hidden: &|triangle| assignment.is_partly_hidden[triangle.index()],
    };
    let job = PaintJob {
        by_frame,
        is_anew: false,
        means: vec![MeanJob {
            texels: means,
            counts: vec![true; frames.len()],
        }],
        known: None,
    };
    let buffers = &mut PaintBuffers::default();
    let done = painter.paint_all(job, frames, buffers, decode, progress, &mut pages);
    let mut report = done.report;
    for MeanJob { texels, .. } in &done.means {
        let written = texels.write(layout, params.mean_form, &mut pages, |_| true);
        (report.num_mean, report.num_unseen) = written;
    }
    Ok((AtlasTexture { pages }, report))
}

fn check(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    assignment: &Assignment,
    num_frames: usize,
) -> Result<(), TransferError> {
    let num_triangles = mesh.num_triangles();
    let num_in_layout = layout
        .corners_texel
        .len()
        .min(layout.chart_of_triangle.len());
    let num_labels = assignment
        .label
        .len()
        .min(assignment.is_partly_hidden.len());
    if num_in_layout != num_triangles || num_labels != num_triangles {
        return Err(TransferError::Mismatch {
            num_triangles,
            num_in_layout,
            num_labels,
        });
    }
    for (triangle, label) in assignment.label.iter().enumerate() {
        if let Some(frame) = label.filter(|&frame| frame as usize >= num_frames) {
            return Err(TransferError::Label {
                triangle,
                frame,
                num_frames,
            });
        }
        let page = layout
            .charts
            .get(layout.chart_of_triangle[triangle].index())
            .map(|chart| chart.page);
        if page.is_none_or(|page| page >= layout.num_pages) {
            return Err(TransferError::Page { triangle });
        }
    }
    Ok(())
}

/// Per frame: the triangles that it paints, ascending.
fn triangles_by_frame(label: &[Option<u32>], num_frames: usize) -> Vec<Vec<TriangleId>> {
    let mut by_frame = vec![vec![]; num_frames];
    for (triangle, frame) in (0u32..).zip(label) {
        if let Some(frame) = frame {
            by_frame[*frame as usize].push(TriangleId(triangle));
        }
    }
    by_frame
}

#[cfg(test)]
mod tests;
