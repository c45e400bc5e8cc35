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

/// sRGB byte nearest to a linear value; values outside [0, 1] are clamped, NaN becomes 0.
pub fn srgb_from_linear(linear: f32) -> u8 {
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
}
