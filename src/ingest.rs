//! From a stream of messages to posed, synchronised frames (L4).

pub mod event;
pub mod source;

pub use event::{Event, Header, MeshUpdate};
pub use source::{EventSource, Rejection, TimedEvent};
