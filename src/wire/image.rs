//! `sensor_msgs/Image`: raw colour and depth images.

use std::sync::Arc;

use crate::geom::{ColorEncoding, DepthEncoding, EncodedColor, EncodedDepth, ImageError};

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, schema};

/// `sensor_msgs/Image`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Image<'a> {
    /// Stamp and optical frame.
    pub header: WireHeader<'a>,
    /// Height in pixels.
    pub height: u32,
    /// Width in pixels.
    pub width: u32,
    /// Name of the encoding.
    pub encoding: &'a str,
    /// Whether multi-byte pixels are big endian.
    pub is_bigendian: bool,
    /// Bytes from one row to the next.
    pub step: u32,
    /// The pixels.
    pub data: &'a [u8],
}

impl<'a> Message<'a> for Image<'a> {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/Image";
    const SCHEMA: &'static str = schema::IMAGE;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            height: reader.scalar("height")?,
            width: reader.scalar("width")?,
            encoding: reader.string("encoding")?,
            is_bigendian: reader.bool("is_bigendian")?,
            step: reader.scalar("step")?,
            data: reader.bytes("data")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.scalar(self.height);
        writer.scalar(self.width);
        writer.string(self.encoding);
        writer.bool(self.is_bigendian);
        writer.scalar(self.step);
        writer.bytes(self.data);
    }
}

/// The depth encoding that ROS calls `name` (REP-118, and `mono16` as older drivers have it).
pub(super) fn depth_encoding(name: &str, big_endian: bool) -> Option<DepthEncoding> {
    match name {
        "16UC1" | "mono16" => Some(DepthEncoding::U16Mm { big_endian }),
        "32FC1" => Some(DepthEncoding::F32M { big_endian }),
        _ => None,
    }
}

impl<'a> Image<'a> {
    /// As a colour image.
    ///
    /// # Errors
    /// [`WireError::Image`] when the encoding is not a colour one, or size, step and data do not
    /// go together.
    pub fn to_color(&self) -> Result<EncodedColor, WireError> {
        let encoding = ColorEncoding::from_ros_name(self.encoding)
            .ok_or_else(|| ImageError::Encoding(self.encoding.to_owned()))?;
        Ok(EncodedColor::from_raw(
            encoding,
            self.width,
            self.height,
            self.step,
            Arc::from(self.data),
        )?)
    }

    /// As a depth image.
    ///
    /// # Errors
    /// [`WireError::Image`] when the encoding is not a depth one, or size, step and data do not
    /// go together.
    pub fn to_depth(&self) -> Result<EncodedDepth, WireError> {
        let encoding = depth_encoding(self.encoding, self.is_bigendian)
            .ok_or_else(|| ImageError::Encoding(self.encoding.to_owned()))?;
        Ok(EncodedDepth::from_raw(
            encoding,
            self.width,
            self.height,
            self.step,
            Arc::from(self.data),
        )?)
    }

    /// The message for a raw colour image; `None` for image files, which go as
    /// [`super::CompressedImage`].
    pub fn from_color(header: WireHeader<'a>, image: &'a EncodedColor) -> Option<Self> {
        Some(Self {
            header,
            height: image.height(),
            width: image.width(),
            encoding: image.encoding().ros_name()?,
            is_bigendian: false,
            step: image.row_bytes(),
            data: image.bytes(),
        })
    }

    /// The message for a raw depth image; `None` for compressed ones, which go as
    /// [`super::CompressedImage`].
    pub fn from_depth(header: WireHeader<'a>, image: &'a EncodedDepth) -> Option<Self> {
        let (encoding, is_bigendian) = match image.encoding() {
            DepthEncoding::U16Mm { big_endian } => ("16UC1", big_endian),
            DepthEncoding::F32M { big_endian } => ("32FC1", big_endian),
            _ => return None,
        };
        Some(Self {
            header,
            height: image.height(),
            width: image.width(),
            encoding,
            is_bigendian,
            step: image.row_bytes(),
            data: image.bytes(),
        })
    }
}
