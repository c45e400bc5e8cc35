//! Alignment of images whose offset is known.

use super::*;

/// A smooth random scene at any real position: octaves of value noise, so that a shift by a
/// fraction of a pixel is exact.
fn scene(x: f64, y: f64, channel: usize) -> f64 {
    let mut sum = 0.0;
    for (octave, scale) in [3.7, 9.1, 23.0, 61.0].into_iter().enumerate() {
        let (u, v) = (x / scale, y / scale);
        let (u0, v0) = (u.floor(), v.floor());
        let smooth = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
        let (fu, fv) = (smooth(u - u0), smooth(v - v0));
        let at = |du: f64, dv: f64| lattice((u0 + du) as i64, (v0 + dv) as i64, octave, channel);
        let top = at(0.0, 0.0) + fu * (at(1.0, 0.0) - at(0.0, 0.0));
        let bottom = at(0.0, 1.0) + fu * (at(1.0, 1.0) - at(0.0, 1.0));
        sum += top + fv * (bottom - top);
    }
    20.0 + 50.0 * sum
}

fn lattice(x: i64, y: i64, octave: usize, channel: usize) -> f64 {
    let mut h = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ (y as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F)
        ^ ((octave * 3 + channel) as u64).wrapping_mul(0x1656_67B1_9E37_79F9);
    h = (h ^ (h >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((h >> 40) & 0xFFFF) as f64 / 65_535.0
}

/// `picture(x) = scene(x − offset)`: the scene moved by the offset.
fn picture(width: u32, height: u32, [dx, dy]: [f64; 2], tone: [f64; 2]) -> ColorImage {
    let pixels = (0..width * height)
        .map(|i| {
            let (x, y) = (f64::from(i % width) - dx, f64::from(i / width) - dy);
            std::array::from_fn(|c| {
                (tone[0] * scene(x, y, c) + tone[1])
                    .round()
                    .clamp(0.0, 255.0) as u8
            })
        })
        .collect();
    ColorImage::new(width, height, pixels).unwrap()
}

/// Blocks that hide about `share` of the picture.
fn holes(width: u32, height: u32, share: f64) -> Vec<bool> {
    (0..width * height)
        .map(|i| {
            let (x, y) = (i64::from(i % width / 20), i64::from(i / width / 20));
            lattice(x, y, 9, 0) >= share
        })
        .collect()
}

fn painted_over(image: &ColorImage, mask: &[bool]) -> ColorImage {
    let pixels = image.pixels().iter().zip(mask);
    let pixels = pixels
        .map(|(p, &keep)| if keep { *p } else { [0, 255, 0] })
        .collect();
    ColorImage::new(image.width(), image.height(), pixels).unwrap()
}

fn assert_near(found: Alignment, expected: [f64; 2], tolerance_px: f64) {
    assert!(found.is_trusted, "{found:?} for {expected:?}");
    for (found_px, expected) in found.offset_px.iter().zip(expected) {
        let error = (f64::from(*found_px) - expected).abs();
        assert!(error <= tolerance_px, "{found:?} for {expected}");
    }
}

#[test]
fn whole_shifts_are_exact_in_every_form() {
    let render = picture(320, 240, [0.0, 0.0], [1.0, 0.0]);
    for offset in [[0.0, 0.0], [5.0, -3.0], [-15.0, 11.0], [1.0, 10.0]] {
        let photo = picture(320, 240, offset, [1.0, 0.0]);
        for form in [AlignForm::Reference, AlignForm::Refined, AlignForm::Phase] {
            let params = AlignParams {
                form,
                ..AlignParams::default()
            };
            let found = align(&photo, &render, None, &params).unwrap();
            let tolerance = if form == AlignForm::Reference {
                0.0
            } else {
                0.03
            };
            assert_near(found, offset, tolerance);
            assert_eq!(found.whole_px(), offset.map(|o| o as i32), "{form:?}");
        }
    }
}

#[test]
fn parts_of_a_pixel_are_found_at_any_size_and_tone() {
    for (width, height) in [(160, 120), (640, 480), (1000, 701)] {
        let render = picture(width, height, [0.0, 0.0], [1.0, 0.0]);
        for (offset, tone) in [
            ([0.3, -0.5], [1.0, 0.0]),
            ([-2.75, 3.4], [0.7, 30.0]),
            ([4.5, 0.1], [1.1, -15.0]),
        ] {
            let photo = picture(width, height, offset, tone);
            let found = align(&photo, &render, None, &AlignParams::default()).unwrap();
            assert_near(found, offset, 0.05);
        }
    }
}

#[test]
fn thirty_percent_of_holes_do_not_matter() {
    let (width, height) = (640, 480);
    let mask = holes(width, height, 0.3);
    let hidden = mask.iter().filter(|keep| !**keep).count() as f64 / mask.len() as f64;
    assert!((0.25..0.4).contains(&hidden), "{hidden}");
    let render = painted_over(&picture(width, height, [0.0, 0.0], [1.0, 0.0]), &mask);
    for offset in [[7.25, -4.5], [-20.6, 13.2], [0.0, 0.4]] {
        let photo = picture(width, height, offset, [0.9, 10.0]);
        let found = align(&photo, &render, Some(&mask), &AlignParams::default()).unwrap();
        assert_near(found, offset, 0.1);
    }
}

#[test]
fn what_the_rendering_lacks_is_weighed_down() {
    let (width, height) = (640, 480);
    let render = picture(width, height, [0.0, 0.0], [1.0, 0.0]);
    let photo = picture(width, height, [3.3, -2.2], [1.0, 0.0]);
    // A stranger before the camera: a quarter of the photo shows another scene.
    let stranger = picture(width, height, [500.0, 900.0], [1.0, 0.0]);
    let pixels = (0..width * height)
        .map(|i| {
            let is_stranger = i % width < width / 2 && i / width < height / 2;
            let from = if is_stranger { &stranger } else { &photo };
            from.pixels()[i as usize]
        })
        .collect();
    let photo = ColorImage::new(width, height, pixels).unwrap();
    let found = align(&photo, &render, None, &AlignParams::default()).unwrap();
    assert_near(found, [3.3, -2.2], 0.1);
}

#[test]
fn offsets_out_of_bounds_and_pictures_of_nothing_are_not_trusted() {
    let render = picture(320, 240, [0.0, 0.0], [1.0, 0.0]);
    let far = picture(320, 240, [40.0, 0.0], [1.0, 0.0]);
    let other = picture(320, 240, [5000.0, 777.0], [1.0, 0.0]);
    let flat = ColorImage::new(320, 240, vec![[90; 3]; 320 * 240]).unwrap();
    let tiny = ColorImage::new(1, 1, vec![[9; 3]]).unwrap();
    let params = AlignParams::default();
    for (photo, render) in [
        (&other, &render),
        (&flat, &render),
        (&render, &flat),
        (&tiny, &tiny),
    ] {
        let found = align(photo, render, None, &params).unwrap();
        assert_eq!(
            (found.is_trusted, found.offset_px),
            (false, [0.0; 2]),
            "{found:?}"
        );
    }
    let reference = AlignParams {
        form: AlignForm::Reference,
        ..params
    };
    let found = align(&far, &render, None, &reference).unwrap();
    assert_eq!(found, Alignment::UNKNOWN);
    let nothing = vec![false; 320 * 240];
    assert!(
        !align(&render, &render, Some(&nothing), &params)
            .unwrap()
            .is_trusted
    );
    assert!(align(&far, &tiny, None, &params).is_err());
    assert!(align(&far, &render, Some(&[true]), &params).is_err());
    let unbounded = AlignParams {
        max_offset_share: 0.0,
        ..params
    };
    assert!(align(&far, &render, None, &unbounded).is_err());
}

#[test]
fn any_thread_count_finds_the_same_bits() {
    let mask = holes(500, 333, 0.3);
    let render = painted_over(&picture(500, 333, [0.0, 0.0], [1.0, 0.0]), &mask);
    let photo = picture(500, 333, [2.6, 1.7], [0.8, 20.0]);
    let with = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build()
            .unwrap();
        pool.install(|| {
            [AlignForm::Reference, AlignForm::Refined, AlignForm::Phase].map(|form| {
                let params = AlignParams {
                    form,
                    ..AlignParams::default()
                };
                align(&photo, &render, Some(&mask), &params).unwrap()
            })
        })
    };
    assert_eq!(with(1), with(2));
    assert_eq!(with(1), with(5));
}

/// The transform against its definition.
#[test]
fn transforms_are_those_of_the_definition() {
    for (width, height) in [(12, 10), (9, 15), (20, 1)] {
        let plane: Vec<f32> = (0..width * height)
            .map(|i| lattice(i as i64, 7, 0, 0) as f32)
            .collect();
        let fft = fft2::Fft2::new(width, height);
        let spectrum = fft.forward(&plane);
        for (index, found) in spectrum.iter().enumerate() {
            let (kx, ky) = (index / height, index % height);
            let (mut re, mut im) = (0.0, 0.0);
            for (at, &value) in plane.iter().enumerate() {
                let turns = (kx * (at % width)) as f64 / width as f64
                    + (ky * (at / width)) as f64 / height as f64;
                re += f64::from(value) * (std::f64::consts::TAU * turns).cos();
                im -= f64::from(value) * (std::f64::consts::TAU * turns).sin();
            }
            let error = (f64::from(found.re) - re).hypot(f64::from(found.im) - im);
            assert!(
                error < 1e-3,
                "{width}x{height} at {kx},{ky}: {found} for {re} {im}"
            );
        }
        let back = fft.inverse(spectrum);
        for (a, b) in plane.iter().zip(back) {
            assert!((a - b / (width * height) as f32).abs() < 1e-5);
        }
    }
}

#[test]
fn a_large_pair_goes_through_all_sizes() {
    let (width, height) = (1920, 1440);
    let mask = holes(width, height, 0.3);
    let render = painted_over(&picture(width, height, [0.0, 0.0], [1.0, 0.0]), &mask);
    let photo = picture(width, height, [31.4, -17.3], [1.0, 0.0]);
    let found = align(&photo, &render, Some(&mask), &AlignParams::default()).unwrap();
    assert_near(found, [31.4, -17.3], 0.05);
}
