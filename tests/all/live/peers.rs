//! Peers of other makes, and peers that misbehave.

use std::path::Path;
use std::time::Duration;

use super::rig::{Rig, send_signal};
use super::{INPUTS, POSE_ARGS, assert_adds_up, is_settled, sent, wait_until};
use crate::command::small_tabletop;
use crate::python;

#[test]
fn garbage_and_wrong_types_are_told_and_harm_nothing() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut node = rig.node(dir.path(), &POSE_ARGS);
    let mut garbage = rig.peer(&[
        "publish",
        "/rgb/image/compressed",
        "sensor_msgs/msg/CompressedImage",
        "00010000",
        "00010000ffffffffffffffffffffffff",
        "0007000000000000",
        "0001000000000000000000000100000000000000ffffff7f00",
    ]);
    assert_eq!(garbage.next()["matched"], true);
    assert_eq!(garbage.next()["sent"], 4);
    let mut wrong = rig.peer(&[
        "publish",
        "/mesh",
        "sensor_msgs/msg/Image",
        "--wait",
        "0",
        "00010000",
    ]);
    wrong.next();
    let seen = wait_until(&rig, "told", |seen| {
        seen.number("inputs", "/rgb/image/compressed taken") == 4
            && seen.message("synchronisation").contains("refused")
            && seen.message("network").contains("sensor_msgs/msg/Image")
    });
    assert!(
        seen.message("synchronisation")
            .contains("/rgb/image/compressed")
    );
    assert!(seen.message("network").contains("/mesh"), "{seen:?}");
    assert!(node.is_running());
    drop((garbage, wrong));
}

#[test]
fn a_frozen_reader_costs_bounded_memory_and_no_one_else() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let args = [&POSE_ARGS[..], &["-p", "publish.depth:=20"]].concat();
    let mut node = rig.node(dir.path(), &args);
    let topic = "/veneer/markers=visualization_msgs/msg/MarkerArray";
    let mut frozen = rig.peer(&["listen", topic]);
    assert_eq!(frozen.next()["listening"], true);
    let mut awake = rig.peer(&["listen", "/veneer/keyframes=geometry_msgs/msg/PoseArray"]);
    assert_eq!(awake.next()["listening"], true);
    std::thread::sleep(Duration::from_secs(1));
    send_signal(frozen.pid(), "STOP");
    let mut player = rig.peer(&["play", bag.to_str().unwrap()]);
    assert_eq!(player.next()["matched"], true);
    player.next();
    wait_until(&rig, "painted", is_settled);
    // Each painting anew is a new whole for the markers.
    let mut peak = 0;
    for _ in 0..6 {
        let done = rig.call("/veneer/retexture", "std_srvs/srv/Trigger", "{}");
        assert_eq!(done["success"], true);
        let seen = rig.diagnostics();
        peak = peak.max(seen.number("process", "memory_bytes"));
    }
    assert!(peak < 400_000_000, "{peak} bytes");
    let counts = awake.stop()["counts"].clone();
    let num = counts["/veneer/keyframes"]["num"].as_u64().unwrap();
    assert!(num > 0, "{counts}");
    assert!(node.is_running());
    send_signal(frozen.pid(), "CONT");
}

/// A scan from, and what is published to, an rclpy of another distribution.
#[test]
fn rclpy_kilted_feeds_the_node_and_hears_it() {
    let Some(kilted) = Rig::of("kilted") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let mut node = kilted.node(dir.path(), &POSE_ARGS);
    let topics = [
        "/veneer/keyframes=geometry_msgs/msg/PoseArray",
        "/veneer/markers=visualization_msgs/msg/MarkerArray",
    ];
    let mut early = kilted.peer(&["listen", topics[0], topics[1]]);
    assert_eq!(early.next()["listening"], true);
    let mut player = kilted.peer(&["play", bag.to_str().unwrap()]);
    assert_eq!(player.next()["matched"], true);
    let said = player.next();
    let seen = wait_until(&kilted, "painted", is_settled);
    for topic in INPUTS {
        assert_adds_up(&seen, topic, sent(&said, topic));
    }
    let state = kilted.call("/veneer/get_state", "lifecycle_msgs/srv/GetState", "{}");
    assert_eq!(state["current_state"]["label"], "active");
    let all = kilted.call(
        "/veneer/list_parameters",
        "rcl_interfaces/srv/ListParameters",
        "{}",
    );
    assert!(all["result"]["names"].as_array().unwrap().len() > 10);
    let counts = early.stop()["counts"].clone();
    for topic in ["/veneer/keyframes", "/veneer/markers"] {
        assert!(counts[topic]["num"].as_u64().unwrap() > 0, "{counts}");
    }
    assert!(node.is_running());
}

/// Keeps Cyclone DDS to this host.
const CYCLONE_CONFIG: &str = "<CycloneDDS><Domain id=\"any\"><General><Interfaces>\
    <NetworkInterface address=\"127.0.0.1\"/></Interfaces><AllowMulticast>false</AllowMulticast>\
    </General><Discovery><Peers><Peer address=\"127.0.0.1\"/></Peers>\
    <ParticipantIndex>auto</ParticipantIndex></Discovery></Domain></CycloneDDS>";

#[test]
fn cyclone_dds_feeds_the_node_and_hears_it() {
    let Some(rig) = Rig::new() else { return };
    let packages = ["cyclonedds==11.0.1", "mcap", "lz4", "zstandard"];
    let Some(python) = python::venv("cyclone-live", &packages) else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let config = dir.path().join("cyclone.xml");
    std::fs::write(&config, CYCLONE_CONFIG).unwrap();
    let mut node = rig.node(dir.path(), &POSE_ARGS);
    let uri = format!("file://{}", config.display());
    let script = Path::new("tests/all/cyclone_peer.py");
    let domain = rig.domain.to_string();
    let args = ["play", bag.to_str().unwrap(), "--domain", &domain];
    let mut cyclone = rig.other_peer(&python, script, &args, &[("CYCLONEDDS_URI", &uri)]);
    let matched = cyclone.next();
    assert_eq!(matched["matched"], true, "{matched}");
    let said = cyclone.next();
    let seen = wait_until(&rig, "painted", is_settled);
    let topics = [
        "/rgb/image/compressed",
        "/rgb/camera_info",
        "/pose",
        "/mesh",
    ];
    for topic in topics {
        assert!(sent(&said, topic) > 0, "{said}");
        assert_adds_up(&seen, topic, sent(&said, topic));
    }
    let heard = cyclone.stop();
    assert!(
        heard["heard"]["/diagnostics"].as_u64().unwrap() > 1,
        "{heard}"
    );
    let num_keyframes = seen.number("keyframes", "keyframes");
    assert_eq!(heard["keyframes"], num_keyframes, "{heard}");
    assert!(node.is_running());
}

#[test]
fn a_publisher_that_dies_is_told_of_and_one_that_takes_over_goes_on() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let mut node = rig.node(dir.path(), &POSE_ARGS);
    let slow = ["play", bag.to_str().unwrap(), "--rate", "0.2", "--aloud"];
    let mut player = rig.peer(&slow);
    assert_eq!(player.next()["matched"], true);
    let image = "/rgb/image/compressed";
    let mut said = player.next();
    while sent(&said, image) < 4 {
        said = player.next();
    }
    send_signal(player.pid(), "KILL");
    let at = said["at"].as_u64().unwrap();
    // One topic falls silent before the other.
    let seen = wait_until(&rig, "told", |seen| {
        let message = seen.message("inputs");
        message.contains("is silent for") && message.contains(image)
    });
    // It may have sent more than it could say.
    let first = seen.number("inputs", &format!("{image} received"));
    assert!(first >= 3, "{seen:?}");

    let from = at.to_string();
    let rest = ["play", bag.to_str().unwrap(), "--from", &from];
    let mut player = rig.peer(&rest);
    assert_eq!(player.next()["matched"], true);
    let said = player.next();
    let seen = wait_until(&rig, "going on", |seen| {
        is_settled(seen) && seen.number("inputs", &format!("{image} received")) > first
    });
    assert!(sent(&said, image) > 0, "{said}");
    assert_adds_up(&seen, image, first + sent(&said, image));
    let silent = seen.message("inputs");
    assert!(
        seen.number("keyframes", "keyframes") > 5,
        "{silent}: {seen:?}"
    );
    assert!(node.is_running());
}
