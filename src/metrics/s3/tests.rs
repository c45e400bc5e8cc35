//! The paper's definition on images whose sharpness is known.

use super::*;

fn grey(width: u32, height: u32, of: impl Fn(u32, u32) -> f64) -> ColorImage {
    let pixels =
        (0..width * height).map(|i| [of(i % width, i / width).round().clamp(0.0, 255.0) as u8; 3]);
    ColorImage::new(width, height, pixels.collect()).unwrap()
}

fn noise(x: u32, y: u32, seed: u32) -> f64 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ seed;
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    f64::from((h ^ (h >> 15)) & 0xFFFF) / 65535.0
}

fn mean(map: &SharpnessMap) -> f64 {
    map.s3.iter().map(|&v| f64::from(v)).sum::<f64>() / map.s3.len() as f64
}

fn blurred(image: &ColorImage, sigma: f64) -> ColorImage {
    let (width, height) = (image.width() as i64, image.height() as i64);
    let reach = (3.0 * sigma).ceil() as i64;
    let weight = |d: i64| (-(d * d) as f64 / (2.0 * sigma * sigma)).exp();
    let total: f64 = (-reach..=reach).map(weight).sum();
    let along = |from: &dyn Fn(i64, i64) -> f64, x: i64, y: i64, is_row: bool| -> f64 {
        let at = |d: i64| {
            if is_row {
                from((x + d).clamp(0, width - 1), y)
            } else {
                from(x, (y + d).clamp(0, height - 1))
            }
        };
        (-reach..=reach).map(|d| weight(d) * at(d)).sum::<f64>() / total
    };
    let source = |x: i64, y: i64| f64::from(image.pixels()[(y * width + x) as usize][0]);
    let rows: Vec<f64> = (0..width * height)
        .map(|i| along(&source, i % width, i / width, true))
        .collect();
    let from_rows = |x: i64, y: i64| rows[(y * width + x) as usize];
    grey(image.width(), image.height(), |x, y| {
        along(&from_rows, i64::from(x), i64::from(y), false)
    })
}

#[test]
fn a_flat_image_has_no_sharpness() {
    for value in [0.0, 128.0, 255.0] {
        let map = sharpness_map(&grey(70, 45, |_, _| value));
        assert_eq!((map.width, map.height), (70, 45));
        assert!(map.s3.iter().all(|&v| v == 0.0));
    }
}

#[test]
fn variation_is_the_share_of_a_checkerboards() {
    let block = |of: fn(usize, usize) -> f64| -> [[f64; 8]; 8] {
        std::array::from_fn(|y| std::array::from_fn(|x| of(x, y)))
    };
    assert_eq!(
        largest_variation(&block(|x, y| 255.0 * ((x + y) % 2) as f64)),
        1.0
    );
    // A straight edge crosses four of six pairs.
    let edge = largest_variation(&block(|x, _| if x < 3 { 40.0 } else { 91.0 }));
    assert!((edge - 51.0 / 255.0).abs() < 1e-12);
    // A lone corner differs from three neighbours.
    let corner = largest_variation(&block(|x, y| if x == 7 && y == 7 { 255.0 } else { 0.0 }));
    assert_eq!(corner, 0.75);
}

#[test]
fn rings_average_the_spectrum() {
    for radius in 1..=NUM_RADII {
        let total: f64 = ring(radius).iter().map(|(_, weight)| weight).sum();
        assert!((total - 1.0).abs() < 1e-12);
    }
    // The origin never counts.
    assert!(ring(1).iter().all(|&(at, _)| at != 0));
}

#[test]
fn the_slope_is_the_exponent_of_the_spectrum() {
    let spectrum = BlockSpectrum::new();
    let mut workspace = spectrum.workspace();
    for exponent in [0.0, 1.0, 2.0] {
        let mut slopes = 0.0;
        let num_blocks = 8;
        for seed in 0..num_blocks {
            // Waves of random phase; the magnitude falls with the frequency.
            let size = 64.0;
            let mut block = [[0.0; BLOCK_PX]; BLOCK_PX];
            for u in 0i32..=31 {
                for v in -31i32..=31 {
                    let frequency = f64::from(u * u + v * v).sqrt();
                    if frequency == 0.0 || (u == 0 && v < 0) {
                        continue;
                    }
                    let phase = noise(u as u32, (v + 40) as u32, seed) * std::f64::consts::TAU;
                    let magnitude = frequency.powf(-exponent);
                    for (y, row) in block.iter_mut().enumerate() {
                        for (x, value) in row.iter_mut().enumerate() {
                            let turn = (f64::from(u) * x as f64 + f64::from(v) * y as f64) / size;
                            *value += magnitude * (std::f64::consts::TAU * turn + phase).cos();
                        }
                    }
                }
            }
            slopes += spectrum.slope(&block, &mut workspace);
        }
        let slope = slopes / f64::from(num_blocks);
        // The window smears steep spectra a little.
        assert!((slope - exponent).abs() < 0.35, "{slope} for {exponent}");
    }
}

#[test]
fn blur_lowers_sharpness_step_by_step() {
    let sharp = grey(160, 96, |x, y| {
        let tile = noise(x / 11, y / 7, 3);
        40.0 + 150.0 * tile + 40.0 * noise(x, y, 9)
    });
    let mut last = mean(&sharpness_map(&sharp));
    assert!(last > 0.3, "{last}");
    // Beyond this, what is left of fine detail is the rounding to whole steps.
    for sigma in [0.6, 1.0, 1.6] {
        let value = mean(&sharpness_map(&blurred(&sharp, sigma)));
        assert!(value < 0.9 * last, "σ {sigma}: {value} after {last}");
        last = value;
    }
}

#[test]
fn only_what_is_near_a_pixel_counts() {
    let left_sharp = grey(
        128,
        64,
        |x, y| if x < 64 { 255.0 * noise(x, y, 4) } else { 90.0 },
    );
    let map = sharpness_map(&left_sharp);
    for y in 0..64 {
        for x in 0..40 {
            assert!(map.at(x, y) > 0.6, "{x} {y}: {}", map.at(x, y));
        }
        for x in 90..128 {
            assert_eq!(map.at(x, y), 0.0);
        }
    }
}

#[test]
fn any_size_has_a_map_and_threads_do_not_matter() {
    for (width, height) in [(1, 1), (3, 50), (37, 9), (64, 33)] {
        let image = grey(width, height, |x, y| 255.0 * noise(x, y, 5));
        let map = sharpness_map(&image);
        assert_eq!(map.s3.len(), (width * height) as usize);
        assert!(map.s3.iter().all(|v| (0.0..=1.0).contains(v)));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
        let one = pool.build().unwrap().install(|| sharpness_map(&image));
        assert_eq!(one, map);
    }
}
