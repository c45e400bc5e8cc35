//! Why a message was refused.

use crate::geom::{CameraError, FrameError, ImageError};
use crate::mesh::MeshError;

/// Why a message was refused. Offsets count from the start of the serialised message.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WireError {
    /// The encapsulation header is missing or is not plain CDR.
    #[error("{message}: encapsulation header {header:02x?} is not plain CDR (00 00 or 00 01)")]
    Encapsulation {
        /// Type of the message.
        message: &'static str,
        /// The first bytes, at most 4.
        header: Vec<u8>,
    },
    /// The message ends inside a field.
    #[error(
        "{message}.{field} at byte {offset} needs {num_elements} x {element_bytes} bytes, {available} are left"
    )]
    Truncated {
        /// Type of the message.
        message: &'static str,
        /// Which field.
        field: &'static str,
        /// Where the field starts.
        offset: usize,
        /// How many elements it says it has.
        num_elements: usize,
        /// Smallest size of one of them.
        element_bytes: usize,
        /// Bytes left in the message.
        available: usize,
    },
    /// A string is not UTF-8, or does not end with its NUL.
    #[error("{message}.{field} at byte {offset} is not a NUL-terminated UTF-8 string")]
    String {
        /// Type of the message.
        message: &'static str,
        /// Which field.
        field: &'static str,
        /// Where the field starts.
        offset: usize,
    },
    /// A field has a value that cannot be used.
    #[error("{field} {reason}")]
    Field {
        /// Which field.
        field: &'static str,
        /// Its value and what is wrong with it.
        reason: String,
    },
    /// An image cannot be used.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A camera cannot be used.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A transform cannot be used.
    #[error("{field}: {error}")]
    Frame {
        /// Which transform.
        field: String,
        /// What is wrong with it.
        error: FrameError,
    },
    /// A mesh cannot be used.
    #[error("{block}: {error}")]
    Mesh {
        /// Which block or marker.
        block: String,
        /// What is wrong with it.
        error: MeshError,
    },
}
