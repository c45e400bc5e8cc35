//! `diagnostic_msgs/DiagnosticArray`.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, schema};

/// `level` of a part that works.
pub const OK: u8 = 0;
/// `level` of a part that works, but not as it should.
pub const WARN: u8 = 1;
/// `level` of a part that does not work.
pub const ERROR: u8 = 2;
/// `level` of a part that no longer reports.
pub const STALE: u8 = 3;

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct DiagnosticStatus<'a> {
    /// [`OK`], [`WARN`], [`ERROR`] or [`STALE`].
    pub level: u8,
    /// The part of the node.
    pub name: &'a str,
    /// What is wrong, and the remedy.
    pub message: &'a str,
    /// The hardware.
    pub hardware_id: &'a str,
    /// Names and values.
    pub values: Vec<(&'a str, &'a str)>,
}

/// `diagnostic_msgs/DiagnosticArray`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DiagnosticArray<'a> {
    /// When this was so.
    pub header: WireHeader<'a>,
    /// Part by part.
    pub status: Vec<DiagnosticStatus<'a>>,
}

/// A byte, three empty strings and an empty sequence.
const MIN_STATUS_BYTES: usize = 17;
const MIN_VALUE_BYTES: usize = 8;

impl<'a> Message<'a> for DiagnosticArray<'a> {
    const TYPE_NAME: &'static str = "diagnostic_msgs/msg/DiagnosticArray";
    const SCHEMA: &'static str = schema::DIAGNOSTIC_ARRAY;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            status: reader.sequence("status", MIN_STATUS_BYTES, |reader| {
                Ok(DiagnosticStatus {
                    level: reader.scalar("status.level")?,
                    name: reader.string("status.name")?,
                    message: reader.string("status.message")?,
                    hardware_id: reader.string("status.hardware_id")?,
                    values: reader.sequence("status.values", MIN_VALUE_BYTES, |reader| {
                        Ok((
                            reader.string("status.values.key")?,
                            reader.string("status.values.value")?,
                        ))
                    })?,
                })
            })?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.sequence_len(self.status.len());
        for status in &self.status {
            writer.scalar(status.level);
            writer.string(status.name);
            writer.string(status.message);
            writer.string(status.hardware_id);
            writer.sequence_len(status.values.len());
            for (key, value) in &status.values {
                writer.string(key);
                writer.string(value);
            }
        }
    }
}
