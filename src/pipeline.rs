//! The only place that knows the whole order: from a source of events to a textured mesh (L5).
//!
//! [`gather()`] takes every event of a source: frames go to the keyframe store, the mesh replaces
//! the one before it and is welded at the end of the stream. [`texture_scan()`] paints the mesh
//! from some of the keyframes. [`run()`] does both, with some keyframes held back that are then
//! compared with the rendering. [`live`] does the same while the scan goes on, and [`mod@stream`] paints
//! only what changed meanwhile. The result depends on the events alone, not on time or threads.

mod clock;
mod held_out;
pub mod live;
pub mod memory;
mod pose_noise;
mod pose_rounds;
pub mod progress;
pub mod refine;
pub mod region;
pub mod run;
pub mod scan;
pub mod stream;
pub mod texture;

pub use clock::StageClock;
pub use held_out::{HeldOutParams, HeldOutView};
pub use live::{Capture, EarlierScan, IdleStep, Latest, LiveScan, Painted, Painter};
pub use memory::{MemoryParams, MemoryPlan};
pub use pose_noise::with_pose_noise;
pub use pose_rounds::PoseReport;
pub use progress::{NoProgress, Progress};
pub use refine::{RefineParams, RefineReport};
pub use region::RegionParams;
pub use run::{PipelineError, PipelineParams, Run, StageTime, run};
pub use scan::{Scan, gather};
pub use stream::idle::{IdleParams, StreamMode};
pub use stream::{StreamPainter, Streamed, UpdateSummary, run_streamed, stream};
pub use texture::{Textured, texture_scan};
