//! Why a journal is not written or read.

use std::io::{self, ErrorKind};
use std::path::PathBuf;

use super::JournalDisk;

/// Why a journal is not written or read.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The disk refused.
    #[error("cannot {action} {}: {error}", path.display())]
    Io {
        /// The journal.
        path: PathBuf,
        /// What was being done to it.
        action: &'static str,
        /// The system's words.
        error: io::Error,
    },
    /// The file is something else, which is not to be overwritten.
    #[error("{} is there and is no journal of veneer: it was left as it is", path.display())]
    NotAJournal {
        /// The file.
        path: PathBuf,
    },
    /// The file holds a scan that this process has not resumed.
    #[error("{} holds another scan: it was left as it is", path.display())]
    IsThere {
        /// The file.
        path: PathBuf,
    },
    /// A mesh or an image is larger than what would be read again.
    #[error("{}: a step of {num_bytes} bytes is larger than a journal takes", path.display())]
    TooLarge {
        /// The journal.
        path: PathBuf,
        /// Its size.
        num_bytes: u64,
    },
}

impl JournalError {
    pub(super) fn io(disk: &dyn JournalDisk, action: &'static str, error: io::Error) -> Self {
        Self::Io {
            path: disk.path().to_owned(),
            action,
            error,
        }
    }

    /// Whether another process holds the journal.
    pub fn is_held(&self) -> bool {
        matches!(self, Self::Io { error, .. } if error.kind() == ErrorKind::WouldBlock)
    }

    /// What a user can do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Io { error, .. } => match error.kind() {
                ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::WriteZero => {
                    "free some space there; what is missing is written as soon as it fits"
                }
                ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
                    "let this user write there, or set keyframe.journal_path"
                }
                ErrorKind::NotFound | ErrorKind::NotADirectory => {
                    "make the folder, or set keyframe.journal_path"
                }
                ErrorKind::WouldBlock => {
                    "end that process, or give each node a keyframe.journal_path of its own"
                }
                _ => "look at the system's log and at the disk",
            },
            Self::NotAJournal { .. } | Self::IsThere { .. } => {
                "move that file away, or set keyframe.journal_path"
            }
            Self::TooLarge { .. } => "cut the mesh into regions, or use smaller images",
        }
    }
}
