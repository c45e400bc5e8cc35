//! A command that is told to stop leaves whole files or none.

#![cfg(unix)]

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A synth that takes far longer than the test; it hears the signal even where the test's own
/// parent ignores it.
fn long_synth(bag: &Path) -> Child {
    Command::new("env")
        .arg("--default-signal=INT,TERM,HUP")
        .args([env!("CARGO_BIN_EXE_veneer"), "synth", "tabletop"])
        .args(["--frames", "3000", "--edge-length-m", "0.04", "-o"])
        .arg(bag)
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

#[test]
fn a_stopped_synth_leaves_the_old_bag_and_no_partial_one() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("scan.mcap");
    let part = dir.path().join("scan.mcap.part");
    std::fs::write(&bag, "old").unwrap();
    for signal in ["-INT", "-TERM"] {
        let mut child = long_synth(&bag);
        let begun = Instant::now();
        while !part.exists() {
            assert!(begun.elapsed() < Duration::from_secs(60), "no bag begun");
            assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
            std::thread::sleep(Duration::from_millis(10));
        }
        let pid = child.id().to_string();
        let sent = Command::new("kill").args([signal, &pid]).status().unwrap();
        assert!(sent.success());
        assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
        assert!(!part.exists(), "{signal} leaves a partial bag");
        assert_eq!(std::fs::read(&bag).unwrap(), b"old");
    }
}
