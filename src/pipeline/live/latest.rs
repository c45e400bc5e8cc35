//! A slot for one value: a newer one takes the place of one that was not taken.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// See the module.
#[derive(Debug)]
pub struct Latest<T> {
    state: Mutex<State<T>>,
    changed: Condvar,
}

#[derive(Debug)]
struct State<T> {
    value: Option<T>,
    num_replaced: u64,
    is_last: bool,
    is_shut: bool,
}

impl<T> Default for Latest<T> {
    fn default() -> Self {
        Self {
            state: Mutex::new(State {
                value: None,
                num_replaced: 0,
                is_last: false,
                is_shut: false,
            }),
            changed: Condvar::new(),
        }
    }
}

impl<T> Latest<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        // The slot is whole after every step, so a panic elsewhere leaves it usable.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts a value in; one that was not taken goes, and is counted.
    pub fn put(&self, value: T) {
        let mut state = self.lock();
        state.num_replaced += u64::from(state.value.replace(value).is_some());
        drop(state);
        self.changed.notify_all();
    }

    /// Takes the value, waited for until `timeout`; `None` when there is none, or after
    /// [`Self::shut`].
    pub fn take(&self, timeout: Duration) -> Option<T> {
        let deadline = Instant::now() + timeout;
        let mut state = self.lock();
        loop {
            if state.is_shut {
                return None;
            }
            if let Some(value) = state.value.take() {
                return Some(value);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() || state.is_last {
                return None;
            }
            let waited = self.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Whether a value waits.
    pub fn is_full(&self) -> bool {
        self.lock().value.is_some()
    }

    /// Values that a newer one replaced before they were taken.
    pub fn num_replaced(&self) -> u64 {
        self.lock().num_replaced
    }

    /// No value comes any more: takers get the one that is there, and wait for no other.
    pub fn end(&self) {
        self.lock().is_last = true;
        self.changed.notify_all();
    }

    /// Whether [`Self::end`] was called and nothing is left to be taken.
    pub fn has_ended(&self) -> bool {
        let state = self.lock();
        state.is_last && state.value.is_none()
    }

    /// Empties the slot for good; takers are let go.
    pub fn shut(&self) {
        let mut state = self.lock();
        state.is_shut = true;
        state.value = None;
        drop(state);
        self.changed.notify_all();
    }

    /// Whether [`Self::shut`] was called.
    pub fn is_shut(&self) -> bool {
        self.lock().is_shut
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn the_latest_wins_and_the_others_are_counted() {
        let slot = Latest::default();
        for value in 0..5 {
            slot.put(value);
        }
        assert_eq!(slot.num_replaced(), 4);
        assert_eq!(slot.take(Duration::ZERO), Some(4));
        assert_eq!(slot.take(Duration::ZERO), None);
    }

    #[test]
    fn a_taker_waits_for_a_value_and_is_let_go_at_the_end() {
        let slot = Arc::new(Latest::default());
        let taker = std::thread::spawn({
            let slot = Arc::clone(&slot);
            move || {
                let first = slot.take(Duration::from_secs(60));
                (first, slot.take(Duration::from_secs(60)))
            }
        });
        slot.put(7);
        while slot.is_full() {
            std::thread::yield_now();
        }
        slot.shut();
        assert_eq!(taker.join().unwrap(), (Some(7), None));
        slot.put(8);
        assert_eq!(slot.take(Duration::from_secs(60)), None);
    }

    #[test]
    fn the_last_value_is_taken_before_the_end() {
        let slot = Latest::default();
        slot.put(1);
        slot.end();
        assert!(!slot.has_ended());
        assert_eq!(slot.take(Duration::from_secs(60)), Some(1));
        assert!(slot.has_ended());
        assert_eq!(slot.take(Duration::from_secs(60)), None);
    }
}
