//! Saving and loading, within one folder.
//!
//! The ending says what: `.mcap` a session, which is a journal of the kept frames at their poses and
//! of the mesh, and can be loaded (to the bit) or replayed; `.glb`, `.obj`, `.ply` the textured mesh.
//! Other recordings are loaded too, their frames selected anew. Paths come from peers: they are
//! relative, go down only, and pass no link.

use std::path::{Component, Path, PathBuf};

use crate::bag::journal::{self, Found, Journal, JournalError, PathDisk};
use crate::bag::{BagError, BagReader, TopicRoles};
use crate::config::NodeParams;
use crate::export::{
    EncodedPages, ExportError, ExportParams, TexturedMesh, glb, write_all, write_atomic,
};
use crate::ingest::{Assembled, Assembler, EventSource, IngestParams};
use crate::pipeline::{Capture, EarlierScan, Painted};

use super::journal::{earlier_scan, scan_state};

/// Why nothing was saved or loaded.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// No folder is set.
    #[error("no folder is set to save in or load from: set the parameter save.folder")]
    NoFolder,
    /// The path leads elsewhere, or nowhere.
    #[error("'{path}' {reason}")]
    Path {
        /// As given.
        path: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// There is nothing to save yet.
    #[error("there is nothing to save: {0}")]
    Nothing(&'static str),
    /// The system refused a file.
    #[error("{path}: {source}")]
    System {
        /// Which file.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// The session could not be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The session could not be written or read.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The textured mesh could not be written.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// The session holds nothing to paint.
    #[error("the session lacks {0}")]
    Incomplete(String),
}

/// What a path's ending stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Session,
    Glb,
    Obj,
    Ply,
}

/// A file below `save.folder`. Its own folder is made where it is not there.
///
/// # Errors
/// [`FileError::Path`] for a path that is not relative, goes up, passes a link, or is longer than
/// `limits.path_bytes`.
pub fn confined(node: &NodeParams, path: &str) -> Result<PathBuf, FileError> {
    let (folder, max_bytes) = (node.save_folder.as_deref(), node.limits.path_bytes);
    let refuse = |reason| {
        Err(FileError::Path {
            path: path.chars().take(max_bytes).collect(),
            reason,
        })
    };
    let Some(folder) = folder else {
        return Err(FileError::NoFolder);
    };
    if path.is_empty() || path.len() > max_bytes || path.contains('\0') {
        return refuse("is empty, or too long");
    }
    let parts: Vec<_> = Path::new(path).components().collect();
    if !parts
        .iter()
        .all(|part| matches!(part, Component::Normal(_)))
    {
        return refuse("must be relative to save.folder and go down only");
    }
    let system = |path: &Path| {
        let path = path.to_owned();
        move |source| FileError::System { path, source }
    };
    std::fs::create_dir_all(folder).map_err(system(Path::new(folder)))?;
    let mut place = PathBuf::from(folder);
    for (i, part) in parts.iter().enumerate() {
        place.push(part);
        match std::fs::symlink_metadata(&place) {
            Ok(found) if found.file_type().is_symlink() => {
                return refuse("passes a link");
            }
            Ok(found) if i + 1 < parts.len() && !found.is_dir() => {
                return refuse("passes a file as if it were a folder");
            }
            Ok(_) => {}
            Err(_) if i + 1 < parts.len() => {
                std::fs::create_dir(&place).map_err(system(&place))?;
            }
            Err(_) => {}
        }
    }
    Ok(place)
}

fn kind(path: &Path) -> Option<Kind> {
    let ending = path.extension()?.to_str()?.to_ascii_lowercase();
    match ending.as_str() {
        "mcap" => Some(Kind::Session),
        "glb" => Some(Kind::Glb),
        "obj" => Some(Kind::Obj),
        "ply" => Some(Kind::Ply),
        _ => None,
    }
}

/// Whether saving to `path` needs a painting.
///
/// # Errors
/// [`FileError::Path`] for an ending that stands for nothing.
pub fn needs_painting(path: &Path) -> Result<bool, FileError> {
    match kind(path) {
        Some(kind) => Ok(kind != Kind::Session),
        None => Err(FileError::Path {
            path: path.display().to_string(),
            reason: "ends in none of .mcap (session), .glb, .obj, .ply",
        }),
    }
}

/// Writes the kept frames at their poses, and the mesh; what was done, in words. The file appears
/// under its name when it is complete.
///
/// # Errors
/// [`FileError`].
pub fn save_session(path: &Path, capture: &Capture) -> Result<String, FileError> {
    if capture.keyframes.is_empty() && capture.mesh.is_none() {
        return Err(FileError::Nothing("no frame was kept and no mesh came"));
    }
    // Renaming over a device would replace the device, over a folder fail after all the work.
    if std::fs::metadata(path).is_ok_and(|there| !there.is_file()) {
        return Err(FileError::Path {
            path: path.display().to_string(),
            reason: "is there already, and is no file to be replaced",
        });
    }
    let num_bytes = journal::save(Box::new(PathDisk::new(path)), &scan_state(capture, 0))?;
    Ok(format!(
        "{} frames, {num_bytes} bytes, to {}",
        capture.keyframes.len(),
        path.display()
    ))
}

/// Writes the textured mesh in the form that the path's ending stands for; what was done, in words.
///
/// # Errors
/// [`FileError`].
pub fn save_painting(
    path: &Path,
    painted: &Painted,
    params: &ExportParams,
) -> Result<String, FileError> {
    let textured = TexturedMesh::new(&painted.mesh, &painted.layout, &painted.texture)?;
    let kind = kind(path);
    if kind == Some(Kind::Glb) {
        let pages = EncodedPages::encode(&painted.texture, params.glb_pages)?;
        let (name, normals) = (&params.name, params.normals);
        write_atomic(path, |out| {
            glb::write(&textured, &pages, name, normals, out)
        })
        .map_err(ExportError::from)?;
        return Ok(path.display().to_string());
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    let stem = path.file_stem().and_then(|stem| stem.to_str());
    let params = ExportParams {
        name: stem.unwrap_or("scan").to_owned(),
        glb: false,
        obj: kind == Some(Kind::Obj),
        ply: kind == Some(Kind::Ply),
        provenance: false,
        ..params.clone()
    };
    let summary = write_all(&textured, folder, &params)?;
    let files: Vec<_> = summary
        .files
        .iter()
        .map(|f| f.display().to_string())
        .collect();
    Ok(format!("{} in {}", files.join(", "), folder.display()))
}

/// What a session holds.
#[derive(Debug)]
pub enum Session {
    /// A scan as it was.
    Exact(EarlierScan),
    /// A recording.
    Recorded {
        /// Frames at their poses, and the mesh.
        assembled: Vec<Assembled>,
        /// The frame that they are in.
        world_frame: Option<String>,
    },
}

impl Session {
    /// Frames and meshes in it.
    pub fn num_items(&self) -> usize {
        match self {
            Self::Exact(scan) => scan.keyframes.len() + usize::from(scan.mesh.is_some()),
            Self::Recorded { assembled, .. } => assembled.len(),
        }
    }
}

/// Reads a session. It is in one world frame and has its own transforms, so it is put together
/// apart from what the node listens to.
///
/// # Errors
/// [`FileError`]; a session that is damaged gives what is whole, and the damage goes to the log.
pub fn load_session(path: &Path) -> Result<Session, FileError> {
    if kind(path) != Some(Kind::Session) {
        return Err(FileError::Path {
            path: path.display().to_string(),
            reason: "is no session (.mcap)",
        });
    }
    match Journal::resume(Box::new(PathDisk::new(path))) {
        Ok(Found::Scan(found)) => {
            for loss in &found.losses {
                tracing::warn!("{loss}");
            }
            Ok(Session::Exact(earlier_scan(found.state)))
        }
        // What is no journal may be another recording, or says why it is none.
        Ok(Found::Nothing(_)) | Err(JournalError::NotAJournal { .. }) => load_recording(path),
        Err(error) => Err(error.into()),
    }
}

fn load_recording(path: &Path) -> Result<Session, FileError> {
    let mut bag = BagReader::open(path, &TopicRoles::default())?;
    if let Some(missing) = bag.plan().missing.first() {
        return Err(FileError::Incomplete(missing.role.name().to_owned()));
    }
    let params = IngestParams::default();
    let mut assembler = Assembler::new(&params, bag.topics());
    let mut assembled = Vec::new();
    while let Some(event) = bag.next_event() {
        assembler.push(event, &mut assembled);
    }
    assembler.finish(&mut assembled);
    Ok(Session::Recorded {
        assembled,
        world_frame: assembler.report().world_frame.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(folder: &Path) -> NodeParams {
        NodeParams {
            save_folder: folder.to_str().map(str::to_owned),
            ..NodeParams::default()
        }
    }

    #[test]
    fn paths_stay_in_their_folder() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("saves");
        let mut node = node(&folder);
        let inside = confined(&node, "a/b/scan.mcap").unwrap();
        assert_eq!(inside, folder.join("a/b/scan.mcap"));
        assert!(folder.join("a/b").is_dir());
        for outside in [
            "",
            "/etc/passwd",
            "../x.mcap",
            "a/../../x",
            "a/./../..",
            "./../x",
            "a\0b",
        ] {
            let refused = confined(&node, outside);
            assert!(refused.is_err(), "{outside:?}: {refused:?}");
        }
        node.limits.path_bytes = 5;
        assert!(confined(&node, "xyzw.mcap").is_err());
        node.save_folder = None;
        assert!(matches!(
            confined(&node, "x.mcap"),
            Err(FileError::NoFolder)
        ));
    }

    #[cfg(unix)]
    #[test]
    fn links_lead_nowhere() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("saves");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(dir.path().join("secret.mcap"), b"x").unwrap();
        std::os::unix::fs::symlink(dir.path(), folder.join("up")).unwrap();
        let link = folder.join("scan.mcap");
        std::os::unix::fs::symlink(dir.path().join("secret.mcap"), link).unwrap();
        for path in ["up/secret.mcap", "scan.mcap"] {
            let refused = confined(&node(&folder), path);
            assert!(refused.is_err(), "{path}: {refused:?}");
        }
    }

    #[test]
    fn endings_say_what_is_saved() {
        assert!(!needs_painting(Path::new("a.mcap")).unwrap());
        assert!(needs_painting(Path::new("a.GLB")).unwrap());
        assert!(needs_painting(Path::new("a.exe")).is_err());
        assert!(needs_painting(Path::new("mcap")).is_err());
    }
}
