//! How a run tells an observer where it is.

/// Told of stages and steps, from any thread; must not influence the run.
pub trait Progress: Sync {
    /// A stage begins and the one before it has ended; 0 steps means that their number is unknown.
    fn begin(&self, stage: &str, num_steps: u64);
    /// Some steps of the running stage are done.
    fn advance(&self, num_steps: u64);
}

/// Tells nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn begin(&self, _stage: &str, _num_steps: u64) {}
    fn advance(&self, _num_steps: u64) {}
}
