//! sRGB transfer function: bytes at the edges, linear light where colours are averaged.

use std::sync::LazyLock;

static LINEAR_FROM_SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        let s = byte as f64 / 255.0;
        let linear = if s <= 0.040_45 {
            s / 12.92
        } else {
            ((s + 0.055) / 1.055).powf(2.4)
        };
        // Exact to f32: the table is the definition (IEC 61966-2-1) rounded once.
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let rounded = linear as f32;
        rounded
    })
});

/// Linear light in [0, 1] of all sRGB bytes, for loops over pixels.
pub fn linear_table() -> &'static [f32; 256] {
    &LINEAR_FROM_SRGB
}

/// Linear light in [0, 1] of an sRGB byte (IEC 61966-2-1).
pub fn linear_from_srgb(byte: u8) -> f32 {
    LINEAR_FROM_SRGB[usize::from(byte)]
}

/// Cells that linear light is looked up in: so narrow that no more than one byte ends in one.
const NUM_CELLS: u16 = 4096;

/// [`srgb_from_power`] without the power function.
struct FromLinear {
    /// The byte at the lower end of each cell.
    at_cell: Vec<u8>,
    /// The least value of each byte, and nothing behind the last.
    least: [f32; 257],
}

static FROM_LINEAR: LazyLock<FromLinear> = LazyLock::new(|| {
    let at_cell =
        (0..=NUM_CELLS).map(|cell| srgb_from_power(f32::from(cell) / f32::from(NUM_CELLS)));
    let least_of = |byte: usize| {
        // Positive floats are in the order of their bits.
        let (mut below, mut least) = (0_u32, 1.0_f32.to_bits());
        while least - below > 1 {
            let middle = u32::midpoint(below, least);
            if usize::from(srgb_from_power(f32::from_bits(middle))) >= byte {
                least = middle;
            } else {
                below = middle;
            }
        }
        f32::from_bits(least)
    };
    FromLinear {
        at_cell: at_cell.collect(),
        least: std::array::from_fn(|byte| match byte {
            0 => 0.0,
            256 => f32::INFINITY,
            _ => least_of(byte),
        }),
    }
});

/// sRGB byte nearest to a linear value; values outside [0, 1] are clamped, NaN becomes 0.
pub fn srgb_from_linear(linear: f32) -> u8 {
    let FromLinear { at_cell, least } = &*FROM_LINEAR;
    let linear = linear.clamp(0.0, 1.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to [0, 1]; NaN becomes 0"
    )]
    let cell = (linear * f32::from(NUM_CELLS)) as usize;
    let byte = at_cell.get(cell).copied().unwrap_or(u8::MAX);
    byte + u8::from(linear >= least[usize::from(byte) + 1])
}

/// The definition (IEC 61966-2-1).
fn srgb_from_power(linear: f32) -> u8 {
    let s = if linear <= 0.003_130_8 {
        linear * 12.92
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 0..=255; float to int casts saturate"
    )]
    let byte = (s.clamp(0.0, 1.0) * 255.0).round() as u8;
    byte
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_round_trips() {
        for byte in 0..=255u8 {
            assert_eq!(srgb_from_linear(linear_from_srgb(byte)), byte);
        }
        assert_eq!(srgb_from_linear(f32::NAN), 0);
        assert_eq!(srgb_from_linear(2.0), 255);
    }

    #[test]
    fn bytes_are_those_of_the_definition() {
        let check = |linear: f32| {
            assert_eq!(
                srgb_from_linear(linear),
                srgb_from_power(linear),
                "{linear}"
            );
        };
        (0..=1_000_000_u32).for_each(|step| check(step as f32 / 1e6));
        for least in FROM_LINEAR.least {
            let bits = least.to_bits();
            (bits.saturating_sub(3)..bits + 3).for_each(|bits| check(f32::from_bits(bits)));
        }
        let edges = [
            -1.0,
            -0.0,
            f32::MIN_POSITIVE,
            f32::INFINITY,
            f32::NEG_INFINITY,
        ];
        edges.into_iter().for_each(check);
    }
}
