//! Why a bag could not be opened or written.

use std::path::PathBuf;

/// Why a bag could not be opened or written.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// A file could not be opened, mapped, written or renamed.
    #[error("{}: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's words.
        error: std::io::Error,
    },
    /// The file is not an MCAP bag.
    #[error("{}: {reason}", path.display())]
    NotABag {
        /// The file.
        path: PathBuf,
        /// What it is instead, as far as that shows.
        reason: String,
    },
    /// A topic that was asked for is not there, or cannot play its role.
    #[error("topic {topic} for {role}: {reason}")]
    Topic {
        /// The topic's name.
        topic: String,
        /// The role it was named for.
        role: &'static str,
        /// What is wrong, and what there is instead.
        reason: String,
    },
    /// A record could not be written.
    #[error("bag not written: {0}")]
    Write(#[from] mcap::McapError),
}
