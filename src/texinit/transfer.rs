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
//! Each frame is decoded once. Frames are worked on in groups of a fixed size; every texel is
//! written by one frame, and means are integer sums, so the bytes do not depend on threads.
//!
//! Confidence: 255 for a head-on view with at least one pixel per texel, falling with the pixels
//! per texel and with the sine of the angle to the surface; means have [`MEAN_CONFIDENCE`].

mod mean;
mod sampler;

use std::sync::Arc;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::atlas::texels::for_each_texel_within;
use crate::atlas::{AtlasLayout, AtlasTexture, TexelSource, TexturePage};
use crate::geom::ImageError;
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::{TriMesh, TriangleId};
use crate::render::{VisibilityBuffer, VisibilityParams};

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

/// How colours are transferred.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferParams {
    /// Where texels take their colours from.
    pub mode: TransferMode,
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
            max_samples: 8,
            visibility: VisibilityParams {
                edge_margin_px: 2,
                ..VisibilityParams::default()
            },
            max_depth_difference_m: 0.25,
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
    let mut means = MeanTexels::new(layout, mesh.triangle_ids().filter(needs_mean));

    let groups = frames.chunks(GROUP_SIZE).zip(by_frame.chunks(GROUP_SIZE));
    for (group_index, (group, group_triangles)) in groups.enumerate() {
        let first = group_index * GROUP_SIZE;
        let looks: Vec<Result<Option<FrameLook>, FailedFrame>> = group
            .par_iter()
            .zip(group_triangles)
            .enumerate()
            .map(|(offset, (pose, triangles))| {
                let frame = first + offset;
                let look = painter.look(pose, triangles, &means, &|| decode(frame));
                progress(1);
                look.map_err(|reason| FailedFrame {
                    #[expect(clippy::cast_possible_truncation, reason = "labels are u32")]
                    frame: frame as u32,
                    reason,
                })
            })
            .collect();
        let mut seen = vec![];
        for (look, pose) in looks.into_iter().zip(group) {
            match look {
                Ok(Some(look)) => {
                    report.num_assigned +=
                        scatter(&look.painted, TexelSource::keyframe(pose.id), &mut pages);
                    seen.push(look);
                }
                Ok(None) => {}
                Err(failed) => report.failed_frames.push(failed),
            }
        }
        means.accumulate(mesh, layout, &seen, params);
    }
    (report.num_mean, report.num_unseen) = means.write(layout, &mut pages);
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
struct FrameLook {
    frame: Arc<DecodedFrame>,
    /// Vertices of the mesh in the camera.
    points_in_camera: Vec<Point3<f64>>,
    /// Drawn only where a mean needs it.
    visibility: Option<VisibilityBuffer>,
    /// Per page.
    painted: Vec<Vec<Painted>>,
}

/// Corners of a triangle among its mesh's transformed vertices.
fn corners_of(mesh: &TriMesh, points: &[Point3<f64>], triangle: TriangleId) -> [Point3<f64>; 3] {
    let [a, b, c] = mesh.triangles()[triangle.index()].map(|v| v as usize);
    [points[a], points[b], points[c]]
}

struct Painter<'a> {
    mesh: &'a TriMesh,
    layout: &'a AtlasLayout,
    params: &'a TransferParams,
    is_assigned: bool,
    is_partly_hidden: &'a [bool],
}

impl Painter<'_> {
    /// Decodes the frame and paints its triangles; nothing when no texel needs it.
    fn look(
        &self,
        pose: &FramePose,
        triangles: &[TriangleId],
        means: &MeanTexels,
        decode: &dyn Fn() -> Result<Arc<DecodedFrame>, ImageError>,
    ) -> Result<Option<FrameLook>, String> {
        let triangles = if self.is_assigned { triangles } else { &[] };
        if triangles.is_empty() && means.is_empty() {
            return Ok(None);
        }
        let frame = decode().map_err(|error| error.to_string())?;
        let camera_from_world = pose.world_from_camera.inverse();
        let points_in_camera = camera_from_world.transform_points(self.mesh.positions_m());
        let mut visibility = None;
        if means.any_in_view(self.mesh, &frame.color_camera, &points_in_camera) {
            let mut buffer = VisibilityBuffer::default();
            buffer
                .update(
                    self.mesh,
                    &frame.color_camera,
                    &camera_from_world,
                    &self.params.visibility,
                )
                .map_err(|error| error.to_string())?;
            visibility = Some(buffer);
        }
        let mut painted = vec![vec![]; self.layout.num_pages as usize];
        for &triangle in triangles {
            let sampler = TriangleSampler::new(
                corners_of(self.mesh, &points_in_camera, triangle),
                &self.layout.corners_texel[triangle.index()],
                &frame.color_camera,
                self.params.max_samples,
            );
            let Some(sampler) = sampler else { continue };
            let hiding = visibility
                .as_ref()
                .filter(|_| self.is_partly_hidden[triangle.index()]);
            let page = &mut painted[self.layout.page_of(triangle) as usize];
            self.paint(triangle, &sampler, &frame, hiding, page);
        }
        Ok(Some(FrameLook {
            frame,
            points_in_camera,
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

/// Writes a frame's texels to the pages; returns how many there were.
fn scatter(painted: &[Vec<Painted>], source: TexelSource, pages: &mut [TexturePage]) -> usize {
    for (page, painted) in pages.iter_mut().zip(painted) {
        for texel in painted {
            let index = texel.texel as usize;
            page.srgb[index] = texel.srgb;
            page.source[index] = source;
            page.confidence[index] = texel.confidence;
        }
    }
    painted.iter().map(Vec::len).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::color::{linear_from_srgb, srgb_from_linear};
    use crate::render::{RenderParams, render_textured};
    use crate::texinit::analytic_scene::{Panel, Scene, grey, red, waves};
    use crate::texinit::assign::{AssignParams, assign_poses};
    use proptest::prelude::*;

    const WALL: Panel = Panel {
        min: [-1.0, -0.7],
        max: [1.0, 0.7],
        z: 3.0,
        cells: [20, 14],
        paint: waves,
    };
    const BOARD: Panel = Panel {
        min: [-0.2, -0.2],
        max: [0.2, 0.2],
        z: 2.0,
        cells: [1, 1],
        paint: red,
    };

    fn paint(
        scene: &Scene,
        layout: &AtlasLayout,
        assign: &AssignParams,
        params: &TransferParams,
    ) -> (Assignment, TexturePage, TransferReport) {
        let mesh = scene.mesh();
        let decode = |frame: usize| Ok(scene.frames[frame].clone());
        let assignment = assign_poses(&mesh, &scene.poses, &decode, assign, &|_| ()).unwrap();
        let (mut texture, report) = transfer_poses(
            &mesh,
            layout,
            &assignment,
            &scene.poses,
            &decode,
            params,
            &|_| (),
        )
        .unwrap();
        (assignment, texture.pages.remove(0), report)
    }

    /// Visits every owned texel of the first panel with its point on it.
    fn for_each_wall_texel(
        scene: &Scene,
        layout: &AtlasLayout,
        mut visit: impl FnMut(TriangleId, usize, Point3<f64>),
    ) {
        let mesh = scene.mesh();
        for &triangle in &layout.charts[0].triangles {
            let corners = mesh.corners_m(triangle);
            for_each_texel_within(
                &layout.corners_texel[triangle.index()],
                layout.page_size_texel,
                |x, y, w| {
                    let [a, b, c] = w.map(f64::from);
                    let point = Point3::from(
                        corners[0].coords * a + corners[1].coords * b + corners[2].coords * c,
                    );
                    visit(
                        triangle,
                        (y * layout.page_size_texel[0] + x) as usize,
                        point,
                    );
                },
            );
        }
    }

    /// The same picture past the outline of the wall.
    const BACKDROP: Panel = Panel {
        min: [-9.0, -9.0],
        max: [9.0, 9.0],
        ..WALL
    };

    fn slanted_views(panels: Vec<Panel>, has_depth: bool) -> Scene {
        let mut scene = Scene {
            panels,
            ..Scene::default()
        };
        scene.photograph([-0.6, 0.0, 0.9], 0.25, &[BACKDROP], has_depth);
        scene.photograph([0.7, 0.1, 0.7], -0.3, &[BACKDROP], has_depth);
        scene.photograph([0.1, -0.1, 0.0], 0.0, &[BACKDROP], has_depth);
        scene
    }

    #[test]
    fn texels_have_the_colour_of_their_point_and_name_their_frame() {
        let scene = slanted_views(vec![WALL], true);
        let layout = scene.layout(60.0);
        let (assignment, page, report) = paint(
            &scene,
            &layout,
            &AssignParams::default(),
            &TransferParams::default(),
        );
        let (mut worst, mut num, mut frames) = (0.0f64, 0usize, [0; 3]);
        for_each_wall_texel(&scene, &layout, |triangle, index, point| {
            let Some(label) = assignment.label[triangle.index()] else {
                return;
            };
            frames[label as usize] += 1;
            assert_eq!(page.source[index], TexelSource::keyframe(100 + label));
            assert!(page.confidence[index] > 0);
            for (byte, expected) in page.srgb[index].iter().zip(waves(point.x, point.y)) {
                worst = worst.max((f64::from(*byte) - expected).abs());
            }
            num += 1;
        });
        // Half a step of rounding twice, and the curvature of the waves over a pixel of 2 cm.
        assert!(worst < 3.0, "{worst}");
        assert!(
            num > 8000 && frames[..2].iter().all(|&n| n > 500),
            "{num} {frames:?}"
        );
        assert_eq!(report.num_assigned, num);
    }

    #[test]
    fn averaging_paints_the_same_smooth_texture() {
        let scene = slanted_views(vec![WALL], true);
        let layout = scene.layout(60.0);
        let params = TransferParams {
            mode: TransferMode::L2Avg,
            ..TransferParams::default()
        };
        let (_, page, report) = paint(&scene, &layout, &AssignParams::default(), &params);
        let mut num = 0;
        for_each_wall_texel(&scene, &layout, |_, index, point| {
            if page.source[index] != TexelSource::MEAN {
                return;
            }
            assert_eq!(page.confidence[index], MEAN_CONFIDENCE);
            for (byte, expected) in page.srgb[index].iter().zip(waves(point.x, point.y)) {
                assert!((f64::from(*byte) - expected).abs() < 3.0);
            }
            num += 1;
        });
        assert_eq!(report.num_assigned, 0);
        assert_eq!(report.num_mean, num);
        assert!(num > 9000);
    }

    #[test]
    fn means_are_taken_in_linear_light() {
        let mut scene = Scene {
            panels: vec![WALL],
            ..Scene::default()
        };
        scene.panels[0].paint = grey;
        scene.photograph([0.0; 3], 0.0, &[], true);
        scene.panels[0].paint = red;
        scene.photograph([0.0; 3], 0.0, &[], true);
        let layout = scene.layout(30.0);
        let params = TransferParams {
            mode: TransferMode::L2Avg,
            ..TransferParams::default()
        };
        let (_, page, _) = paint(&scene, &layout, &AssignParams::default(), &params);
        let expected: [u8; 3] = [[120, 250], [120, 0], [120, 0]].map(|pair| {
            srgb_from_linear((linear_from_srgb(pair[0]) + linear_from_srgb(pair[1])) / 2.0)
        });
        let center = page.srgb.len() / 2 + page.width as usize / 2;
        assert_eq!(page.source[center], TexelSource::MEAN);
        assert_eq!(page.srgb[center], expected);
    }

    #[test]
    fn coarse_texels_average_a_fine_pattern() {
        // Stripes of 4 cm, two pixels each, on texels of 20 cm.
        fn stripes(x: f64, _: f64) -> [f64; 3] {
            [if (x / 0.04).floor() % 2.0 == 0.0 {
                255.0
            } else {
                0.0
            }; 3]
        }
        let mut scene = Scene {
            panels: vec![Panel {
                paint: stripes,
                ..WALL
            }],
            ..Scene::default()
        };
        scene.photograph([0.0; 3], 0.0, &[], true);
        let layout = scene.layout(5.0);
        let (_, page, _) = paint(
            &scene,
            &layout,
            &AssignParams::default(),
            &TransferParams::default(),
        );
        let mut num = 0;
        for_each_wall_texel(&scene, &layout, |_, index, point| {
            if page.source[index].as_keyframe().is_some() && point.x.abs() < 0.8 {
                // 2½ periods a texel: between 40 and 60 % of light.
                let light = linear_from_srgb(page.srgb[index][0]);
                assert!((light - 0.5).abs() < 0.13, "{light} at {point}");
                num += 1;
            }
        });
        assert!(num > 20);
    }

    #[test]
    fn what_hides_part_of_a_large_triangle_is_not_painted_on_it() {
        let wall = Panel {
            cells: [1, 1],
            ..WALL
        };
        let mut scene = Scene {
            panels: vec![wall, BOARD],
            ..Scene::default()
        };
        scene.photograph([0.0, 0.0, -0.5], 0.0, &[BACKDROP], false);
        scene.photograph([0.5, 0.0, -0.6], 0.0, &[BACKDROP], false);
        let layout = scene.layout(60.0);
        let (assignment, page, report) = paint(
            &scene,
            &layout,
            &AssignParams::default(),
            &TransferParams::default(),
        );
        assert!(assignment.label[..2].iter().all(Option::is_some));
        assert!(assignment.is_partly_hidden[..2].contains(&true));
        let (mut num_red, mut num_mean) = (0, 0);
        for_each_wall_texel(&scene, &layout, |_, index, point| {
            num_mean += usize::from(page.source[index] == TexelSource::MEAN);
            if page.source[index] != TexelSource::NONE {
                let error = (f64::from(page.srgb[index][2]) - waves(point.x, point.y)[2]).abs();
                num_red += usize::from(error > 20.0);
            }
        });
        // The board hides about 1100 texels.
        assert_eq!(num_red, 0);
        assert!(num_mean > 300, "{num_mean}");
        assert_eq!(report.num_mean, num_mean);
    }

    #[test]
    fn a_new_view_of_the_painted_scene_looks_like_its_photo() {
        let mut scene = slanted_views(vec![WALL], true);
        let layout = scene.layout(80.0);
        let (_, page, _) = paint(
            &scene,
            &layout,
            &AssignParams::default(),
            &TransferParams::default(),
        );
        let texture = AtlasTexture { pages: vec![page] };
        scene.photograph([-0.2, 0.15, 0.5], 0.15, &[], true);
        let photo = scene.frames[3].clone();
        let camera_from_world = scene.poses[3].world_from_camera.inverse();
        for supersampling in [1, 2] {
            let params = RenderParams { supersampling };
            let view = render_textured(
                &scene.mesh(),
                &layout,
                &texture,
                &photo.color_camera,
                &camera_from_world,
                &params,
            )
            .unwrap();
            let depths = photo.depth.as_ref().unwrap().image.depths_m();
            let (mut num_compared, mut num_differing_in_mask) = (0, 0);
            for (index, &is_seen) in view.mask.iter().enumerate() {
                num_differing_in_mask += usize::from(is_seen != (depths[index] > 0.0));
                if is_seen && depths[index] > 0.0 {
                    num_compared += 1;
                    let (seen, expected) =
                        (view.color.pixels()[index], photo.color.pixels()[index]);
                    for (a, b) in seen.iter().zip(expected) {
                        assert!(
                            a.abs_diff(b) <= 5,
                            "{seen:?} for {expected:?} at pixel {index}"
                        );
                    }
                }
            }
            assert!(num_compared > 9000, "{num_compared}");
            // The outline, and texels there that no frame holds.
            assert!(num_differing_in_mask < 400, "{num_differing_in_mask}");
        }
    }

    #[test]
    fn keyframes_give_what_their_decoded_frames_give() {
        use crate::geom::{CameraModel, ColorEncoding, EncodedColor, Stamp};
        use crate::keyframe::KeyframeId;

        let scene = slanted_views(vec![WALL], false);
        let (mesh, layout) = (scene.mesh(), scene.layout(40.0));
        let keyframes: Vec<Arc<Keyframe>> = scene
            .poses
            .iter()
            .zip(&scene.frames)
            .map(|(pose, frame)| {
                let bytes: Vec<u8> = frame.color.pixels().iter().flatten().copied().collect();
                let color =
                    EncodedColor::from_raw(ColorEncoding::Rgb8, 160, 120, 480, bytes.into());
                Arc::new(Keyframe {
                    id: KeyframeId(pose.id),
                    stamp: Stamp::default(),
                    world_from_camera: pose.world_from_camera,
                    color: color.unwrap(),
                    color_camera: CameraModel::ideal(frame.color_camera),
                    depth: None,
                    quality: pose.quality,
                })
            })
            .collect();
        let decode = |keyframe: &Keyframe| {
            Ok(Arc::new(DecodedFrame {
                color: keyframe.color.decode()?,
                color_camera: keyframe.color_camera.pinhole,
                depth: None,
            }))
        };
        let (assign_params, params) = (AssignParams::default(), TransferParams::default());
        let assignment =
            crate::texinit::assign::assign(&mesh, &keyframes, &decode, &assign_params, &|_| ())
                .unwrap();
        let (texture, _) = transfer(
            &mesh,
            &layout,
            &assignment,
            &keyframes,
            &decode,
            &params,
            &|_| (),
        )
        .unwrap();
        let (expected_assignment, expected_page, _) =
            paint(&scene, &layout, &assign_params, &params);
        assert_eq!(assignment, expected_assignment);
        assert_eq!(texture.pages, [expected_page]);
    }

    #[test]
    fn a_wall_that_reaches_behind_the_camera_is_painted_by_the_mean() {
        let wall = Panel {
            min: [-50.0, -0.7],
            max: [50.0, 0.7],
            cells: [1, 1],
            ..WALL
        };
        let mut scene = Scene {
            panels: vec![wall],
            ..Scene::default()
        };
        // Looking along the wall: its far end is in view, its near end behind the camera.
        scene.photograph([0.0, 0.0, 2.0], 1.2, &[], false);
        let mut layout = scene.layout(4.0);
        layout.texels_per_m = 4.0;
        let (assignment, page, report) = paint(
            &scene,
            &layout,
            &AssignParams::default(),
            &TransferParams::default(),
        );
        assert!(assignment.label.iter().all(Option::is_none));
        assert!(report.num_mean > 20, "{report:?}");
        for_each_wall_texel(&scene, &layout, |_, index, point| {
            if page.source[index] == TexelSource::MEAN {
                assert!(point.x > 0.0);
            }
        });
    }

    #[test]
    fn thread_count_leaves_no_trace() {
        let scene = slanted_views(vec![WALL, BOARD], true);
        let layout = scene.layout(50.0);
        let run = |threads: usize, mode: TransferMode| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let params = TransferParams {
                mode,
                ..TransferParams::default()
            };
            pool.install(|| paint(&scene, &layout, &AssignParams::default(), &params))
        };
        for mode in [TransferMode::Assigned, TransferMode::L2Avg] {
            assert_eq!(run(1, mode), run(4, mode));
        }
    }

    #[test]
    fn mismatched_inputs_are_refused() {
        let scene = slanted_views(vec![WALL], false);
        let mesh = scene.mesh();
        let decode = |_: usize| unreachable!();
        let layout = scene.layout(20.0);
        let run = |layout: &AtlasLayout, assignment: &Assignment| {
            transfer_poses(
                &mesh,
                layout,
                assignment,
                &[],
                &decode,
                &TransferParams::default(),
                &|_| (),
            )
            .unwrap_err()
        };
        let num_triangles = mesh.num_triangles();
        let empty = Assignment::default();
        assert!(matches!(
            run(&layout, &empty),
            TransferError::Mismatch { num_labels: 0, .. }
        ));
        let mut labelled = Assignment {
            label: vec![None; num_triangles],
            is_partly_hidden: vec![false; num_triangles],
            ..Assignment::default()
        };
        labelled.label[7] = Some(3);
        let expected = TransferError::Label {
            triangle: 7,
            frame: 3,
            num_frames: 0,
        };
        assert_eq!(run(&layout, &labelled), expected);
        labelled.label[7] = None;
        let mut pageless = layout.clone();
        pageless.num_pages = 0;
        assert_eq!(
            run(&pageless, &labelled),
            TransferError::Page { triangle: 0 }
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn no_layout_makes_it_panic(
            coordinates in prop::collection::vec(
                prop_oneof![-2.0..2.0f64, 1.0..4.0f64, Just(1e200), Just(0.0)], 9..30),
            corners in prop::collection::vec(
                prop_oneof![-5.0..40.0f32, Just(f32::NAN), Just(f32::INFINITY), Just(1e30)], 6..60),
        ) {
            let positions: Vec<Point3<f64>> =
                coordinates.chunks_exact(3).map(|c| Point3::new(c[0], c[1], c[2])).collect();
            let num = positions.len() as u32;
            let corners_texel: Vec<[[f32; 2]; 3]> = corners
                .chunks_exact(6)
                .map(|c| [[c[0], c[1]], [c[2], c[3]], [c[4], c[5]]])
                .collect();
            let triangles: Vec<[u32; 3]> = (0..corners_texel.len() as u32)
                .map(|i| [i, i + 1, 2 * i + 2].map(|v| v % num))
                .collect();
            let mesh = TriMesh::from_soup(positions, triangles).unwrap().0;
            let views = slanted_views(vec![WALL], true);
            let num_triangles = mesh.num_triangles();
            let layout = AtlasLayout {
                page_size_texel: [32, 16],
                num_pages: 1,
                texels_per_m: 1.0,
                charts: views.layout(5.0).charts,
                chart_of_triangle: vec![crate::atlas::ChartId(0); num_triangles],
                corners_texel,
            };
            let assignment = Assignment {
                label: (0..num_triangles).map(|i| [Some(0), None, Some(2)][i % 3]).collect(),
                is_partly_hidden: (0..num_triangles).map(|i| i % 2 == 0).collect(),
                ..Assignment::default()
            };
            let decode = |frame: usize| Ok(views.frames[frame].clone());
            let result = transfer_poses(
                &mesh, &layout, &assignment, &views.poses, &decode,
                &TransferParams::default(), &|_| (),
            );
            prop_assert!(result.is_ok());
        }
    }
}
