//! `nav_msgs/Odometry`.

use crate::ingest::event::StampedTransform;

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::geometry::WirePose;
use super::header::{WireHeader, frame_name};
use super::{Message, schema};

/// `nav_msgs/Odometry`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Odometry<'a> {
    /// Stamp, and the frame the pose is given in.
    pub header: WireHeader<'a>,
    /// The frame whose pose it is.
    pub child_frame_id: &'a str,
    /// The pose.
    pub pose: WirePose,
    /// Row-major 6×6 over x, y, z and the rotations about them.
    pub pose_covariance: [f64; 36],
    /// Velocity in the child frame: linear m/s, then angular rad/s.
    pub twist: [f64; 6],
    /// Row-major 6×6, as `pose_covariance`.
    pub twist_covariance: [f64; 36],
}

impl<'a> Message<'a> for Odometry<'a> {
    const TYPE_NAME: &'static str = "nav_msgs/msg/Odometry";
    const SCHEMA: &'static str = schema::ODOMETRY;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            child_frame_id: reader.string("child_frame_id")?,
            pose: WirePose::read(reader, "pose.pose.position", "pose.pose.orientation")?,
            pose_covariance: reader.array("pose.covariance")?,
            twist: reader.array("twist.twist")?,
            twist_covariance: reader.array("twist.covariance")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.string(self.child_frame_id);
        self.pose.write(writer);
        writer.array(&self.pose_covariance);
        writer.array(&self.twist);
        writer.array(&self.twist_covariance);
    }
}

impl Odometry<'_> {
    /// Pose of the child frame in the header's frame.
    ///
    /// # Errors
    /// [`WireError::Frame`] when the pose is not one.
    pub fn to_transform(&self) -> Result<StampedTransform, WireError> {
        let parent_from_child = self.pose.to_transform().map_err(|error| WireError::Frame {
            field: "pose.pose".into(),
            error,
        })?;
        Ok(StampedTransform {
            header: self.header.to_header(),
            child_frame_id: frame_name(self.child_frame_id).into(),
            parent_from_child,
        })
    }
}
