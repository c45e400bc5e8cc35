//! `rosgraph_msgs/Clock`: simulated time.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header;
use super::{Message, schema};
use crate::geom::Stamp;

/// `rosgraph_msgs/Clock`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    /// Now.
    pub clock: Stamp,
}

impl Message<'_> for Clock {
    const TYPE_NAME: &'static str = "rosgraph_msgs/msg/Clock";
    const SCHEMA: &'static str = schema::CLOCK;

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, WireError> {
        let clock = header::read_time(reader, "clock.sec", "clock.nanosec")?;
        Ok(Self { clock })
    }

    fn write(&self, writer: &mut CdrWriter) {
        header::write_time(writer, self.clock);
    }
}
