//! A scan that goes on from its journal, or from a saved session, is painted as the one before.

use std::path::Path;

use veneer::bag::journal::{Found, Journal, PathDisk, ScanState};
use veneer::bag::{BagReader, TopicRoles};
use veneer::ingest::EventSource;
use veneer::pipeline::{
    Capture, EarlierScan, LiveScan, NoProgress, Painted, Painter, PipelineParams,
};

use crate::command::small_tabletop;

pub(crate) fn state_of(capture: &Capture) -> ScanState {
    let keyframes = capture.keyframes.iter();
    ScanState {
        keyframes: keyframes.map(|k| (k.id, k.clone())).collect(),
        mesh: capture.mesh.clone(),
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

/// A capture of a scan that goes on from `state`.
pub(crate) fn capture_of(state: ScanState, params: &PipelineParams) -> Capture {
    let mut scan = LiveScan::new(params, &[], 0);
    scan.resume(EarlierScan {
        keyframes: state.keyframes.into_values().collect(),
        next_id: state.next_id,
        mesh: state.mesh,
        num_mesh_updates: state.num_mesh_updates.try_into().unwrap(),
        world_frame: state.world_frame,
    });
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
