//! `sensor_msgs/CompressedImage`: JPEG and PNG colour, and depth as `compressedDepth`.
//!
//! `compressed_depth_image_transport` puts 12 bytes before its PNG or RVL stream: an `int32`
//! (0 = inverse depth), and the floats A and B of depth = A / (q − B), all little endian; for
//! `16UC1` they mean nothing. Its `format` is `"<encoding>; compressedDepth png"` or `… rvl`, in
//! older releases `"<encoding>; compressedDepth"` or just `"<encoding>"`, both PNG. The plain
//! `compressed` transport of a depth image is a PNG without the 12 bytes; both are read.

use std::borrow::Cow;
use std::sync::Arc;

use crate::geom::{ColorEncoding, DepthEncoding, EncodedColor, EncodedDepth, ImageError};

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, schema};

/// `sensor_msgs/CompressedImage`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompressedImage<'a> {
    /// Stamp and optical frame.
    pub header: WireHeader<'a>,
    /// What `data` is, in the words of the transport that wrote it.
    pub format: Cow<'a, str>,
    /// The file or stream.
    pub data: Cow<'a, [u8]>,
}

impl<'a> Message<'a> for CompressedImage<'a> {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/CompressedImage";
    const SCHEMA: &'static str = schema::COMPRESSED_IMAGE;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            format: Cow::Borrowed(reader.string("format")?),
            data: Cow::Borrowed(reader.bytes("data")?),
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.string(&self.format);
        writer.bytes(&self.data);
    }
}

/// Bytes of the transport's own header.
const CONFIG_BYTES: usize = 12;
const PNG_MAGIC: &[u8] = b"\x89PNG";

impl<'a> CompressedImage<'a> {
    /// Whether `format` names a depth image.
    pub fn is_depth(&self) -> bool {
        self.format.contains("compressedDepth") || is_depth_encoding(self.source_encoding())
    }

    /// The encoding before compression, as far as `format` says.
    fn source_encoding(&self) -> &str {
        self.format.split(';').next().unwrap_or("").trim()
    }

    /// As a colour image; the file's own bytes tell JPEG from PNG.
    ///
    /// # Errors
    /// [`WireError::Image`] when the data is neither, or is cut off.
    pub fn to_color(&self) -> Result<EncodedColor, WireError> {
        if self.is_depth() {
            return Err(ImageError::Encoding(self.format.as_ref().to_owned()).into());
        }
        Ok(EncodedColor::from_file(Arc::from(self.data.as_ref()))?)
    }

    /// As a depth image.
    ///
    /// # Errors
    /// [`WireError::Image`] when the format is unknown or the data does not fit it.
    pub fn to_depth(&self) -> Result<EncodedDepth, WireError> {
        let unknown = || ImageError::Encoding(self.format.as_ref().to_owned());
        let (encoding, transport) = match self.format.split_once(';') {
            Some((encoding, transport)) => (encoding.trim(), transport.trim()),
            None => (self.format.trim(), ""),
        };
        if !is_depth_encoding(encoding) {
            return Err(unknown().into());
        }
        let is_inverse = encoding == "32FC1";
        let is_rvl = match transport {
            "compressedDepth rvl" => true,
            "" | "compressedDepth" | "compressedDepth png" => false,
            plain if plain.starts_with("png") => false,
            _ => return Err(unknown().into()),
        };
        // RVL is never written without the header; a PNG shows by its first bytes.
        let (config, stream) = if !is_rvl && self.data.starts_with(PNG_MAGIC) {
            (None, self.data.as_ref())
        } else {
            let split = self.data.split_first_chunk::<CONFIG_BYTES>();
            let (config, stream) = split.ok_or_else(|| ImageError::Codec {
                codec: "compressedDepth",
                reason: format!("{} bytes are too few for its header", self.data.len()),
            })?;
            (Some(config), stream)
        };
        let depth_encoding = match (is_inverse, is_rvl, config) {
            (false, true, _) => DepthEncoding::RvlMm,
            (false, false, _) => DepthEncoding::Png16Mm,
            (true, _, None) => return Err(unknown().into()),
            (true, is_rvl, Some(config)) => {
                let [a, b] = quantisation(config)?;
                if is_rvl {
                    DepthEncoding::RvlInverse { a, b }
                } else {
                    DepthEncoding::Png16Inverse { a, b }
                }
            }
        };
        Ok(EncodedDepth::from_compressed(
            depth_encoding,
            Arc::from(stream),
        )?)
    }

    /// The message for a JPEG or PNG file; `None` for raw images, which go as [`super::Image`].
    pub fn from_color(header: WireHeader<'a>, image: &'a EncodedColor) -> Option<Self> {
        let format = match image.encoding() {
            ColorEncoding::Jpeg => "rgb8; jpeg compressed bgr8",
            ColorEncoding::Png => "rgb8; png compressed bgr8",
            _ => return None,
        };
        Some(Self {
            header,
            format: Cow::Borrowed(format),
            data: Cow::Borrowed(image.bytes()),
        })
    }

    /// The message for a compressed depth image; `None` for raw ones, which go as
    /// [`super::Image`].
    pub fn from_depth(header: WireHeader<'a>, image: &EncodedDepth) -> Option<Self> {
        let (format, [a, b]) = match image.encoding() {
            DepthEncoding::Png16Mm => ("16UC1; compressedDepth png", [0.0; 2]),
            DepthEncoding::RvlMm => ("16UC1; compressedDepth rvl", [0.0; 2]),
            DepthEncoding::Png16Inverse { a, b } => ("32FC1; compressedDepth png", [a, b]),
            DepthEncoding::RvlInverse { a, b } => ("32FC1; compressedDepth rvl", [a, b]),
            _ => return None,
        };
        let mut data = Vec::with_capacity(CONFIG_BYTES + image.bytes().len());
        data.extend_from_slice(&0i32.to_le_bytes());
        data.extend_from_slice(&a.to_le_bytes());
        data.extend_from_slice(&b.to_le_bytes());
        data.extend_from_slice(image.bytes());
        Some(Self {
            header,
            format: Cow::Borrowed(format),
            data: Cow::Owned(data),
        })
    }
}

fn is_depth_encoding(name: &str) -> bool {
    super::image::depth_encoding(name, false).is_some()
}

fn quantisation(config: &[u8; CONFIG_BYTES]) -> Result<[f32; 2], WireError> {
    let [_, _, _, _, a0, a1, a2, a3, b0, b1, b2, b3] = *config;
    let a = f32::from_le_bytes([a0, a1, a2, a3]);
    let b = f32::from_le_bytes([b0, b1, b2, b3]);
    if a.is_finite() && a > 0.0 && b.is_finite() {
        return Ok([a, b]);
    }
    Err(WireError::Field {
        field: "data",
        reason: format!("has quantisation A = {a}, B = {b}, which no inverse depth has"),
    })
}
