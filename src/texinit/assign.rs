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
//! - C2: the largest difference over the vertices and the centroid between the measured and the
//!   predicted distance from the depth camera, metres, at the nearest depth pixel.
//! - C3: distance in RGB ([0, 1] per channel, sRGB) between the mean colour at the vertices
//!   (nearest pixel) in this frame and its mean over the frames.
//! - Ours: occlusion by the mesh itself, depth edges, image border, grazing views, back faces,
//!   sharpness and exposure of the frame, and the resolution as pixels per metre, which C1 loses
//!   when triangles are small.
//!
//! Scores separate per (triangle, frame); what couples frames is one colour sum per triangle, in
//! integers, and one median per quality figure. Frames may therefore be added one by one and in
//! any order ([`label::CandidateTable`]), with the result of the batch to the last bit.
//!
//! Memory: 16 bytes per (triangle, frame) in view and not beaten by the empty label: a frame costs
//! about what its JPEG costs.

pub mod cues;
pub mod label;
pub mod pairwise;
pub mod validity;

use std::sync::Arc;

use rayon::prelude::*;

use crate::geom::{ImageError, RigidTransform};
use crate::keyframe::{DecodedFrame, FrameQuality, Keyframe};
use crate::mesh::TriMesh;
use crate::render::VisibilityParams;

use cues::FrameCandidates;
use label::CandidateTable;
use pairwise::PairwiseParams;

/// Which frames the mean colour of cue C3 runs over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColorReference {
    /// Per triangle, the frames that see it.
    SeeingFrames,
    /// Per vertex, the frames that are valid for any triangle at it, occluded or not (the
    /// authors' program).
    ValidFrames,
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
    /// What C3 compares with.
    pub color_reference: ColorReference,
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
            color_reference: ColorReference::SeeingFrames,
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
            color_reference: ColorReference::ValidFrames,
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

    fn check(&self) -> Result<(), AssignError> {
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
    /// Edges between triangles of different frames, each triangle decided alone.
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

pub(crate) fn assign_poses(
    mesh: &TriMesh,
    frames: &[FramePose],
    decode: &(dyn Fn(usize) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &AssignParams,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Assignment, AssignError> {
    params.check()?;
    let num_frames =
        u32::try_from(frames.len()).map_err(|_| AssignError::TooManyFrames(frames.len()))?;
    let scored: Vec<Result<FrameCandidates, FailedFrame>> = (0..num_frames)
        .into_par_iter()
        .map_init(cues::FrameWorkspace::default, |workspace, frame| {
            let pose = &frames[frame as usize];
            let candidates = decode(frame as usize)
                .map_err(|error| error.to_string())
                .and_then(|decoded| {
                    cues::score_frame(mesh, pose, &decoded, params, workspace)
                        .map_err(|error| error.to_string())
                })
                .map_err(|reason| FailedFrame { frame, reason });
            progress(1);
            candidates
        })
        .collect();

    let mut table = CandidateTable::new(mesh.num_triangles(), mesh.num_vertices());
    let mut failed_frames = vec![];
    for (frame, candidates) in (0u32..).zip(scored) {
        match candidates {
            Ok(candidates) => table.add(frame, frames[frame as usize].quality, candidates),
            Err(failed) => failed_frames.push(failed),
        }
    }
    let mut assignment = table.assign(mesh, params);
    assignment.report.failed_frames = failed_frames;
    Ok(assignment)
}

#[cfg(test)]
pub(crate) mod capture;

#[cfg(test)]
mod measure;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::PinholeCamera;
    use crate::keyframe::DecodedDepth;
    use crate::mesh::TriangleId;
    use crate::texinit::analytic_scene::{Panel, Scene, camera, grey, red, waves};
    use nalgebra::Point3;
    use proptest::prelude::*;

    const WALL: Panel = Panel {
        min: [-1.4, -1.0],
        max: [1.4, 1.0],
        z: 3.0,
        cells: [28, 20],
        paint: grey,
    };
    const BOARD: Panel = Panel {
        min: [-0.3, -0.25],
        max: [0.3, 0.25],
        z: 2.0,
        cells: [6, 5],
        paint: red,
    };

    fn assign_scene(scene: &Scene, params: &AssignParams) -> Assignment {
        let decode = |frame: usize| Ok(scene.frames[frame].clone());
        assign_poses(&scene.mesh(), &scene.poses, &decode, params, &|_| ()).unwrap()
    }

    fn wall_with_board(has_depth: bool) -> Scene {
        let mut scene = Scene {
            panels: vec![WALL, BOARD],
            ..Scene::default()
        };
        for x in [0.0, 1.0, -1.0, 0.1] {
            scene.photograph([x, 0.0, 0.0], 0.0, &[], has_depth);
        }
        scene
    }

    fn centroid(mesh: &TriMesh, triangle: usize) -> Point3<f64> {
        let [a, b, c] = mesh.corners_m(TriangleId(triangle as u32));
        Point3::from((a.coords + b.coords + c.coords) / 3.0)
    }

    #[test]
    fn the_nearest_camera_that_holds_the_whole_triangle_paints_it() {
        let mut scene = Scene {
            panels: vec![WALL],
            ..Scene::default()
        };
        let positions = [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.6, 0.2, 1.5]];
        let backdrop = Panel {
            min: [-9.0, -9.0],
            max: [9.0, 9.0],
            ..WALL
        };
        for position in positions {
            // At the wall's outline the nearest depth pixel may lie past it.
            scene.photograph(position, 0.0, &[backdrop], true);
        }
        let mesh = scene.mesh();
        let assignment = assign_scene(&scene, &AssignParams::paper());
        let mut counts = [0; 4];
        for triangle in mesh.triangle_ids() {
            let holds = |position: [f64; 3]| {
                mesh.corners_m(triangle).iter().all(|p| {
                    let d = p - Point3::from(position);
                    let (x, y) = (150.0 * d.x / d.z + 79.5, 150.0 * d.y / d.z + 59.5);
                    (0.0..=159.0).contains(&x) && (0.0..=119.0).contains(&y)
                })
            };
            // Head-on views of one plane: the projected area falls with distance.
            let expected = [2, 0, 1]
                .into_iter()
                .find(|&i| holds(positions[i as usize]));
            let label = assignment.label[triangle.index()];
            assert_eq!(label, expected);
            counts[label.map_or(3, |l| l as usize)] += 1;
            let scale = 150.0 / [2.0f32, 3.0, 1.5][expected.unwrap_or(0) as usize];
            if assignment.num_views[triangle.index()] == 1 {
                let density = assignment.best_texels_per_m[triangle.index()];
                assert!((density / scale - 1.0).abs() < 1e-3);
            }
        }
        assert!(counts[..3].iter().all(|&n| n > 40), "{counts:?}");
    }

    #[test]
    fn a_frame_whose_view_is_blocked_never_paints() {
        let scene = wall_with_board(false);
        let mesh = scene.mesh();
        let blocked_labels = |params: &AssignParams| {
            let assignment = assign_scene(&scene, params);
            let num_wall = 28 * 20 * 2;
            let blocked = (0..num_wall).filter(|&triangle| {
                assignment.label[triangle].is_some_and(|frame| {
                    let eye =
                        Point3::from(*scene.poses[frame as usize].world_from_camera.translation());
                    let mut points = mesh.corners_m(TriangleId(triangle as u32)).to_vec();
                    points.push(centroid(&mesh, triangle));
                    // The buffer knows the board's outline to a pixel: 1.4 cm on the board.
                    let inner = Panel {
                        min: BOARD.min.map(|v| v + 0.014),
                        max: BOARD.max.map(|v| v - 0.014),
                        ..BOARD
                    };
                    points.iter().any(|p| inner.cut(&eye, p).is_some())
                })
            });
            (blocked.count(), assignment)
        };
        let (num_blocked, assignment) = blocked_labels(&AssignParams::default());
        assert_eq!(num_blocked, 0);
        // Two of the cameras see each part of the wall past the board.
        let behind = (0..1120).filter(|&t| {
            let c = centroid(&mesh, t);
            c.x.abs() < 0.25 && c.y.abs() < 0.25
        });
        for triangle in behind {
            assert!(assignment.label[triangle].is_some());
        }
        let blind = AssignParams {
            visibility: None,
            ..AssignParams::default()
        };
        assert!(
            blocked_labels(&blind).0 > 20,
            "the scene does not test occlusion"
        );
    }

    #[test]
    fn measured_depth_keeps_out_what_the_mesh_does_not_know() {
        let mut scene = Scene {
            panels: vec![WALL],
            ..Scene::default()
        };
        scene.photograph([0.0, 0.0, 0.2], 0.0, &[BOARD], true);
        scene.photograph([0.5, 0.0, 0.0], 0.0, &[], true);
        let mesh = scene.mesh();
        let assignment = assign_scene(&scene, &AssignParams::paper());
        let eye = Point3::new(0.0, 0.0, 0.2);
        let mut num_hidden = 0;
        for triangle in mesh.triangle_ids() {
            let hidden = mesh
                .corners_m(triangle)
                .iter()
                .chain([&centroid(&mesh, triangle.index())])
                // Depth is read at the nearest pixel, up to 0.71 px from the point.
                .any(|p| {
                    let inner = Panel {
                        min: BOARD.min.map(|v| v + 0.01),
                        max: BOARD.max.map(|v| v - 0.01),
                        ..BOARD
                    };
                    inner.cut(&eye, p).is_some()
                });
            if hidden {
                num_hidden += 1;
                assert_ne!(assignment.label[triangle.index()], Some(0));
            }
        }
        assert!(num_hidden > 50);
        assert!(assignment.label.contains(&Some(0)));
    }

    #[test]
    fn a_frame_of_another_colour_loses_to_its_peers() {
        let mut scene = Scene {
            panels: vec![WALL],
            ..Scene::default()
        };
        for _ in 0..3 {
            scene.photograph([0.0, 0.0, 0.0], 0.0, &[], true);
        }
        scene.panels[0].paint = waves;
        scene.photograph([0.0, 0.0, 0.0], 0.0, &[], true);
        // All cues are equal but C3; ties go to the last frame.
        let assignment = assign_scene(&scene, &AssignParams::paper());
        assert!(assignment.label.iter().flatten().all(|&label| label == 2));
        assert!(assignment.report.num_labelled > 500);
    }

    #[test]
    fn adding_frames_one_by_one_in_any_order_equals_the_batch() {
        let scene = wall_with_board(true);
        let mesh = scene.mesh();
        for params in [AssignParams::default(), AssignParams::paper()] {
            let batch = assign_scene(&scene, &params);
            for order in [[0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]] {
                let mut table = CandidateTable::new(mesh.num_triangles(), mesh.num_vertices());
                let mut workspace = cues::FrameWorkspace::default();
                for frame in order {
                    let pose = &scene.poses[frame];
                    let scored = cues::score_frame(
                        &mesh,
                        pose,
                        &scene.frames[frame],
                        &params,
                        &mut workspace,
                    )
                    .unwrap();
                    table.add(frame as u32, pose.quality, scored);
                    // Looking at the labels in between changes nothing.
                    assert_eq!(
                        table.assign(&mesh, &params).label.len(),
                        mesh.num_triangles()
                    );
                }
                assert_eq!(table.assign(&mesh, &params), batch);
            }
        }
    }

    #[test]
    fn thread_count_leaves_no_trace() {
        let scene = wall_with_board(true);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| assign_scene(&scene, &AssignParams::default()))
        };
        let one = run(1);
        assert_eq!(one, run(2));
        assert_eq!(one, run(4));
    }

    #[test]
    fn a_frame_that_does_not_decode_is_reported_and_the_others_go_on() {
        let scene = wall_with_board(true);
        let decode = |frame: usize| match frame {
            1 => Err(ImageError::Encoding("broken".to_owned())),
            _ => Ok(scene.frames[frame].clone()),
        };
        let params = AssignParams::default();
        let assignment =
            assign_poses(&scene.mesh(), &scene.poses, &decode, &params, &|_| ()).unwrap();
        assert_eq!(assignment.report.failed_frames.len(), 1);
        assert_eq!(assignment.report.failed_frames[0].frame, 1);
        assert!(!assignment.label.contains(&Some(1)));
        assert!(assignment.report.num_labelled > 500);
    }

    #[test]
    fn parameters_out_of_range_are_named() {
        let params = AssignParams {
            depth_weight: 10.0,
            ..AssignParams::default()
        };
        let error = assign_poses(
            &TriMesh::default(),
            &[],
            &|_| unreachable!(),
            &params,
            &|_| (),
        );
        assert_eq!(
            error,
            Err(AssignError::Param {
                name: "depth_weight",
                value: 10.0
            })
        );
    }

    #[test]
    fn real_captures_are_mostly_painted() {
        let captures = [
            ("charuco_lidar", "mesh_tsdf_refined.ply", 10),
            ("apt0_structure", "mesh.ply", 40),
        ];
        for (name, mesh, step) in captures {
            let Some(capture) = capture::Capture::load(name, mesh, |i| i % step == 0) else {
                continue;
            };
            let decode = |frame| capture.decode(frame);
            let params = AssignParams::default();
            let assignment =
                assign_poses(&capture.mesh, &capture.poses, &decode, &params, &|_| ()).unwrap();
            let report = &assignment.report;
            assert_eq!(report.num_frames, capture.poses.len());
            assert!(
                report.num_seams < report.num_seams_unary,
                "{name}: {report:?}"
            );
            // Few frames cannot cover an apartment.
            let share = report.num_labelled as f64 / capture.mesh.num_triangles() as f64;
            assert!(share > 0.1, "{name}: {share}");
        }
    }

    fn any_coordinate() -> impl Strategy<Value = f64> {
        prop_oneof![
            -2.0..2.0f64,
            0.5..3.0f64,
            Just(0.0),
            Just(1e300),
            Just(-1e30),
            Just(1e-300)
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn no_mesh_makes_it_panic(
            coordinates in prop::collection::vec(any_coordinate(), 9..60),
            order in prop::collection::vec(0usize..1000, 3..40),
        ) {
            let positions: Vec<Point3<f64>> =
                coordinates.chunks_exact(3).map(|c| Point3::new(c[0], c[1], c[2])).collect();
            let num = positions.len();
            let triangles = order.chunks_exact(3)
                .map(|c| [c[0], c[1], c[2]].map(|i| (i % num) as u32)).collect();
            let mesh = TriMesh::from_soup(positions, triangles).unwrap().0;
            let mut scene = Scene { panels: vec![BOARD], ..Scene::default() };
            scene.photograph([0.0; 3], 0.0, &[], true);
            scene.photograph([0.1, 0.0, 0.3], 0.2, &[], false);
            let decode = |frame: usize| Ok(scene.frames[frame].clone());
            for params in [AssignParams::default(), AssignParams::paper()] {
                let assignment =
                    assign_poses(&mesh, &scene.poses, &decode, &params, &|_| ()).unwrap();
                prop_assert!(assignment.best_texels_per_m.iter().all(|d| d.is_finite() && *d >= 0.0));
            }
        }
    }

    #[test]
    fn an_unregistered_depth_camera_is_looked_through_its_own_pose() {
        let mut scene = Scene {
            panels: vec![WALL],
            ..Scene::default()
        };
        scene.photograph([0.0; 3], 0.0, &[], true);
        let mut shifted = Scene {
            panels: vec![WALL],
            ..Scene::default()
        };
        shifted.photograph([0.2, 0.0, 0.5], 0.0, &[], true);
        let mut frame = (*scene.frames[0]).clone();
        let mut depth = shifted.frames[0].depth.clone().unwrap();
        depth.camera = PinholeCamera::new(camera().intrinsics_px(), 160, 120).unwrap();
        depth.depth_from_color =
            shifted.poses[0].world_from_camera.inverse() * scene.poses[0].world_from_camera;
        let unregistered = depth.clone();
        frame.depth = Some(depth);
        scene.frames[0] = Arc::new(frame);
        let num_painted = assign_scene(&scene, &AssignParams::paper())
            .report
            .num_labelled;
        assert!(num_painted > 400);
        // Taken for registered, the same depth contradicts the mesh by half a metre.
        let mut frame = (*scene.frames[0]).clone();
        frame.depth = Some(DecodedDepth {
            depth_from_color: RigidTransform::identity(),
            ..unregistered
        });
        scene.frames[0] = Arc::new(frame);
        assert_eq!(
            assign_scene(&scene, &AssignParams::paper())
                .report
                .num_labelled,
            0
        );
    }
}
