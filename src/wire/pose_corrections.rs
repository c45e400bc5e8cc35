//! `veneer/PoseCorrections`: late poses of past keyframes.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::geometry::WirePose;
use super::header::{self, WireHeader};
use super::{Message, schema};
use crate::geom::Stamp;
use crate::ingest::{self, CorrectedBody, Event};

/// `veneer/PoseCorrection`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseCorrection {
    /// Stamp of the colour image.
    pub stamp: Stamp,
    /// Pose of the colour camera's optical frame in the frame of the corrections.
    pub pose: WirePose,
}

/// `veneer/PoseCorrections`.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseCorrections<'a> {
    /// When the poses were found, and the frame they are in.
    pub header: WireHeader<'a>,
    /// In any order.
    pub corrections: Vec<PoseCorrection>,
}

impl PoseCorrections<'_> {
    /// What it says, poses of the colour camera.
    ///
    /// # Errors
    /// [`WireError::Frame`] for a pose that is none.
    pub fn to_event(&self) -> Result<Event, WireError> {
        let corrections = self.corrections.iter().map(|c| (c.stamp, c.pose));
        event(
            &self.header,
            CorrectedBody::Camera,
            corrections,
            "corrections.pose",
        )
    }
}

/// Corrections of the poses of `body`, in the frame of `header`.
///
/// # Errors
/// [`WireError::Frame`] of `field` for a pose that is none.
pub(super) fn event(
    header: &WireHeader<'_>,
    body: CorrectedBody,
    poses: impl Iterator<Item = (Stamp, WirePose)>,
    field: &'static str,
) -> Result<Event, WireError> {
    let corrections = poses.map(|(stamp, pose)| {
        let pose = pose.to_transform().map_err(|error| WireError::Frame {
            field: field.into(),
            error,
        })?;
        Ok(ingest::PoseCorrection { stamp, pose })
    });
    let corrections = corrections.collect::<Result<_, WireError>>()?;
    Ok(Event::Corrections(header.to_header(), body, corrections))
}

/// Time and pose.
const MIN_BYTES: usize = 8 + WirePose::NUM_BYTES;

impl<'a> Message<'a> for PoseCorrections<'a> {
    const TYPE_NAME: &'static str = "veneer/msg/PoseCorrections";
    const SCHEMA: &'static str = schema::POSE_CORRECTIONS;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            corrections: reader.sequence("corrections", MIN_BYTES, |reader| {
                Ok(PoseCorrection {
                    stamp: header::read_time(
                        reader,
                        "corrections.stamp.sec",
                        "corrections.stamp.nanosec",
                    )?,
                    pose: WirePose::read(
                        reader,
                        "corrections.pose.position",
                        "corrections.pose.orientation",
                    )?,
                })
            })?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.sequence_len(self.corrections.len());
        for correction in &self.corrections {
            header::write_time(writer, correction.stamp);
            correction.pose.write(writer);
        }
    }
}
