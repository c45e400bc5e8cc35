//! Late poses of past frames, live and from a bag.

use std::path::Path;

use super::{Painted, is_settled, wait_until};
use crate::command::{small_tabletop, veneer_ok};

/// Metres that every corrected pose is shifted by.
const SHIFT_M: f64 = 0.05;

#[test]
fn a_loop_closure_repaints_a_live_scan_and_back_again() {
    // With hysteresis labels remember the way.
    let Some(mut live) = Painted::new(&["stream.hysteresis:=0"]) else {
        return;
    };
    let num_keyframes = live.seen.number("keyframes", "keyframes");
    let before = live.glb();
    let correct = |shift_m: f64, num_corrected: u64| {
        let shift = shift_m.to_string();
        let args = ["correct", live.bag.to_str().unwrap(), "--shift", &shift];
        let mut closer = live.rig.peer(&args);
        assert_eq!(closer.next()["matched"], true);
        let said = closer.next();
        assert!(said["poses"].as_u64().unwrap() >= num_keyframes, "{said}");
        wait_until(&live.rig, "corrected", |seen| {
            is_settled(seen) && seen.number("keyframes", "poses corrected") == num_corrected
        })
    };
    correct(SHIFT_M, num_keyframes);
    let shifted = live.glb();
    assert!(shifted != before, "the poses change nothing");
    let seen = correct(0.0, 2 * num_keyframes);
    assert!(
        live.glb() == before,
        "the old poses do not give the old scan"
    );
    assert_eq!(seen.number("keyframes", "keyframes"), num_keyframes);
    assert!(live.node.is_running());
}

/// `bag` with a path on `/loop` at its end: each pose of the bag, shifted.
fn with_path(bag: &Path, shift_m: f64) -> std::path::PathBuf {
    use veneer::wire::header::WireHeader;
    use veneer::wire::{Message, Path as WirePath, PoseStamped};

    let bytes = std::fs::read(bag).unwrap();
    let out = bag.with_file_name(format!("path_{shift_m}.mcap"));
    let file = std::io::BufWriter::new(std::fs::File::create(&out).unwrap());
    let mut writer = mcap::Writer::new(file).unwrap();
    let mut poses = Vec::new();
    let mut last = 0;
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        last = last.max(message.log_time);
        if message.channel.topic == "/camera/pose" {
            poses.push(message.data.to_vec());
        }
        writer.write(&message).unwrap();
    }
    let poses = poses.iter().map(|bytes| {
        let mut pose = PoseStamped::decode(bytes).unwrap();
        pose.pose.position_m[0] += shift_m;
        pose
    });
    let path = WirePath {
        header: WireHeader {
            stamp: veneer::geom::Stamp::default(),
            frame_id: "map",
        },
        poses: poses.collect(),
    };
    let schema = writer
        .add_schema(WirePath::TYPE_NAME, "ros2msg", WirePath::SCHEMA.as_bytes())
        .unwrap();
    let channel = writer
        .add_channel(schema, "/loop", "cdr", &std::collections::BTreeMap::new())
        .unwrap();
    let header = mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: last + 1,
        publish_time: last + 1,
    };
    writer
        .write_to_known_channel(&header, &path.encode())
        .unwrap();
    writer.finish().unwrap();
    out
}

fn replayed(bag: &Path, args: &[&str]) -> Vec<u8> {
    let out = bag.with_extension("out");
    let bag = bag.to_str().unwrap();
    let out_text = out.to_str().unwrap();
    let base = ["--quiet", "replay", bag, "--out", out_text];
    let no_eval = ["-p", "eval.held_out_views:=0"];
    veneer_ok(&[&base[..], &no_eval, args].concat());
    std::fs::read(out.join("scan.glb")).unwrap()
}

#[test]
fn a_path_in_a_bag_corrects_the_keyframes_where_it_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let named = ["--remap", "pose_corrections:=/loop"];
    let plain = replayed(&bag, &[]);
    let same = with_path(&bag, 0.0);
    assert!(replayed(&same, &named) == plain);
    let shifted = with_path(&bag, SHIFT_M);
    assert!(replayed(&shifted, &named) != plain);
}
