use super::*;
use crate::geom::{CameraModel, ColorImage, EncodedColor, PinholeCamera, RigidTransform, Stamp};
use crate::keyframe::{FrameQuality, Keyframe, KeyframeId};
use crate::pipeline::{LiveScan, PipelineParams};

fn keyframe(id: u32) -> Arc<Keyframe> {
    let image = ColorImage::new(2, 2, vec![[9, 8, 7]; 4]).unwrap();
    let pinhole = PinholeCamera::new([2.0, 2.0, 0.5, 0.5], 2, 2).unwrap();
    Arc::new(Keyframe {
        id: KeyframeId(id),
        stamp: Stamp::from_nanos(i64::from(id)),
        world_from_camera: RigidTransform::identity(),
        color: EncodedColor::png_from_image(&image).unwrap(),
        color_camera: CameraModel::ideal(pinhole),
        depth: None,
        quality: FrameQuality::default(),
    })
}

fn triangle(height_m: f64) -> Arc<TriMesh> {
    let positions = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    let positions = positions.map(|[x, y]| nalgebra::Point3::new(x, y, height_m));
    let (mesh, _) = TriMesh::from_soup(positions.to_vec(), vec![[0, 1, 2]]).unwrap();
    Arc::new(mesh)
}

fn capture(num_keyframes: u32, num_mesh_updates: usize) -> Capture {
    let mut scan = LiveScan::new(&PipelineParams::default(), &[], 0);
    scan.resume(EarlierScan {
        keyframes: (0..num_keyframes).map(keyframe).collect(),
        mesh: Some(triangle(num_mesh_updates as f64)),
        num_mesh_updates,
        ..EarlierScan::default()
    });
    scan.capture()
}

#[track_caller]
fn wait_until(slot: &JournalSlot, what: &str, is_so: impl Fn(&JournalStatus) -> bool) {
    let begun = Instant::now();
    while !is_so(&slot.status().unwrap()) {
        let status = slot.status().unwrap();
        assert!(
            begun.elapsed() < Duration::from_secs(20),
            "not {what}: {status:?}"
        );
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_disk_that_comes_back_gets_all_that_it_missed() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("scans");
    let path = folder.join("journal.mcap");
    let slot = Arc::new(JournalSlot::new(path.to_str()));
    let (thread, earlier) = JournalThread::start(Arc::clone(&slot), Duration::ZERO);
    assert!(earlier.is_none());
    for num_keyframes in 1..=5 {
        slot.put(&capture(num_keyframes, 1), 0);
    }
    wait_until(&slot, "refused", |status| status.problem.is_some());
    let told = finding(&slot.status().unwrap());
    for words in [
        folder.to_str().unwrap(),
        "0 of 5 keyframes are safe",
        "make the folder",
    ] {
        assert!(told.message.contains(words), "'{words}': {}", told.message);
    }
    std::fs::create_dir(&folder).unwrap();
    wait_until(&slot, "caught up", |status| {
        status.problem.is_none() && status.report.num_keyframes == 5
    });
    drop(thread);

    let again = Arc::new(JournalSlot::new(path.to_str()));
    let (thread, earlier) = JournalThread::start(Arc::clone(&again), Duration::ZERO);
    let earlier = earlier.unwrap();
    assert_eq!(earlier.keyframes, (0..5).map(keyframe).collect::<Vec<_>>());
    assert_eq!(earlier.mesh.as_deref(), Some(&*triangle(1.0)));
    assert_eq!(again.status().unwrap().num_resumed, 5);
    drop(thread);
}

#[test]
fn meshes_are_paced_and_the_last_one_is_kept_at_the_end() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("journal.mcap");
    let slot = Arc::new(JournalSlot::new(path.to_str()));
    let (thread, _) = JournalThread::start(Arc::clone(&slot), Duration::from_secs(3600));
    slot.put(&capture(1, 1), 0);
    wait_until(&slot, "written", |status| {
        status.report.num_mesh_updates == 1
    });
    slot.put(&capture(2, 9), 0);
    // Keyframes do not wait for the mesh.
    wait_until(&slot, "written", |status| status.report.num_keyframes == 2);
    assert_eq!(slot.status().unwrap().report.num_mesh_updates, 1);
    drop(thread);
    let (thread, earlier) = JournalThread::start(slot_of(&path), Duration::ZERO);
    let earlier = earlier.unwrap();
    assert_eq!(earlier.num_mesh_updates, 9);
    assert_eq!(earlier.mesh.as_deref(), Some(&*triangle(9.0)));
    drop(thread);
}

fn slot_of(path: &Path) -> Arc<JournalSlot> {
    Arc::new(JournalSlot::new(path.to_str()))
}

#[test]
fn what_cannot_be_gone_on_with_is_not_written_over() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("journal.mcap");
    std::fs::write(&path, b"a letter").unwrap();
    let slot = slot_of(&path);
    let (thread, earlier) = JournalThread::start(Arc::clone(&slot), Duration::ZERO);
    assert!(earlier.is_none());
    slot.put(&capture(1, 1), 0);
    let told = finding(&slot.status().unwrap());
    assert!(
        told.message.contains("no journal is kept"),
        "{}",
        told.message
    );
    drop(thread);
    assert_eq!(std::fs::read(&path).unwrap(), b"a letter");
}
