//! RVL: lossless depth compression by runs and variable-length deltas (A. D. Wilson, "Fast
//! lossless depth image compression", ISS 2017), as `compressed_depth_image_transport` writes it.
//!
//! A buffer is `cols: u32, rows: u32`, then 32-bit words, all little endian. Each word holds eight
//! nibbles, the first in the highest bits. A number is a chain of nibbles, three bits each from
//! the lowest, with the fourth bit set while more follow. The stream repeats: the length of a run
//! of zeros, the length of a run of non-zeros, the zigzag-coded differences of the latter (the
//! first from the last non-zero pixel before, 0 at the start).

use super::image::{ImageError, check_decoded_size};

const HEADER_BYTES: usize = 8;

fn broken(reason: String) -> ImageError {
    ImageError::Codec {
        codec: "rvl",
        reason,
    }
}

/// Width and height in pixels as the header has them.
///
/// # Errors
/// [`ImageError`] when the header is cut off.
pub fn size(bytes: &[u8]) -> Result<[u32; 2], ImageError> {
    let words = bytes.first_chunk::<HEADER_BYTES>().ok_or_else(|| {
        broken(format!(
            "{} bytes are too few for the header of {HEADER_BYTES}",
            bytes.len()
        ))
    })?;
    let [w0, w1, w2, w3, h0, h1, h2, h3] = *words;
    Ok([
        u32::from_le_bytes([w0, w1, w2, w3]),
        u32::from_le_bytes([h0, h1, h2, h3]),
    ])
}

/// The pixels of a buffer, row-major.
///
/// # Errors
/// [`ImageError`] when the size is unusable, or the stream ends early or runs past the image.
pub fn decode(bytes: &[u8]) -> Result<Vec<u16>, ImageError> {
    let [width, height] = size(bytes)?;
    let num_pixels = check_decoded_size(width, height)?;
    let mut nibbles = NibbleReader::new(&bytes[HEADER_BYTES..]);
    let mut pixels = vec![0u16; num_pixels];
    let mut at = 0;
    let mut previous = 0i32;
    while at < num_pixels {
        let num_zeros = nibbles.number()? as usize;
        let num_nonzeros = nibbles.number()? as usize;
        let left = num_pixels - at;
        if num_zeros > left || num_nonzeros > left - num_zeros || num_zeros + num_nonzeros == 0 {
            return Err(broken(format!(
                "runs of {num_zeros} zeros and {num_nonzeros} values at pixel {at} of {num_pixels}"
            )));
        }
        at += num_zeros;
        for pixel in &mut pixels[at..at + num_nonzeros] {
            let coded = nibbles.number()?;
            let delta = (coded >> 1).cast_signed() ^ -((coded & 1).cast_signed());
            previous = previous.wrapping_add(delta);
            // The reference decoder truncates too; a valid stream never leaves 16 bits.
            *pixel = (previous & 0xffff).unsigned_abs().try_into().unwrap_or(0);
        }
        at += num_nonzeros;
    }
    Ok(pixels)
}

/// A buffer of `pixels`, which must be `width` × `height` of them.
pub fn encode([width, height]: [u32; 2], pixels: &[u16]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + pixels.len());
    bytes.extend_from_slice(&width.to_le_bytes());
    bytes.extend_from_slice(&height.to_le_bytes());
    let mut nibbles = NibbleWriter {
        bytes,
        word: 0,
        num_nibbles: 0,
    };
    let mut rest = pixels;
    let mut previous = 0i32;
    while !rest.is_empty() {
        let num_zeros = rest.iter().take_while(|&&mm| mm == 0).count();
        rest = &rest[num_zeros..];
        let num_nonzeros = rest.iter().take_while(|&&mm| mm != 0).count();
        let (values, after) = rest.split_at(num_nonzeros);
        rest = after;
        nibbles.run(num_zeros);
        nibbles.run(num_nonzeros);
        for &mm in values {
            let delta = i32::from(mm) - previous;
            nibbles.number(((delta << 1) ^ (delta >> 31)).cast_unsigned());
            previous = i32::from(mm);
        }
    }
    nibbles.finish()
}

struct NibbleReader<'a> {
    words: std::slice::Iter<'a, [u8; 4]>,
    word: u32,
    num_left: u32,
}

impl<'a> NibbleReader<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
            words: bytes.as_chunks::<4>().0.iter(),
            word: 0,
            num_left: 0,
        }
    }

    #[inline]
    fn number(&mut self) -> Result<u32, ImageError> {
        let mut value = 0u32;
        let mut shift = 0;
        loop {
            if self.num_left == 0 {
                let word = self.words.next();
                self.word =
                    u32::from_le_bytes(*word.ok_or_else(|| broken("stream ends early".into()))?);
                self.num_left = 8;
            }
            let nibble = self.word >> 28;
            self.word <<= 4;
            self.num_left -= 1;
            value |= (nibble & 7) << shift;
            if nibble & 8 == 0 {
                return Ok(value);
            }
            shift += 3;
            if shift > 30 {
                return Err(broken("a number is longer than 32 bits".into()));
            }
        }
    }
}

struct NibbleWriter {
    bytes: Vec<u8>,
    word: u32,
    num_nibbles: u32,
}

impl NibbleWriter {
    fn run(&mut self, length: usize) {
        // An image has fewer pixels than 32 bits count: its sides are checked.
        self.number(u32::try_from(length).unwrap_or(u32::MAX));
    }

    #[inline]
    fn number(&mut self, mut value: u32) {
        loop {
            let low = value & 7;
            value >>= 3;
            let nibble = if value == 0 { low } else { low | 8 };
            self.word = self.word << 4 | nibble;
            self.num_nibbles += 1;
            if self.num_nibbles == 8 {
                self.flush_word();
            }
            if value == 0 {
                return;
            }
        }
    }

    fn flush_word(&mut self) {
        self.bytes.extend_from_slice(&self.word.to_le_bytes());
        self.word = 0;
        self.num_nibbles = 0;
    }

    fn finish(mut self) -> Vec<u8> {
        if self.num_nibbles > 0 {
            self.word <<= 4 * (8 - self.num_nibbles);
            self.flush_word();
        }
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn matches_a_stream_worked_out_by_hand() {
        // 2 zeros, 2 values (5: +5 → 10; 3: −2 → 3), then 1 zero and 0 values:
        // nibbles 2 | 2 | 10 = 0b1010 → (2|8), 1 | 3 | 1 | 0 → 2 2 a 1 3 1 0, padded with 0.
        let bytes = encode([5, 1], &[0, 0, 5, 3, 0]);
        assert_eq!(bytes[8..], 0x22a1_3100_u32.to_le_bytes());
        assert_eq!(decode(&bytes).unwrap(), [0, 0, 5, 3, 0]);
    }

    #[test]
    fn refuses_runs_past_the_image() {
        let mut bytes = encode([5, 1], &[0, 0, 5, 3, 0]);
        bytes[0] = 3;
        assert!(decode(&bytes).unwrap_err().to_string().contains("runs of"));
        assert!(decode(&bytes[..7]).is_err());
        assert!(decode(&bytes[..8]).is_err());
    }

    proptest! {
        #[test]
        fn round_trips(pixels in prop::collection::vec(
            prop_oneof![Just(0u16), any::<u16>(), 900u16..1100], 1..400)) {
            let width = u32::try_from(pixels.len()).unwrap();
            prop_assert_eq!(decode(&encode([width, 1], &pixels)).unwrap(), pixels);
        }

        #[test]
        fn any_bytes_are_refused_or_decoded(mut bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            if bytes.len() >= 8 {
                // Sizes within reach, so that the stream itself is exercised.
                let [width, height] = [bytes[0] % 40, bytes[4] % 40];
                bytes[..8].copy_from_slice(&[width, 0, 0, 0, height, 0, 0, 0]);
            }
            if let Ok(pixels) = decode(&bytes) {
                let [width, height] = size(&bytes).unwrap();
                prop_assert_eq!(pixels.len(), width as usize * height as usize);
            }
        }
    }
}
