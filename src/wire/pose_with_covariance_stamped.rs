//! `geometry_msgs/PoseWithCovarianceStamped`.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::geometry::WirePose;
use super::header::WireHeader;
use super::{Message, schema};

/// `geometry_msgs/PoseWithCovarianceStamped`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseWithCovarianceStamped<'a> {
    /// Stamp, and the frame the pose is given in.
    pub header: WireHeader<'a>,
    /// The pose.
    pub pose: WirePose,
    /// Row-major 6×6 over x, y, z and the rotations about them.
    pub covariance: [f64; 36],
}

impl<'a> Message<'a> for PoseWithCovarianceStamped<'a> {
    const TYPE_NAME: &'static str = "geometry_msgs/msg/PoseWithCovarianceStamped";
    const SCHEMA: &'static str = schema::POSE_WITH_COVARIANCE_STAMPED;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            pose: WirePose::read(reader, "pose.pose.position", "pose.pose.orientation")?,
            covariance: reader.array("pose.covariance")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        self.pose.write(writer);
        writer.array(&self.covariance);
    }
}
