//! `geometry_msgs/PoseStamped`.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::geometry::WirePose;
use super::header::WireHeader;
use super::{Message, schema};

/// `geometry_msgs/PoseStamped`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseStamped<'a> {
    /// Stamp, and the frame the pose is given in.
    pub header: WireHeader<'a>,
    /// The pose.
    pub pose: WirePose,
}

impl<'a> Message<'a> for PoseStamped<'a> {
    const TYPE_NAME: &'static str = "geometry_msgs/msg/PoseStamped";
    const SCHEMA: &'static str = schema::POSE_STAMPED;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            pose: WirePose::read(reader, "pose.position", "pose.orientation")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        self.pose.write(writer);
    }
}
