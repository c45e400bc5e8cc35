//! The values behind the header of a PLY file, one after the other.

use super::header::{Encoding, Scalar};

/// What stops the reading of a value; the caller knows where in the mesh that is.
pub(super) enum Stop {
    Ended,
    NotANumber(String),
}

pub(super) struct Body<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) encoding: Encoding,
}

impl Body<'_> {
    /// The next value. Every scalar type of PLY is exact in `f64`.
    pub(super) fn next(&mut self, scalar: Scalar) -> Result<f64, Stop> {
        match self.encoding {
            Encoding::Ascii => self.next_word(scalar),
            Encoding::LittleEndian => self.next_binary(scalar, false),
            Encoding::BigEndian => self.next_binary(scalar, true),
        }
    }

    fn next_word(&mut self, scalar: Scalar) -> Result<f64, Stop> {
        let bytes = self.bytes.trim_ascii_start();
        let end = bytes
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(bytes.len());
        if end == 0 {
            return Err(Stop::Ended);
        }
        let (word, rest) = bytes.split_at(end);
        self.bytes = rest;
        let refuse = || Stop::NotANumber(String::from_utf8_lossy(&word[..end.min(40)]).into());
        let value: f64 = std::str::from_utf8(word)
            .ok()
            .and_then(|word| word.parse().ok())
            .ok_or_else(refuse)?;
        if scalar == Scalar::F32 {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "the file declares the value a 32-bit float"
            )]
            return Ok(f64::from(value as f32));
        }
        Ok(value)
    }

    fn next_binary(&mut self, scalar: Scalar, big_endian: bool) -> Result<f64, Stop> {
        let (raw, rest) = self
            .bytes
            .split_at_checked(scalar.num_bytes())
            .ok_or(Stop::Ended)?;
        self.bytes = rest;
        let mut le = [0u8; 8];
        le[..raw.len()].copy_from_slice(raw);
        if big_endian {
            le[..raw.len()].reverse();
        }
        let [b0, b1, b2, b3, ..] = le;
        Ok(match scalar {
            Scalar::I8 => f64::from(b0.cast_signed()),
            Scalar::U8 => f64::from(b0),
            Scalar::I16 => f64::from(i16::from_le_bytes([b0, b1])),
            Scalar::U16 => f64::from(u16::from_le_bytes([b0, b1])),
            Scalar::I32 => f64::from(i32::from_le_bytes([b0, b1, b2, b3])),
            Scalar::U32 => f64::from(u32::from_le_bytes([b0, b1, b2, b3])),
            Scalar::F32 => f64::from(f32::from_le_bytes([b0, b1, b2, b3])),
            Scalar::F64 => f64::from_le_bytes(le),
        })
    }

    /// The next list, appended to `items`. A length that the file cannot hold ends at its end.
    pub(super) fn next_list(
        &mut self,
        length: Scalar,
        item: Scalar,
        items: &mut Vec<f64>,
    ) -> Result<(), Stop> {
        let length = self.next(length)?;
        if length < 0.0 || length.fract() != 0.0 {
            return Err(Stop::NotANumber(length.to_string()));
        }
        let mut remaining = length;
        while remaining > 0.0 {
            items.push(self.next(item)?);
            remaining -= 1.0;
        }
        Ok(())
    }
}
