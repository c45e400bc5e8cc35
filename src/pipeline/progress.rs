//! How a run tells an observer where it is.

use crate::geom::ColorImage;
use crate::texsmooth::StepProgress;

/// Told of stages and steps, from any thread; must not influence the run.
pub trait Progress: Sync {
    /// A stage begins and the one before it has ended; 0 steps means that their number is unknown.
    fn begin(&self, stage: &str, num_steps: u64);
    /// Some steps of the running stage are done.
    fn advance(&self, num_steps: u64);
    /// The losses of the optimisation, after each of its steps.
    fn losses(&self, _progress: &StepProgress) {}
    /// A photo, and beside it its rendering as the optimisation has it now.
    fn preview(&self, _num_steps: usize, _image: &ColorImage) {}
    /// The optimisation's state, to go on from.
    fn checkpoint(&self, _num_steps: usize, _bytes: &[u8]) {}
}

/// Tells nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn begin(&self, _stage: &str, _num_steps: u64) {}
    fn advance(&self, _num_steps: u64) {}
}
