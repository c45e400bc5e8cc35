//! `geometry_msgs/PoseArray`.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::geometry::WirePose;
use super::header::WireHeader;
use super::{Message, schema};

/// `geometry_msgs/PoseArray`.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseArray<'a> {
    /// Stamp, and the frame of the poses.
    pub header: WireHeader<'a>,
    /// The poses.
    pub poses: Vec<WirePose>,
}

impl<'a> Message<'a> for PoseArray<'a> {
    const TYPE_NAME: &'static str = "geometry_msgs/msg/PoseArray";
    const SCHEMA: &'static str = schema::POSE_ARRAY;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            poses: reader.sequence("poses", WirePose::NUM_BYTES, |reader| {
                WirePose::read(reader, "poses.position", "poses.orientation")
            })?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.sequence_len(self.poses.len());
        self.poses.iter().for_each(|pose| pose.write(writer));
    }
}
