//! Virtual environments with independent Python implementations, made once and kept under
//! `target/`.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The interpreter of a virtual environment with `packages` (as pip names them), made on the
/// first call. `None`, said loudly, where python3, pip or the network is missing: the caller
/// returns then.
pub(crate) fn venv(name: &str, packages: &[&str]) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("venv");
    let made = make(&root, name, packages);
    if let Err(reason) = &made {
        skipped(&format!("no virtual environment '{name}': {reason}"));
    }
    made.ok()
}

#[expect(clippy::print_stderr, reason = "a skipped test must be seen")]
fn skipped(reason: &str) {
    eprintln!("SKIPPED: {reason}");
}

fn make(root: &Path, name: &str, packages: &[&str]) -> Result<PathBuf, String> {
    let folder = root.join(name);
    let words = |error: std::io::Error| error.to_string();
    fs::create_dir_all(root).map_err(words)?;
    // Test runners start many tests at once, each in its own process perhaps.
    let lock = File::create(root.join(format!("{name}.lock"))).map_err(words)?;
    lock.lock().map_err(words)?;
    let python = folder.join("bin/python");
    let marker = folder.join("packages.txt");
    let wanted = packages.join("\n");
    if fs::read_to_string(&marker).is_ok_and(|made| made == wanted) && python.exists() {
        return Ok(python);
    }
    if folder.exists() {
        fs::remove_dir_all(&folder).map_err(words)?;
    }
    run(Command::new("python3").args(["-m", "venv"]).arg(&folder))?;
    run(Command::new(&python)
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
        ])
        .args(packages))?;
    fs::write(&marker, wanted).map_err(words)?;
    Ok(python)
}

/// Runs a command to its end.
///
/// # Errors
/// How it failed, with what it said.
pub(crate) fn run(command: &mut Command) -> Result<String, String> {
    let output = command
        .output()
        .map_err(|error| format!("{command:?}: {error}"))?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    if output.status.success() {
        return Ok(said);
    }
    let complaint = String::from_utf8_lossy(&output.stderr);
    Err(format!(
        "{command:?}: {}\n{said}\n{complaint}",
        output.status
    ))
}
