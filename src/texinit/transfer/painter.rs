//! Frames painting the triangles that chose them, and adding to means.

use std::sync::Arc;

use nalgebra::{Point3, Rotation3};
use rayon::prelude::*;

use crate::atlas::texels::for_each_texel_within;
use crate::atlas::{AtlasLayout, SharedPage, TexelSource};
use crate::geom::camera::CameraError;
use crate::geom::{ImageError, PinholeCamera, RigidTransform};
use crate::keyframe::DecodedFrame;
use crate::mesh::{TriMesh, TriangleId};
use crate::render::{
    DepthBound, Frustum, KeptView, MeshRuns, PixelWindow, ViewPoint, ViewScratch, VisibilityBuffer,
    WindowFinder,
};

use super::super::assign::{FailedFrame, FramePose};
use super::TransferReport;
use super::mean::{CameraSight, MeanTexels};
use super::params::{MeanForm, TransferParams};
use super::sampler::TriangleSampler;

/// Frames that are in memory at a time.
const GROUP_SIZE: usize = 8;

/// Triangles that one task paints: where one frame paints most of them, all threads help.
const TASK_SIZE: usize = 512;

/// Rows of a page that one task writes.
const BAND_ROWS: usize = 256;

/// What is to be painted.
pub(crate) struct PaintJob<'a> {
    /// Per frame: the triangles that it paints.
    pub(crate) by_frame: Vec<Vec<TriangleId>>,
    /// Whether texels of these that the frame does not see are blanked; else they stay.
    pub(crate) is_anew: bool,
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

/// A painted texel of one page.
#[derive(Clone, Copy)]
struct Painted {
    texel: u32,
    srgb: [u8; 3],
    confidence: u8,
}

/// What a task writes.
struct TaskTexels {
    /// By page, and by band there.
    bands: Vec<BandTexels>,
    /// Triangles, with the number of their texels, all of which are painted.
    complete: Vec<(TriangleId, u32)>,
    partly: Vec<TriangleId>,
}

/// What is written to a band of a page.
#[derive(Clone, Default)]
struct BandTexels {
    painted: Vec<Painted>,
    /// Texels that become blank.
    blank: Vec<u32>,
}

impl BandTexels {
    fn is_empty(&self) -> bool {
        self.painted.is_empty() && self.blank.is_empty()
    }
}

/// Scratch memory of [`Painter::paint_all`], worth keeping.
#[derive(Debug, Default)]
pub(crate) struct PaintBuffers {
    of_group: Vec<Buffers>,
    /// Per frame, what is kept of its depths where its camera is known, in buffers of the size that means
    /// use; empty where nothing is kept of any.
    pub(crate) views: Vec<Option<KeptView>>,
}

/// Scratch memory for a frame.
#[derive(Clone, Debug, Default)]
struct Buffers {
    visibility: VisibilityBuffer,
    scratch: ViewScratch,
}

/// What came of looking through one frame.
pub(super) struct FrameLook<'a> {
    /// Which of the frames.
    index: usize,
    source: TexelSource,
    pub(super) frame: Arc<DecodedFrame>,
    pub(super) pose: CameraPose,
    /// Drawn only where a mean needs it.
    pub(super) visibility: Option<&'a VisibilityBuffer>,
    painted: Vec<TaskTexels>,
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
pub(super) struct CameraPose {
    pub(super) camera_from_world: RigidTransform,
    rotation: Rotation3<f64>,
}

impl CameraPose {
    fn new(camera_from_world: RigidTransform) -> Self {
        Self {
            camera_from_world,
            rotation: camera_from_world.rotation().to_rotation_matrix(),
        }
    }

    pub(super) fn corners_in_camera(
        &self,
        mesh: &TriMesh,
        triangle: TriangleId,
    ) -> [Point3<f64>; 3] {
        let translation = self.camera_from_world.translation();
        mesh.corners_m(triangle)
            .map(|corner| Point3::from(self.rotation * corner.coords + translation))
    }
}

/// What came of a job.
pub(crate) struct PaintDone {
    /// With what the frames added; written by [`MeanTexels::write`].
    pub(crate) means: Vec<MeanJob>,
    pub(crate) report: TransferReport,
    /// Triangles that their frame painted, with the number of their texels.
    pub(crate) complete: Vec<(TriangleId, u32)>,
    /// Triangles of which their frame painted not all.
    pub(crate) partly: Vec<TriangleId>,
}

/// Paints triangles of one mesh and layout.
pub(crate) struct Painter<'a> {
    pub(crate) mesh: &'a TriMesh,
    pub(crate) runs: &'a MeshRuns,
    pub(crate) layout: &'a AtlasLayout,
    pub(crate) params: &'a TransferParams,
    pub(crate) is_partly_hidden: &'a (dyn Fn(TriangleId) -> bool + Sync),
}

impl Painter<'_> {
    /// Paints what the job says and nothing else: texels of its triangles that nobody sees stay as
    /// they are.
    pub(crate) fn paint_all(
        &self,
        mut job: PaintJob<'_>,
        frames: &[FramePose],
        buffers: &mut PaintBuffers,
        decode: &(dyn Fn(usize) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
        progress: &(dyn Fn(usize) + Sync),
        pages: &mut [SharedPage],
    ) -> PaintDone {
        let mut report = TransferReport::default();
        let (mut complete, mut partly) = (Vec::new(), Vec::new());
        let PaintBuffers {
            of_group: buffers,
            views,
        } = buffers;
        buffers.resize_with(GROUP_SIZE, Buffers::default);
        let mut nothing_kept = vec![None; GROUP_SIZE];
        let mut views = views.chunks_mut(GROUP_SIZE);
        for (group_index, group) in frames.chunks(GROUP_SIZE).enumerate() {
            let first = group_index * GROUP_SIZE;
            let kept = views.next().unwrap_or(&mut nothing_kept);
            let looks: Vec<Result<Option<FrameLook<'_>>, FailedFrame>> = group
                .par_iter()
                .zip(&mut *buffers)
                .zip(kept)
                .enumerate()
                .map(|(offset, ((pose, buffers), view))| {
                    let frame = first + offset;
                    let look = self.look(pose, frame, &job, buffers, view, &|| decode(frame));
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
            for task in seen.iter().flat_map(|look| &look.painted) {
                complete.extend_from_slice(&task.complete);
                partly.extend_from_slice(&task.partly);
            }
            for MeanJob { texels, counts } in &mut job.means {
                let looks = seen.iter().filter(|look| counts[look.index]);
                let looks: Vec<&FrameLook<'_>> = looks.collect();
                texels.accumulate(self.mesh, self.layout, &looks, self.params);
            }
        }
        PaintDone {
            means: job.means,
            report,
            complete,
            partly,
        }
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
        let is_hidden = |triangle: &&TriangleId| (self.is_partly_hidden)(**triangle);
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

    /// Texels at most whose mean asks for the depth edges that the frame sees.
    fn num_edge_tests(
        &self,
        job: &PaintJob<'_>,
        index: usize,
        camera: &PinholeCamera,
        pose: &CameraPose,
    ) -> usize {
        let bound = job.known.and_then(|known| known[index].bound.as_deref());
        let sight = self.sight(camera, pose, bound);
        let means = job.means.iter().filter(|means| means.counts[index]);
        let num_texels = means.map(|means| means.texels.num_visible(self.mesh, &sight));
        num_texels.sum()
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
        buffers: &'b mut Buffers,
        view: &mut Option<KeptView>,
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
            let num_edge_tests = self.num_edge_tests(job, index, &camera, &camera_pose);
            let from = ViewPoint {
                camera: &camera,
                camera_from_world,
            };
            let drawn = self.draw(buffers, view, from, window, num_edge_tests);
            visibility = Some(drawn.map_err(|error| error.to_string())?);
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
        let tasks = triangles.par_chunks(TASK_SIZE).map(|triangles| {
            let mut texels = TaskTexels::new(self.layout);
            for &triangle in triangles {
                let sampler = TriangleSampler::new(
                    camera_pose.corners_in_camera(self.mesh, triangle),
                    &self.layout.corners_texel[triangle.index()],
                    &frame.color_camera,
                    self.params,
                );
                let hiding = visibility.filter(|_| (self.is_partly_hidden)(triangle));
                match sampler {
                    Some(sampler) => {
                        self.paint(triangle, &sampler, &frame, hiding, job.is_anew, &mut texels);
                    }
                    None if job.is_anew => self.blank(triangle, &mut texels),
                    None => {}
                }
            }
            texels
        });
        let painted = tasks.collect();
        Ok(Some(FrameLook {
            index,
            source: TexelSource::keyframe(pose.id),
            frame,
            pose: camera_pose,
            visibility,
            painted,
        }))
    }

    /// What a frame sees in a window; from what is kept of its view, where something is.
    fn draw<'b>(
        &self,
        buffers: &'b mut Buffers,
        view: &mut Option<KeptView>,
        from: ViewPoint<'_>,
        window: PixelWindow,
        num_edge_tests: usize,
    ) -> Result<&'b VisibilityBuffer, CameraError> {
        let params = &self.params.visibility;
        let ViewPoint {
            camera,
            camera_from_world,
        } = from;
        let own_camera = WindowFinder::new(camera, params).buffer_camera(camera)?;
        let part_in = |window: PixelWindow| {
            let far_m = params.far_m;
            let frustum = Frustum::of_window(&own_camera, camera_from_world, far_m, window);
            self.runs.in_frustum(&frustum)
        };
        let Buffers {
            visibility,
            scratch,
        } = buffers;
        match view {
            Some(view) => {
                let from = ViewPoint {
                    camera: &own_camera,
                    camera_from_world,
                };
                if !view.stale().is_empty() {
                    view.redraw(self.mesh, &part_in(view.stale()), from, scratch);
                }
                visibility.load(view, camera, params, window, num_edge_tests)?;
            }
            None => {
                let part = part_in(window);
                visibility.update_window(
                    self.mesh,
                    &part,
                    camera,
                    camera_from_world,
                    params,
                    window,
                )?;
            }
        }
        Ok(visibility)
    }

    fn paint(
        &self,
        triangle: TriangleId,
        sampler: &TriangleSampler,
        frame: &DecodedFrame,
        hiding: Option<&VisibilityBuffer>,
        is_anew: bool,
        out: &mut TaskTexels,
    ) {
        let page_size = self.layout.page_size_texel;
        let corners_texel = &self.layout.corners_texel[triangle.index()];
        let confidence = sampler.confidence();
        let bands = out.bands_of(self.layout, triangle);
        let [mut num_painted, mut num_blank] = [0_u32; 2];
        for_each_texel_within(corners_texel, page_size, |x, y, weights| {
            let texel = sampler.at(weights);
            let is_hidden = hiding.is_some_and(|buffer| {
                !texel.surface_point().is_some_and(|p| buffer.is_visible(&p))
            });
            let color = match is_hidden {
                true => None,
                false => texel.color(&frame.color),
            };
            let band = &mut bands[y as usize / BAND_ROWS];
            let texel = y * page_size[0] + x;
            if let Some(srgb) = color {
                num_painted += 1;
                band.painted.push(Painted {
                    texel,
                    srgb,
                    confidence,
                });
            } else {
                num_blank += 1;
                if is_anew {
                    band.blank.push(texel);
                }
            }
        });
        if num_blank == 0 {
            out.complete.push((triangle, num_painted));
        } else {
            out.partly.push(triangle);
        }
    }

    fn blank(&self, triangle: TriangleId, out: &mut TaskTexels) {
        let page_size = self.layout.page_size_texel;
        let corners_texel = &self.layout.corners_texel[triangle.index()];
        let bands = out.bands_of(self.layout, triangle);
        for_each_texel_within(corners_texel, page_size, |x, y, _| {
            let band = &mut bands[y as usize / BAND_ROWS];
            band.blank.push(y * page_size[0] + x);
        });
        out.partly.push(triangle);
    }
}

impl TaskTexels {
    fn new(layout: &AtlasLayout) -> Self {
        let num_bands = layout.num_pages as usize * num_bands(layout.page_size_texel);
        Self {
            bands: vec![BandTexels::default(); num_bands],
            complete: Vec::new(),
            partly: Vec::new(),
        }
    }

    /// Those of the triangle's page.
    fn bands_of(&mut self, layout: &AtlasLayout, triangle: TriangleId) -> &mut [BandTexels] {
        let num_bands = num_bands(layout.page_size_texel);
        let first = layout.page_of(triangle) as usize * num_bands;
        &mut self.bands[first..first + num_bands]
    }
}

fn num_bands([_, height]: [u32; 2]) -> usize {
    (height as usize).div_ceil(BAND_ROWS)
}

/// Writes the frames' texels to the pages; returns how many were painted.
fn scatter(looks: &[FrameLook<'_>], pages: &mut [SharedPage]) -> usize {
    pages.par_iter_mut().enumerate().for_each(|(number, page)| {
        let num_bands = num_bands([page.width, page.height]);
        let first_band = number * num_bands;
        let tasks = || looks.iter().flat_map(|look| &look.painted);
        let mut bands = tasks().flat_map(|task| &task.bands[first_band..][..num_bands]);
        if bands.all(BandTexels::is_empty) {
            return;
        }
        let page = page.to_mut();
        let band_len = BAND_ROWS * page.width as usize;
        let srgb = page.srgb.par_chunks_mut(band_len);
        let source = page.source.par_chunks_mut(band_len);
        let confidence = page.confidence.par_chunks_mut(band_len);
        let bands = srgb.zip(source).zip(confidence).enumerate();
        bands.for_each(|(band, ((srgb, source), confidence))| {
            let first = band * band_len;
            for look in looks {
                for task in &look.painted {
                    let BandTexels { painted, blank } = &task.bands[first_band + band];
                    for texel in painted {
                        let index = texel.texel as usize - first;
                        srgb[index] = texel.srgb;
                        source[index] = look.source;
                        confidence[index] = texel.confidence;
                    }
                    for texel in blank {
                        let index = *texel as usize - first;
                        srgb[index] = [0; 3];
                        source[index] = TexelSource::NONE;
                        confidence[index] = 0;
                    }
                }
            }
        });
    });
    let tasks = looks.iter().flat_map(|look| &look.painted);
    let bands = tasks.flat_map(|task| &task.bands);
    bands.map(|band| band.painted.len()).sum()
}
