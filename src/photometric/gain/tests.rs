use nalgebra::{Point3, Vector3};

use super::*;
use crate::geom::{CameraModel, ColorEncoding, EncodedColor, PinholeCamera, RigidTransform, Stamp};
use crate::keyframe::FrameQuality;

/// A floor at z = 2 before cameras that look along z.
fn floor() -> TriMesh {
    let positions = [[-3.0, -2.0], [3.0, -2.0], [3.0, 2.0], [-3.0, 2.0]]
        .map(|[x, y]| Point3::new(x, y, 2.0))
        .to_vec();
    TriMesh::from_soup(positions, vec![[0, 2, 1], [0, 3, 2]])
        .unwrap()
        .0
}

fn albedo(x: f64, y: f64) -> [f64; 3] {
    [
        0.25 + 0.08 * (2.0 * x).sin() * (3.0 * y).cos(),
        0.22 + 0.05 * (1.5 * x - 2.0 * y).sin(),
        0.28 + 0.03 * x,
    ]
}

struct Scene {
    mesh: TriMesh,
    keyframes: Vec<Arc<Keyframe>>,
    frames: Vec<Arc<DecodedFrame>>,
}

/// Cameras along x, each multiplying the light with its gain; `outlier` replaces what it hits.
fn photograph(gains: &[[f64; 3]], outlier: impl Fn(usize, f64, f64) -> Option<[f64; 3]>) -> Scene {
    let camera = PinholeCamera::new([100.0, 100.0, 59.5, 44.5], 120, 90).unwrap();
    let mut scene = Scene {
        mesh: floor(),
        keyframes: vec![],
        frames: vec![],
    };
    for (index, gain) in gains.iter().enumerate() {
        let position = Vector3::new(-1.2 + 2.4 * index as f64 / gains.len() as f64, 0.0, 0.0);
        let mut pixels = vec![];
        for y in 0..90 {
            for x in 0..120 {
                let point = camera.unproject([f64::from(x), f64::from(y)], 2.0).coords + position;
                let light =
                    outlier(index, point.x, point.y).unwrap_or_else(|| albedo(point.x, point.y));
                pixels.push([0, 1, 2].map(|c| srgb_from_linear((light[c] * gain[c]) as f32)));
            }
        }
        let bytes = vec![0; 120 * 90];
        scene.keyframes.push(Arc::new(Keyframe {
            id: KeyframeId(10 + index as u32),
            stamp: Stamp::from_nanos(0),
            world_from_camera: RigidTransform::from_parts(
                nalgebra::UnitQuaternion::identity(),
                position,
            ),
            color: EncodedColor::from_raw(ColorEncoding::Mono8, 120, 90, 120, bytes.into())
                .unwrap(),
            color_camera: CameraModel::ideal(camera),
            depth: None,
            quality: FrameQuality::default(),
        }));
        scene.frames.push(Arc::new(DecodedFrame {
            color: ColorImage::new(120, 90, pixels).unwrap(),
            color_camera: camera,
            depth: None,
        }));
    }
    scene
}

impl Scene {
    fn estimate(&self, params: &GainParams) -> (GainTable, GainReport) {
        let decode = |keyframe: &Keyframe| Ok(self.frames[keyframe.id.0 as usize - 10].clone());
        estimate_gains(&self.mesh, &self.keyframes, &decode, params, &|_| ()).unwrap()
    }

    /// Largest relative error of the factors, both normalised to a geometric mean of 1.
    fn error(&self, table: &GainTable, gains: &[[f64; 3]]) -> f64 {
        let mut worst: f64 = 0.0;
        for c in 0..3 {
            let logs: Vec<f64> = gains.iter().map(|gain| gain[c].ln()).collect();
            let mean = logs.iter().sum::<f64>() / logs.len() as f64;
            for (log, keyframe) in logs.iter().zip(&self.keyframes) {
                let found = f64::from(table.factors(keyframe.id)[c]);
                worst = worst.max((found * (log - mean).exp() - 1.0).abs());
            }
        }
        worst
    }
}

fn gains() -> Vec<[f64; 3]> {
    (0..12)
        .map(|i| {
            let t = f64::from(i);
            [
                1.0 + 0.4 * (1.3 * t).sin(),
                1.0 + 0.3 * (0.9 * t + 1.0).cos(),
                1.1 + 0.35 * (2.1 * t).sin(),
            ]
        })
        .collect()
}

#[test]
fn known_gains_are_found_within_a_percent() {
    let scene = photograph(&gains(), |_, _, _| None);
    let (table, report) = scene.estimate(&GainParams::default());
    assert!(
        report.num_samples > 10_000 && report.num_unlinked == 0,
        "{report:?}"
    );
    let error = scene.error(&table, &gains());
    assert!(error < 0.01, "{error}");
    assert!(
        report.median_after < 0.1 * report.median_before,
        "{report:?}"
    );
    let uncorrected = scene.error(&GainTable::default(), &gains());
    assert!(uncorrected > 0.3);
}

#[test]
fn a_fifth_of_wrong_colours_does_not_matter() {
    // In every frame other stripes, twice as bright or half as bright as what is there.
    let wrong = |frame: usize, x: f64, y: f64| {
        let stripe = (5.0 * (x + 0.7 * y) + frame as f64 * 0.618).rem_euclid(1.0);
        let factor = match stripe {
            s if s < 0.15 => 1.9,
            s if s < 0.20 => 0.5,
            _ => return None,
        };
        Some(albedo(x, y).map(|light| light * factor))
    };
    let scene = photograph(&gains(), wrong);
    let (table, _) = scene.estimate(&GainParams::default());
    let error = scene.error(&table, &gains());
    assert!(error < 0.01, "{error}");
}

#[test]
fn threads_do_not_change_the_bits() {
    let scene = photograph(&gains()[..10], |_, _, _| None);
    let with = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build()
            .unwrap();
        pool.install(|| scene.estimate(&GainParams::default()))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn what_shares_nothing_keeps_its_colours() {
    let one = photograph(&[[1.5; 3]], |_, _, _| None);
    let (table, report) = one.estimate(&GainParams::default());
    assert_eq!(table.factors(KeyframeId(10)), [1.0; 3]);
    assert_eq!((report.num_samples, report.num_unlinked), (0, 1));

    let mut none = photograph(&gains()[..3], |_, _, _| None);
    none.mesh = TriMesh::default();
    assert_eq!(none.estimate(&GainParams::default()).1.num_points, 0);
    none.keyframes.clear();
    none.mesh = floor();
    assert_eq!(
        none.estimate(&GainParams::default()).0,
        GainTable::default()
    );

    let white = photograph(&[[100.0; 3]; 2], |_, _, _| None);
    assert_eq!(white.estimate(&GainParams::default()).1.num_samples, 0);
}

#[test]
fn gains_stay_within_their_bound() {
    let gains = [[0.3; 3], [1.0; 3], [2.4; 3]];
    let scene = photograph(&gains, |_, _, _| None);
    let params = GainParams {
        max_log_gain: 0.5,
        ..GainParams::default()
    };
    let (_, report) = scene.estimate(&params);
    let [low, high] = report.factor_range.map(f64::from);
    assert!(
        (high.ln() - 0.5).abs() < 1e-6 && (low.ln() + 0.5).abs() < 1e-6,
        "{report:?}"
    );
    let refused = GainParams {
        robust_scale: f64::NAN,
        ..params
    };
    let decode = |_: &Keyframe| Ok(scene.frames[0].clone());
    let error = estimate_gains(&scene.mesh, &scene.keyframes, &decode, &refused, &|_| ());
    assert!(error.is_err());
}

#[test]
fn corrected_frames_are_the_same_with_and_without_memory() {
    use super::super::CorrectedFrames;
    let scene = photograph(&[[1.2, 1.0, 0.8]; 3], |_, _, _| None);
    let factors = [[0.9, 1.0, 1.1], [1.0; 3], [1.2, 0.8, 1.0]];
    let table = GainTable::new(scene.keyframes.iter().map(|k| k.id).zip(factors));
    let num_decoded = std::sync::atomic::AtomicUsize::new(0);
    let decode = |keyframe: &Keyframe| {
        num_decoded.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        Ok(scene.frames[keyframe.id.0 as usize - 10].clone())
    };
    let num_bytes = size_of_val(scene.frames[0].color.pixels());
    for (max_bytes, expected_decodes) in [(0, 12), (num_bytes, 11), (2 * num_bytes, 6)] {
        num_decoded.store(0, std::sync::atomic::Ordering::Relaxed);
        let frames = CorrectedFrames::new(&decode, &table, max_bytes);
        for (round, index) in [0, 0, 1, 2, 1, 0, 1, 2, 0, 2, 0, 1].into_iter().enumerate() {
            let frame = frames.decode(&scene.keyframes[index]).unwrap();
            let linear = linear_table();
            for (old, new) in scene.frames[index]
                .color
                .pixels()
                .iter()
                .zip(frame.color.pixels())
            {
                for c in 0..3 {
                    let wanted = linear[usize::from(old[c])] * factors[index][c];
                    assert_eq!(new[c], srgb_from_linear(wanted), "round {round}");
                }
            }
        }
        let decoded = num_decoded.load(std::sync::atomic::Ordering::Relaxed);
        assert_eq!(decoded, expected_decodes, "{max_bytes}");
    }
}
