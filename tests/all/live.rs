//! The live node among real ROS 2 peers, on 127.0.0.1.

mod corrections;
mod limits;
mod painting;
mod peers;
mod raw_peer;
mod resumed;
mod rig;
mod services;
mod subnets;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

use crate::command::small_tabletop;
use rig::{Diagnostics, LiveNode, Peer, Rig, free_port, http_get};

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
        && seen.number("painting", "keyframes to paint") == 0
        && seen.value("painting", "revision painted") == seen.value("keyframes", "revision")
}

/// A table-top that was played to a node, which has painted it and serves it.
struct Painted {
    rig: Rig,
    bag: PathBuf,
    port: u16,
    node: LiveNode,
    seen: Diagnostics,
    _player: Peer,
    _dir: TempDir,
}

impl Painted {
    /// With more settings for the node; `None`, said aloud, where there is no rclpy.
    fn new(settings: &[&str]) -> Option<Self> {
        let rig = Rig::new()?;
        let dir = tempfile::tempdir().unwrap();
        let bag = small_tabletop(dir.path(), &[]);
        let port = free_port();
        let http = format!("http.port:={port}");
        let settings = settings.iter().copied().chain([http.as_str()]);
        let settings = settings.flat_map(|setting| ["-p", setting]);
        let args: Vec<&str> = POSE_ARGS.into_iter().chain(settings).collect();
        let node = rig.node(dir.path(), &args);
        let mut player = rig.peer(&["play", bag.to_str().unwrap()]);
        assert_eq!(player.next()["matched"], true);
        player.next();
        let seen = wait_until(&rig, "painted", is_settled);
        Some(Self {
            rig,
            bag,
            port,
            node,
            seen,
            _player: player,
            _dir: dir,
        })
    }

    /// The GLB that the node serves.
    fn glb(&self) -> Vec<u8> {
        http_get(self.port, "/scan.glb").1
    }
}

fn sent(said: &Value, topic: &str) -> u64 {
    said["sent"][topic].as_u64().unwrap_or(0)
}

/// Of what was sent, all was received or is known to be lost; what was received was taken or dropped.
fn assert_adds_up(seen: &Diagnostics, topic: &str, num_sent: u64) {
    let number = |what: &str| seen.number("inputs", &format!("{topic} {what}"));
    let received = number("received");
    assert_eq!(received + number("lost"), num_sent, "{topic}: {seen:?}");
    let taken = number("taken");
    assert_eq!(taken + number("dropped"), received, "{topic}: {seen:?}");
}
