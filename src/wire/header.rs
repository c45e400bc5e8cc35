//! `std_msgs/Header`.

use crate::geom::Stamp;
use crate::ingest::Header;

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;

/// `std_msgs/Header`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct WireHeader<'a> {
    /// When the data was taken.
    pub stamp: Stamp,
    /// The frame the data is in.
    pub frame_id: &'a str,
}

/// Smallest size of a header in a message: time and the length of the frame's name.
pub(super) const MIN_BYTES: usize = 12;

/// A `builtin_interfaces/Time` of the fields of these names.
pub(super) fn read_time(
    reader: &mut CdrReader<'_>,
    sec: &'static str,
    nanosec: &'static str,
) -> Result<Stamp, WireError> {
    let sec = reader.scalar(sec)?;
    Ok(Stamp::from_ros(sec, reader.scalar(nanosec)?))
}

/// A `builtin_interfaces/Time`.
pub(super) fn write_time(writer: &mut CdrWriter, stamp: Stamp) {
    let (sec, nanosec) = stamp.to_ros();
    writer.scalar(sec);
    writer.scalar(nanosec);
}

impl<'a> WireHeader<'a> {
    pub(super) fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            stamp: read_time(reader, "header.stamp.sec", "header.stamp.nanosec")?,
            frame_id: reader.string("header.frame_id")?,
        })
    }

    pub(super) fn write(&self, writer: &mut CdrWriter) {
        write_time(writer, self.stamp);
        writer.string(self.frame_id);
    }

    /// Our own header. A leading slash, as ROS 1 wrote it, is not part of a frame's name.
    pub fn to_header(&self) -> Header {
        Header {
            stamp: self.stamp,
            frame_id: frame_name(self.frame_id).into(),
        }
    }
}

impl<'a> From<&'a Header> for WireHeader<'a> {
    fn from(header: &'a Header) -> Self {
        Self {
            stamp: header.stamp,
            frame_id: &header.frame_id,
        }
    }
}

/// The name of a frame without the leading slash of ROS 1.
pub(super) fn frame_name(frame_id: &str) -> &str {
    frame_id.strip_prefix('/').unwrap_or(frame_id)
}
