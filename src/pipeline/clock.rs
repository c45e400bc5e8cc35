//! Wall times of the stages of a run.

use std::sync::Mutex;
use std::time::Instant;

use super::Progress;
use super::run::StageTime;
use crate::geom::ColorImage;
use crate::texinit::{Observer, Stage};
use crate::texsmooth::{self, StepProgress};

/// Notes when each stage begins, and passes it on to whoever watches.
pub struct StageClock<'a> {
    progress: &'a dyn Progress,
    noted: Mutex<Noted>,
}

#[derive(Default)]
struct Noted {
    done: Vec<StageTime>,
    running: Option<(&'static str, Instant)>,
}

impl Noted {
    fn end(&mut self) {
        if let Some((name, begun)) = self.running.take() {
            let seconds = begun.elapsed().as_secs_f64();
            self.done.push(StageTime { name, seconds });
        }
    }
}

impl<'a> StageClock<'a> {
    /// Tells `progress` of every stage.
    pub fn new(progress: &'a dyn Progress) -> Self {
        Self {
            progress,
            noted: Mutex::default(),
        }
    }

    /// A stage begins, and the one before it has ended; 0 steps means that their number is unknown.
    pub fn begin(&self, name: &'static str, num_steps: usize) {
        if let Ok(mut noted) = self.noted.lock() {
            noted.end();
            noted.running = Some((name, Instant::now()));
        }
        self.progress.begin(name, num_steps as u64);
    }

    /// Some steps of the running stage are done.
    pub fn advance(&self, num_steps: usize) {
        self.progress.advance(num_steps as u64);
    }

    /// The stages that ran, in order.
    pub fn finish(self) -> Vec<StageTime> {
        match self.noted.into_inner() {
            Ok(mut noted) => {
                noted.end();
                noted.done
            }
            Err(_) => Vec::new(),
        }
    }
}

impl Observer for StageClock<'_> {
    fn begin(&self, stage: Stage, num_steps: usize) {
        self.begin(stage.name(), num_steps);
    }

    fn advance(&self, num_steps: usize) {
        self.advance(num_steps);
    }
}

impl texsmooth::Observer for StageClock<'_> {
    fn step(&self, progress: &StepProgress) {
        self.advance(1);
        self.progress.losses(progress);
    }

    fn preview(&self, num_done: usize, image: &ColorImage) {
        self.progress.preview(num_done, image);
    }

    fn checkpoint(&self, num_done: usize, bytes: &[u8]) {
        self.progress.checkpoint(num_done, bytes);
    }
}
