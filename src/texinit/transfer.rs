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
//! ([`TexelSource::MEAN`]); views beside a depth edge count for an eighth. What nobody sees stays
//! [`TexelSource::NONE`]. [`TransferMode::L2Avg`] paints every texel with the mean over the frames
//! that see it; with [`VisibilityParams::edge_margin_px`] 0 all of them count alike.
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
mod sampler;

use std::sync::Arc;

use nalgebra::{Point3, Rotation3};
use rayon::prelude::*;

use crate::atlas::texels::for_each_texel_within;
use crate::atlas::{AtlasLayout, AtlasTexture, TexelSource, TexturePage};
use crate::geom::{ImageError, RigidTransform};
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::{TriMesh, TriangleId};
use crate::render::{Frustum, MeshRuns, VisibilityBuffer, VisibilityParams};

use super::assign::{Assignment, FailedFrame, FramePose};
use mean::MeanTexels;
use sampler::TriangleSampler;

/// Confidence of texels that show a mean over frames.
pub const MEAN_CONFIDENCE: u8 = 48;

/// Frames that are in memory at a time.
const GROUP_SIZE: usize = 8;

/// Where texels take their colours from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum TransferMode {
    /// From the frame that its triangle was assigned to.
    #[default]
    Assigned,
    /// The mean over all frames that see it.
    L2Avg,
}

/// How a texel's colour is looked up in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Lookup {
    /// Perspective-correct, averaged over the texel's footprint.
    #[default]
    Footprint,
    /// The pixel nearest to where the texel's centre lands when the triangle's three pixels are
    /// joined affinely (the authors' program).
    NearestAffine,
}

/// Which frames a mean runs over, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum MeanForm {
    /// The frames that see the texel, in linear light.
    #[default]
    Seeing,
    /// The frames into whose image it projects, whatever lies before it, of sRGB values (the
    /// authors' program).
    Projecting,
}

/// How colours are transferred.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferParams {
    /// Where texels take their colours from.
    pub mode: TransferMode,
    /// How colours are looked up.
    pub lookup: Lookup,
    /// What a mean runs over.
    pub mean_form: MeanForm,
    /// Samples along each side of a texel where the image is finer, 1..=16.
    pub max_samples: u32,
    /// Which frames a mean runs over: visibility by the mesh.
    pub visibility: VisibilityParams,
    /// Which frames a mean runs over: the measured depth differs by less than this, metres (> 0).
    pub max_depth_difference_m: f32,
}

impl Default for TransferParams {
    fn default() -> Self {
        Self {
            mode: TransferMode::Assigned,
            lookup: Lookup::Footprint,
            mean_form: MeanForm::Seeing,
            max_samples: 8,
            visibility: VisibilityParams {
                edge_margin_px: 2,
                ..VisibilityParams::default()
            },
            max_depth_difference_m: 0.25,
        }
    }
}

impl TransferParams {
    /// The published program's form: nearest pixels, affine in the image, means over every frame.
    pub fn paper() -> Self {
        Self {
            lookup: Lookup::NearestAffine,
            mean_form: MeanForm::Projecting,
            ..Self::default()
        }
    }
}

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

/// A painted texel of one page.
#[derive(Clone, Copy)]
struct Painted {
    texel: u32,
    srgb: [u8; 3],
    confidence: u8,
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
    let mut pages: Vec<TexturePage> = (0..layout.num_pages)
        .map(|_| TexturePage::blank(width, height))
        .collect();
    let mut report = TransferReport::default();

    let painter = Painter {
        mesh,
        runs: MeshRuns::new(mesh),
        layout,
        params,
        is_assigned: params.mode == TransferMode::Assigned,
        is_partly_hidden: &assignment.is_partly_hidden,
    };
    let by_frame = triangles_by_frame(&assignment.label, frames.len());
    let needs_mean = |triangle: &TriangleId| {
        !painter.is_assigned
            || assignment.label[triangle.index()].is_none()
            || assignment.is_partly_hidden[triangle.index()]
    };
    let mut means = MeanTexels::new(mesh, layout, mesh.triangle_ids().filter(needs_mean));

    let mut buffers = vec![VisibilityBuffer::default(); GROUP_SIZE];
    let groups = frames.chunks(GROUP_SIZE).zip(by_frame.chunks(GROUP_SIZE));
    for (group_index, (group, group_triangles)) in groups.enumerate() {
        let first = group_index * GROUP_SIZE;
        let looks: Vec<Result<Option<FrameLook<'_>>, FailedFrame>> = group
            .par_iter()
            .zip(group_triangles)
            .zip(&mut buffers)
            .enumerate()
            .map(|(offset, ((pose, triangles), buffer))| {
                let frame = first + offset;
                let look = painter.look(pose, triangles, &means, buffer, &|| decode(frame));
                progress(1);
                look.map_err(|reason| FailedFrame {
                    #[expect(clippy::cast_possible_truncation, reason = "labels are u32")]
                    frame: frame as u32,
                    reason,
                })
            })
            .collect();
        let mut seen = vec![];
        for look in looks {
            match look {
                Ok(look) => seen.extend(look),
                Err(failed) => report.failed_frames.push(failed),
            }
        }
        report.num_assigned += scatter(&seen, &mut pages);
        means.accumulate(mesh, layout, &seen, params);
    }
    (report.num_mean, report.num_unseen) = means.write(layout, params.mean_form, &mut pages);
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

/// What came of looking through one frame.
struct FrameLook<'a> {
    source: TexelSource,
    frame: Arc<DecodedFrame>,
    pose: CameraPose,
    /// Drawn only where a mean needs it.
    visibility: Option<&'a VisibilityBuffer>,
    /// Per page.
    painted: Vec<Vec<Painted>>,
}

/// Where a camera stands.
struct CameraPose {
    camera_from_world: RigidTransform,
    rotation: Rotation3<f64>,
}

impl CameraPose {
    fn new(camera_from_world: RigidTransform) -> Self {
        Self {
            camera_from_world,
            rotation: camera_from_world.rotation().to_rotation_matrix(),
        }
    }

    fn corners_in_camera(&self, mesh: &TriMesh, triangle: TriangleId) -> [Point3<f64>; 3] {
        let translation = self.camera_from_world.translation();
        mesh.corners_m(triangle)
            .map(|corner| Point3::from(self.rotation * corner.coords + translation))
    }
}

struct Painter<'a> {
    mesh: &'a TriMesh,
    runs: MeshRuns,
    layout: &'a AtlasLayout,
    params: &'a TransferParams,
    is_assigned: bool,
    is_partly_hidden: &'a [bool],
}

impl Painter<'_> {
    /// Decodes the frame and paints its triangles; nothing when no texel needs it.
    fn look<'b>(
        &self,
        pose: &FramePose,
        triangles: &[TriangleId],
        means: &MeanTexels,
        buffer: &'b mut VisibilityBuffer,
        decode: &dyn Fn() -> Result<Arc<DecodedFrame>, ImageError>,
    ) -> Result<Option<FrameLook<'b>>, String> {
        let triangles = if self.is_assigned { triangles } else { &[] };
        if triangles.is_empty() && means.is_empty() {
            return Ok(None);
        }
        let frame = decode().map_err(|error| error.to_string())?;
        let camera_pose = CameraPose::new(pose.world_from_camera.inverse());
        let camera_from_world = &camera_pose.camera_from_world;
        let mut visibility = None;
        let has_to_look = self.params.mean_form == MeanForm::Seeing
            || self.is_partly_hidden.iter().any(|&is_hidden| is_hidden);
        let frustum = Frustum::new(&frame.color_camera, camera_from_world);
        if has_to_look && means.any_in_view(&frustum) {
            let part = self.runs.in_view(&frame.color_camera, camera_from_world);
            buffer
                .update_part(
                    self.mesh,
                    &part,
                    &frame.color_camera,
                    camera_from_world,
                    &self.params.visibility,
                )
                .map_err(|error| error.to_string())?;
            visibility = Some(&*buffer);
        }
        let mut painted = vec![vec![]; self.layout.num_pages as usize];
        for &triangle in triangles {
            let sampler = TriangleSampler::new(
                camera_pose.corners_in_camera(self.mesh, triangle),
                &self.layout.corners_texel[triangle.index()],
                &frame.color_camera,
                self.params,
            );
            let Some(sampler) = sampler else { continue };
            let hiding = visibility.filter(|_| self.is_partly_hidden[triangle.index()]);
            let page = &mut painted[self.layout.page_of(triangle) as usize];
            self.paint(triangle, &sampler, &frame, hiding, page);
        }
        Ok(Some(FrameLook {
            source: TexelSource::keyframe(pose.id),
            frame,
            pose: camera_pose,
            visibility,
            painted,
        }))
    }

    fn paint(
        &self,
        triangle: TriangleId,
        sampler: &TriangleSampler,
        frame: &DecodedFrame,
        hiding: Option<&VisibilityBuffer>,
        out: &mut Vec<Painted>,
    ) {
        let page_size = self.layout.page_size_texel;
        let corners_texel = &self.layout.corners_texel[triangle.index()];
        let confidence = sampler.confidence();
        for_each_texel_within(corners_texel, page_size, |x, y, weights| {
            let texel = sampler.at(weights);
            let is_hidden = hiding.is_some_and(|buffer| {
                !texel.surface_point().is_some_and(|p| buffer.is_visible(&p))
            });
            if is_hidden {
                return;
            }
            if let Some(srgb) = texel.color(&frame.color) {
                out.push(Painted {
                    texel: y * page_size[0] + x,
                    srgb,
                    confidence,
                });
            }
        });
    }
}

/// Writes the frames' texels to the pages; returns how many there were.
fn scatter(looks: &[FrameLook<'_>], pages: &mut [TexturePage]) -> usize {
    pages.par_iter_mut().enumerate().for_each(|(index, page)| {
        for look in looks {
            for texel in &look.painted[index] {
                let index = texel.texel as usize;
                page.srgb[index] = texel.srgb;
                page.source[index] = look.source;
                page.confidence[index] = texel.confidence;
            }
        }
    });
    let painted = looks.iter().flat_map(|look| &look.painted);
    painted.map(Vec::len).sum()
}

#[cfg(test)]
mod tests;
