//! What goes beyond a limit that peers could press on: refused or not looked at, told, and no harm done.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::rig::{Peer, Rig, free_domain, free_port, node_in};
use super::{POSE_ARGS, sent, wait_until};
use crate::command::small_tabletop;

#[test]
fn inputs_beyond_the_limits_are_told_with_the_limit() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let limits = [
        "-p",
        "limits.message_bytes:=2000",
        "-p",
        "limits.mesh_triangles:=10",
    ];
    let mut node = rig.node(dir.path(), &[&POSE_ARGS[..], &limits].concat());
    let mut player = rig.peer(&["play", bag.to_str().unwrap()]);
    assert_eq!(player.next()["matched"], true);
    let said = player.next();
    let image = "/rgb/image/compressed";
    let seen = wait_until(&rig, "told", |seen| {
        let too_long = seen.number("inputs", &format!("{image} too long"));
        too_long > 0
            && too_long + seen.number("inputs", &format!("{image} lost")) == sent(&said, image)
    });
    assert_eq!(seen.number("inputs", &format!("{image} taken")), 0);
    assert!(seen.message("inputs").contains("limits.message_bytes"));
    assert!(node.is_running());
}

#[test]
fn requests_beyond_the_limits_get_no_answer_and_harm_nothing() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let args = ["limits.request_bytes:=300", "limits.request_names:=2"];
    let mut node = rig.node(dir.path(), &["-p", args[0], "-p", args[1]]);
    let ask = |num_names: usize| {
        let names = vec!["approx_sync"; num_names];
        let names = serde_json::json!({ "names": names }).to_string();
        rig.peer(&[
            "call",
            "/veneer/get_parameters",
            "rcl_interfaces/srv/GetParameters",
            &names,
            "--wait",
            "50",
        ])
    };
    let num_values = |mut peer: Peer| {
        let said = peer.next();
        let values = said["response"]["values"].as_array().cloned();
        values.unwrap_or_else(|| panic!("{said}")).len()
    };
    assert_eq!(num_values(ask(2)), 2);
    assert_eq!(num_values(ask(3)), 0);
    let mut long = ask(100);
    let deadline = Instant::now() + Duration::from_secs(40);
    while !node.log().contains("limits.request_bytes") {
        assert!(Instant::now() < deadline, "{}", node.log());
        std::thread::sleep(Duration::from_millis(100));
    }
    // Whoever asks after it is answered; it is not.
    assert_eq!(num_values(ask(1)), 1);
    assert!(long.is_silent_for(Duration::from_secs(1)));
    assert!(node.is_running());
}

#[test]
fn publishers_beyond_the_limit_are_not_looked_at() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut node = rig.node(dir.path(), &["-p", "limits.publishers:=2"]);
    let publisher = || {
        let (topic, kind) = ("/rgb/camera_info", "sensor_msgs/msg/CameraInfo");
        let mut peer = rig.peer(&["publish", topic, kind, "--wait", "30", "00010000"]);
        assert_eq!(peer.next()["matched"], true);
        peer
    };
    let key = "/rgb/camera_info publishers";
    let first = publisher();
    let seen = wait_until(&rig, "one", |seen| seen.number("network", key) == 1);
    assert!(!seen.message("network").contains("limits.publishers"));
    let others = [publisher(), publisher()];
    let seen = wait_until(&rig, "told", |seen| {
        seen.message("network").contains("limits.publishers")
    });
    assert_eq!(seen.number("network", key), 2, "{seen:?}");
    assert!(node.is_running());
    drop((first, others));
}

#[test]
fn readers_beyond_the_limit_are_not_told_apart() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let args = [&POSE_ARGS[..], &["-p", "limits.readers:=2"]].concat();
    let mut node = rig.node(dir.path(), &args);
    let topic = "/veneer/keyframes=geometry_msgs/msg/PoseArray";
    let listener = || {
        let mut peer = rig.peer(&["listen", topic]);
        assert_eq!(peer.next()["listening"], true);
        peer
    };
    let key = "/veneer/keyframes readers";
    let mut listeners = vec![listener()];
    wait_until(&rig, "one", |seen| seen.number("outputs", key) == 1);
    listeners.extend([listener(), listener()]);
    wait_until(&rig, "two", |seen| seen.number("outputs", key) == 2);
    let mut player = rig.peer(&["play", bag.to_str().unwrap()]);
    assert_eq!(player.next()["matched"], true);
    player.next();
    let seen = wait_until(&rig, "painted", super::is_settled);
    assert_eq!(seen.number("outputs", key), 2, "{seen:?}");
    // All of them hear what is published from now on.
    for listener in listeners {
        let counts = listener.stop()["counts"].clone();
        let num = counts["/veneer/keyframes"]["num"].as_u64().unwrap();
        assert!(num > 0, "{counts}");
    }
    assert!(node.is_running());
}

/// What an HTTP server on this host answers to these bytes.
fn answered(port: u16, request: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn http_clients_beyond_the_limits_are_turned_away() {
    let dir = tempfile::tempdir().unwrap();
    let port = free_port();
    let settings = [
        &format!("http.port:={port}"),
        "limits.http_clients:=2",
        "limits.http_request_bytes:=200",
        "limits.http_silence_s:=4",
    ];
    let args: Vec<&str> = settings.iter().flat_map(|s| ["-p", *s]).collect();
    let mut node = node_in(free_domain(), dir.path(), &args);
    let deadline = Instant::now() + Duration::from_secs(30);
    while TcpStream::connect(("127.0.0.1", port)).is_err() {
        assert!(Instant::now() < deadline, "{}", node.log());
        std::thread::sleep(Duration::from_millis(50));
    }
    let get = "GET /scan.glb HTTP/1.1\r\n\r\n";
    let is_served = || answered(port, get).contains("nothing was painted yet");
    while !is_served() {
        assert!(Instant::now() < deadline, "{}", answered(port, get));
    }
    let long = format!("GET /{} HTTP/1.1\r\n\r\n", "a".repeat(5000));
    let answer = answered(port, &long);
    assert!(answer.starts_with("HTTP/1.1 431 "), "{answer}");
    assert!(answer.contains("limits.http_request_bytes"), "{answer}");

    // Two that say nothing, and bytes that never make a request, hold all there is, but not for long.
    let begun = Instant::now();
    let mut held = [(); 2].map(|()| TcpStream::connect(("127.0.0.1", port)).unwrap());
    let answer = answered(port, get);
    assert!(answer.starts_with("HTTP/1.1 503 "), "{answer}");
    assert!(answer.contains("limits.http_clients"), "{answer}");
    while !is_served() {
        for stream in &mut held {
            // The server may have hung up.
            stream.write_all(b"a").ok();
        }
        assert!(begun.elapsed() < Duration::from_secs(20));
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(begun.elapsed() > Duration::from_secs(3));
    assert!(node.is_running());
}
