//! Tells a late message from a clock that was set back.

use crate::geom::Stamp;

/// What a stamp says of its stream's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ClockVerdict {
    /// In order, or late by less than the threshold.
    Running,
    /// Far back; one such message alone is a straggler.
    Straggler,
    /// Far back twice in a row: the clock was set back.
    SetBack,
}

/// Watches the stamps of one stream.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ClockGuard {
    newest: Option<Stamp>,
    was_straggler: bool,
}

impl ClockGuard {
    /// Judges the next stamp; after [`ClockVerdict::SetBack`] the stream starts anew from it.
    pub(super) fn judge(&mut self, stamp: Stamp, jump_back_ns: u64) -> ClockVerdict {
        let Some(newest) = self.newest else {
            self.newest = Some(stamp);
            return ClockVerdict::Running;
        };
        if stamp >= newest || newest.abs_diff_nanos(stamp) <= jump_back_ns {
            self.newest = Some(newest.max(stamp));
            self.was_straggler = false;
            return ClockVerdict::Running;
        }
        if !self.was_straggler {
            self.was_straggler = true;
            return ClockVerdict::Straggler;
        }
        self.newest = Some(stamp);
        self.was_straggler = false;
        ClockVerdict::SetBack
    }
}

/// Whole nanoseconds of a setting in seconds; negative and NaN settings are 0.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to int casts saturate, as documented"
)]
pub(super) fn nanos_from_seconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}
