//! Virtual environments for the oracles that live on PyPI.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The Python of a virtual environment with `packages` (pip requirements), made under the test
/// binary's scratch folder at first use and kept. `None`, with a line that says why, where there
/// is no Python or the package index cannot be reached.
pub(crate) fn venv(name: &str, packages: &[&str]) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("venv")
        .join(name);
    let python = folder.join("bin/python");
    let wanted = packages.join("\n");
    let stamp = folder.join("installed.txt");
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Some(python);
    }
    let made = run(Command::new("python3").args(["-m", "venv"]).arg(&folder));
    let installed = made.and_then(|()| {
        run(Command::new(&python)
            .args([
                "-m",
                "pip",
                "install",
                "--quiet",
                "--disable-pip-version-check",
            ])
            .args(packages))
    });
    if let Err(reason) = installed {
        println!("SKIPPED: no Python environment with {packages:?}: {reason}");
        return None;
    }
    std::fs::write(&stamp, wanted).unwrap();
    Some(python)
}

fn run(command: &mut Command) -> Result<(), String> {
    let output = command.output().map_err(|e| e.to_string())?;
    if output.status.success() {
        Ok(())
    } else {
        Err(String::from_utf8_lossy(&output.stderr).trim().to_owned())
    }
}
