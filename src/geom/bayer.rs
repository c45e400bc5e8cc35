//! Bilinear demosaicing of 8-bit Bayer mosaics.
//!
//! Each missing channel is the mean of its two or four nearest samples, rounded half up. At the
//! border the image is mirrored about its edge pixels, which keeps the pattern's phase.

use super::encoded::ColorEncoding;

/// Column and row parity of the red sample in each 2×2 block; `None` if not a mosaic.
pub(crate) fn red_parity(encoding: ColorEncoding) -> Option<[usize; 2]> {
    match encoding {
        ColorEncoding::BayerRggb8 => Some([0, 0]),
        ColorEncoding::BayerGrbg8 => Some([1, 0]),
        ColorEncoding::BayerGbrg8 => Some([0, 1]),
        ColorEncoding::BayerBggr8 => Some([1, 1]),
        _ => None,
    }
}

/// RGB pixels of a mosaic of `width` × `height` (both at least 2) whose rows start `row_bytes`
/// apart. The caller has checked that the bytes are there.
pub(crate) fn demosaic(
    [width, height]: [usize; 2],
    row_bytes: usize,
    bytes: &[u8],
    [red_x, red_y]: [usize; 2],
) -> Vec<[u8; 3]> {
    let mut pixels = Vec::with_capacity(width * height);
    let row = |y: usize| &bytes[y * row_bytes..][..width];
    for y in 0..height {
        let above = row(if y == 0 { 1 } else { y - 1 });
        let below = row(if y + 1 == height { height - 2 } else { y + 1 });
        let rows = [above, row(y), below];
        let on_red_row = y % 2 == red_y;
        pixels.extend((0..width).map(|x| {
            let left = if x == 0 { 1 } else { x - 1 };
            let right = if x + 1 == width { width - 2 } else { x + 1 };
            interpolate(rows, [left, x, right], on_red_row, x % 2 == red_x)
        }));
    }
    pixels
}

#[inline]
fn interpolate(
    [above, here, below]: [&[u8]; 3],
    [left, x, right]: [usize; 3],
    on_red_row: bool,
    on_red_column: bool,
) -> [u8; 3] {
    let center = here[x];
    let horizontal = mean2(here[left], here[right]);
    let vertical = mean2(above[x], below[x]);
    let cross = mean4([here[left], here[right], above[x], below[x]]);
    let diagonal = mean4([above[left], above[right], below[left], below[right]]);
    match (on_red_row, on_red_column) {
        (true, true) => [center, cross, diagonal],
        (false, false) => [diagonal, cross, center],
        (true, false) => [horizontal, center, vertical],
        (false, true) => [vertical, center, horizontal],
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a mean of bytes is at most 255"
)]
fn mean2(a: u8, b: u8) -> u8 {
    (u16::from(a) + u16::from(b)).div_ceil(2) as u8
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a mean of bytes is at most 255"
)]
fn mean4(samples: [u8; 4]) -> u8 {
    ((samples.iter().map(|&s| u16::from(s)).sum::<u16>() + 2) / 4) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATTERNS: [ColorEncoding; 4] = [
        ColorEncoding::BayerRggb8,
        ColorEncoding::BayerGrbg8,
        ColorEncoding::BayerGbrg8,
        ColorEncoding::BayerBggr8,
    ];

    /// The mosaic of an RGB image, by the definition in [`ColorEncoding`]'s docs.
    fn mosaic(encoding: ColorEncoding, [width, height]: [usize; 2], rgb: [[u8; 3]; 64]) -> Vec<u8> {
        let block = match encoding {
            ColorEncoding::BayerRggb8 => [[0, 1], [1, 2]],
            ColorEncoding::BayerBggr8 => [[2, 1], [1, 0]],
            ColorEncoding::BayerGbrg8 => [[1, 2], [0, 1]],
            _ => [[1, 0], [2, 1]],
        };
        (0..width * height)
            .map(|i| rgb[i][block[i / width % 2][i % width % 2]])
            .collect()
    }

    #[test]
    fn a_flat_colour_comes_back_exactly() {
        for encoding in PATTERNS {
            let bytes = mosaic(encoding, [8, 8], [[200, 100, 50]; 64]);
            let parity = red_parity(encoding).unwrap();
            let pixels = demosaic([8, 8], 8, &bytes, parity);
            assert!(pixels.iter().all(|&p| p == [200, 100, 50]), "{encoding:?}");
        }
    }

    #[test]
    fn a_ramp_is_exact_inside_the_border() {
        let rgb = std::array::from_fn(|i| {
            let (x, y) = (u8::try_from(i % 8).unwrap(), u8::try_from(i / 8).unwrap());
            [4 * x + 2 * y, 8 * y + 10, 100 - 2 * x - 4 * y]
        });
        for encoding in PATTERNS {
            let bytes = mosaic(encoding, [8, 8], rgb);
            let pixels = demosaic([8, 8], 8, &bytes, red_parity(encoding).unwrap());
            for i in (0..64).filter(|i| (1..7).contains(&(i % 8)) && (1..7).contains(&(i / 8))) {
                assert_eq!(pixels[i], rgb[i], "{encoding:?} at {i}");
            }
        }
    }
}
