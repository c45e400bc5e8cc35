//! From a stream of messages to posed, synchronised frames (L4).
//!
//! [`Assembler`] is the whole stage: it takes [`TimedEvent`]s in the order of arrival and gives
//! [`PosedFrame`](crate::geom::PosedFrame)s and meshes in one world frame. It has no I/O and no
//! clock of its own, so that a bag and a live node run the same code.

pub mod assembler;
mod clock;
pub mod event;
mod info_match;
pub mod mesh_blocks;
pub mod mesh_buffer;
pub mod params;
pub mod pose_buffer;
mod pose_lookup;
pub mod report;
pub mod source;
pub mod sync;

pub use assembler::{Assembled, Assembler};
pub use event::{CorrectedBody, Event, Header, MeshUpdate, PoseCorrection};
pub use mesh_blocks::{MeshBlockSpan, MeshBlocks, MeshBlocksError};
pub use params::{IngestLimits, IngestParams, PoseSource, ReportLimits};
pub use report::IngestReport;
pub use source::{EventSource, Rejection, TimedEvent};
