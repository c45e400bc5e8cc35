//! MCAP bags as rosbag2 writes them: a source of events, and a writer (L7).
//!
//! Profile `ros2`, schemas `ros2msg`, messages `cdr`; chunked or not, none, lz4 or zstd. Reading
//! is memory-mapped and in the order of log times; what a damaged or cut-off bag still holds is
//! read, and the loss is told in words.

mod chunk;
pub mod error;
mod index;
pub mod info;
pub mod journal;
mod mapped;
mod peek;
pub mod reader;
mod record;
pub mod roles;
pub mod scan_writer;
pub mod writer;

pub use error::BagError;
pub use info::BagInfo;
pub use mapped::metadata;
pub use reader::BagReader;
pub use roles::{MissingRole, TopicAssignment, TopicPlan, TopicRoles};
pub use writer::{BagSummary, BagWriter, ChannelId, Compression, partial_path};

#[cfg(test)]
mod tests;
