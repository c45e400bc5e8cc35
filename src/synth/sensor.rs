//! What the sensor makes of an ideal image: exposure, colour noise, depth noise, lost pixels.

use std::sync::LazyLock;

use crate::geom::color::srgb_from_linear;

use super::caster::CastImage;
use super::hash::Stream;
use super::options::SynthNoise;
use super::texture::Linear;

const NUM_LEVELS: usize = 1 << 16;

static SRGB_FROM_LEVEL: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..=NUM_LEVELS)
        .map(|level| srgb_from_linear(level as f32 / NUM_LEVELS as f32))
        .collect()
});

/// Per-channel gain of a frame: a slow random walk of the exposure (standard deviation
/// `exposure_stops`) and of the white balance (a quarter of it, red against blue).
pub(super) fn frame_gain(noise: &SynthNoise, seed: u64, time_s: f64) -> Linear {
    if noise.exposure_stops <= 0.0 {
        return [1.0; 3];
    }
    const CHANGES_PER_S: f64 = 0.5;
    // A lattice walk has a standard deviation of about one half.
    let walk = |name: &str| 2.0 * Stream::new(seed, name).walk(time_s * CHANGES_PER_S);
    let stops = noise.exposure_stops * walk("exposure");
    let warmth = 0.25 * noise.exposure_stops * walk("white balance");
    #[expect(clippy::cast_possible_truncation, reason = "a gain near 1")]
    let gains = [stops + warmth, stops, stops - warmth].map(|s| s.exp2() as f32);
    gains
}

/// sRGB bytes of the image under a gain, with read noise.
pub(super) fn develop(
    linear: &[Linear],
    gain: Linear,
    image_noise_255: f64,
    noise: Stream,
) -> Vec<[u8; 3]> {
    let table: &[u8] = &SRGB_FROM_LEVEL;
    let byte = |value: f32| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the table; NaN becomes 0"
        )]
        let level = (value * NUM_LEVELS as f32 + 0.5).clamp(0.0, NUM_LEVELS as f32) as usize;
        table.get(level).copied().unwrap_or(255)
    };
    (0u64..)
        .zip(linear)
        .map(|(index, pixel)| {
            let clean: [u8; 3] = std::array::from_fn(|c| byte(pixel[c] * gain[c]));
            if image_noise_255 <= 0.0 {
                return clean;
            }
            std::array::from_fn(|c| {
                let noisy =
                    f64::from(clean[c]) + image_noise_255 * noise.gaussian(index * 3 + c as u64);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "clamped to a byte"
                )]
                let noisy = noisy.round().clamp(0.0, 255.0) as u8;
                noisy
            })
        })
        .collect()
}

/// Depth in millimetres, 0 = no measurement: quantised, with noise that grows with the square of
/// the distance, and lost with some probability where the depth jumps.
pub(super) fn measure(
    image: &CastImage,
    width: usize,
    noise: &SynthNoise,
    random: Stream,
) -> Vec<u16> {
    let depth_m = &image.depth_m;
    let lost = random.sub(1);
    (0..depth_m.len())
        .map(|at| {
            let depth = f64::from(depth_m[at]);
            let index = at as u64;
            let is_lost = noise.depth_dropout > 0.0
                && is_at_jump(depth_m, width, at)
                && lost.uniform(index) < noise.depth_dropout;
            if depth <= 0.0 || is_lost {
                return 0;
            }
            let sigma_m = noise.depth_quadratic_per_m * depth * depth;
            let measured_m = if sigma_m > 0.0 {
                depth + sigma_m * random.gaussian(index)
            } else {
                depth
            };
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to 16 bits"
            )]
            let millimetres = (measured_m * 1e3).round().clamp(1.0, 65_535.0) as u16;
            millimetres
        })
        .collect()
}

/// Whether a pixel within two columns or rows lies 4 % nearer or farther.
fn is_at_jump(depth_m: &[f32], width: usize, at: usize) -> bool {
    const REACH: usize = 2;
    let here = depth_m[at];
    let column = at % width;
    let differs = |other: Option<usize>| {
        other
            .and_then(|other| depth_m.get(other))
            .is_some_and(|&depth| (depth - here).abs() > 0.04 * here)
    };
    (1..=REACH).any(|step| {
        differs(at.checked_sub(step * width))
            || differs(Some(at + step * width))
            || (column >= step && differs(Some(at - step)))
            || (column + step < width && differs(Some(at + step)))
    })
}
