//! `visualization_msgs/MarkerArray`.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::marker::{self, Marker};
use super::{Message, schema};

/// `visualization_msgs/MarkerArray`.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerArray<'a> {
    /// The markers, applied in order.
    pub markers: Vec<Marker<'a>>,
}

impl<'a> Message<'a> for MarkerArray<'a> {
    const TYPE_NAME: &'static str = "visualization_msgs/msg/MarkerArray";
    const SCHEMA: &'static str = schema::MARKER_ARRAY;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        let markers = reader.sequence("markers", marker::MIN_BYTES, Marker::read)?;
        Ok(Self { markers })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.sequence_len(self.markers.len());
        for marker in &self.markers {
            marker.write(writer);
        }
    }
}
