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
use crate::geom::{ImageError, PinholeCamera, RigidTransform};
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::{TriMesh, TriangleId};
use crate::render::{
    DepthBound, Frustum, MeshRuns, PixelWindow, VisibilityBuffer, VisibilityParams, WindowFinder,
};

use super::assign::{Assignment, FailedFrame, FramePose};
use mean::CameraSight;
pub(crate) use mean::{MAX_FRAMES_IN_ANY_ORDER, MeanTexels, TexelSum};
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

    /// Depth of what a mean takes in, metres.
    pub(crate) fn far_m(&self) -> f64 {
        match self.mean_form {
            MeanForm::Seeing => self.visibility.far_m,
            MeanForm::Projecting => f64::INFINITY,
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
        is_partly_hidden: &assignment.is_partly_hidden,
    };
    let job = PaintJob {
        by_frame,
        means: vec![MeanJob {
            texels: means,
            counts: vec![true; frames.len()],
        }],
        known: None,
    };
    let (_, report) = painter.paint_all(job, frames, decode, progress, &mut pages);
    Ok((AtlasTexture { pages }, report))
}

/// What is to be painted.
pub(crate) struct PaintJob<'a> {
    /// Per frame: the triangles that it paints.
    pub(crate) by_frame: Vec<Vec<TriangleId>>,
    /// Triangles that show a mean where no frame paints them.
    pub(crate) means: Vec<MeanJob>,
    /// Per frame, what is known before it is decoded: what neither paints a triangle nor sees one with
    /// a mean is then not decoded.
    pub(crate) known: Option<&'a [KnownSight]>,
}

/// What is known of a frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct KnownSight {
    pub(crate) camera: Option<PinholeCamera>,
    /// How far it sees at most, in a buffer of the size that means use.
    pub(crate) bound: Option<Arc<DepthBound>>,
}

/// Means over some of the frames.
pub(crate) struct MeanJob {
    pub(crate) texels: MeanTexels,
    /// Per frame: whether it is to be added.
    pub(crate) counts: Vec<bool>,
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
    /// Which of the frames.
    index: usize,
    source: TexelSource,
    frame: Arc<DecodedFrame>,
    pose: CameraPose,
    /// Drawn only where a mean needs it.
    visibility: Option<&'a VisibilityBuffer>,
    /// Per page.
    painted: Vec<Vec<Painted>>,
}

/// Pixels of a triangle's corners; `None` unless all are in front of the camera.
fn pixels_of(
    camera: &PinholeCamera,
    corners_in_camera: &[Point3<f64>; 3],
) -> Option<[[f64; 2]; 3]> {
    let [a, b, c] = corners_in_camera.map(|corner| camera.project(&corner));
    Some([a?, b?, c?])
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

/// Paints triangles of one mesh and layout.
pub(crate) struct Painter<'a> {
    pub(crate) mesh: &'a TriMesh,
    pub(crate) runs: &'a MeshRuns,
    pub(crate) layout: &'a AtlasLayout,
    pub(crate) params: &'a TransferParams,
    pub(crate) is_partly_hidden: &'a [bool],
}

impl Painter<'_> {
    /// Paints what the job says and nothing else: texels of its triangles that nobody sees stay as
    /// they are. Returns the means with what the frames added to them.
    pub(crate) fn paint_all(
        &self,
        mut job: PaintJob<'_>,
        frames: &[FramePose],
        decode: &(dyn Fn(usize) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
        progress: &(dyn Fn(usize) + Sync),
        pages: &mut [TexturePage],
    ) -> (Vec<MeanJob>, TransferReport) {
        let mut report = TransferReport::default();
        let mut buffers = vec![VisibilityBuffer::default(); GROUP_SIZE];
        for (group_index, group) in frames.chunks(GROUP_SIZE).enumerate() {
            let first = group_index * GROUP_SIZE;
            let looks: Vec<Result<Option<FrameLook<'_>>, FailedFrame>> = group
                .par_iter()
                .zip(&mut buffers)
                .enumerate()
                .map(|(offset, (pose, buffer))| {
                    let frame = first + offset;
                    let look = self.look(pose, frame, &job, buffer, &|| decode(frame));
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
            report.num_assigned += scatter(&seen, pages);
            for MeanJob { texels, counts } in &mut job.means {
                let looks = seen.iter().filter(|look| counts[look.index]);
                let looks: Vec<&FrameLook<'_>> = looks.collect();
                texels.accumulate(self.mesh, self.layout, &looks, self.params);
            }
        }
        for MeanJob { texels, .. } in &job.means {
            let (num_mean, num_unseen) = texels.write(self.layout, self.params.mean_form, pages);
            report.num_mean += num_mean;
            report.num_unseen += num_unseen;
        }
        (job.means, report)
    }

    /// What of a frame's visibility buffer is looked at: where triangles lie that are partly hidden, or
    /// show a mean.
    fn window(
        &self,
        job: &PaintJob<'_>,
        index: usize,
        camera: &PinholeCamera,
        pose: &CameraPose,
    ) -> PixelWindow {
        let mut finder = WindowFinder::new(camera, &self.params.visibility);
        let is_hidden = |triangle: &&TriangleId| self.is_partly_hidden[triangle.index()];
        let mut hidden = job.by_frame[index].iter().filter(is_hidden);
        let is_seeing = self.params.mean_form == MeanForm::Seeing;
        let means = || {
            job.means
                .iter()
                .filter(|means| is_seeing && means.counts[index])
        };
        let Some(known) = job.known.map(|known| &known[index]) else {
            // What is not known beforehand is drawn whole, without looking for the part that matters.
            let sight = self.sight(camera, pose, None);
            let mut means = means();
            let is_needed =
                hidden.next().is_some() || means.any(|m| m.texels.any_visible(self.mesh, &sight));
            return if is_needed {
                finder.whole()
            } else {
                PixelWindow::default()
            };
        };
        for &triangle in hidden {
            let corners = pose.corners_in_camera(self.mesh, triangle);
            finder.include(pixels_of(camera, &corners));
        }
        let sight = self.sight(camera, pose, known.bound.as_deref());
        for means in means() {
            means.texels.each_visible(self.mesh, &sight, |corners| {
                finder.include(pixels_of(camera, corners));
            });
        }
        finder.window()
    }

    fn sight<'b>(
        &'b self,
        camera: &'b PinholeCamera,
        pose: &'b CameraPose,
        bound: Option<&'b DepthBound>,
    ) -> CameraSight<'b> {
        CameraSight {
            camera,
            pose,
            bound,
            params: self.params,
        }
    }

    /// Decodes the frame and paints its triangles; nothing when no texel needs it.
    fn look<'b>(
        &self,
        pose: &FramePose,
        index: usize,
        job: &PaintJob<'_>,
        buffer: &'b mut VisibilityBuffer,
        decode: &dyn Fn() -> Result<Arc<DecodedFrame>, ImageError>,
    ) -> Result<Option<FrameLook<'b>>, String> {
        let triangles = &*job.by_frame[index];
        let means = || job.means.iter().filter(|means| means.counts[index]);
        let camera_pose = CameraPose::new(pose.world_from_camera.inverse());
        let camera_from_world = &camera_pose.camera_from_world;
        let known = job.known.and_then(|known| known[index].camera);
        let known_window = known.map(|camera| self.window(job, index, &camera, &camera_pose));
        let may_need_mean = match known_window {
            Some(window) => !window.is_empty(),
            None => means().any(|means| !means.texels.is_empty()),
        };
        if triangles.is_empty() && !may_need_mean {
            return Ok(None);
        }
        let decode = || decode().map_err(|error| error.to_string());
        let mut decoded = None;
        let camera = match known {
            Some(camera) => camera,
            None => decoded.insert(decode()?).color_camera,
        };
        let window = known_window.unwrap_or_else(|| self.window(job, index, &camera, &camera_pose));
        let mut visibility = None;
        if !window.is_empty() {
            let params = &self.params.visibility;
            let finder = WindowFinder::new(&camera, params);
            let buffer_camera = finder.buffer_camera(&camera);
            let frustum = Frustum::of_window(
                &buffer_camera.map_err(|error| error.to_string())?,
                camera_from_world,
                params.far_m,
                window,
            );
            let part = self.runs.in_frustum(&frustum);
            buffer
                .update_window(self.mesh, &part, &camera, camera_from_world, params, window)
                .map_err(|error| error.to_string())?;
            visibility = Some(&*buffer);
        }
        let bound = visibility.map(VisibilityBuffer::depth_bound);
        let sight = self.sight(&camera, &camera_pose, bound);
        let any_visible = || means().any(|m| m.texels.any_visible(self.mesh, &sight));
        if known.is_some() && triangles.is_empty() && !any_visible() {
            return Ok(None);
        }
        let frame = match decoded {
            Some(frame) => frame,
            None => decode()?,
        };
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
            index,
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
