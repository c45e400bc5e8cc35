//! The live ROS 2 node, in Rust from the wire up (L7).
//!
//! Threads, and what passes between them:
//!
//! ```text
//! DDS ─→ receive ─→ inbox ─→ ingest ─→ Latest<Capture> ─→ paint ─→ Latest<Painted> ─→ publish ─→ DDS
//!        (bytes)  (bounded)  (decode,      (one)                       (one)         (paced)
//!                             select)
//! ```
//!
//! Nothing upstream waits for what is downstream: the inbox drops its oldest, the slots keep their
//! latest, and each drop is counted. Frames are metres and optical frames as everywhere.

pub mod args;
pub mod clock;
mod control;
mod diagnostics;
mod engine;
pub mod env;
pub mod error;
pub mod files;
mod graph;
mod http;
pub mod inbox;
pub mod inputs;
mod journal;
pub mod lifecycle;
mod monitor;
pub mod names;
pub mod node;
pub mod output;
pub mod pacer;
pub mod parameters;
mod receive;
pub mod rosout;
pub mod security;
mod server;
mod service_types;
mod services;
pub mod socket_buffer;
pub mod source;
mod static_peers;
mod status;
pub mod transport;

pub use args::{ArgsError, RosArgs};
pub use env::Network;
pub use error::NodeError;
pub use node::NodeSetup;
