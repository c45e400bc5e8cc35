//! The thread that paints.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::coverage::Coverage;
use super::{POLL, PaintStatus, Painting, Shared, lock};
use crate::config::Config;
use crate::pipeline::{
    Capture, IdleStep, NoProgress, Painted, Painter, PipelineError, PipelineParams, StreamMode,
};

/// Paints captures as they come, until there are no more.
pub(super) fn paint(shared: &Shared) {
    let mut thread = PaintThread {
        shared,
        painter: Painter::new(&shared.config().pipeline.keyframe),
        begun: None,
        painted_revision: None,
        left_over: None,
        refinable: None,
        is_quiet: false,
        coverage: Coverage::default(),
    };
    while !shared.captures.is_shut() {
        thread.go_on(&shared.config());
    }
}

struct PaintThread<'a> {
    shared: &'a Shared,
    painter: Painter,
    begun: Option<Instant>,
    painted_revision: Option<u64>,
    /// A capture of whose keyframes some wait, and after how many resets it was taken.
    left_over: Option<(u64, Capture)>,
    /// After how many resets that was painted which idle steps may refine.
    refinable: Option<u64>,
    /// Whether no capture came for a while.
    is_quiet: bool,
    coverage: Coverage,
}

impl PaintThread<'_> {
    /// Paints what is to be painted, refines where nothing is, or waits a little for it.
    fn go_on(&mut self, config: &Config) {
        let shared = self.shared;
        let period = Duration::from_secs_f64(config.node.paint_period_s);
        if let Some(left) = self.begun.and_then(|at| period.checked_sub(at.elapsed()))
            && !left.is_zero()
        {
            std::thread::sleep(left.min(POLL));
            return;
        }
        // Of many new keyframes some wait, and come even where nothing else does.
        let waiting = self.left_over.take();
        let waiting = waiting.filter(|(num_resets, _)| *num_resets == shared.num_resets());
        let waiting = waiting.map(|(_, capture)| capture);
        let is_busy = waiting.is_some() || (self.is_quiet && self.can_refine());
        let timeout = if is_busy { Duration::ZERO } else { POLL };
        let has_waiting = waiting.is_some();
        let Some(capture) = shared.captures.take(timeout).or(waiting) else {
            self.is_quiet = true;
            self.refine_some(config);
            return;
        };
        self.is_quiet = false;
        let is_asked_for = shared.retexture.swap(false, Ordering::Relaxed);
        if self.painted_revision != Some(capture.revision) || is_asked_for || has_waiting {
            self.paint(capture, config, is_asked_for);
        }
    }

    fn paint(&mut self, capture: Capture, config: &Config, is_asked_for: bool) {
        let shared = self.shared;
        self.begun = Some(Instant::now());
        self.refinable = None;
        let num_resets = shared.num_resets();
        self.painted_revision = Some(capture.revision);
        lock(&shared.paint_status).is_painting = true;
        let mut params = live_params(config);
        let is_refined = shared.refine.swap(false, Ordering::Relaxed);
        let num_steps = params.texsmooth.num_steps.max(config.node.refine_steps);
        let can_follow = can_follow(&params, num_steps);
        if is_refined && !can_follow {
            params.texsmooth.num_steps = num_steps;
            params.stream_mode = StreamMode::Whole;
        } else if is_asked_for && !is_refined {
            self.painter.take_back_smooth_all();
        }
        let result = self.painter.paint(capture, &params, &NoProgress);
        if is_refined && can_follow && result.is_ok() {
            self.painter.smooth_all(num_steps, &params);
        }
        if let Ok(painted) = &result
            && let Some(update) = &painted.update
        {
            self.refinable = Some(num_resets);
            if update.num_frames_waiting > 0 && shared.num_resets() == num_resets {
                self.left_over = Some((num_resets, painted.capture.clone()));
            }
        }
        self.hand_on(num_resets, result.map(Some));
    }

    /// Whether what was painted last can be refined, and is still wanted.
    fn can_refine(&self) -> bool {
        self.refinable == Some(self.shared.num_resets()) && self.painter.has_idle_work()
    }

    /// An idle step.
    fn refine_some(&mut self, config: &Config) {
        if !self.can_refine() {
            return;
        }
        let num_resets = self.shared.num_resets();
        lock(&self.shared.paint_status).is_painting = true;
        let refined = match self.painter.refine_some(&live_params(config), &NoProgress) {
            Ok(IdleStep::Nothing) => {
                // Painted with other settings: the next painting goes by those of now.
                self.refinable = None;
                Ok(None)
            }
            Ok(IdleStep::Unchanged) => Ok(None),
            Ok(IdleStep::Refined(painted)) => Ok(Some(*painted)),
            Err(error) => Err(error),
        };
        lock(&self.shared.paint_status).num_idle_steps += 1;
        self.hand_on(num_resets, refined);
    }

    /// Notes how it went, and hands on what was made to those who publish it.
    fn hand_on(&mut self, num_resets: u64, result: Result<Option<Painted>, PipelineError>) {
        let shared = self.shared;
        let painted = result.as_ref().ok().and_then(Option::as_ref);
        let coverage = painted.map(|painted| self.coverage.of(&painted.texture));
        let mut status = lock(&shared.paint_status);
        status.is_painting = false;
        status.num_cached_bytes = self.painter.num_cached_bytes();
        [status.num_charts_waiting, status.num_poses_waiting] = self.painter.num_waiting();
        match result {
            Ok(None) => {}
            Ok(Some(painted)) => {
                note(&mut status, &painted, coverage.unwrap_or_default());
                let number = status.num_painted;
                drop(status);
                // What was painted before a reset is of no use to those who asked for it.
                if shared.num_resets() == num_resets {
                    let painting = Arc::new(Painting {
                        session: shared.first_session + num_resets,
                        revision: number,
                        painted,
                    });
                    *lock(&shared.last_painted) = Some(Arc::clone(&painting));
                    shared.painted.put(painting);
                }
            }
            Err(error) => {
                status.num_failed += 1;
                status.last_error = Some(error.to_string());
                tracing::error!("the scan was not painted: {error}");
            }
        }
    }
}

/// The settings for a scan that goes on.
fn live_params(config: &Config) -> PipelineParams {
    config.pipeline.clone().for_live().0
}

/// Whether so many steps of the optimisation can be made of what changes.
fn can_follow(params: &PipelineParams, num_steps: usize) -> bool {
    let mut refined = params.clone();
    refined.texsmooth.num_steps = num_steps;
    refined.follows_changes() && refined.whole_scan_only().is_none()
}

fn note(status: &mut PaintStatus, painted: &Painted, coverage: f32) {
    status.num_painted += 1;
    status.last_error = None;
    status.revision = painted.capture.revision;
    status.memory = painted.memory;
    let update = painted.update.as_ref();
    status.num_frames_waiting = update.map_or(0, |update| update.num_frames_waiting);
    for stage in &painted.stages {
        let entry = status.stages.entry(stage.name).or_default();
        entry.num_runs += 1;
        entry.last_s = stage.seconds;
        entry.sum_s += stage.seconds;
    }
    let texture = &painted.texture;
    status.num_pages = texture.pages.len();
    status.num_charts = painted.layout.charts.len();
    status.coverage = coverage;
}
