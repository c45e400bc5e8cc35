//! Files that appear under their name only when they are complete.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Why a file could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} {}: {source}", path.display())]
pub struct FileError {
    /// What was being done, as in "cannot … the file".
    pub action: &'static str,
    /// The file or folder.
    pub path: PathBuf,
    /// The system's words.
    #[source]
    pub source: io::Error,
}

/// Large enough that an atlas goes out in few system calls, small enough for each of many files.
const BUFFER_BYTES: usize = 256 * 1024;

/// Removes the partial file unless it was given its name.
struct Partial {
    path: PathBuf,
    is_complete: bool,
}

impl Drop for Partial {
    fn drop(&mut self) {
        if !self.is_complete {
            // The reason of the failure is on its way to the caller; this one adds nothing.
            drop(fs::remove_file(&self.path));
        }
    }
}

/// Writes `path` through a buffer and gives it its name when `write` and the flush succeed; until
/// then the bytes are in `.NAME.partial` beside it, which is removed on failure. Missing parent
/// folders are made.
///
/// # Errors
/// [`FileError`] with the path and the system's reason: an unwritable folder, a full disk.
pub fn write_atomic(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), FileError> {
    let failed = |action, path: &Path, source| FileError {
        action,
        path: path.to_owned(),
        source,
    };
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(|e| failed("create folder", folder, e))?;
    }
    let mut partial = Partial {
        path: partial_path(path),
        is_complete: false,
    };
    let file = File::create(&partial.path).map_err(|e| failed("create", path, e))?;
    let mut out = BufWriter::with_capacity(BUFFER_BYTES, file);
    write(&mut out).map_err(|e| failed("write", path, e))?;
    out.flush().map_err(|e| failed("write", path, e))?;
    drop(out);
    fs::rename(&partial.path, path).map_err(|e| failed("rename into place", path, e))?;
    partial.is_complete = true;
    Ok(())
}

/// The files that [`write_atomic`] has under way in an output folder and the folders in it: what a
/// process that is told to stop has to remove.
pub fn partial_files(folder: &Path) -> Vec<PathBuf> {
    let entries = |folder: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).collect()
    };
    let is_partial = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with('.') && name.ends_with(".partial") && path.is_file()
    };
    let top = entries(folder);
    let below = top.iter().filter(|path| path.is_dir());
    let below: Vec<PathBuf> = below.flat_map(|path| entries(path)).collect();
    top.into_iter().chain(below).filter(is_partial).collect()
}

fn partial_path(path: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".partial");
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<OsString> {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_partial_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.glb");
        write_atomic(&path, |out| out.write_all(b"old")).unwrap();
        let error = write_atomic(&path, |out| {
            out.write_all(&[1; 1000])?;
            Err(io::Error::from(io::ErrorKind::StorageFull))
        })
        .unwrap_err();
        assert!(error.to_string().contains("scan.glb"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["scan.glb"]);
    }

    #[test]
    fn files_under_way_are_found_where_they_lie() {
        let folder = tempfile::tempdir().unwrap();
        let page = folder.path().join("atlas/page_0.png");
        write_atomic(&page, |out| {
            let found = partial_files(folder.path());
            assert_eq!(found, [partial_path(&page)]);
            out.write_all(b"whole")
        })
        .unwrap();
        assert!(partial_files(folder.path()).is_empty());
        assert!(page.is_file());
    }

    #[test]
    fn a_file_in_the_way_of_a_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let blocker = folder.path().join("atlas");
        fs::write(&blocker, b"").unwrap();
        let error = write_atomic(&blocker.join("page_0.png"), |_| Ok(())).unwrap_err();
        assert_eq!(error.path, blocker);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error() {
        // /dev/full cannot be renamed over, so only the writer's half is exercised on it.
        let mut out = BufWriter::new(File::create("/dev/full").unwrap());
        out.write_all(b"x").unwrap();
        assert_eq!(out.flush().unwrap_err().kind(), io::ErrorKind::StorageFull);
        drop(out.into_parts());
    }
}
