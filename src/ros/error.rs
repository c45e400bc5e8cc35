//! Why the node could not start or go on.

use super::args::ArgsError;
use super::env::EnvError;
use super::names::NameError;
use super::security::SecurityError;

/// Why the node could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The command line.
    #[error(transparent)]
    Args(#[from] ArgsError),
    /// The environment.
    #[error(transparent)]
    Env(#[from] EnvError),
    /// The keys among secured peers.
    #[error(transparent)]
    Security(#[from] SecurityError),
    /// A name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// DDS refused something.
    #[error("{what}: {reason}")]
    Dds {
        /// Which entity.
        what: String,
        /// DDS' own words.
        reason: String,
    },
    /// The system refused a thread, a socket or a file.
    #[error("{what}: {source}")]
    System {
        /// What was to be done.
        what: &'static str,
        /// The system's words.
        source: std::io::Error,
    },
}

impl NodeError {
    pub(super) fn dds(what: &str, reason: &dyn std::fmt::Display) -> Self {
        Self::Dds {
            what: what.to_owned(),
            reason: reason.to_string(),
        }
    }
}
