use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::geom::color::srgb_from_linear;
use crate::geom::{
    CameraModel, ColorEncoding, ColorImage, DepthImage, EncodedColor, PinholeCamera,
    RigidTransform, Stamp,
};
use crate::keyframe::{DecodedDepth, FrameQuality, KeyframeId};

const WALL_M: f64 = 2.0;

fn albedo(x: f64, y: f64) -> [f64; 3] {
    [
        0.25 + 0.08 * (2.0 * x).sin() * (3.0 * y).cos(),
        0.22 + 0.05 * (1.5 * x - 2.0 * y).sin(),
        0.28 + 0.03 * x,
    ]
}

/// A wall at z = 2 from (`x_m`, 0, 0), with the light times `gain`. The left third of it is another
/// thing in this frame where `has_stranger`.
fn photograph(id: u32, x_m: f64, gain: [f64; 3], has_stranger: bool) -> (Keyframe, DecodedFrame) {
    let camera = PinholeCamera::new([200.0, 200.0, 119.5, 89.5], 240, 180).unwrap();
    let mut pixels = vec![];
    for y in 0..180 {
        for x in 0..240 {
            let point = camera.unproject([f64::from(x), f64::from(y)], WALL_M);
            let light = if has_stranger && x < 80 {
                [0.6, 0.1, 0.1]
            } else {
                albedo(point.x + x_m, point.y)
            };
            pixels.push([0, 1, 2].map(|c| srgb_from_linear((light[c] * gain[c]) as f32)));
        }
    }
    let raw = vec![0; 240 * 180];
    let keyframe = Keyframe {
        id: KeyframeId(id),
        stamp: Stamp::from_nanos(0),
        world_from_camera: RigidTransform::from_parts(
            UnitQuaternion::identity(),
            Vector3::new(x_m, 0.0, 0.0),
        ),
        color: EncodedColor::from_raw(ColorEncoding::Mono8, 240, 180, 240, raw.into()).unwrap(),
        color_camera: CameraModel::ideal(camera),
        depth: None,
        quality: FrameQuality::default(),
    };
    // The depth camera is 5 cm to the right and has half the pixels.
    let decoded = DecodedFrame {
        color: ColorImage::new(240, 180, pixels).unwrap(),
        color_camera: camera,
        depth: Some(DecodedDepth {
            image: DepthImage::new(120, 90, vec![WALL_M as f32; 120 * 90]).unwrap(),
            camera: PinholeCamera::new([100.0, 100.0, 59.5, 44.5], 120, 90).unwrap(),
            depth_from_color: RigidTransform::from_parts(
                UnitQuaternion::identity(),
                Vector3::new(-0.05, 0.0, 0.0),
            ),
        }),
    };
    (keyframe, decoded)
}

fn gained<'a>(
    (keyframe, decoded): &'a (Keyframe, DecodedFrame),
    factors: [f32; 3],
) -> GainedFrame<'a> {
    GainedFrame {
        keyframe,
        decoded,
        factors,
    }
}

fn worst(found: Option<[f32; 3]>, expected: [f64; 3]) -> f64 {
    let found = found.expect("a gain");
    (0..3)
        .map(|c| (f64::from(found[c]) / expected[c] - 1.0).abs())
        .fold(0.0, f64::max)
}

#[test]
fn a_known_gain_is_undone_within_a_percent() {
    let new = photograph(2, 0.3, [1.3, 0.8, 1.1], false);
    let old = photograph(1, 0.0, [0.9, 1.1, 1.0], false);
    let factors = [1.0 / 0.9, 1.0 / 1.1, 1.0];
    let others = [gained(&old, factors)];
    let found = gain_of_frame(&new.0, &new.1, &others, &GainParams::default());
    let error = worst(found, [1.0 / 1.3, 1.0 / 0.8, 1.0 / 1.1]);
    assert!(error < 0.01, "{error}");
}

#[test]
fn something_else_in_a_third_of_the_photo_changes_little() {
    let new = photograph(2, 0.1, [1.2, 0.9, 1.0], true);
    let olds = [0.0, -0.2].map(|x_m| photograph(1, x_m, [1.0; 3], false));
    let others = olds.each_ref().map(|old| gained(old, [1.0; 3]));
    let found = gain_of_frame(&new.0, &new.1, &others, &GainParams::default());
    let error = worst(found, [1.0 / 1.2, 1.0 / 0.9, 1.0]);
    assert!(error < 0.03, "{error}");
}

#[test]
fn views_without_common_points_say_nothing() {
    let new = photograph(2, 0.0, [1.3, 0.8, 1.1], false);
    let far = photograph(1, 5.0, [1.0; 3], false);
    let mut blind = photograph(1, 0.0, [1.0; 3], false);
    blind.1.depth = None;
    let mut nearer = photograph(1, 0.0, [1.0; 3], false);
    let depth = nearer.1.depth.as_mut().expect("made with one");
    depth.image = DepthImage::new(120, 90, vec![1.0; 120 * 90]).unwrap();
    for other in [&far, &blind, &nearer] {
        let others = [gained(other, [1.0; 3])];
        let found = gain_of_frame(&new.0, &new.1, &others, &GainParams::default());
        assert_eq!(found, None);
    }
    assert_eq!(
        gain_of_frame(&blind.0, &blind.1, &[], &GainParams::default()),
        None
    );
}

#[test]
fn a_gain_is_bounded() {
    let new = photograph(2, 0.0, [0.3; 3], false);
    let old = photograph(1, 0.1, [1.0; 3], false);
    let params = GainParams {
        max_log_gain: 0.5,
        ..GainParams::default()
    };
    let found = gain_of_frame(&new.0, &new.1, &[gained(&old, [1.0; 3])], &params);
    let error = worst(found, [0.5f64.exp(); 3]);
    assert!(error < 1e-6, "{error}");
}
