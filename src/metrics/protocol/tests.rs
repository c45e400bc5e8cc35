use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::texsmooth::align::AlignForm;

const SIZE: [u32; 2] = [96, 72];

fn texture(x: i64, y: i64) -> [u8; 3] {
    let value = |scale: i64, seed: i64| {
        let mut h =
            (x.div_euclid(scale) * 0x9E37_79B1) ^ (y.div_euclid(scale) * 0x85EB_CA77) ^ seed;
        h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
        (h >> 9) & 0x7F
    };
    let [r, g, b] = [1, 2, 3].map(|c| value(7, c) + value(2, 10 + c) / 2);
    [r as u8, g as u8, b as u8]
}

fn picture(of: impl Fn(i64, i64) -> [u8; 3]) -> ColorImage {
    let [width, height] = SIZE.map(i64::from);
    let pixels = (0..width * height).map(|i| of(i % width, i / width));
    ColorImage::new(SIZE[0], SIZE[1], pixels.collect()).unwrap()
}

fn view(of: impl Fn(i64, i64) -> Option<[u8; 3]>) -> MethodView {
    let render = picture(|x, y| of(x, y).unwrap_or_default());
    let [width, height] = SIZE.map(i64::from);
    let mask = (0..width * height).map(|i| of(i % width, i / width).is_some());
    MethodView {
        render,
        mask: mask.collect(),
    }
}

fn reference_form() -> AlignParams {
    AlignParams {
        form: AlignForm::Reference,
        ..AlignParams::default()
    }
}

#[test]
fn shifted_renderings_are_perfect_once_aligned() {
    let photo = picture(texture);
    // render(x) shows photo(x + d).
    let methods =
        [[3, -2], [-4, 1], [0, 0]].map(|[dx, dy]| view(|x, y| Some(texture(x + dx, y + dy))));
    let scores = score_view(&photo, &methods, &reference_form(), None).unwrap();
    let offsets: Vec<_> = scores
        .scores
        .iter()
        .map(|s| s.alignment.offset_px)
        .collect();
    assert_eq!(offsets, [[3.0, -2.0], [-4.0, 1.0], [0.0, 0.0]]);
    let expected = Cut {
        x: 3,
        y: 1,
        width: 96 - 7,
        height: 72 - 3,
    };
    assert_eq!(scores.cut, expected);
    assert_eq!(scores.common_share, 1.0);
    for (score, render) in scores.scores.iter().zip(&scores.renders) {
        assert_eq!(render, &scores.photo);
        assert_eq!(score.coverage, 1.0);
        assert!((score.ssim.unwrap() - 1.0).abs() < 1e-12);
        assert!((score.ssim_uniform.unwrap() - 1.0).abs() < 1e-12);
        assert_eq!((score.s3, score.grad, score.psnr_db), (0.0, 0.0, None));
        assert_eq!(score.lpips, None);
    }
    // The maps of whole images differ at the borders only.
    assert!(scores.scores[2].s3_whole == 0.0 && scores.scores[0].s3_whole < 0.2);
    for pixel in [[0, 0], [40, 33]] {
        let at = |image: &ColorImage| image.pixel_clamped(pixel[0], pixel[1]);
        let source = texture(i64::from(pixel[0]) + 3, i64::from(pixel[1]) + 1);
        assert_eq!(at(&scores.photo), source);
    }
}

#[test]
fn what_one_method_lacks_is_left_out_of_all() {
    let photo = picture(texture);
    let holes = |hole: fn(i64, i64) -> bool| view(|x, y| (!hole(x, y)).then(|| texture(x, y)));
    let methods = [
        holes(|x, _| x < 10),
        holes(|x, y| x > 80 && y > 60),
        // Wrong where the others have holes: it must not matter.
        view(|x, y| {
            Some(if x < 10 || (x > 80 && y > 60) {
                [255; 3]
            } else {
                texture(x, y)
            })
        }),
    ];
    let scores = score_view(&photo, &methods, &reference_form(), None).unwrap();
    let num_common = 96 * 72 - 10 * 72 - 15 * 11;
    assert_eq!(scores.common_share, f64::from(num_common) / (96.0 * 72.0));
    for (score, render) in scores.scores.iter().zip(&scores.renders) {
        assert_eq!(render, &scores.photo);
        assert_eq!(score.psnr_db, None);
        assert!((score.ssim.unwrap() - 1.0).abs() < 1e-12);
    }
    assert_eq!(scores.photo.pixel_clamped(3, 3), [0; 3]);
    let coverage: Vec<_> = scores.scores.iter().map(|s| s.coverage).collect();
    assert_eq!(coverage[2], 1.0);
    assert!((coverage[0] - 86.0 / 96.0).abs() < 1e-12);
}

#[test]
fn a_worse_rendering_scores_worse() {
    let photo = picture(texture);
    let noisy = |amount: i64| {
        view(|x, y| {
            let [r, g, b] = texture(x, y).map(i64::from);
            let wobble = ((x * 7 + y * 13) % 5 - 2) * amount;
            Some([r, g, b].map(|v| (v + wobble).clamp(0, 255) as u8))
        })
    };
    let methods = [noisy(1), noisy(4), noisy(12)];
    let scores = score_view(&photo, &methods, &reference_form(), None)
        .unwrap()
        .scores;
    for pair in scores.windows(2) {
        assert!(pair[0].ssim > pair[1].ssim && pair[0].ssim_uniform > pair[1].ssim_uniform);
        assert!(pair[0].grad < pair[1].grad && pair[0].psnr_db > pair[1].psnr_db);
        assert!(pair[0].s3 <= pair[1].s3);
    }
}

#[test]
fn nothing_and_misfits_are_refused() {
    let photo = picture(texture);
    let none = score_view(&photo, &[], &reference_form(), None);
    assert!(matches!(none, Err(ProtocolError::NoRender)));
    let mut short = view(|x, y| Some(texture(x, y)));
    short.mask.pop();
    let misfit = score_view(&photo, &[short], &reference_form(), None);
    assert!(matches!(
        misfit,
        Err(ProtocolError::Metric(MetricError::Mask { .. }))
    ));
    assert_eq!(common_cut([10, 10], &[[6, 0], [-6, 0]]), None);
}

#[test]
fn the_nearest_camera_is_found_by_its_turn() {
    let turned = |degrees: f64| {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), degrees.to_radians());
        RigidTransform::from_parts(rotation, Vector3::new(degrees, 0.0, 0.0))
    };
    let others = [10.0, -4.0, 179.0].map(turned);
    let nearest = nearest_angle_rad(&turned(1.0), others.iter()).unwrap();
    assert!((nearest.to_degrees() - 5.0).abs() < 1e-9);
    assert_eq!(nearest_angle_rad(&turned(1.0), [].iter()), None);
}
