#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

mod incremental;
mod plain_cues;

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
    let runs = MeshRuns::new(&mesh);
    for params in [AssignParams::default(), AssignParams::paper()] {
        let batch = assign_scene(&scene, &params);
        for order in [[0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]] {
            let mut table = CandidateTable::new(mesh.num_triangles(), mesh.num_vertices());
            let mut workspace = cues::FrameWorkspace::default();
            for frame in order {
                let pose = &scene.poses[frame];
                let images = &scene.frames[frame];
                let scored =
                    cues::score_frame(&mesh, &runs, pose, images, &params, &mut workspace).unwrap();
                table.add(frame as u32, pose.quality, scored);
                // Looking at the labels in between changes nothing.
                let so_far = table.assign(&mesh, &params, table.typical_quality());
                assert_eq!(so_far.label.len(), mesh.num_triangles());
            }
            let all = table.assign(&mesh, &params, table.typical_quality());
            assert_eq!(all, batch);
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
    let assignment = assign_poses(&scene.mesh(), &scene.poses, &decode, &params, &|_| ()).unwrap();
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
