//! A scan that goes on from its journal, or from a saved session, is painted as the one before.

use std::path::Path;

use nalgebra::Point3;
use veneer::bag::journal::{Found, Journal, PathDisk, ScanState};
use veneer::bag::{BagReader, TopicRoles};
use veneer::ingest::event::MeshBlockKey;
use veneer::ingest::{Event, EventSource, Header, MeshUpdate, TimedEvent};
use veneer::mesh::{Region, SoupReport, TriMesh};
use veneer::pipeline::{
    Capture, EarlierScan, LiveScan, NoProgress, Painted, Painter, PipelineParams,
};

use crate::command::small_tabletop;

pub(crate) fn state_of(capture: &Capture) -> ScanState {
    let keyframes = capture.keyframes.iter();
    ScanState {
        keyframes: keyframes.map(|k| (k.id, k.clone())).collect(),
        mesh: capture.mesh.clone(),
        mesh_blocks: capture.mesh_blocks.clone(),
        num_mesh_updates: capture.num_mesh_updates as u64,
        world_frame: capture.ingest.world_frame.clone(),
        ..ScanState::default()
    }
}

/// What is in a journal or session at `path`.
pub(crate) fn resumed(path: &Path) -> ScanState {
    match Journal::resume(Box::new(PathDisk::new(path))).unwrap() {
        Found::Scan(resumed) => {
            assert_eq!(resumed.losses, [""; 0]);
            resumed.state
        }
        Found::Nothing(_) => panic!("nothing in {}", path.display()),
    }
}

fn earlier(state: ScanState) -> EarlierScan {
    EarlierScan {
        keyframes: state.keyframes.into_values().collect(),
        next_id: state.next_id,
        mesh: state.mesh,
        mesh_blocks: state.mesh_blocks,
        num_mesh_updates: state.num_mesh_updates.try_into().unwrap(),
        world_frame: state.world_frame,
    }
}

/// A capture of a scan that goes on from `state`.
pub(crate) fn capture_of(state: ScanState, params: &PipelineParams) -> Capture {
    let mut scan = LiveScan::new(params, &[], 0);
    scan.resume(earlier(state)).unwrap();
    scan.capture()
}

pub(crate) fn painted(capture: Capture, params: &PipelineParams) -> Painted {
    let mut painter = Painter::new(&params.keyframe);
    painter.paint(capture, params, &NoProgress).unwrap()
}

fn assert_same(a: &Painted, b: &Painted) {
    assert!(a.texture.pages.len() == b.texture.pages.len());
    for (a, b) in a.texture.pages.iter().zip(&b.texture.pages) {
        assert!(a.srgb == b.srgb && a.source == b.source, "another page");
    }
    assert!(a.layout.corners_texel == b.layout.corners_texel);
}

#[test]
fn a_scan_that_goes_on_is_painted_as_the_one_before() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let params = PipelineParams::default();
    let mut reader = BagReader::open(&bag, &TopicRoles::default()).unwrap();
    let mut scan = LiveScan::new(&params, reader.topics(), 0);
    let path = dir.path().join("journal.mcap");
    let mut journal = Some(Journal::create(Box::new(PathDisk::new(&path))).unwrap());
    let mut num_events = 0;
    while let Some(event) = reader.next_event() {
        num_events += 1;
        if scan.push(event) {
            let journal = journal.as_mut().unwrap();
            journal.follow(&state_of(&scan.capture())).unwrap();
        }
        // The process ends and another one goes on, more than once.
        if num_events % 20 == 0 {
            drop(journal.take());
            let Found::Scan(found) = Journal::resume(Box::new(PathDisk::new(&path))).unwrap()
            else {
                panic!("nothing is left");
            };
            assert_eq!(found.losses, [""; 0]);
            journal = Some(found.journal);
        }
    }
    scan.flush();
    let capture = scan.capture();
    journal.unwrap().follow(&state_of(&capture)).unwrap();
    assert!(capture.keyframes.len() > 3);
    let before = painted(capture, &params);

    let state = resumed(&path);
    let after = painted(capture_of(state.clone(), &params), &params);
    assert_same(&before, &after);

    // A saved session is the same, and a recording for everybody else.
    let session = dir.path().join("session.mcap");
    let num_bytes = veneer::bag::journal::save(Box::new(PathDisk::new(&session)), &state).unwrap();
    assert!(std::fs::metadata(&session).unwrap().len() > num_bytes);
    let loaded = resumed(&session);
    assert_eq!(loaded, state);
    let mut reader = BagReader::open(&session, &TopicRoles::default()).unwrap();
    let replayed = veneer::pipeline::gather(
        &mut reader,
        &params,
        &veneer::pipeline::StageClock::new(&NoProgress),
    )
    .unwrap();
    assert_eq!(replayed.keyframes.len(), state.keyframes.len());
    assert!(replayed.duration_s < 60.0, "{}", replayed.duration_s);
    assert_eq!(
        replayed.mesh.num_triangles(),
        before.mesh.num_triangles(),
        "the mesh of the recording"
    );
}

/// What there is of a scan whose process ended and went on after each `num_events` events.
fn interrupted(bag: &Path, params: &PipelineParams, num_events: usize) -> Capture {
    let mut reader = BagReader::open(bag, &TopicRoles::default()).unwrap();
    let topics = reader.topics().to_vec();
    let mut scan = LiveScan::new(params, &topics, 0);
    let mut num_left = num_events;
    while let Some(event) = reader.next_event() {
        scan.push(event);
        num_left -= 1;
        if num_left == 0 {
            num_left = num_events;
            scan.flush();
            let state = state_of(&scan.capture());
            scan = LiveScan::new(params, &topics, 0);
            scan.resume(earlier(state)).unwrap();
        }
    }
    scan.flush();
    scan.capture()
}

#[test]
fn blocks_that_come_after_an_interruption_update_the_mesh() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &["--grow", "6"]);
    let left = Region::new([f64::NEG_INFINITY; 3], [0.03, f64::INFINITY, f64::INFINITY]);
    for region in [None, Some(left.unwrap())] {
        let mut params = PipelineParams::default();
        params.region.region = region;
        let at_once = interrupted(&bag, &params, usize::MAX);
        assert!(at_once.mesh_blocks.spans().len() > 3);
        for num_events in [7, 40] {
            let capture = interrupted(&bag, &params, num_events);
            assert_eq!(capture.mesh_blocks, at_once.mesh_blocks);
            assert!(capture.mesh == at_once.mesh, "{num_events}");
        }
    }
}

#[test]
fn a_whole_mesh_that_comes_after_an_interruption_replaces_the_blocks() {
    let dir = tempfile::tempdir().unwrap();
    let params = PipelineParams::default();
    let in_blocks = small_tabletop(dir.path(), &["--grow", "6"]);
    let mut scan = LiveScan::new(&params, &[], 0);
    let before = interrupted(&in_blocks, &params, usize::MAX);
    scan.resume(earlier(state_of(&before))).unwrap();
    let num_before = before.mesh.unwrap().num_triangles();

    let (half, _) = TriMesh::from_soup(
        vec![
            Point3::origin(),
            Point3::new(1.0, 0.0, 0.0),
            Point3::new(0.0, 1.0, 0.0),
        ],
        vec![[0, 1, 2]],
    )
    .unwrap();
    let frame_id = before.ingest.world_frame.unwrap();
    let event = |update| TimedEvent {
        received: before.stamp,
        topic: 0,
        event: Ok(Event::Mesh(
            Header {
                stamp: before.stamp,
                frame_id: frame_id.as_str().into(),
            },
            update,
            SoupReport::default(),
        )),
    };
    let block = (MeshBlockKey([1 << 40, 0, 0]), half.clone());
    let more = MeshUpdate::Blocks {
        clear: false,
        blocks: vec![block],
    };
    assert!(scan.push(event(more)));
    let num_now = scan.capture().mesh.unwrap().num_triangles();
    assert_eq!(num_now, num_before + 1);
    assert!(scan.push(event(MeshUpdate::Whole(half))));
    let capture = scan.capture();
    assert_eq!(capture.mesh.unwrap().num_triangles(), 1);
    assert!(capture.mesh_blocks.is_whole());
}
