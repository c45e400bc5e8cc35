//! The node's time: the system's, or `/clock`'s under `use_sim_time`.
//!
//! ros2-client subscribes to `/clock` with another type than ROS publishes, so simulated time
//! never reaches it; this clock is fed by a subscription of our own.

use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};

use crate::geom::Stamp;
use crate::wire::{CdrReader, WireError};

/// `rosgraph_msgs/msg/Clock`.
pub(super) const CLOCK_TYPE: &str = "rosgraph_msgs/msg/Clock";

/// Tells the time.
#[derive(Debug, Default)]
pub struct RosClock {
    is_simulated: AtomicBool,
    simulated_ns: AtomicI64,
}

impl RosClock {
    /// A clock that follows `/clock`, or the system.
    pub fn new(is_simulated: bool) -> Self {
        Self {
            is_simulated: AtomicBool::new(is_simulated),
            simulated_ns: AtomicI64::new(0),
        }
    }

    /// Whether it follows `/clock`.
    pub fn is_simulated(&self) -> bool {
        self.is_simulated.load(Ordering::Relaxed)
    }

    /// Now. Simulated time is 0 until the first message on `/clock`.
    pub fn now(&self) -> Stamp {
        if self.is_simulated() {
            Stamp::from_nanos(self.simulated_ns.load(Ordering::Relaxed))
        } else {
            Stamp::from_nanos(ros2_client::SystemTime::now().to_nanos())
        }
    }

    /// Whether it tells a time: under simulated time, whether `/clock` was heard.
    pub fn is_running(&self) -> bool {
        !self.is_simulated() || self.simulated_ns.load(Ordering::Relaxed) != 0
    }

    /// Takes a serialised `rosgraph_msgs/Clock`.
    ///
    /// # Errors
    /// [`WireError`] where it is none.
    pub fn take(&self, message: &[u8]) -> Result<(), WireError> {
        let mut reader = CdrReader::new(CLOCK_TYPE, message)?;
        let (sec, nanosec) = (reader.scalar("clock.sec")?, reader.scalar("clock.nanosec")?);
        let stamp = Stamp::from_ros(sec, nanosec);
        self.simulated_ns.store(stamp.as_nanos(), Ordering::Relaxed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::CdrWriter;

    #[test]
    fn simulated_time_is_what_the_last_message_said() {
        let clock = RosClock::new(true);
        assert!(!clock.is_running());
        let mut writer = CdrWriter::little_endian();
        writer.scalar(12_i32);
        writer.scalar(5_u32);
        clock.take(&writer.into_bytes()).unwrap();
        assert_eq!(clock.now(), Stamp::from_ros(12, 5));
        assert!(clock.take(&[0, 1, 0, 0, 1]).is_err());
        assert_eq!(clock.now(), Stamp::from_ros(12, 5));
        assert!(clock.is_running());
    }

    #[test]
    fn system_time_needs_no_message() {
        let clock = RosClock::new(false);
        assert!(clock.is_running());
        assert!(clock.now() > Stamp::from_seconds(1.6e9));
    }
}
