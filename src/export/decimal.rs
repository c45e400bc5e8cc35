//! Decimal numbers as text, fast: OBJ files are mostly this.

/// Appends `value` with `NUM_DECIMALS` decimals, rounded half away from zero. Values whose
/// scaled integer does not fit 63 bits are written by the standard library with the same number
/// of decimals.
pub(super) fn push_fixed<const NUM_DECIMALS: u32>(out: &mut Vec<u8>, value: f64) {
    let scale = 10u64.pow(NUM_DECIMALS);
    let scaled = (value.abs() * scale as f64).round();
    // 2^53: beyond it the scaled value is not exact any more, and the slow path is.
    if scaled >= 9_007_199_254_740_992.0 || scaled.is_nan() {
        out.extend_from_slice(format!("{value:.*}", NUM_DECIMALS as usize).as_bytes());
        return;
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and 2^53, as just checked"
    )]
    let scaled = scaled as u64;
    if value < 0.0 && scaled != 0 {
        out.push(b'-');
    }
    push_integer(out, scaled / scale);
    out.push(b'.');
    let mut digits = [b'0'; 20];
    let mut rest = scaled % scale;
    for digit in digits[..NUM_DECIMALS as usize].iter_mut().rev() {
        *digit = ascii_digit(rest % 10);
        rest /= 10;
    }
    out.extend_from_slice(&digits[..NUM_DECIMALS as usize]);
}

/// Appends `value` in decimal.
pub(super) fn push_integer(out: &mut Vec<u8>, mut value: u64) {
    let mut digits = [0u8; 20];
    let mut first = digits.len();
    loop {
        first -= 1;
        digits[first] = ascii_digit(value % 10);
        value /= 10;
        if value == 0 {
            break;
        }
    }
    out.extend_from_slice(&digits[first..]);
}

#[expect(clippy::cast_possible_truncation, reason = "a digit is below 10")]
fn ascii_digit(digit: u64) -> u8 {
    b'0' + digit as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fixed(value: f64) -> String {
        let mut out = Vec::new();
        push_fixed::<6>(&mut out, value);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn writes_what_a_person_would() {
        assert_eq!(fixed(0.0), "0.000000");
        assert_eq!(fixed(-0.000_000_1), "0.000000");
        assert_eq!(fixed(-1.5), "-1.500000");
        assert_eq!(fixed(12.000_034), "12.000034");
        assert_eq!(fixed(1e12), "1000000000000.000000");
    }

    proptest! {
        #[test]
        fn parses_back_within_half_a_unit(value in -1e6..1e6f64) {
            let back: f64 = fixed(value).parse().unwrap();
            prop_assert!((back - value).abs() <= 0.5e-6 + 1e-9);
        }

        #[test]
        fn integers_are_exact(value in any::<u64>()) {
            let mut out = Vec::new();
            push_integer(&mut out, value);
            prop_assert_eq!(String::from_utf8(out).unwrap(), value.to_string());
        }
    }
}
