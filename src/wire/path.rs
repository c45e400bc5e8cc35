//! `nav_msgs/Path`: poses along a path, as loop closers publish them.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::geometry::WirePose;
use super::header::{self, WireHeader};
use super::pose_stamped::PoseStamped;
use super::{Message, pose_corrections, schema};
use crate::ingest::{CorrectedBody, Event};

/// `nav_msgs/Path`.
#[derive(Clone, Debug, PartialEq)]
pub struct Path<'a> {
    /// When it was made, and the frame it is in.
    pub header: WireHeader<'a>,
    /// The poses, each with its own stamp.
    pub poses: Vec<PoseStamped<'a>>,
}

impl Path<'_> {
    /// What it says as corrections, each pose by its own stamp. The poses are in the path's frame, as
    /// ROS has it, whatever their own headers say.
    ///
    /// # Errors
    /// [`WireError::Frame`] for a pose that is none.
    pub fn to_event(&self) -> Result<Event, WireError> {
        let poses = self.poses.iter().map(|p| (p.header.stamp, p.pose));
        pose_corrections::event(&self.header, CorrectedBody::PoseFrame, poses, "poses.pose")
    }
}

const MIN_POSE_BYTES: usize = header::MIN_BYTES + WirePose::NUM_BYTES;

impl<'a> Message<'a> for Path<'a> {
    const TYPE_NAME: &'static str = "nav_msgs/msg/Path";
    const SCHEMA: &'static str = schema::PATH;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            poses: reader.sequence("poses", MIN_POSE_BYTES, PoseStamped::read)?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.sequence_len(self.poses.len());
        self.poses.iter().for_each(|pose| pose.write(writer));
    }
}
