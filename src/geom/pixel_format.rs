//! Raw pixel layouts: how many bytes they need, and their conversion to RGB or depth.
//!
//! YUV follows OpenCV's `COLOR_YUV2RGB_YUY2` and `COLOR_YUV2RGB_NV12`, which is what `cv_bridge`
//! calls: BT.601, limited range (Y 16–235), fixed point with 20 fractional bits, chroma repeated.

use super::bayer;
use super::encoded::ColorEncoding;

/// What a raw image needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RawLayout {
    pub(crate) min_row_bytes: usize,
    pub(crate) num_rows: usize,
}

/// Layout of a raw encoding; `None` for files, and for sizes the encoding cannot have (it pairs
/// pixels and a side is odd, or it needs neighbours and there are none).
pub(crate) fn raw_layout(encoding: ColorEncoding, width: u32, height: u32) -> Option<RawLayout> {
    let (width, height) = (width as usize, height as usize);
    let even = |n: usize| n.is_multiple_of(2);
    let (min_row_bytes, num_rows) = match encoding {
        ColorEncoding::Jpeg | ColorEncoding::Png => return None,
        ColorEncoding::Rgb8 | ColorEncoding::Bgr8 => (width * 3, height),
        ColorEncoding::Rgba8 | ColorEncoding::Bgra8 => (width * 4, height),
        ColorEncoding::Mono8 => (width, height),
        ColorEncoding::BayerRggb8
        | ColorEncoding::BayerBggr8
        | ColorEncoding::BayerGbrg8
        | ColorEncoding::BayerGrbg8 => (width >= 2 && height >= 2).then_some((width, height))?,
        ColorEncoding::Yuv422Yuy2 => even(width).then_some((width * 2, height))?,
        ColorEncoding::Nv12 => (even(width) && even(height)).then_some((width, height / 2 * 3))?,
    };
    Some(RawLayout {
        min_row_bytes,
        num_rows,
    })
}

/// RGB pixels of a raw image whose layout was checked.
pub(crate) fn decode_raw(
    encoding: ColorEncoding,
    [width, height]: [u32; 2],
    row_bytes: usize,
    bytes: &[u8],
) -> Vec<[u8; 3]> {
    let size = [width as usize, height as usize];
    match encoding {
        ColorEncoding::Bgr8 => per_pixel(size, row_bytes, bytes, |&[b, g, r]: &[u8; 3]| [r, g, b]),
        ColorEncoding::Rgba8 => {
            per_pixel(size, row_bytes, bytes, |&[r, g, b, _]: &[u8; 4]| [r, g, b])
        }
        ColorEncoding::Bgra8 => {
            per_pixel(size, row_bytes, bytes, |&[b, g, r, _]: &[u8; 4]| [r, g, b])
        }
        ColorEncoding::Mono8 => per_pixel(size, row_bytes, bytes, |&[y]: &[u8; 1]| [y; 3]),
        ColorEncoding::Yuv422Yuy2 => decode_yuy2(size, row_bytes, bytes),
        ColorEncoding::Nv12 => decode_nv12(size, row_bytes, bytes),
        other => match bayer::red_parity(other) {
            Some(red) => bayer::demosaic(size, row_bytes, bytes, red),
            None => per_pixel(size, row_bytes, bytes, |&rgb: &[u8; 3]| rgb),
        },
    }
}

fn rows(
    [_, height]: [usize; 2],
    row_bytes: usize,
    min_row_bytes: usize,
    bytes: &[u8],
) -> impl Iterator<Item = &[u8]> {
    (0..height).map(move |y| &bytes[y * row_bytes..][..min_row_bytes])
}

fn per_pixel<T, const N: usize>(
    size: [usize; 2],
    row_bytes: usize,
    bytes: &[u8],
    convert: impl Fn(&[u8; N]) -> T,
) -> Vec<T> {
    let mut pixels = Vec::with_capacity(size[0] * size[1]);
    for row in rows(size, row_bytes, size[0] * N, bytes) {
        pixels.extend(row.as_chunks::<N>().0.iter().map(&convert));
    }
    pixels
}

/// 16-bit pixels of rows whose layout was checked.
pub(crate) fn u16_rows(
    [width, height]: [u32; 2],
    row_bytes: usize,
    bytes: &[u8],
    big_endian: bool,
) -> Vec<u16> {
    let size = [width as usize, height as usize];
    if big_endian {
        per_pixel(size, row_bytes, bytes, |&px| u16::from_be_bytes(px))
    } else {
        per_pixel(size, row_bytes, bytes, |&px| u16::from_le_bytes(px))
    }
}

/// 32-bit float pixels of rows whose layout was checked.
pub(crate) fn f32_rows(
    [width, height]: [u32; 2],
    row_bytes: usize,
    bytes: &[u8],
    big_endian: bool,
) -> Vec<f32> {
    let size = [width as usize, height as usize];
    if big_endian {
        per_pixel(size, row_bytes, bytes, |&px| f32::from_be_bytes(px))
    } else {
        per_pixel(size, row_bytes, bytes, |&px| f32::from_le_bytes(px))
    }
}

fn decode_yuy2(size: [usize; 2], row_bytes: usize, bytes: &[u8]) -> Vec<[u8; 3]> {
    let mut pixels = Vec::with_capacity(size[0] * size[1]);
    for row in rows(size, row_bytes, size[0] * 2, bytes) {
        for &[y0, u, y1, v] in row.as_chunks::<4>().0 {
            let chroma = Chroma::new(u, v);
            pixels.extend([chroma.rgb(y0), chroma.rgb(y1)]);
        }
    }
    pixels
}

fn decode_nv12(size: [usize; 2], row_bytes: usize, bytes: &[u8]) -> Vec<[u8; 3]> {
    let [width, height] = size;
    let mut pixels = Vec::with_capacity(width * height);
    for (y, luma) in rows(size, row_bytes, width, bytes).enumerate() {
        let uv = &bytes[(height + y / 2) * row_bytes..][..width];
        for (&[y0, y1], &[u, v]) in luma.as_chunks::<2>().0.iter().zip(uv.as_chunks::<2>().0) {
            let chroma = Chroma::new(u, v);
            pixels.extend([chroma.rgb(y0), chroma.rgb(y1)]);
        }
    }
    pixels
}

/// What the chroma adds to each channel, in OpenCV's fixed point (its `ITUR_BT_601_*`).
struct Chroma([i32; 3]);

const FRACTION_BITS: u32 = 20;

impl Chroma {
    fn new(u: u8, v: u8) -> Self {
        let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
        let half = 1 << (FRACTION_BITS - 1);
        Self([
            half + 1_673_527 * v,
            half - 852_492 * v - 409_993 * u,
            half + 2_116_026 * u,
        ])
    }

    #[expect(clippy::cast_sign_loss, reason = "clamped to 0..=255")]
    fn rgb(&self, y: u8) -> [u8; 3] {
        let luma = (i32::from(y) - 16).max(0) * 1_220_542;
        self.0
            .map(|chroma| ((luma + chroma) >> FRACTION_BITS).clamp(0, 255) as u8)
    }
}
