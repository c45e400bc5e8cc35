//! Time as integer nanoseconds since the Unix epoch (or since a simulation's start).

use std::fmt;

/// A point in time, in nanoseconds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Stamp(i64);

impl Stamp {
    /// The stamp `nanos` nanoseconds after the epoch.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// The stamp of a ROS `builtin_interfaces/Time`; `nanosec` may exceed one second.
    pub const fn from_ros(sec: i32, nanosec: u32) -> Self {
        Self(sec as i64 * 1_000_000_000 + nanosec as i64)
    }

    /// The stamp nearest to `seconds` after the epoch; saturates at the ends of the range.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "float to int casts saturate, as documented"
    )]
    pub fn from_seconds(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// Nanoseconds since the epoch.
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// Seconds and nanoseconds as ROS writes them; saturates outside the range of `int32` seconds.
    pub fn to_ros(self) -> (i32, u32) {
        let sec = self.0.div_euclid(1_000_000_000);
        let nanosec = u32::try_from(self.0.rem_euclid(1_000_000_000)).unwrap_or(0);
        match i32::try_from(sec) {
            Ok(sec) => (sec, nanosec),
            Err(_) if sec < 0 => (i32::MIN, 0),
            Err(_) => (i32::MAX, 999_999_999),
        }
    }

    /// Signed seconds from `earlier` to `self`.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 * 1e-9
    }

    /// Distance to `other` in nanoseconds, whichever comes first.
    pub const fn abs_diff_nanos(self, other: Self) -> u64 {
        self.0.abs_diff(other.0)
    }
}

impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let nanos = self.0.unsigned_abs();
        write!(
            f,
            "{sign}{}.{:09}",
            nanos / 1_000_000_000,
            nanos % 1_000_000_000
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ros_time_round_trips() {
        for (sec, nanosec) in [(0, 0), (1, 999_999_999), (-1, 500_000_000), (i32::MAX, 7)] {
            assert_eq!(Stamp::from_ros(sec, nanosec).to_ros(), (sec, nanosec));
        }
        assert_eq!(Stamp::from_seconds(1.5), Stamp::from_ros(1, 500_000_000));
        assert_eq!(Stamp::from_nanos(-1).to_string(), "-0.000000001");
    }
}
