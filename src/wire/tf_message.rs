//! `tf2_msgs/TFMessage`.

use crate::ingest::event::StampedTransform;

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::geometry::WirePose;
use super::header::{self, WireHeader, frame_name};
use super::{Message, schema};

/// `geometry_msgs/TransformStamped`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransformStamped<'a> {
    /// Stamp and parent frame.
    pub header: WireHeader<'a>,
    /// The child frame.
    pub child_frame_id: &'a str,
    /// Pose of the child in the parent.
    pub transform: WirePose,
}

/// `tf2_msgs/TFMessage`.
#[derive(Clone, Debug, PartialEq)]
pub struct TfMessage<'a> {
    /// The transforms.
    pub transforms: Vec<TransformStamped<'a>>,
}

impl<'a> Message<'a> for TfMessage<'a> {
    const TYPE_NAME: &'static str = "tf2_msgs/msg/TFMessage";
    const SCHEMA: &'static str = schema::TF_MESSAGE;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        let min_bytes = header::MIN_BYTES + 4 + WirePose::NUM_BYTES;
        let transforms = reader.sequence("transforms", min_bytes, |reader| {
            Ok(TransformStamped {
                header: WireHeader::read(reader)?,
                child_frame_id: reader.string("transforms.child_frame_id")?,
                transform: WirePose::read(
                    reader,
                    "transforms.transform.translation",
                    "transforms.transform.rotation",
                )?,
            })
        })?;
        Ok(Self { transforms })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.sequence_len(self.transforms.len());
        for transform in &self.transforms {
            transform.header.write(writer);
            writer.string(transform.child_frame_id);
            transform.transform.write(writer);
        }
    }
}

impl TfMessage<'_> {
    /// The transforms that are valid, and why the others are not.
    pub fn to_transforms(&self) -> (Vec<StampedTransform>, Vec<WireError>) {
        let mut valid = Vec::with_capacity(self.transforms.len());
        let mut refused = Vec::new();
        for t in &self.transforms {
            match t.transform.to_transform() {
                Ok(parent_from_child) => valid.push(StampedTransform {
                    header: t.header.to_header(),
                    child_frame_id: frame_name(t.child_frame_id).into(),
                    parent_from_child,
                }),
                Err(error) => refused.push(WireError::Frame {
                    field: format!("transform {} -> {}", t.header.frame_id, t.child_frame_id),
                    error,
                }),
            }
        }
        (valid, refused)
    }
}
