//! The live node among real ROS 2 peers, on 127.0.0.1.

mod raw_peer;
mod resumed;
mod rig;

use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use veneer::publish::mirror::{Mirror, MirrorLimits};
use veneer::wire::{Message, TexturedMeshBlock};

use crate::command::{small_tabletop, veneer_ok};
use raw_peer::RawPeer;
use rig::{Diagnostics, Rig, free_port, http_get, send_signal};

const INPUTS: [&str; 6] = [
    "/rgb/image/compressed",
    "/rgb/camera_info",
    "/depth/image/compressedDepth",
    "/depth/camera_info",
    "/pose",
    "/mesh",
];
/// For a mesh that does not say its frame, and poses without transforms.
const POSE_ARGS: [&str; 4] = ["-p", "pose_source:=pose", "-p", "mesh_frame:=map"];

fn wait_until(rig: &Rig, what: &str, is_so: impl Fn(&Diagnostics) -> bool) -> Diagnostics {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let seen = rig.diagnostics();
        if is_so(&seen) {
            return seen;
        }
        assert!(Instant::now() < deadline, "not {what}: {seen:?}");
    }
}

/// Whether all that came is painted.
fn is_settled(seen: &Diagnostics) -> bool {
    seen.number("painting", "paintings") > 0
        && seen.number("keyframes", "pending") == 0
        && seen.value("painting", "is painting").as_deref() == Some("false")
        && seen.value("painting", "revision painted") == seen.value("keyframes", "revision")
}

fn sent(said: &Value, topic: &str) -> u64 {
    said["sent"][topic].as_u64().unwrap_or(0)
}

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
        let received = seen.number("inputs", &format!("{topic} received"));
        let lost = seen.number("inputs", &format!("{topic} lost"));
        assert_eq!(received + lost, sent(&said, topic), "{topic}: {seen:?}");
        let taken = seen.number("inputs", &format!("{topic} taken"));
        let dropped = seen.number("inputs", &format!("{topic} dropped"));
        assert_eq!(taken + dropped, received + lost, "{topic}: {seen:?}");
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

#[test]
fn parameters_services_and_lifecycle_answer_rclpy() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let args = [
        "-r",
        "__ns:=/robot",
        "-r",
        "__node:=painter",
        "-p",
        "autostart:=false",
    ];
    let mut node = rig.node(dir.path(), &args);
    let trigger = |name: &str| {
        rig.call(
            &format!("/robot/painter/{name}"),
            "std_srvs/srv/Trigger",
            "{}",
        )
    };
    let lifecycle = |name: &str, request: &str| {
        let type_name = match name {
            "change_state" => "lifecycle_msgs/srv/ChangeState",
            "get_available_states" => "lifecycle_msgs/srv/GetAvailableStates",
            "get_available_transitions" => "lifecycle_msgs/srv/GetAvailableTransitions",
            _ => "lifecycle_msgs/srv/GetState",
        };
        rig.call(&format!("/robot/painter/{name}"), type_name, request)
    };
    let state = || lifecycle("get_state", "{}")["current_state"]["label"].clone();
    assert_eq!(state(), "unconfigured");
    let states = lifecycle("get_available_states", "{}");
    assert_eq!(states["available_states"].as_array().unwrap().len(), 4);
    for (id, success, label) in [
        (3, false, "unconfigured"),
        (1, true, "inactive"),
        (3, true, "active"),
    ] {
        let request = format!(r#"{{"transition": {{"id": {id}}}}}"#);
        assert_eq!(lifecycle("change_state", &request)["success"], success);
        assert_eq!(state(), label);
    }
    let transitions = lifecycle("get_available_transitions", "{}");
    let first = &transitions["available_transitions"][0]["transition"];
    assert_eq!(first["label"], "deactivate");

    let of = |name: &str, type_name: &str, request: &str| {
        rig.call(
            &format!("/robot/painter/{name}"),
            &format!("rcl_interfaces/srv/{type_name}"),
            request,
        )
    };
    let names = r#"{"names": ["paint_period", "image_transport", "photometric.max_turn_rad"]}"#;
    let described = of("describe_parameters", "DescribeParameters", names);
    let descriptors = described["descriptors"].as_array().unwrap();
    assert_eq!(descriptors[1]["read_only"], true);
    assert_eq!(descriptors[2]["floating_point_range"][0]["to_value"], 0.5);
    let values = of("get_parameters", "GetParameters", names);
    assert_eq!(values["values"][1]["string_value"], "auto");
    let all = of("list_parameters", "ListParameters", "{}");
    assert!(
        all["result"]["names"].as_array().unwrap().len() > 10,
        "{all}"
    );
    let prefix = r#"{"prefixes": ["texinit.chart"]}"#;
    let listed = of("list_parameters", "ListParameters", prefix);
    let listed = listed["result"]["names"].as_array().unwrap();
    assert!(listed.contains(&Value::from("texinit.chart.max_stretch")));
    let set = rig
        .peer(&[
            "set",
            "/robot/painter",
            "paint_period=2.5",
            "paint_period=-1.0",
            "image_transport=raw",
        ])
        .next();
    let results = set["results"].as_array().unwrap();
    assert_eq!(results[0]["successful"], true, "{set}");
    assert_eq!(results[1]["successful"], false, "{set}");
    assert!(
        results[1]["reason"]
            .as_str()
            .unwrap()
            .contains("0 ..= 3600")
    );
    assert!(results[2]["reason"].as_str().unwrap().contains("fixed"));
    let values = of("get_parameters", "GetParameters", names);
    assert_eq!(values["values"][0]["double_value"], 2.5);

    assert_eq!(trigger("pause")["success"], true);
    assert_eq!(trigger("resume")["success"], true);
    let painted = trigger("retexture");
    assert_eq!(painted["success"], false);
    let words = painted["message"].as_str().unwrap();
    assert!(words.contains("no mesh has come"), "{words}");
    assert_eq!(trigger("reset")["success"], true);

    let log = [
        "take",
        "/rosout",
        "rcl_interfaces/msg/Log",
        "--latched",
        "--num",
        "3",
    ];
    let log = rig.peer(&log).next();
    assert_eq!(log["messages"][0]["name"], "robot.painter", "{log}");

    let graph = rig
        .peer(&[
            "graph",
            "painter",
            "--namespace",
            "/robot",
            "--subscriptions",
            "/tf",
        ])
        .next();
    assert!(
        graph["subscriptions"]["/robot/rgb/camera_info"].is_array(),
        "{graph}"
    );
    assert!(
        graph["publishers"]["/robot/painter/markers"].is_array(),
        "{graph}"
    );
    assert!(
        graph["services"]["/robot/painter/save"].is_array(),
        "{graph}"
    );
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/topics.md");
    let page = std::fs::read_to_string(page).unwrap();
    for kind in ["subscriptions", "publishers", "services"] {
        for name in graph[kind].as_object().unwrap().keys() {
            let private = name.strip_prefix("/robot/painter/");
            let written = match (private, name.strip_prefix("/robot/")) {
                (Some(private), _) => format!("`~/{private}`"),
                (None, Some(relative)) => format!("`{relative}`"),
                (None, None) => format!("`{name}`"),
            };
            assert!(page.contains(&written), "docs/topics.md lacks {written}");
        }
    }
    assert!(node.is_running());
}

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
    assert_eq!(status["revision"], early.revision().unwrap());

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
