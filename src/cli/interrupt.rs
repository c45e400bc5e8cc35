//! Ctrl-C and its kin (SIGINT, SIGTERM, SIGHUP): what is half written goes, what is whole stays.

use std::path::PathBuf;

/// What shells report of a command that Ctrl-C ended.
const INTERRUPTED: i32 = 130;

/// From now on, a signal to stop removes the files that `partial_files` names at that moment, and
/// ends the process.
///
/// A process started with one of the signals ignored (`nohup`, a script's background job) keeps
/// ignoring it, and takes the others in the system's way.
pub(super) fn remove_when_interrupted(partial_files: impl Fn() -> Vec<PathBuf> + Send + 'static) {
    let installed = ctrlc::try_set_handler(move || {
        for path in partial_files() {
            // One that was completed or removed meanwhile is no longer there.
            std::fs::remove_file(path).ok();
        }
        std::process::exit(INTERRUPTED);
    });
    if let Err(error) = installed {
        tracing::debug!("signals stay as they were: {error}");
    }
}
