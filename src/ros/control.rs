//! What services do: everything that a peer may ask of the running node, without the transport.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ros2_client::parameters::raw;

use crate::config::Config;

use super::engine::{Engine, Shared};
use super::files::{self, FileError};
use super::lifecycle::{State, Transition};
use super::output::OutputState;
use super::parameters;

/// What a service answers: what was done, or why not.
pub(super) type Answer = Result<String, String>;

/// The node, as services see it.
pub(super) struct Control {
    pub(super) shared: Arc<Shared>,
    engine: Engine,
    output: Arc<OutputState>,
    state: Mutex<State>,
    is_paused: AtomicBool,
}

impl Control {
    pub(super) fn new(shared: Arc<Shared>, engine: Engine, output: Arc<OutputState>) -> Self {
        Self {
            shared,
            engine,
            output,
            state: Mutex::new(State::Unconfigured),
            is_paused: AtomicBool::new(false),
        }
    }

    fn lock_state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The lifecycle's state.
    pub(super) fn state(&self) -> State {
        *self.lock_state()
    }

    /// Whether frames are left out at a user's wish.
    pub(super) fn is_paused(&self) -> bool {
        self.is_paused.load(Ordering::Relaxed)
    }

    /// Does a transition; where it led from and to, or `None` where it does not start here.
    pub(super) fn change(&self, transition: Transition) -> Option<(State, State)> {
        let mut state = self.lock_state();
        let (start, goal) = (*state, transition.goal(*state)?);
        if transition == Transition::Cleanup {
            self.engine.reset()?;
        }
        *state = goal;
        drop(state);
        if transition == Transition::Configure
            && let Some(reason) = self.shared.why_whole()
        {
            tracing::warn!("the whole scan is painted at every change: {reason}");
        }
        self.apply();
        tracing::info!(
            "{}: {} → {}",
            transition.label(),
            start.label(),
            goal.label()
        );
        Some((start, goal))
    }

    /// Opens or shuts what state and pause say.
    fn apply(&self) {
        let is_active = self.state() == State::Active;
        self.shared.inbox.set_open(is_active && !self.is_paused());
        self.output.set_active(is_active);
    }

    pub(super) fn pause(&self, is_paused: bool) -> Answer {
        let was_paused = self.is_paused.swap(is_paused, Ordering::Relaxed);
        self.apply();
        Ok(match (was_paused, is_paused) {
            (true, true) => "was paused already",
            (false, false) => "was not paused",
            (false, true) => "paused: messages are dropped and counted",
            (true, false) => "resumed",
        }
        .to_owned())
    }

    pub(super) fn reset(&self) -> Answer {
        self.engine.reset().ok_or("the node is stopping")?;
        Ok("the scan is forgotten".to_owned())
    }

    /// Paints again all that there is, refined by the optimisation or not.
    pub(super) fn paint(&self, is_refined: bool) -> Answer {
        let capture = self.engine.capture().ok_or("the node is stopping")?;
        if !capture.is_paintable() {
            let words = match &capture.mesh {
                None => "no mesh has come",
                Some(_) if capture.keyframes.is_empty() => "no frame was kept",
                Some(_) => "the mesh has no triangle",
            };
            return Err(format!("there is nothing to paint: {words}"));
        }
        let words = format!(
            "painting {} frames, revision {}",
            capture.keyframes.len(),
            capture.revision
        );
        self.shared.paint_again(capture, is_refined);
        Ok(words)
    }

    pub(super) fn save(&self, path: &str) -> Answer {
        self.try_save(path).map_err(|error| error.to_string())
    }

    fn try_save(&self, path: &str) -> Result<String, FileError> {
        let config = self.shared.config();
        let place = files::confined(&config.node, path)?;
        let stopping = FileError::Nothing("the node is stopping");
        if files::needs_painting(&place)? {
            let painted = self.shared.last_painted();
            let painted = painted.ok_or(FileError::Nothing("nothing was painted yet"))?;
            files::save_painting(&place, &painted.painted, &config.export)
        } else {
            let capture = self.engine.capture().ok_or(stopping)?;
            files::save_session(&place, &capture)
        }
    }

    pub(super) fn load(&self, path: &str) -> Answer {
        let config = self.shared.config();
        let loaded = files::confined(&config.node, path)
            .and_then(|place: PathBuf| Ok((files::load_session(&place)?, place)));
        let (session, place) = loaded.map_err(|error| error.to_string())?;
        let num_items = session.num_items();
        self.engine.load(session).ok_or("the node is stopping")?;
        Ok(format!(
            "{num_items} frames and meshes from {}",
            place.display()
        ))
    }

    /// Sets parameters one by one, or all or none; what to tell of each, and those that were set.
    pub(super) fn set_parameters(
        &self,
        wanted: &[raw::Parameter],
        is_atomic: bool,
    ) -> (Vec<Result<(), String>>, Vec<raw::Parameter>) {
        let mut config = self.shared.config();
        let before = config.clone();
        let mut results = Vec::new();
        let mut changed = Vec::new();
        let max_names = before.node.limits.request_names;
        for (at, parameter) in wanted.iter().enumerate() {
            let result = if at < max_names {
                parameters::set(&mut config, parameter)
            } else {
                Err(format!("a request may set {max_names} parameters"))
            };
            if result.is_ok() {
                changed.push(parameter.clone());
            }
            results.push(result);
        }
        if is_atomic && results.iter().any(Result::is_err) {
            return (results, Vec::new());
        }
        self.shared.set_config(config);
        let config = self.shared.config();
        self.take_config(&before, &config, &changed);
        (results, changed)
    }

    fn take_config(&self, before: &Config, after: &Config, changed: &[raw::Parameter]) {
        if before.node.publish_rate_mb != after.node.publish_rate_mb {
            self.output.set_rate(after.node.publish_rate_mb * 1e6);
        }
        if changed.iter().any(|p| parameters::repaints(&p.name))
            && let Err(reason) = self.paint(false)
        {
            tracing::debug!("set, and not painted: {reason}");
        }
    }
}
