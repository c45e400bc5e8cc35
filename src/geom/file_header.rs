//! Size and completeness of JPEG and PNG files, read from their markers without decoding.

use super::image::ImageError;

const PNG_MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

pub(crate) fn is_png(bytes: &[u8]) -> bool {
    bytes.starts_with(PNG_MAGIC)
}

pub(crate) fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xd8, 0xff])
}

fn broken(codec: &'static str, reason: impl Into<String>) -> ImageError {
    ImageError::Codec {
        codec,
        reason: reason.into(),
    }
}

/// The fields of IHDR that matter here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PngHeader {
    /// Width and height in pixels.
    pub(crate) size: [u32; 2],
    bits_per_sample: u8,
    color_type: u8,
}

impl PngHeader {
    /// The size, if the pixels are single 16-bit samples.
    pub(crate) fn grey16_size(&self) -> Result<[u32; 2], ImageError> {
        match (self.bits_per_sample, self.color_type) {
            (16, 0) => Ok(self.size),
            (bits, color_type) => Err(broken(
                "png",
                format!(
                    "depth needs 16-bit grey, the file has {bits} bits a sample and colour type {color_type}"
                ),
            )),
        }
    }
}

/// Header of a PNG whose chunks reach to IEND.
pub(crate) fn png_header(bytes: &[u8]) -> Result<PngHeader, ImageError> {
    let mut rest = bytes
        .strip_prefix(PNG_MAGIC)
        .ok_or_else(|| broken("png", "the file does not start as a PNG does"))?;
    let mut header = None;
    loop {
        let (kind, data, after) = png_chunk(rest).ok_or_else(|| {
            broken(
                "png",
                format!("cut off: {} bytes end before IEND", bytes.len()),
            )
        })?;
        match kind {
            b"IHDR" => header = parse_ihdr(data),
            b"IEND" => break,
            _ => {}
        }
        rest = after;
    }
    header.ok_or_else(|| broken("png", "no IHDR"))
}

fn png_chunk(bytes: &[u8]) -> Option<(&[u8; 4], &[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (kind, rest) = rest.split_first_chunk::<4>()?;
    let (data, rest) = rest.split_at_checked(u32::from_be_bytes(*length) as usize)?;
    let (_crc, rest) = rest.split_first_chunk::<4>()?;
    Some((kind, data, rest))
}

fn parse_ihdr(data: &[u8]) -> Option<PngHeader> {
    let (width, rest) = data.split_first_chunk::<4>()?;
    let (height, rest) = rest.split_first_chunk::<4>()?;
    let &[bits_per_sample, color_type, ..] = rest else {
        return None;
    };
    Some(PngHeader {
        size: [u32::from_be_bytes(*width), u32::from_be_bytes(*height)],
        bits_per_sample,
        color_type,
    })
}

const SOS: u8 = 0xda;
const EOI: u8 = 0xd9;

/// Width and height from the frame header of a JPEG that has its end-of-image marker. The
/// decoder paints what a cut-off file lacks in grey without a word, so that is refused here.
pub(crate) fn jpeg_size(bytes: &[u8]) -> Result<[u32; 2], ImageError> {
    let mut size = None;
    let mut offset = 2;
    loop {
        let (marker, after) = next_marker(bytes, offset)
            .ok_or_else(|| broken("jpeg", format!("no scan in {} bytes", bytes.len())))?;
        // Markers without a payload: TEM, RSTn, SOI.
        if matches!(marker, 0x01 | 0xd0..=0xd8) {
            offset = after;
            continue;
        }
        let payload = jpeg_payload(bytes, after)
            .ok_or_else(|| broken("jpeg", format!("cut off in its segment at byte {after}")))?;
        // SOF0..SOF15 without DHT (c4), JPG (c8) and DAC (cc), which share their range.
        if matches!(marker, 0xc0..=0xcf)
            && !matches!(marker, 0xc4 | 0xc8 | 0xcc)
            && let &[_precision, h1, h0, w1, w0, ..] = payload
        {
            size = Some([w1, w0, h1, h0].map(u32::from));
        }
        offset = after + 2 + payload.len();
        if marker == SOS {
            break;
        }
    }
    let [w1, w0, h1, h0] = size.ok_or_else(|| broken("jpeg", "no frame header"))?;
    // Entropy-coded data never holds FF D9, so any after the first scan header is the end.
    let has_end = bytes[offset..].windows(2).rev().any(|w| w == [0xff, EOI]);
    if !has_end {
        return Err(broken(
            "jpeg",
            format!("cut off: no end marker in {} bytes", bytes.len()),
        ));
    }
    Ok([w1 << 8 | w0, h1 << 8 | h0])
}

/// The marker at `offset` (fill bytes skipped) and the offset behind it.
fn next_marker(bytes: &[u8], mut offset: usize) -> Option<(u8, usize)> {
    if *bytes.get(offset)? != 0xff {
        return None;
    }
    while *bytes.get(offset)? == 0xff {
        offset += 1;
    }
    Some((bytes[offset], offset + 1))
}

fn jpeg_payload(bytes: &[u8], offset: usize) -> Option<&[u8]> {
    let (length, rest) = bytes.get(offset..)?.split_first_chunk::<2>()?;
    let num_bytes = usize::from(u16::from_be_bytes(*length)).checked_sub(2)?;
    rest.get(..num_bytes)
}
