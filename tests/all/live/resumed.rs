//! A node that is killed goes on where its journal says it was.

use std::time::{Duration, Instant};

use veneer::export::ExportParams;
use veneer::pipeline::PipelineParams;
use veneer::ros::files;

use super::{POSE_ARGS, Rig, is_settled, wait_until};
use crate::command::small_tabletop;
use crate::journal::{capture_of, painted, resumed};

#[test]
fn a_killed_node_goes_on_with_all_that_was_acknowledged_and_paints_the_same() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let journal = dir.path().join("journal.mcap");
    let saves = dir.path().join("saves");
    let path = format!("keyframe.journal_path:={}", journal.display());
    let folder = format!("save.folder:={}", saves.display());
    let saved = ["-p", "save.on_shutdown:=scan.glb"];
    // Charts that follow changes remember the way; the whole does not.
    let whole = ["-p", "stream.mode:=whole"];
    let args = [
        &POSE_ARGS[..],
        &["-p", &path, "-p", &folder],
        &saved,
        &whole,
    ]
    .concat();

    let node = rig.node(dir.path(), &args);
    let mut player = rig.peer(&["play", bag.to_str().unwrap()]);
    assert_eq!(player.next()["matched"], true);
    let seen = wait_until(&rig, "journalled", |seen| {
        seen.number("journal", "acknowledged keyframes") > 2
            && seen.number("journal", "acknowledged mesh updates") > 0
    });
    let num_acknowledged = seen.number("journal", "acknowledged keyframes");
    // As `kill -9`, while the bag may still be playing.
    drop(node);
    drop(player);

    let state = resumed(&journal);
    assert!(state.keyframes.len() as u64 >= num_acknowledged, "{seen:?}");
    assert!(state.mesh.is_some());
    let num_keyframes = state.keyframes.len() as u64;
    let params = PipelineParams::default();
    let expected = painted(capture_of(state, &params), &params);
    let expected_glb = dir.path().join("expected.glb");
    files::save_painting(&expected_glb, &expected, &ExportParams::default()).unwrap();

    let begun = Instant::now();
    let node = rig.node(dir.path(), &args);
    let seen = wait_until(&rig, "painted again", is_settled);
    assert!(begun.elapsed() < Duration::from_secs(60));
    assert_eq!(seen.number("journal", "resumed keyframes"), num_keyframes);
    assert_eq!(seen.number("keyframes", "keyframes"), num_keyframes);
    let (success, _) = node.end("INT");
    assert!(success);
    let glb = std::fs::read(saves.join("scan.glb")).unwrap();
    assert!(glb == std::fs::read(expected_glb).unwrap(), "another scan");
    // A clean end leaves a whole file.
    let bytes = std::fs::read(&journal).unwrap();
    assert!(mcap::MessageStream::new(&bytes).unwrap().all(|m| m.is_ok()));
}
