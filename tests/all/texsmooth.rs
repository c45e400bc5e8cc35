//! The optimisation and the fast refinement through the command: the same bytes for any thread
//! count, a checkpoint that goes on as if it had not been, and nothing made worse that was right.

use std::path::Path;

use serde_json::Value;

use crate::command::{small_tabletop, veneer, veneer_ok};

fn bake(bag: &Path, out: &Path, extra: &[&str]) -> (String, Value) {
    let mut args = vec!["--quiet", "bake", bag.to_str().unwrap()];
    args.extend(["--out", out.to_str().unwrap()]);
    args.extend(extra);
    veneer_ok(&args);
    let hashes = std::fs::read_to_string(out.join("hashes.txt")).unwrap();
    let report = std::fs::read_to_string(out.join("report.json")).unwrap();
    // Below the first comment are the reports, which hold times.
    let hashes = hashes.split('#').next().unwrap().to_owned();
    (hashes, serde_json::from_str(&report).unwrap())
}

/// Crops that fit the small photos, and a discriminator that can look at them.
const SMALL: [&str; 2] = ["-p", "texsmooth.crop_px:=96"];

#[test]
fn thread_counts_and_checkpoints_give_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let saved = dir.path().join("state.ckpt");
    let preview = dir.path().join("preview.jpg");
    let saved = saved.to_str().unwrap();
    let run = |name: &str, extra: &[&str]| {
        bake(&bag, &dir.path().join(name), &[&SMALL[..], extra].concat())
    };
    let (reference, report) = run("1", &["--threads", "1", "--steps", "8"]);
    assert_eq!(report["texsmooth"]["num_steps"], 8);
    assert!(report["texsmooth"]["num_texels"].as_u64().unwrap() > 1000);
    assert!(report["refine"]["pose"]["residual_255"].is_array());
    let (other, _) = run("3", &["--threads", "3", "--steps", "8"]);
    assert_eq!(other, reference, "3 threads");

    // λ and the learning rate go by the step and by the number of steps in all; a run that is
    // ended by its budget after none has written what it began with.
    let half = [
        "--steps",
        "8",
        "--checkpoint",
        saved,
        "-p",
        "texsmooth.checkpoint_interval:=5",
    ];
    let with_preview = ["--preview", preview.to_str().unwrap()];
    let every_four = ["-p", "texsmooth.preview_interval:=4"];
    let (whole, _) = run("half", &[&half[..], &with_preview, &every_four].concat());
    assert_eq!(whole, reference, "with checkpoints");
    assert!(preview.is_file());
    let (resumed, report) = run("resumed", &["--steps", "8", "--resume", saved]);
    assert_eq!(resumed, reference, "resumed");
    assert_eq!(report["texsmooth"]["num_steps"], 8);

    let bytes = std::fs::read(saved).unwrap();
    std::fs::write(saved, &bytes[..bytes.len() / 2]).unwrap();
    let out = dir.path().join("damaged");
    let mut args = vec![
        "bake",
        bag.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    args.extend(["--steps", "8", "--resume", saved]);
    let refused = veneer(&args);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("checkpoint is damaged"));
}

#[test]
fn what_is_right_already_is_not_made_worse() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let error = |name: &str, extra: &[&str]| {
        let (_, report) = bake(&bag, &dir.path().join(name), extra);
        report["synthetic"]["mean_abs"].as_f64().unwrap()
    };
    let off = ["gain", "pose", "global_seams", "local_seams"];
    let off: Vec<String> = off
        .map(|part| format!("photometric.{part}:=false"))
        .to_vec();
    let mut plain: Vec<&str> = vec!["--steps", "0"];
    for setting in &off {
        plain.extend(["-p", setting.as_str()]);
    }
    let plain = error("plain", &plain);
    let fast = error("fast", &["--steps", "0"]);
    assert!(fast < plain + 0.3, "fast {fast}, plain {plain}");
    let smoothed = error("smooth", &[&["--steps", "40"], &SMALL[..]].concat());
    assert!(smoothed < plain + 0.5, "smooth {smoothed}, plain {plain}");
}
