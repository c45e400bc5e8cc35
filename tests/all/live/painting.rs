//! Scans that reach the node from rclpy, and what the node publishes of them.

use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use veneer::publish::mirror::{Mirror, MirrorLimits};
use veneer::wire::{Message, TexturedMeshBlock};

use super::raw_peer::RawPeer;
use super::rig::{Rig, free_port, http_get, send_signal};
use super::{INPUTS, POSE_ARGS, Painted, assert_adds_up, is_settled, sent, wait_until};
use crate::command::{small_tabletop, veneer_ok};

#[test]
fn a_scan_is_painted_and_reaches_early_and_late_subscribers() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let mut node = rig.node(dir.path(), &POSE_ARGS);
    let topics = [
        "/veneer/keyframes=geometry_msgs/msg/PoseArray",
        "/veneer/markers=visualization_msgs/msg/MarkerArray",
    ];
    let mut early = rig.peer(&["listen", topics[0], topics[1]]);
    assert_eq!(early.next()["listening"], true);
    let mut player = rig.peer(&["play", bag.to_str().unwrap()]);
    let matched = player.next();
    assert_eq!(matched["matched"], true, "{matched}");
    let said = player.next();
    let seen = wait_until(&rig, "painted", is_settled);

    for topic in INPUTS {
        assert_adds_up(&seen, topic, sent(&said, topic));
    }
    assert!(seen.number("keyframes", "keyframes") > 3, "{seen:?}");

    let whole = |arguments: &[&str]| {
        let mut late = rig.peer(arguments);
        assert_eq!(late.next()["listening"], true);
        std::thread::sleep(Duration::from_secs(3));
        late.stop()["counts"].clone()
    };
    let latched = whole(&["listen", "--latched", topics[0], topics[1]]);
    let volatile = whole(&["listen", topics[0], topics[1]]);
    let early = early.stop()["counts"].clone();
    for counts in [&early, &latched, &volatile] {
        for topic in ["/veneer/keyframes", "/veneer/markers"] {
            let count = &counts[topic];
            assert!(count["num"].as_u64().unwrap() > 0, "{topic}: {counts}");
            assert!(count["max_bytes"].as_u64().unwrap() <= 190_000, "{counts}");
        }
    }
    assert!(node.is_running());
    let log = node.log();
    let (success, took) = node.end("TERM");
    assert!(success && took < Duration::from_secs(2), "{took:?}\n{log}");
    drop(player);
}

#[test]
fn live_is_replay_under_simulated_time() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let out = dir.path().join("replayed");
    veneer_ok(&[
        "--quiet",
        "replay",
        bag.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "-p",
        "eval.held_out_views:=0",
        "-p",
        "stream.mode:=whole",
    ]);
    let saves = dir.path().join("saves");
    let folder = format!("save.folder:={}", saves.display());
    let port = free_port();
    let http = format!("http.port:={port}");
    let node = rig.node(
        dir.path(),
        &[
            "-p",
            "use_sim_time:=true",
            "-p",
            "mesh_frame:=map",
            "-p",
            "stream.mode:=whole",
            "-p",
            &folder,
            "-p",
            &http,
            "-p",
            "save.on_shutdown:=scan.glb",
        ],
    );
    let mut transforms = RawPeer::new(rig.domain);
    transforms.send(&bag, "/tf_static", "/tf_static");
    transforms.send(&bag, "/tf", "/tf");
    let args = [
        "play",
        "--clock",
        bag.to_str().unwrap(),
        "--optional",
        "/pose",
    ];
    let mut player = rig.peer(&args);
    assert_eq!(player.next()["matched"], true);
    let said = player.next();
    let seen = wait_until(&rig, "painted", is_settled);
    for topic in &INPUTS[..4] {
        let taken = seen.number("inputs", &format!("{topic} taken"));
        assert_eq!(taken, sent(&said, topic), "a message was lost: {seen:?}");
    }
    let (_, index) = http_get(port, "/");
    let index: Value = serde_json::from_slice(&index).unwrap();
    let (status, served) = http_get(port, index["url"].as_str().unwrap());
    assert!(status.contains("200"), "{status}");
    let (status, _) = http_get(port, "/1/1/scan.glb");
    assert!(status.contains("404"), "{status}");
    let (success, _) = node.end("INT");
    assert!(success);
    let live = std::fs::read(saves.join("scan.glb")).unwrap();
    let replayed = std::fs::read(out.join("scan.glb")).unwrap();
    assert!(
        live == replayed,
        "{} and {} bytes",
        live.len(),
        replayed.len()
    );
    assert!(served == live, "what is served is what is saved");
}

/// What a dump of `~/textured_mesh` puts together, message by message, so far.
fn mirror(dump: &Path) -> Mirror {
    let bytes = std::fs::read(dump.join("textured_mesh")).unwrap_or_default();
    let mut rest = &bytes[..];
    let mut mirror = Mirror::new(MirrorLimits::default());
    while let Some((length, after)) = rest.split_first_chunk::<4>() {
        let length = u32::from_le_bytes(*length) as usize;
        let Some((message, after)) = after.split_at_checked(length) else {
            break;
        };
        let block = TexturedMeshBlock::decode(message).unwrap();
        mirror.apply(&block).unwrap();
        rest = after;
    }
    mirror
}

#[test]
fn sessions_and_blocks_reach_peers_that_know_our_messages() {
    let Some(rig) = Rig::new() else { return };
    let Some(ours) = rig.with_our_messages() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let saves = dir.path().join("saves");
    let folder = format!("save.folder:={}", saves.display());
    let args = [&POSE_ARGS[..], &["-p", &folder]].concat();
    let mut node = rig.node(dir.path(), &args);
    let dumps = ["early", "late"].map(|name| dir.path().join(name));
    let listen = |dump: &Path, how: &[&str]| {
        std::fs::create_dir(dump).unwrap();
        let topic = "/veneer/textured_mesh=veneer/msg/TexturedMeshBlock";
        let args = ["listen", topic, "--dump", dump.to_str().unwrap()];
        let mut peer = ours.peer(&[&args[..], how].concat());
        assert_eq!(peer.next()["listening"], true);
        peer
    };
    let early = listen(&dumps[0], &[]);
    let mut player = rig.peer(&["play", bag.to_str().unwrap()]);
    assert_eq!(player.next()["matched"], true);
    player.next();
    // A publisher that dies after its last message is nobody's loss.
    send_signal(player.pid(), "KILL");
    let seen = wait_until(&rig, "painted", is_settled);
    let late = listen(&dumps[1], &["--latched"]);
    let deadline = Instant::now() + Duration::from_secs(30);
    let [early_dump, late_dump] = &dumps;
    let is_same = |a: &Mirror, b: &Mirror| a.revision().is_some() && a.holds_same_as(b);
    while !is_same(&mirror(early_dump), &mirror(late_dump)) {
        assert!(Instant::now() < deadline, "early and late differ");
        std::thread::sleep(Duration::from_millis(200));
    }
    drop((early.stop(), late.stop()));
    let early = mirror(early_dump);
    let (mesh, ..) = early.to_textured().unwrap();
    assert!(mesh.num_triangles() > 100, "{}", mesh.num_triangles());

    let status = ours
        .peer(&["take", "/veneer/status", "veneer/msg/Status"])
        .next();
    let status = &status["messages"][0];
    assert_eq!(status["state"], "active");
    let num_keyframes = seen.number("keyframes", "keyframes");
    assert_eq!(status["num_keyframes"], num_keyframes);
    // A keyframe that changes no texel is published alone.
    let published = status["revision"].as_u64().unwrap();
    assert!(published >= early.revision().unwrap());

    let file = |service: &str, path: &str| {
        let request = serde_json::json!({ "file_path": path }).to_string();
        let service = format!("/veneer/{service}");
        ours.call(&service, "veneer/srv/FilePath", &request)
    };
    for path in ["../scan.mcap", "/tmp/scan.mcap", "scan.exe", ""] {
        assert_eq!(file("save", path)["success"], false, "{path}");
    }
    for path in ["a/scan.mcap", "scan.glb"] {
        let saved = file("save", path);
        assert_eq!(saved["success"], true, "{saved}");
        assert!(saves.join(path).is_file());
    }
    assert_eq!(
        rig.call("/veneer/reset", "std_srvs/srv/Trigger", "{}")["success"],
        true
    );
    assert_eq!(rig.diagnostics().number("keyframes", "keyframes"), 0);
    let loaded = file("load", "a/scan.mcap");
    assert_eq!(loaded["success"], true, "{loaded}");
    let seen = wait_until(&rig, "painted again", is_settled);
    assert_eq!(seen.number("keyframes", "keyframes"), num_keyframes);
    assert!(node.is_running());
}

#[test]
fn a_live_scan_is_refined_while_nothing_comes() {
    let settings = [
        "photometric.global_seams:=true",
        "photometric.local_seams:=true",
        "photometric.pose:=true",
    ];
    let Some(live) = Painted::new(&settings) else {
        return;
    };
    let is_refined = |seen: &super::Diagnostics| {
        let waiting = ["charts to refine", "keyframes to align"];
        is_settled(seen)
            && waiting
                .iter()
                .all(|what| seen.number("painting", what) == 0)
    };
    let seen = wait_until(&live.rig, "refined", is_refined);
    assert!(seen.number("painting", "idle steps") > 0, "{seen:?}");
    assert_eq!(seen.number("painting", "failed"), 0, "{seen:?}");
    let refined = live.glb();
    // What is refined stays, whatever is painted again without a change.
    live.rig
        .call("/veneer/retexture", "std_srvs/srv/Trigger", "{}");
    let again = wait_until(&live.rig, "painted again", |now| {
        is_refined(now)
            && now.number("painting", "paintings") > seen.number("painting", "paintings")
    });
    assert!(live.glb() == refined);
    let steps = |seen: &super::Diagnostics| seen.number("painting", "idle steps");
    assert_eq!(steps(&again), steps(&seen));
}
