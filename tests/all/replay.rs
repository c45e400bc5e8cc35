//! The main job, through the command: every output there, valid, and the same on every run.

use std::path::Path;

use crate::command::{capture, said, small_tabletop, veneer, veneer_ok};

fn replay(bag: &Path, out: &Path, extra: &[&str]) -> String {
    let mut args = vec!["--quiet", "replay", bag.to_str().unwrap()];
    args.extend(["--out", out.to_str().unwrap()]);
    args.extend(extra);
    veneer_ok(&args);
    let hashes = std::fs::read_to_string(out.join("hashes.txt")).unwrap();
    // Below the first comment are the reports, which hold times.
    hashes.split('#').next().unwrap().to_owned()
}

fn report(out: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(out.join("report.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

#[test]
fn every_output_is_written_and_hashed() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let out = dir.path().join("out");
    let hashes = replay(&bag, &out, &[]);
    for name in [
        "scan.glb",
        "scan.obj",
        "scan.mtl",
        "scan.ply",
        "atlas/page_0.png",
        "provenance/page_0_source.png",
        "provenance/page_0_confidence.png",
    ] {
        assert!(out.join(name).is_file(), "{name} is missing");
        assert!(hashes.contains(name), "{name} is not hashed");
    }
    let html = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.contains("</html>"));
}

#[test]
fn runs_and_thread_counts_give_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &["--grow", "3"]);
    let reference = replay(&bag, &dir.path().join("1"), &["--threads", "1"]);
    assert!(reference.lines().count() > 6);
    for (name, threads) in [("1b", "1"), ("2", "2"), ("4", "4")] {
        let hashes = replay(&bag, &dir.path().join(name), &["--threads", threads]);
        assert_eq!(hashes, reference, "{threads} threads");
    }
}

#[test]
fn a_replay_that_follows_changes_gives_the_same_bytes_and_says_what_it_did() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &["--grow", "4"]);
    let follow = ["-p", "stream.mode:=changes", "-p", "paint_period:=0"];
    let run = |name: &str, threads| {
        let out = dir.path().join(name);
        let hashes = replay(&bag, &out, &[&follow[..], &["--threads", threads]].concat());
        (hashes, report(&out))
    };
    let (reference, told) = run("1", "1");
    assert_eq!(run("4", "4").0, reference);
    let details = told["charts"]["details"].as_array().unwrap();
    let updates = details.iter().find(|row| row["name"] == "updates").unwrap();
    assert!(updates["value"].as_u64().unwrap() > 4, "{updates}");
    assert!(told["coverage"]["keyframe_share"].as_f64().unwrap() > 0.1);
    // What needs the whole texture is refused by name.
    let out = dir.path().join("refused");
    let mut args = vec!["replay", bag.to_str().unwrap()];
    args.extend([
        "--out",
        out.to_str().unwrap(),
        "-p",
        "texsmooth.iterations:=3",
        "-p",
        "texsmooth.start:=blank",
    ]);
    let refused = veneer(&[&args[..], &follow].concat());
    assert!(!refused.status.success());
    assert!(
        said(&refused).contains("texsmooth.start:=blank"),
        "{}",
        said(&refused)
    );
}

#[test]
fn refinement_in_idle_time_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &["--grow", "4", "--pose-noise-rad", "0.01"]);
    let settings = [
        "stream.mode:=changes",
        "paint_period:=0.1",
        "photometric.global_seams:=true",
        "photometric.local_seams:=true",
        "photometric.pose:=true",
        "stream.idle_keyframes:=3",
        "texsmooth.iterations:=12",
        "texsmooth.crop_px:=96",
        "stream.idle_steps:=3",
        "stream.idle_texels:=30000",
    ];
    let settings: Vec<&str> = settings.iter().flat_map(|s| ["-p", *s]).collect();
    let run = |name: &str, threads| {
        let out = dir.path().join(name);
        let hashes = replay(
            &bag,
            &out,
            &[&settings[..], &["--threads", threads]].concat(),
        );
        (hashes, report(&out))
    };
    let (reference, told) = run("1", "1");
    assert_eq!(run("4", "4").0, reference);
    let details = told["charts"]["details"].as_array().unwrap();
    let steps = details
        .iter()
        .find(|row| row["name"] == "idle steps")
        .unwrap();
    assert!(steps["value"].as_u64().unwrap() > 3, "{steps}");
}

#[test]
fn flags_are_the_parameters_that_they_stand_for() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let run = |name: &str, args: &[&str]| {
        let out = dir.path().join(name);
        let hashes = replay(&bag, &out, args);
        (hashes, report(&out)["coverage"].clone())
    };
    let (default, default_coverage) = run("default", &[]);
    let (mean, mean_coverage) = run("mean", &["--init", "l2avg"]);
    assert_eq!(mean, run("p", &["-p", "texinit.init:=l2avg"]).0);
    assert_ne!(mean, default);
    assert_eq!(mean_coverage["keyframe_share"], 0.0);
    assert!(default_coverage["keyframe_share"].as_f64().unwrap() > 0.1);
    // Single parameters change the mode's.
    let (paper, _) = run("paper", &["--mode", "paper", "--init", "l2avg"]);
    let spelled = [
        "-p",
        "texinit.mode:=paper",
        "-p",
        "texinit.init:=l2avg",
        "-p",
        "texinit.lookup:=nearest",
    ];
    assert_eq!(paper, run("spelled", &spelled).0);
    assert_ne!(paper, mean);
}

#[test]
fn a_growing_mesh_ends_as_the_whole_one() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &["--grow", "4"]);
    let out = dir.path().join("out");
    replay(&bag, &out, &[]);
    let growing = report(&out)["mesh"]["num_triangles"].as_u64().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    replay(&bag, &out, &[]);
    let whole = report(&out)["mesh"]["num_triangles"].as_u64().unwrap();
    assert_eq!(growing, whole);
}

/// The strongest oracle: the scene's true texture. Without noise, what was seen is right.
#[test]
fn a_noise_free_room_is_painted_with_its_true_colours() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("room.mcap");
    let path = bag.to_str().unwrap();
    // As a person would make it, but with every other frame only.
    let args = ["--quiet", "synth", "room", "-o", path, "--frames", "60"];
    veneer_ok(&args);
    let out = dir.path().join("out");
    replay(&bag, &out, &[]);
    let report = report(&out);
    let error = report["synthetic"]["mean_abs"].as_f64().unwrap();
    assert!(error < 3.0, "mean absolute colour error {error}/255");
    assert!(report["synthetic"]["num_texels"].as_u64().unwrap() > 1_000_000);
    let views = report["views"].as_array().unwrap().iter();
    let num_shown = views.filter(|view| view["held_out"] == true).count();
    let counts = report["counts"].as_array().unwrap();
    let counted = counts.iter().find(|c| c["name"] == "keyframes held out");
    assert!(num_shown > 0);
    assert_eq!(counted.unwrap()["value"], num_shown);
}

#[test]
fn real_captures_are_textured() {
    for (name, min_seen_share) in [("charuco_lidar", 0.9), ("apt0_structure", 0.9)] {
        let Some(source) = capture(name) else {
            continue;
        };
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("scan.mcap");
        let (source, bag_path) = (source.to_str().unwrap(), bag.to_str().unwrap());
        veneer_ok(&["--quiet", "import", "capture", source, "-o", bag_path]);
        let out = dir.path().join("out");
        replay(&bag, &out, &[]);
        let report = report(&out);
        let seen = report["coverage"]["keyframe_share"].as_f64().unwrap();
        assert!(
            seen > min_seen_share,
            "{name}: a frame painted only {seen} of the texture"
        );
    }
}
