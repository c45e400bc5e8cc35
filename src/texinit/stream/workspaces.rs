//! Scratch memory that threads take turns with, kept from update to update: to get it from the system
//! anew takes longer than many an update.

use std::sync::{Mutex, PoisonError};

/// As many as were in use at a time.
#[derive(Debug, Default)]
pub(super) struct Workspaces<T> {
    idle: Mutex<Vec<T>>,
}

impl<T: Default> Workspaces<T> {
    /// Does something with one of them; what another left there must not matter.
    pub(super) fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = idle().pop();
        let mut workspace = taken.unwrap_or_default();
        let done = work(&mut workspace);
        idle().push(workspace);
        done
    }
}
