//! `veneer import`: small trees of each format, made here, and the real captures, through a bag
//! and back.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod read_back;
mod tree;

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use veneer::geom::{Distortion, RigidTransform, Stamp};
use veneer::import::{
    DepthOutput, ImportError, ImportFormat, ImportOptions, ImportSummary, SignedAxis, WorldUp,
    import,
};

use read_back::ReadBack;
use tree::{Frame, Tree};

fn run(
    format: ImportFormat,
    tree: &Tree,
    options: &ImportOptions,
) -> (Result<ImportSummary, ImportError>, PathBuf) {
    let out = tree.path("out.mcap");
    let result = import(format, &tree.path("scan"), &out, options, &mut |_, _| {});
    (result, out)
}

fn imported(
    format: ImportFormat,
    tree: &Tree,
    options: &ImportOptions,
) -> (ImportSummary, ReadBack) {
    let (result, out) = run(format, tree, options);
    let summary = result.unwrap();
    let back = ReadBack::open(&out);
    assert_eq!(back.rejections, Vec::<String>::new());
    assert_eq!(back.losses, Vec::<String>::new());
    (summary, back)
}

fn assert_same_pose(actual: &RigidTransform, expected: &RigidTransform) {
    let (angle_rad, distance_m) = actual.distance_to(expected);
    assert!(
        angle_rad < 1e-7 && distance_m < 1e-9,
        "{angle_rad} {distance_m}"
    );
}

/// Photos byte for byte, poses, and one message of each kind a frame.
fn assert_same_frames(back: &ReadBack, frames: &[Frame]) {
    assert_eq!(back.colors.len(), frames.len());
    assert_eq!(back.color_infos.len(), frames.len());
    assert_eq!(back.transforms.len(), frames.len());
    for (index, frame) in frames.iter().enumerate() {
        let (stamp, color) = &back.colors[index];
        assert_eq!(*stamp, frame.stamp, "frame {index}");
        assert_eq!(color.bytes()[..], frame.photo[..], "frame {index}");
        assert_eq!(back.color_infos[index].0, *stamp);
        assert_eq!(back.transforms[index].0, *stamp);
        assert_same_pose(&back.transforms[index].1, &frame.world_from_camera);
    }
}

/// Stamps are whole milliseconds, which seconds in files can hold exactly.
fn frames(num_frames: u32, first_ms: i64, step_ms: i64) -> Vec<Frame> {
    (0..num_frames)
        .map(|i| {
            let stamp_ms = first_ms + i64::from(i) * step_ms;
            Frame::new(i, Stamp::from_nanos(stamp_ms * 1_000_000))
        })
        .collect()
}

/// The importer moves a clock that starts at zero to one second.
fn rebased(mut frames: Vec<Frame>) -> Vec<Frame> {
    let first = frames[0].stamp.as_nanos();
    for frame in &mut frames {
        frame.stamp = Stamp::from_nanos(frame.stamp.as_nanos() - first + 1_000_000_000);
    }
    frames
}

#[test]
fn capture_round_trips() {
    let tree = Tree::new();
    let frames = frames(20, 0, 250);
    tree.write_capture(&frames);
    let (summary, back) = imported(ImportFormat::Capture, &tree, &ImportOptions::default());
    assert_same_frames(&back, &rebased(frames.clone()));
    assert_eq!((summary.num_frames, summary.num_depth_images), (20, 20));
    assert_eq!(summary.refusals, Vec::<String>::new());
    assert_eq!(summary.first, Stamp::from_nanos(1_000_000_000));
    assert_eq!(summary.last, Stamp::from_nanos(5_750_000_000));
    for (index, frame) in frames.iter().enumerate() {
        let color_camera = &back.color_infos[index].1;
        assert_eq!(color_camera.pinhole.intrinsics_px(), frame.color_px);
        assert_eq!(color_camera.distortion, Distortion::None);
        let depth_camera = &back.depth_infos[index].1;
        assert_eq!(depth_camera.pinhole.intrinsics_px(), frame.depth_px);
        // Confidence is below 1 exactly in the first row.
        let depth = back.depths[index].1.decode().unwrap();
        for (pixel, &depth_m) in depth.depths_m().iter().enumerate() {
            let is_kept = pixel >= depth.width() as usize;
            let expected_mm = if is_kept { frame.depth_mm[pixel] } else { 0 };
            assert_eq!((depth_m * 1000.0).round(), f32::from(expected_mm));
        }
    }
    let mesh = back.whole_mesh();
    assert_eq!(mesh, &tree::mesh());
    assert_eq!(back.meshes[0].0, summary.first);
    assert_eq!(back.metadata("veneer.import", "format"), "capture");
}

#[test]
fn a_world_is_turned_to_z_up_with_its_mesh() {
    let tree = Tree::new();
    let frames = frames(3, 0, 250);
    tree.write_capture(&frames);
    let options = ImportOptions {
        up: WorldUp::Axis(SignedAxis::Y),
        ..ImportOptions::default()
    };
    let (_, back) = imported(ImportFormat::Capture, &tree, &options);
    // (x, y, z) becomes (x, -z, y).
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turn = RigidTransform::try_from_quaternion([half, 0.0, 0.0, half], [0.0; 3]).unwrap();
    for (index, frame) in frames.iter().enumerate() {
        assert_same_pose(&back.transforms[index].1, &(turn * frame.world_from_camera));
    }
    let positions = back.whole_mesh().positions_m();
    assert_eq!(positions.len(), tree::mesh().num_vertices());
    for (turned, recorded) in positions.iter().zip(tree::mesh().positions_m()) {
        let expected = [recorded.x, -recorded.z, recorded.y];
        let distance = (turned.coords - nalgebra::Vector3::from(expected)).norm();
        assert!(distance < 1e-6, "{turned} {recorded}");
    }
    assert_eq!(back.metadata("veneer.import", "up"), "0 1 0");
}

#[test]
fn capture_keeps_depth_bytes_without_a_confidence_limit() {
    let tree = Tree::new();
    let frames = frames(3, 0, 500);
    tree.write_capture(&frames);
    let options = ImportOptions {
        min_confidence: 0,
        ..ImportOptions::default()
    };
    let (_, back) = imported(ImportFormat::Capture, &tree, &options);
    for (frame, (_, depth)) in frames.iter().zip(&back.depths) {
        assert_eq!(depth.bytes()[..], frame.depth_png[..]);
    }
    let raw = ImportOptions {
        depth_output: DepthOutput::Raw,
        ..options
    };
    let (_, back_raw) = imported(ImportFormat::Capture, &tree, &raw);
    for ((_, raw), (_, png)) in back_raw.depths.iter().zip(&back.depths) {
        assert_eq!(raw.decode().unwrap(), png.decode().unwrap());
        assert_ne!(raw.encoding(), png.encoding());
    }
}

#[test]
fn capture_refined_scales_depth_and_takes_the_other_camera_and_mesh() {
    let tree = Tree::new();
    let frames = frames(2, 0, 500);
    tree.write_capture(&frames);
    let options = ImportOptions {
        refined: true,
        min_confidence: 0,
        ..ImportOptions::default()
    };
    let (summary, back) = imported(ImportFormat::Capture, &tree, &options);
    assert_eq!(summary.mesh.unwrap().name, "mesh_tsdf_refined.ply");
    for (index, frame) in frames.iter().enumerate() {
        let color_camera = back.color_infos[index].1.pinhole;
        assert_eq!(color_camera.intrinsics_px(), frame.refined_px());
        let depth_camera = back.depth_infos[index].1.pinhole;
        let (width, height) = (depth_camera.width(), depth_camera.height());
        assert_eq!(depth_camera, color_camera.resized(width, height).unwrap());
        let depth = back.depths[index].1.decode().unwrap();
        for (&depth_m, &mm) in depth.depths_m().iter().zip(&frame.depth_mm) {
            // 0.5 is the tree's depth scale; halves are rounded up.
            assert_eq!((depth_m * 1000.0).round(), (f32::from(mm) * 0.5).round());
        }
    }
}

#[test]
fn tum_round_trips_with_its_own_stamps() {
    let tree = Tree::new();
    let frames = frames(5, 1_305_031_102_175, 250);
    tree.write_tum(&frames);
    let (summary, back) = imported(ImportFormat::Tum, &tree, &ImportOptions::default());
    assert_same_frames(&back, &frames);
    assert_eq!(summary.num_depth_images, 5);
    for (frame, (stamp, depth)) in frames.iter().zip(&back.depths) {
        assert_eq!(stamp.as_nanos() - frame.stamp.as_nanos(), 7_000_000);
        let depth = depth.decode().unwrap();
        for (&depth_m, &mm) in depth.depths_m().iter().zip(&frame.full_depth()) {
            assert_eq!((depth_m * 1000.0).round(), f32::from(mm));
        }
    }
    let camera = &back.color_infos[0].1;
    assert_eq!(camera.pinhole.intrinsics_px(), tree::TREE_PX);
    assert!(back.meshes.is_empty());
    assert!(
        summary.notes.iter().any(|note| note.contains("no mesh")),
        "{summary:?}"
    );
}

#[test]
fn intrinsics_of_the_command_line_reach_the_bag() {
    let tree = Tree::new();
    tree.write_tum(&frames(3, 100_000, 250));
    let (scan, out) = (tree.path("scan"), tree.path("out.mcap"));
    let mut args = ["import", "tum", "--intrinsics", "500,501.5,320,241", "-o"]
        .map(std::ffi::OsStr::new)
        .to_vec();
    args.extend([out.as_os_str(), scan.as_os_str()]);
    crate::command::veneer_ok(&args);
    let camera = &ReadBack::open(&out).color_infos[0].1;
    let expected = [500.0, 501.5, 320.0, 241.0];
    assert_eq!(camera.pinhole.intrinsics_px(), expected);
}

#[test]
fn tum_associates_by_time() {
    let tree = Tree::new();
    let frames = frames(5, 100_000, 250);
    tree.write_tum(&frames);
    // Without the depth line of frame 1, and with the ground truth of frames 0 to 3 only.
    let scan = tree.path("scan");
    let edit = |name: &str, keep: &dyn Fn(usize) -> bool| {
        let text = std::fs::read_to_string(scan.join(name)).unwrap();
        let kept: Vec<&str> = text
            .lines()
            .enumerate()
            .filter(|&(index, _)| keep(index))
            .map(|(_, line)| line)
            .collect();
        std::fs::write(scan.join(name), kept.join("\n")).unwrap();
    };
    edit("depth.txt", &|line| line != 2);
    edit("groundtruth.txt", &|line| line < 2 + 2 * 4);
    let (summary, back) = imported(ImportFormat::Tum, &tree, &ImportOptions::default());
    assert_same_frames(&back, &frames[..4]);
    assert_eq!(summary.num_depth_images, 3);
    assert_eq!(summary.refusals.len(), 1, "{:?}", summary.refusals);
    assert!(summary.refusals[0].contains("groundtruth.txt"));
}

#[test]
fn seven_scenes_round_trips() {
    let tree = Tree::new();
    let mut frames = frames(4, 0, 33);
    for (frame, shade) in frames.iter_mut().zip(10..) {
        frame.photo = tree::photo_png(shade);
    }
    tree.write_seven_scenes(&frames);
    let (summary, back) = imported(ImportFormat::SevenScenes, &tree, &ImportOptions::default());
    let mut expected = rebased(frames.clone());
    for (number, frame) in expected.iter_mut().enumerate() {
        let nanos = 1_000_000_000 + number as i64 * 1_000_000_000 / 30;
        frame.stamp = Stamp::from_nanos(nanos);
    }
    assert_same_frames(&back, &expected);
    assert_eq!(summary.num_frames, 4);
    for (frame, (_, depth)) in frames.iter().zip(&back.depths) {
        let depth = depth.decode().unwrap();
        // The tree writes 65535 for the first pixel.
        assert_eq!(depth.depths_m()[0], 0.0);
        for (&depth_m, &mm) in depth.depths_m().iter().zip(&frame.full_depth()).skip(1) {
            assert_eq!((depth_m * 1000.0).round(), f32::from(mm));
        }
    }
    let camera = back.depth_infos[0].1.pinhole;
    assert_eq!(camera.intrinsics_px(), [585.0, 585.0, 320.0, 240.0]);
}

#[test]
fn three_d_scanner_round_trips() {
    let tree = Tree::new();
    let frames = frames(6, 5_000_000, 500);
    tree.write_three_d_scanner(&frames);
    let (summary, back) = imported(
        ImportFormat::ThreeDScanner,
        &tree,
        &ImportOptions::default(),
    );
    assert_same_frames(&back, &rebased(frames.clone()));
    assert!(
        summary.notes.iter().any(|note| note.starts_with("3 of")),
        "{summary:?}"
    );
    for (index, frame) in frames.iter().enumerate() {
        let color_camera = back.color_infos[index].1.pinhole;
        assert_eq!(color_camera.intrinsics_px(), frame.color_px);
        let depth_camera = back.depth_infos[index].1.pinhole;
        let (width, height) = (depth_camera.width(), depth_camera.height());
        assert_eq!(depth_camera, color_camera.resized(width, height).unwrap());
    }
    assert_eq!(back.whole_mesh(), &tree::mesh());
    assert_eq!(summary.mesh.unwrap().name, "export.obj");
}

#[test]
fn bad_frames_are_named_and_the_others_stay() {
    let tree = Tree::new();
    let frames = frames(6, 0, 250);
    tree.write_capture(&frames);
    let scan = tree.path("scan");
    std::fs::write(scan.join("frames/000001.jpg"), b"\xff\xd8\xff no photo").unwrap();
    std::fs::remove_file(scan.join("frames/000002.jpg")).unwrap();
    std::fs::write(scan.join("frames/000003.png"), b"no depth").unwrap();
    let cameras = std::fs::read_to_string(scan.join("cameras.json")).unwrap();
    let mut cameras: serde_json::Value = serde_json::from_str(&cameras).unwrap();
    cameras[4]["c2w"][0][0] = serde_json::json!(7.0);
    std::fs::write(scan.join("cameras.json"), cameras.to_string()).unwrap();
    let (summary, back) = imported(ImportFormat::Capture, &tree, &ImportOptions::default());
    assert_eq!((summary.num_frames, summary.num_depth_images), (3, 2));
    let mut kept = rebased(frames);
    kept.remove(4);
    kept.drain(1..3);
    assert_same_frames(&back, &kept);
    assert_eq!(summary.refusals.len(), 4, "{:#?}", summary.refusals);
    for name in ["frame 4", "000001.jpg", "000002.jpg", "000003.png"] {
        assert!(
            summary
                .refusals
                .iter()
                .any(|refusal| refusal.contains(name)),
            "{name} of {:#?}",
            summary.refusals
        );
    }
}

#[test]
fn a_growing_mesh_adds_up_to_the_whole() {
    let tree = Tree::new();
    let frames = frames(20, 0, 250);
    tree.write_capture(&frames);
    let options = ImportOptions {
        grow: NonZeroU32::new(4),
        ..ImportOptions::default()
    };
    let (summary, back) = imported(ImportFormat::Capture, &tree, &options);
    assert_eq!(back.meshes.len(), 4);
    assert_eq!(summary.mesh.unwrap().num_updates, 4);
    assert_eq!(back.block_corners(), read_back::corners_of(&tree::mesh()));
}

#[test]
fn what_is_no_data_set_is_refused_and_an_older_bag_stays() {
    let tree = Tree::new();
    std::fs::create_dir(tree.path("scan")).unwrap();
    std::fs::write(tree.path("out.mcap"), b"older").unwrap();
    let options = ImportOptions::default();
    for (_, format) in ImportFormat::NAMES {
        let (result, out) = run(format, &tree, &options);
        let message = result.unwrap_err().to_string();
        assert!(message.contains("scan"), "{message}");
        assert_eq!(std::fs::read(out).unwrap(), b"older");
    }
    tree.write_capture(&frames(2, 0, 500));
    let missing = ImportOptions {
        mesh: Some("nowhere.ply".into()),
        ..options.clone()
    };
    let (result, _) = run(ImportFormat::Capture, &tree, &missing);
    assert!(matches!(result, Err(ImportError::NoSuchMesh { .. })));
    std::fs::write(tree.path("scan/mesh.ply"), b"ply\nformat ascii").unwrap();
    let (result, out) = run(ImportFormat::Capture, &tree, &options);
    assert!(matches!(result, Err(ImportError::MeshFile(_))));
    assert_eq!(std::fs::read(out).unwrap(), b"older");
    let nowhere = tree.path("no/such/folder/out.mcap");
    std::fs::write(tree.path("scan/mesh.ply"), tree::mesh_ply()).unwrap();
    let result = import(
        ImportFormat::Capture,
        &tree.path("scan"),
        &nowhere,
        &options,
        &mut |_, _| {},
    );
    assert!(matches!(result, Err(ImportError::Bag(_))));
    // The refused imports left nothing of their own behind.
    let names: Vec<_> = std::fs::read_dir(tree.path(""))
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert_eq!(names.len(), 2, "{names:?}");
}

fn shared_capture(name: &str) -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    #[expect(clippy::print_stdout, reason = "a skipped test says so")]
    {
        println!("SKIPPED: {} is not there", folder.display());
    }
    None
}

/// Imports a real capture; every photo and every pose is compared with the files.
fn real_capture_round_trips(name: &str, num_frames: usize, options: &ImportOptions) {
    let Some(folder) = shared_capture(name) else {
        return;
    };
    let tree = Tree::new();
    let out = tree.path("out.mcap");
    let mut last_progress = (0, 0);
    let summary = import(
        ImportFormat::Capture,
        &folder,
        &out,
        options,
        &mut |done, of| {
            last_progress = (done, of);
        },
    )
    .unwrap();
    assert_eq!(last_progress, (num_frames as u64, num_frames as u64));
    assert_eq!(summary.refusals, Vec::<String>::new());
    assert_eq!(summary.num_depth_images, num_frames);
    let back = ReadBack::open(&out);
    let cameras = std::fs::read(folder.join("cameras.json")).unwrap();
    let cameras: serde_json::Value = serde_json::from_slice(&cameras).unwrap();
    let expected: Vec<Frame> = cameras
        .as_array()
        .unwrap()
        .iter()
        .map(|camera| {
            let c2w: [[f64; 4]; 4] = serde_json::from_value(camera["c2w"].clone()).unwrap();
            let time_s = camera["timestamp_s"].as_f64().unwrap();
            let id = camera["id"].as_u64().unwrap();
            let photo = std::fs::read(folder.join(format!("frames/{id:06}.jpg"))).unwrap();
            Frame {
                stamp: Stamp::from_seconds(time_s),
                world_from_camera: RigidTransform::try_from_matrix(&c2w).unwrap(),
                photo,
                ..Frame::new(0, Stamp::from_nanos(0))
            }
        })
        .collect();
    assert_same_frames(&back, &rebased(expected));
    let mesh_name = summary.mesh.unwrap().name;
    let (mesh, _) = veneer::import::mesh_file::read(&folder.join(mesh_name)).unwrap();
    if options.grow.is_some() {
        assert_eq!(back.block_corners(), read_back::corners_of(&mesh));
    } else {
        assert_eq!(back.whole_mesh(), &mesh);
    }
}

#[test]
fn apt0_round_trips() {
    real_capture_round_trips("apt0_structure", 219, &ImportOptions::default());
}

#[test]
fn apt0_grows() {
    let options = ImportOptions {
        grow: NonZeroU32::new(12),
        ..ImportOptions::default()
    };
    real_capture_round_trips("apt0_structure", 219, &options);
}

#[test]
fn charuco_round_trips() {
    real_capture_round_trips("charuco_lidar", 31, &ImportOptions::default());
    let refined = ImportOptions {
        refined: true,
        grow: NonZeroU32::new(5),
        ..ImportOptions::default()
    };
    real_capture_round_trips("charuco_lidar", 31, &refined);
}
