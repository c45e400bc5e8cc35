//! What `replay --record` writes, against independent decoders and the exports of the same run.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::path::Path;
use std::process::Command;

use crate::command::{small_tabletop, veneer, veneer_ok};
use crate::python;

#[test]
fn a_recording_shows_what_the_exports_hold() {
    let packages = [
        "rosbags==0.11.9",
        "mcap-ros2-support==0.6.0",
        "numpy",
        "pillow",
    ];
    let Some(python) = python::venv("published", &packages) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let bag = small_tabletop(folder.path(), &[]);
    let (out, recorded) = (folder.path().join("out"), folder.path().join("shown.mcap"));
    let mut args = vec!["--quiet", "replay", bag.to_str().unwrap()];
    args.extend(["--out", out.to_str().unwrap()]);
    args.extend(["--record", recorded.to_str().unwrap()]);
    // Small messages, so that all is cut to many; exact textures, so that colours can be compared.
    for setting in ["publish.block_bytes:=60000", "publish.viewer_textures:=png"] {
        args.extend(["-p", setting]);
    }
    veneer_ok(&args);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/published.py");
    let said = python::run(Command::new(&python).arg(&script).args([
        recorded.as_path(),
        out.as_path(),
        Path::new("60000"),
    ]));
    let said = said.unwrap();
    assert!(said.ends_with("all as exported\n"), "{said}");
    // The same again is the same to the bit.
    let first = std::fs::read(&recorded).unwrap();
    veneer_ok(&args);
    assert!(std::fs::read(&recorded).unwrap() == first);
}

#[test]
fn a_recording_that_cannot_be_written_is_known_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let bag = small_tabletop(folder.path(), &[]);
    let out = folder.path().join("out");
    let output = veneer(&[
        "replay",
        bag.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--record",
        folder.path().join("no/such/folder.mcap").to_str().unwrap(),
    ]);
    assert_eq!(output.status.code(), Some(1));
    let words = String::from_utf8_lossy(&output.stderr);
    assert!(words.contains("cannot record to"), "{words}");
    assert!(!out.join("scan.glb").exists());
}
