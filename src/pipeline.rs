//! The only place that knows the whole order: from a source of events to a textured mesh (L5).
//!
//! [`run()`] takes every event of a source: frames go to the keyframe store, the mesh replaces the
//! one before it. At the end of the stream the mesh is welded, some keyframes are held back,
//! TexInit paints the mesh from the others, and the held-back ones are compared with its
//! rendering. The result depends on the events alone, not on time or threads.

mod clock;
mod held_out;
pub mod progress;
pub mod run;

pub use held_out::{HeldOutParams, HeldOutView};
pub use progress::{NoProgress, Progress};
pub use run::{PipelineError, PipelineParams, Run, StageTime, run};
