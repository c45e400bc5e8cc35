//! The live node among real ROS 2 peers, on 127.0.0.1.

mod corrections;
mod painting;
mod peers;
mod raw_peer;
mod resumed;
mod rig;
mod services;

use std::time::{Duration, Instant};

use serde_json::Value;

use rig::{Diagnostics, Rig};

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

/// Of what was sent, all was received or is known to be lost; what was received was taken or dropped.
fn assert_adds_up(seen: &Diagnostics, topic: &str, num_sent: u64) {
    let number = |what: &str| seen.number("inputs", &format!("{topic} {what}"));
    let received = number("received");
    assert_eq!(received + number("lost"), num_sent, "{topic}: {seen:?}");
    let taken = number("taken");
    assert_eq!(taken + number("dropped"), received, "{topic}: {seen:?}");
}
