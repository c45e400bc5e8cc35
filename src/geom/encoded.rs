//! Images as they were recorded: kept encoded, decoded on demand.

use std::sync::Arc;

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

/// A colour image in the encoding it came in.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedColor {
    encoding: ColorEncoding,
    width: u32,
    height: u32,
    row_bytes: u32,
    bytes: Arc<[u8]>,
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
