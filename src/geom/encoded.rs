//! Images as they were recorded: kept encoded, decoded on demand.
//!
//! A value that exists has a usable size, rows long enough for it, and bytes for every row; a
//! JPEG or PNG file is complete as far as its markers tell. What only decoding can tell (a broken
//! entropy stream) is an error of `decode`.

use std::sync::Arc;

use super::file_header::{self, PngHeader};
use super::image::{ColorImage, DepthImage, ImageError};
use super::{file_codec, pixel_format, rvl};

/// How the bytes of a colour image are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColorEncoding {
    /// A JPEG file.
    Jpeg,
    /// A PNG file.
    Png,
    /// 3 bytes a pixel: red, green, blue.
    Rgb8,
    /// 3 bytes a pixel: blue, green, red.
    Bgr8,
    /// 4 bytes a pixel: red, green, blue, alpha.
    Rgba8,
    /// 4 bytes a pixel: blue, green, red, alpha.
    Bgra8,
    /// 1 byte a pixel.
    Mono8,
    /// Bayer mosaic whose first 2×2 block reads R G / G B.
    BayerRggb8,
    /// Bayer mosaic whose first 2×2 block reads B G / G R.
    BayerBggr8,
    /// Bayer mosaic whose first 2×2 block reads G B / R G.
    BayerGbrg8,
    /// Bayer mosaic whose first 2×2 block reads G R / B G.
    BayerGrbg8,
    /// 4:2:2, bytes Y0 U Y1 V for two pixels (`yuv422_yuy2`).
    Yuv422Yuy2,
    /// 4:2:0, a plane of Y, then a half-size plane of interleaved U and V.
    Nv12,
}

impl ColorEncoding {
    /// Raw encodings under their names in `sensor_msgs/image_encodings.hpp`.
    const ROS_NAMES: [(&'static str, Self); 11] = [
        ("rgb8", Self::Rgb8),
        ("bgr8", Self::Bgr8),
        ("rgba8", Self::Rgba8),
        ("bgra8", Self::Bgra8),
        ("mono8", Self::Mono8),
        ("bayer_rggb8", Self::BayerRggb8),
        ("bayer_bggr8", Self::BayerBggr8),
        ("bayer_gbrg8", Self::BayerGbrg8),
        ("bayer_grbg8", Self::BayerGrbg8),
        ("yuv422_yuy2", Self::Yuv422Yuy2),
        ("nv12", Self::Nv12),
    ];

    /// The raw encoding that ROS calls `name`; OpenCV's type names for 8-bit images count as the
    /// colour order that `cv_bridge` gives them.
    pub fn from_ros_name(name: &str) -> Option<Self> {
        let name = match name {
            "8UC1" => "mono8",
            "8UC3" => "bgr8",
            "8UC4" => "bgra8",
            "yuyv" | "YUY2" => "yuv422_yuy2",
            "NV12" => "nv12",
            other => other,
        };
        let found = Self::ROS_NAMES.iter().find(|(ros, _)| *ros == name);
        found.map(|&(_, encoding)| encoding)
    }

    /// ROS's name of a raw encoding; `None` for image files.
    pub fn ros_name(self) -> Option<&'static str> {
        let found = Self::ROS_NAMES.iter().find(|(_, e)| *e == self);
        found.map(|&(name, _)| name)
    }

    /// Whether the bytes are an image file, whose rows have no fixed length.
    pub fn is_file(self) -> bool {
        matches!(self, Self::Jpeg | Self::Png)
    }
}

/// How the bytes of a depth image are laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DepthEncoding {
    /// `16UC1`: millimetres, 0 = no measurement.
    U16Mm {
        /// Byte order of the pixels.
        big_endian: bool,
    },
    /// `32FC1`: metres, NaN = no measurement.
    F32M {
        /// Byte order of the pixels.
        big_endian: bool,
    },
    /// 16-bit grey PNG file of millimetres.
    Png16Mm,
    /// RVL stream (Wilson 2017) of millimetres, behind its `cols`, `rows` words.
    RvlMm,
    /// 16-bit grey PNG file of inverse depth: depth_m = a / (q − b), q = 0 no measurement.
    Png16Inverse {
        /// Quantisation parameter A of compressedDepth.
        a: f32,
        /// Quantisation parameter B of compressedDepth.
        b: f32,
    },
    /// RVL stream of inverse depth, as [`Self::Png16Inverse`].
    RvlInverse {
        /// Quantisation parameter A of compressedDepth.
        a: f32,
        /// Quantisation parameter B of compressedDepth.
        b: f32,
    },
}

impl DepthEncoding {
    /// Whether the pixels lie there uncompressed, row by row.
    pub fn is_raw(self) -> bool {
        matches!(self, Self::U16Mm { .. } | Self::F32M { .. })
    }
}

/// A colour image in the encoding it came in.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedColor {
    encoding: ColorEncoding,
    width: u32,
    height: u32,
    row_bytes: u32,
    bytes: Arc<[u8]>,
}

impl EncodedColor {
    /// A raw image whose rows start `row_bytes` apart (`step` in ROS). The last row may end
    /// without its padding.
    ///
    /// # Errors
    /// [`ImageError`] when the encoding is a file's, the size is unusable (odd sides where the
    /// encoding pairs pixels among them), or rows or bytes are too few for it.
    pub fn from_raw(
        encoding: ColorEncoding,
        width: u32,
        height: u32,
        row_bytes: u32,
        bytes: Arc<[u8]>,
    ) -> Result<Self, ImageError> {
        if encoding.is_file() {
            return Err(ImageError::Encoding(format!("{encoding:?} as a raw image")));
        }
        let layout = pixel_format::raw_layout(encoding, width, height)
            .ok_or(ImageError::Size { width, height })?;
        check_rows([width, height], row_bytes, layout, bytes.len())?;
        Ok(Self {
            encoding,
            width,
            height,
            row_bytes,
            bytes,
        })
    }

    /// A JPEG or PNG file, told apart by its first bytes; size from its header.
    ///
    /// # Errors
    /// [`ImageError`] when it is neither, its header is broken, it is cut off, or its size is
    /// unusable.
    pub fn from_file(bytes: Arc<[u8]>) -> Result<Self, ImageError> {
        let (encoding, [width, height]) = if file_header::is_png(&bytes) {
            let PngHeader { size, .. } = file_header::png_header(&bytes)?;
            (ColorEncoding::Png, size)
        } else if file_header::is_jpeg(&bytes) {
            (ColorEncoding::Jpeg, file_header::jpeg_size(&bytes)?)
        } else {
            let start: Vec<u8> = bytes.iter().copied().take(8).collect();
            return Err(ImageError::Encoding(format!(
                "a file of {} bytes that starts with {start:02x?}, neither JPEG nor PNG",
                bytes.len()
            )));
        };
        super::image::check_decoded_size(width, height)?;
        Ok(Self {
            encoding,
            width,
            height,
            row_bytes: 0,
            bytes,
        })
    }

    /// The decoded image: sRGB; alpha dropped, grey spread over the channels, Bayer mosaics
    /// interpolated ([`super::bayer`]), YUV as BT.601 with the limited ("studio") range that
    /// OpenCV, and so `cv_bridge`, assumes.
    ///
    /// # Errors
    /// [`ImageError::Codec`] when the file does not decode.
    pub fn decode(&self) -> Result<ColorImage, ImageError> {
        let size = [self.width, self.height];
        let pixels = match self.encoding {
            ColorEncoding::Jpeg => file_codec::decode_jpeg(&self.bytes, size)?,
            ColorEncoding::Png => file_codec::decode_png_rgb(&self.bytes, size)?,
            raw => pixel_format::decode_raw(raw, size, self.row_bytes as usize, &self.bytes),
        };
        ColorImage::new(self.width, self.height, pixels)
    }

    /// The same pixels in a compressed file: itself where it is a file, else a PNG (the same
    /// bytes on every machine).
    ///
    /// # Errors
    /// [`ImageError::Codec`] when the encoder fails.
    pub fn compressed_lossless(&self) -> Result<Self, ImageError> {
        if self.encoding.is_file() {
            return Ok(self.clone());
        }
        let size = [self.width, self.height];
        let num_bytes = self.width as usize * self.height as usize * 3;
        // Pixels that lie there as the encoder wants them need no copy.
        let has_padding = self.row_bytes as usize != self.width as usize * 3;
        let file = match self.bytes.get(..num_bytes) {
            Some(rgb) if self.encoding == ColorEncoding::Rgb8 && !has_padding => {
                file_codec::encode_photo_png(size, rgb)?
            }
            _ => file_codec::encode_photo_png(size, self.decode()?.pixels().as_flattened())?,
        };
        Ok(Self::png(size, file))
    }

    /// A PNG of a decoded image.
    ///
    /// # Errors
    /// [`ImageError::Codec`] when the encoder fails.
    pub fn png_from_image(image: &ColorImage) -> Result<Self, ImageError> {
        let size = [image.width(), image.height()];
        let bytes = file_codec::encode_png(
            size,
            image.pixels().as_flattened(),
            png::ColorType::Rgb,
            png::BitDepth::Eight,
        )?;
        Ok(Self::png(size, bytes))
    }

    fn png([width, height]: [u32; 2], file: Vec<u8>) -> Self {
        Self {
            encoding: ColorEncoding::Png,
            width,
            height,
            row_bytes: 0,
            bytes: file.into(),
        }
    }

    /// How the bytes are laid out.
    pub fn encoding(&self) -> ColorEncoding {
        self.encoding
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Bytes from one row to the next; 0 for image files.
    pub fn row_bytes(&self) -> u32 {
        self.row_bytes
    }

    /// The bytes as recorded.
    pub fn bytes(&self) -> &Arc<[u8]> {
        &self.bytes
    }
}

/// A depth image in the encoding it came in.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedDepth {
    encoding: DepthEncoding,
    width: u32,
    height: u32,
    row_bytes: u32,
    bytes: Arc<[u8]>,
}

impl EncodedDepth {
    /// A raw image (`16UC1`, `32FC1`) whose rows start `row_bytes` apart.
    ///
    /// # Errors
    /// [`ImageError`] when the encoding is a compressed one, the size is unusable, or rows or
    /// bytes are too few for it.
    pub fn from_raw(
        encoding: DepthEncoding,
        width: u32,
        height: u32,
        row_bytes: u32,
        bytes: Arc<[u8]>,
    ) -> Result<Self, ImageError> {
        let bytes_per_px = match encoding {
            DepthEncoding::U16Mm { .. } => 2,
            DepthEncoding::F32M { .. } => 4,
            other => {
                return Err(ImageError::Encoding(format!(
                    "{other:?} as a raw depth image"
                )));
            }
        };
        let layout = pixel_format::RawLayout {
            min_row_bytes: width as usize * bytes_per_px,
            num_rows: height as usize,
        };
        check_rows([width, height], row_bytes, layout, bytes.len())?;
        Ok(Self {
            encoding,
            width,
            height,
            row_bytes,
            bytes,
        })
    }

    /// A compressed image: a 16-bit grey PNG file, or RVL behind its `cols`, `rows` words.
    ///
    /// # Errors
    /// [`ImageError`] when the encoding is a raw one, the header is broken, or the size unusable.
    pub fn from_compressed(encoding: DepthEncoding, bytes: Arc<[u8]>) -> Result<Self, ImageError> {
        let [width, height] = match encoding {
            DepthEncoding::Png16Mm | DepthEncoding::Png16Inverse { .. } => {
                file_header::png_header(&bytes)?.grey16_size()?
            }
            DepthEncoding::RvlMm | DepthEncoding::RvlInverse { .. } => rvl::size(&bytes)?,
            raw => {
                return Err(ImageError::Encoding(format!(
                    "{raw:?} as a compressed depth image"
                )));
            }
        };
        super::image::check_decoded_size(width, height)?;
        Ok(Self {
            encoding,
            width,
            height,
            row_bytes: 0,
            bytes,
        })
    }

    /// A PNG of millimetres, 0 = no measurement.
    ///
    /// # Errors
    /// [`ImageError`] when the size is unusable or `depth_mm` does not match it.
    pub fn png_from_u16_mm(width: u32, height: u32, depth_mm: &[u16]) -> Result<Self, ImageError> {
        super::image::check_length(width, height, depth_mm.len())?;
        let big_endian: Vec<u8> = depth_mm.iter().flat_map(|mm| mm.to_be_bytes()).collect();
        let bytes = file_codec::encode_png(
            [width, height],
            &big_endian,
            png::ColorType::Grayscale,
            png::BitDepth::Sixteen,
        )?;
        Self::from_compressed(DepthEncoding::Png16Mm, bytes.into())
    }

    /// An RVL stream of millimetres, 0 = no measurement.
    ///
    /// # Errors
    /// [`ImageError`] when the size is unusable or `depth_mm` does not match it.
    pub fn rvl_from_u16_mm(width: u32, height: u32, depth_mm: &[u16]) -> Result<Self, ImageError> {
        super::image::check_length(width, height, depth_mm.len())?;
        let bytes = rvl::encode([width, height], depth_mm);
        Self::from_compressed(DepthEncoding::RvlMm, bytes.into())
    }

    /// The decoded image in metres; 0 = no measurement.
    ///
    /// # Errors
    /// [`ImageError::Codec`] when the file or stream does not decode.
    pub fn decode(&self) -> Result<DepthImage, ImageError> {
        let row_bytes = self.row_bytes as usize;
        let size = [self.width, self.height];
        let in_mm = |mm| DepthImage::from_mm(self.width, self.height, mm);
        let in_m = |depth_m| DepthImage::new(self.width, self.height, depth_m);
        match self.encoding {
            DepthEncoding::U16Mm { big_endian } => in_mm(pixel_format::u16_rows(
                size,
                row_bytes,
                &self.bytes,
                big_endian,
            )),
            DepthEncoding::F32M { big_endian } => in_m(pixel_format::f32_rows(
                size,
                row_bytes,
                &self.bytes,
                big_endian,
            )),
            DepthEncoding::Png16Mm | DepthEncoding::RvlMm => in_mm(self.quantised()?),
            DepthEncoding::Png16Inverse { a, b } | DepthEncoding::RvlInverse { a, b } => {
                in_m(metres_from_inverse(&self.quantised()?, a, b))
            }
        }
    }

    fn quantised(&self) -> Result<Vec<u16>, ImageError> {
        match self.encoding {
            DepthEncoding::RvlMm | DepthEncoding::RvlInverse { .. } => rvl::decode(&self.bytes),
            _ => file_codec::decode_png_grey16(&self.bytes, [self.width, self.height]),
        }
    }

    /// The same pixels compressed: `16UC1` becomes RVL; everything else stays as it is (floats
    /// have no lossless codec here).
    ///
    /// # Errors
    /// [`ImageError`], which cannot happen for a value that exists.
    pub fn compressed_lossless(&self) -> Result<Self, ImageError> {
        let DepthEncoding::U16Mm { big_endian } = self.encoding else {
            return Ok(self.clone());
        };
        let mm = pixel_format::u16_rows(
            [self.width, self.height],
            self.row_bytes as usize,
            &self.bytes,
            big_endian,
        );
        Self::rvl_from_u16_mm(self.width, self.height, &mm)
    }

    /// How the bytes are laid out.
    pub fn encoding(&self) -> DepthEncoding {
        self.encoding
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Bytes from one row to the next; 0 where rows have no fixed length.
    pub fn row_bytes(&self) -> u32 {
        self.row_bytes
    }

    /// The bytes as recorded.
    pub fn bytes(&self) -> &Arc<[u8]> {
        &self.bytes
    }
}

fn metres_from_inverse(quantised: &[u16], a: f32, b: f32) -> Vec<f32> {
    let depth_m = |&q: &u16| match q {
        0 => 0.0,
        q => a / (f32::from(q) - b),
    };
    quantised.iter().map(depth_m).collect()
}

fn check_rows(
    [width, height]: [u32; 2],
    row_bytes: u32,
    layout: pixel_format::RawLayout,
    num_bytes: usize,
) -> Result<(), ImageError> {
    super::image::check_decoded_size(width, height)?;
    let row_bytes = row_bytes as usize;
    if row_bytes < layout.min_row_bytes {
        return Err(ImageError::Row {
            width,
            min_row_bytes: layout.min_row_bytes,
            row_bytes,
        });
    }
    let shortest = row_bytes * (layout.num_rows - 1) + layout.min_row_bytes;
    let expected = row_bytes * layout.num_rows;
    if (shortest..=expected).contains(&num_bytes) {
        return Ok(());
    }
    Err(ImageError::Length {
        width,
        height,
        unit: "bytes",
        expected,
        actual: num_bytes,
    })
}

#[cfg(test)]
mod tests;
