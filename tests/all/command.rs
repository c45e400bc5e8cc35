//! Runs the `veneer` command as a person would, and finds the real captures.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs `veneer ARGS…` to its end.
pub(crate) fn veneer<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_veneer"))
        .args(args)
        .output()
        .expect("the veneer binary starts")
}

/// Runs `veneer ARGS…` and demands success.
pub(crate) fn veneer_ok<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> String {
    let output = veneer(args);
    let text = said(&output);
    assert!(output.status.success(), "veneer failed: {text}");
    text
}

/// Both streams of a finished command.
pub(crate) fn said(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// A small recording of the synthetic table-top in `dir`.
pub(crate) fn small_tabletop(dir: &Path, extra: &[&str]) -> PathBuf {
    let bag = dir.join("tabletop.mcap");
    let path = bag.to_str().expect("temporary folders have plain names");
    let mut args = vec!["--quiet", "synth", "tabletop", "-o", path];
    args.extend(["--frames", "10", "--width", "240", "--height", "180"]);
    args.extend(["--edge-length-m", "0.04"]);
    args.extend(extra);
    veneer_ok(&args);
    bag
}

/// A real capture beside the checkout; says so aloud where it is not there.
pub(crate) fn capture(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../shared/data")
        .join(name);
    if path.is_dir() {
        Some(path)
    } else {
        eprintln!("SKIPPED: no capture at ../shared/data/{name}");
        None
    }
}
