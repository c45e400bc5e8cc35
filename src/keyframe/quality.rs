//! How sharp and how well exposed an image is, from its luma.
//!
//! Sharpness is the energy of the Laplacian over the energy of the gradient, both on the luma
//! averaged over 2×2 pixels (which halves the noise) and both at edges only (where the gradient
//! exceeds what noise makes): the ratio says how fast edges rise, in 1/px², and hardly depends on
//! how many edges there are or on their contrast. It is taken along x and along y, and the lower
//! value counts: motion blurs along one direction. An image with few edges says little of its
//! sharpness and is drawn towards the value that photographs in focus have (1 to 2; a
//! motion blur of 7 px gives 0.3).

use super::frame::FrameQuality;
use crate::geom::{EncodedColor, ImageError, LumaImage};

/// Least difference across two pixels of the averaged luma that counts as an edge, in bytes.
const MIN_EDGE: i16 = 16;
/// Sharpness that an image without edges is taken to have.
const PRIOR_SHARPNESS: f64 = 1.0;
/// Share of the pixels whose edges weigh as much as the prior.
const PRIOR_SHARE: f64 = 0.002;

/// Judges an encoded image.
///
/// # Errors
/// [`ImageError`] when it does not decode.
pub fn measure(color: &EncodedColor) -> Result<FrameQuality, ImageError> {
    Ok(measure_luma(&color.decode_luma()?))
}

/// Judges a decoded image.
#[expect(
    clippy::cast_possible_truncation,
    reason = "f32 is precise enough for a judgement"
)]
pub fn measure_luma(image: &LumaImage) -> FrameQuality {
    let luma = image.luma();
    let num_pixels = luma.len().max(1) as f64;
    let sum: u64 = luma
        .chunks(1 << 16)
        .map(|chunk| u64::from(chunk.iter().map(|&y| u32::from(y)).sum::<u32>()))
        .sum();
    let num_clipped: u64 = luma
        .chunks(255)
        .map(|chunk| {
            u64::from(
                chunk
                    .iter()
                    .map(|&y| u8::from(y == 0 || y == 255))
                    .sum::<u8>(),
            )
        })
        .sum();
    FrameQuality {
        sharpness: sharpness(image) as f32,
        mean_luma: (sum as f64 / (255.0 * num_pixels)) as f32,
        clipped: (num_clipped as f64 / num_pixels) as f32,
    }
}

/// Luma summed over 2×2 pixels; an odd last row or column is left out.
struct HalfLuma {
    width: usize,
    sums: Vec<i16>,
}

impl HalfLuma {
    fn new(image: &LumaImage) -> Self {
        let full_width = image.width() as usize;
        let width = full_width / 2;
        let mut sums = Vec::with_capacity(width * (image.height() as usize / 2));
        for rows in image.luma().chunks_exact(2 * full_width) {
            let (upper, lower) = rows.split_at(full_width);
            let (upper, lower) = (upper.as_chunks().0, lower.as_chunks().0);
            sums.extend(
                upper.iter().zip(lower).map(|([a, b], [c, d])| {
                    [a, b, c, d].map(|&y| i16::from(y)).iter().sum::<i16>()
                }),
            );
        }
        Self { width, sums }
    }
}

/// Energies at the edges along one axis; in units of the sums of 2×2 pixels.
#[derive(Clone, Copy, Default)]
struct EdgeEnergy {
    laplacian: u64,
    /// Of differences across two pixels: four times the gradient's energy.
    difference: u64,
}

/// Squares of up to 2040² are summed in 32 bits over this many pixels.
const CHUNK: usize = 256;

impl EdgeEnergy {
    /// Adds a run of pixels with their neighbours before and after; all of one length. In 16 bits
    /// and without branches, which compilers turn into eight pixels at a time.
    fn add(&mut self, before: &[i16], here: &[i16], after: &[i16]) {
        let chunks = before
            .chunks(CHUNK)
            .zip(here.chunks(CHUNK))
            .zip(after.chunks(CHUNK));
        for ((before, here), after) in chunks {
            let (mut laplacians, mut differences) = (0i32, 0i32);
            for ((&b, &h), &a) in before.iter().zip(here).zip(after) {
                let difference = a - b;
                let is_edge = -i16::from(difference.abs() >= 4 * MIN_EDGE);
                let laplacian = (b + a - 2 * h) & is_edge;
                let difference = difference & is_edge;
                laplacians += i32::from(laplacian) * i32::from(laplacian);
                differences += i32::from(difference) * i32::from(difference);
            }
            self.laplacian += u64::from(laplacians.unsigned_abs());
            self.difference += u64::from(differences.unsigned_abs());
        }
    }

    fn ratio(self, num_pixels: usize) -> f64 {
        let edge = f64::from(8 * MIN_EDGE);
        let prior = PRIOR_SHARE * num_pixels as f64 * edge * edge / 4.0;
        let gradient = self.difference as f64 / 4.0;
        (self.laplacian as f64 + PRIOR_SHARPNESS * prior) / (gradient + prior)
    }
}

fn sharpness(image: &LumaImage) -> f64 {
    let half = HalfLuma::new(image);
    let width = half.width;
    if width < 3 || half.sums.len() < 3 * width {
        return PRIOR_SHARPNESS;
    }
    let mut along_x = EdgeEnergy::default();
    let mut along_y = EdgeEnergy::default();
    for rows in half.sums.windows(3 * width).step_by(width) {
        let (above, rest) = rows.split_at(width);
        let (here, below) = rest.split_at(width);
        along_x.add(&here[..width - 2], &here[1..width - 1], &here[2..]);
        along_y.add(above, here, below);
    }
    let num_pixels = half.sums.len();
    along_x.ratio(num_pixels).min(along_y.ratio(num_pixels))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::ColorImage;

    const SIDE: u32 = 160;

    /// Cells of random brightness: edges at every angle that a lattice has, random contrast.
    fn pattern(contrast: f64) -> Vec<f64> {
        let value = |x: u32, y: u32| {
            let hash = (x / 9 * 7919 + y / 11 * 104_729 + 17).wrapping_mul(2_654_435_761);
            128.0 + contrast * (f64::from(hash >> 24) - 128.0)
        };
        (0..SIDE * SIDE)
            .map(|i| value(i % SIDE, i / SIDE))
            .collect()
    }

    fn blurred(image: &[f64], step: usize, radius: usize) -> Vec<f64> {
        let last = image.len() - 1;
        let mean = |i: usize| {
            let window = (0..=2 * radius).map(|k| {
                let at = (i + k * step).saturating_sub(radius * step);
                image[at.min(last)]
            });
            window.sum::<f64>() / (2 * radius + 1) as f64
        };
        (0..image.len()).map(mean).collect()
    }

    fn noisy(image: &[f64], sigma: f64) -> Vec<f64> {
        let mut state = 12_345u32;
        let mut uniform = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1u32 << 24) - 0.5
        };
        image
            .iter()
            .map(|v| v + sigma * (uniform() + uniform() + uniform()) * 2.0)
            .collect()
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to a byte"
    )]
    fn quality(image: &[f64]) -> FrameQuality {
        let pixels = image
            .iter()
            .map(|v| [v.round().clamp(0.0, 255.0) as u8; 3])
            .collect();
        let image = ColorImage::new(SIDE, SIDE, pixels).unwrap();
        measure(&EncodedColor::png_from_image(&image).unwrap()).unwrap()
    }

    #[test]
    fn sharpness_falls_with_blur_in_any_one_direction() {
        let sharp = pattern(0.8);
        let at_rest = quality(&sharp).sharpness;
        let side = SIDE as usize;
        for step in [1, side, side + 1] {
            let mut last = at_rest;
            for radius in [1, 2, 3, 5] {
                let moved = quality(&blurred(&sharp, step, radius)).sharpness;
                assert!(moved < 0.95 * last, "step {step} radius {radius}: {moved}");
                last = moved;
            }
            assert!(last < 0.35 * at_rest);
        }
    }

    #[test]
    fn contrast_and_noise_hardly_matter() {
        let strong = quality(&pattern(0.9)).sharpness;
        let weak = quality(&pattern(0.45)).sharpness;
        assert!((weak / strong - 1.0).abs() < 0.15, "{weak} {strong}");
        let noise = quality(&noisy(&pattern(0.9), 3.0)).sharpness;
        assert!((noise / strong - 1.0).abs() < 0.15, "{noise} {strong}");
        // A blurred image must not pass for a sharp one because of its noise.
        let blurry = blurred(&pattern(0.9), 1, 4);
        let noisy_blurry = quality(&noisy(&blurry, 3.0)).sharpness;
        assert!(noisy_blurry < 0.5 * strong, "{noisy_blurry} {strong}");
    }

    #[test]
    fn walls_are_middling_and_exposure_is_measured() {
        let wall = quality(&noisy(&[128.0; (SIDE * SIDE) as usize], 3.0));
        assert!((f64::from(wall.sharpness) - PRIOR_SHARPNESS).abs() < 0.3);
        assert!((wall.mean_luma - 0.5).abs() < 0.01 && wall.clipped == 0.0);
        let mut half = vec![255.0; (SIDE * SIDE) as usize];
        half[..(SIDE * SIDE / 2) as usize].fill(0.0);
        let half = quality(&half);
        assert!((half.mean_luma - 0.5).abs() < 1e-6 && half.clipped == 1.0);
        let tiny = ColorImage::new(1, 1, vec![[9; 3]]).unwrap();
        let tiny = measure(&EncodedColor::png_from_image(&tiny).unwrap()).unwrap();
        assert_eq!(f64::from(tiny.sharpness), PRIOR_SHARPNESS);
    }
}
