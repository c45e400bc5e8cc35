use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;
use rayon::prelude::*;

use super::*;
use crate::geom::{
    CameraModel, ColorImage, Distortion, EncodedDepth, PinholeCamera, RigidTransform, Stamp,
};

const WIDTH: u32 = 64;
const HEIGHT: u32 = 48;

fn camera(distortion: Distortion) -> CameraModel {
    CameraModel {
        pinhole: PinholeCamera::new([60.0, 60.0, 31.5, 23.5], WIDTH, HEIGHT).unwrap(),
        distortion,
    }
}

/// Cells of random brightness; `blur` averages over that many pixels to the right.
fn image(seed: u32, blur: u32) -> EncodedColor {
    let cell = |x: u32, y: u32| {
        ((x / 5 * 7919 + y / 4 * 104_729 + seed).wrapping_mul(2_654_435_761)) >> 24
    };
    let pixels = (0..WIDTH * HEIGHT)
        .map(|i| {
            let (x, y) = (i % WIDTH, i / WIDTH);
            let sum: u32 = (0..=blur).map(|k| cell(x + k, y)).sum();
            [u8::try_from(sum / (blur + 1)).unwrap(); 3]
        })
        .collect();
    EncodedColor::png_from_image(&ColorImage::new(WIDTH, HEIGHT, pixels).unwrap()).unwrap()
}

fn depth() -> FrameDepth {
    let depth_mm = vec![1500u16; (WIDTH * HEIGHT) as usize];
    FrameDepth {
        image: EncodedDepth::png_from_u16_mm(WIDTH, HEIGHT, &depth_mm).unwrap(),
        camera: camera(Distortion::None),
        depth_from_color: RigidTransform::identity(),
    }
}

/// Looks outwards at an angle from the middle of a round room.
fn frame(i: i64, angle_rad: f64, color: EncodedColor) -> PosedFrame {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle_rad);
    PosedFrame {
        stamp: Stamp::from_nanos(i * 100_000_000),
        world_from_camera: RigidTransform::from_parts(
            rotation,
            rotation * Vector3::new(0.0, 0.0, 0.2),
        ),
        color,
        color_camera: camera(Distortion::None),
        depth: Some(depth()),
    }
}

fn ids(store: &KeyframeStore) -> Vec<u32> {
    store.keyframes().map(|k| k.id.0).collect()
}

/// Largest angle between neighbouring kept views of the ring.
fn largest_gap_rad(store: &KeyframeStore) -> f64 {
    let mut angles: Vec<f64> = store
        .keyframes()
        .map(|k| {
            let axis = k.world_from_camera.rotation() * Vector3::z();
            axis.x.atan2(axis.z)
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    let wrapped = angles[0] + TAU;
    angles
        .iter()
        .skip(1)
        .chain([&wrapped])
        .zip(&angles)
        .map(|(b, a)| b - a)
        .fold(0.0, f64::max)
}

fn ring(budget_mb: f64) -> KeyframeStore {
    let mut store = KeyframeStore::new(&KeyframeParams {
        budget_mb,
        ..KeyframeParams::default()
    });
    for i in 0..108u32 {
        // Three rounds, each a little off the last.
        let angle = (f64::from(i) / 36.0 + f64::from(i / 36) * 0.01) * TAU;
        store.offer(frame(i64::from(i), angle, image(i, 0)));
    }
    store
}

#[test]
fn eviction_keeps_the_budget_and_the_ring() {
    let one = encoded_bytes(&image(0, 0), Some(&depth()));
    let unbounded = ring(512.0);
    assert!(unbounded.len() >= 36, "{:?}", unbounded.report());
    let budget_mb = 14.5 * one as f64 * 1e-6;
    let store = ring(budget_mb);
    assert!(store.num_bytes() as f64 <= budget_mb * 1e6);
    assert!(store.len() >= 12, "{:?}", store.report());
    assert!(store.report().num_evicted > 0);
    // Even spacing of 12 would be 30°; a view is 56° wide.
    let gap_rad = largest_gap_rad(&store);
    assert!(gap_rad.to_degrees() < 56.0, "{}", gap_rad.to_degrees());
    assert_eq!(ids(&store), ids(&ring(budget_mb)));
}

#[test]
fn the_last_view_of_a_place_stays() {
    let one = encoded_bytes(&image(0, 0), Some(&depth()));
    let mut store = KeyframeStore::new(&KeyframeParams {
        budget_mb: 6.5 * one as f64 * 1e-6,
        ..KeyframeParams::default()
    });
    let Admission::Kept(lonely) = store.offer(frame(0, TAU / 2.0, image(0, 0))) else {
        panic!("the first frame is kept");
    };
    for i in 1..40u32 {
        let angle = f64::from(i % 8) * 0.18 + f64::from(i / 8) * 0.05;
        store.offer(frame(i64::from(i) * 10, angle, image(i, 0)));
    }
    assert!(store.report().num_evicted + store.report().rejected_by_reason.len() as u64 > 0);
    assert!(store.keyframes().any(|k| k.id == lonely));
}

#[test]
fn a_sharper_frame_of_the_same_view_replaces_a_dull_one() {
    let mut store = KeyframeStore::new(&KeyframeParams::default());
    assert_eq!(
        store.offer(frame(0, 0.0, image(1, 4))),
        Admission::Kept(KeyframeId(0))
    );
    assert_eq!(
        store.offer(frame(1, 0.001, image(1, 4))),
        Admission::Rejected(RejectReason::SameView)
    );
    assert_eq!(
        store.offer(frame(2, 0.002, image(1, 0))),
        Admission::Replaced {
            id: KeyframeId(1),
            replaced: KeyframeId(0)
        }
    );
    assert_eq!(ids(&store), [1]);
}

#[test]
fn blurred_frames_go_unless_they_show_something_new() {
    let mut store = KeyframeStore::new(&KeyframeParams::default());
    for i in 0..8 {
        store.offer(frame(i, i as f64 * 0.5, image(1, 0)));
    }
    let blurred = Admission::Rejected(RejectReason::Blurred);
    assert_eq!(store.offer(frame(8, 1.75, image(1, 8))), blurred);
    let far = store.offer(frame(9, 5.0, image(1, 8)));
    assert!(matches!(far, Admission::Kept(_)), "{far:?}");
}

#[test]
fn sparse_frames_need_less_motion_and_a_camera_at_rest_gives_one() {
    let mut store = KeyframeStore::new(&KeyframeParams::default());
    for i in 0..20 {
        let _kept = store.offer(frame(i * 10, i as f64 * 0.03, image(1, 0)));
    }
    assert_eq!(store.len(), 20);
    for i in 0..20 {
        let _kept = store.offer(frame(1_000 + i * 10, 1.5, image(1, 0)));
    }
    assert_eq!(store.len(), 21);
}

#[test]
fn bad_images_are_refused_and_bad_depth_costs_only_itself() {
    let mut store = KeyframeStore::new(&KeyframeParams::default());
    let black = ColorImage::new(WIDTH, HEIGHT, vec![[0; 3]; (WIDTH * HEIGHT) as usize]);
    let black = EncodedColor::png_from_image(&black.unwrap()).unwrap();
    assert_eq!(
        store.offer(frame(0, 0.0, black)),
        Admission::Rejected(RejectReason::BadExposure)
    );
    let mut wrong_size = frame(0, 0.0, image(1, 0));
    wrong_size.color_camera.pinhole = wrong_size.color_camera.pinhole.resized(9, 9).unwrap();
    assert!(matches!(
        store.offer(wrong_size),
        Admission::Rejected(RejectReason::BadImage(ImageError::Length { .. }))
    ));
    let mut bytes = image(1, 0).bytes().to_vec();
    let middle = bytes.len() / 2;
    bytes[middle..].fill(0xff);
    if let Ok(broken) = EncodedColor::from_file(bytes.into()) {
        assert!(matches!(
            store.offer(frame(0, 0.0, broken)),
            Admission::Rejected(RejectReason::BadImage(_))
        ));
    }
    let mut bad_depth = frame(0, 0.0, image(1, 0));
    if let Some(half) = &mut bad_depth.depth {
        half.camera.pinhole = half.camera.pinhole.resized(9, 9).unwrap();
    }
    assert!(matches!(store.offer(bad_depth), Admission::Kept(_)));
    assert!(store.keyframes().all(|k| k.depth.is_none()));
    assert_eq!(store.report().num_depth_refused, 1);
    let mut store = KeyframeStore::new(&KeyframeParams {
        budget_mb: 1e-5,
        ..KeyframeParams::default()
    });
    assert_eq!(
        store.offer(frame(0, 0.0, image(1, 0))),
        Admission::Rejected(RejectReason::LargerThanBudget)
    );
}

#[test]
fn raw_images_are_stored_compressed_and_decode_to_the_same_pixels() {
    let recorded = image(3, 2).decode().unwrap();
    let raw = EncodedColor::from_raw(
        crate::geom::ColorEncoding::Rgb8,
        WIDTH,
        HEIGHT,
        WIDTH * 3,
        recorded.pixels().as_flattened().into(),
    )
    .unwrap();
    let mut store = KeyframeStore::new(&KeyframeParams::default());
    store.offer(frame(0, 0.0, raw.clone()));
    let keyframe = store.keyframes().next().unwrap().clone();
    assert!(keyframe.color.bytes().len() < raw.bytes().len());
    assert_eq!(store.decode(&keyframe).unwrap().color, recorded);
}

#[test]
fn decoding_does_not_depend_on_the_cache_nor_on_threads() {
    let distortion = Distortion::PlumbBob([-0.2, 0.05, 0.001, 0.0, 0.0]);
    let fill = |decode_cache_mb| {
        let mut store = KeyframeStore::new(&KeyframeParams {
            decode_cache_mb,
            ..KeyframeParams::default()
        });
        for i in 0..30u32 {
            let mut frame = frame(i64::from(i), f64::from(i) * 0.2, image(i, 0));
            frame.color_camera = camera(distortion);
            store.offer(frame);
        }
        store
    };
    let one_mb = 64.0 * 48.0 * 5.0 * 1e-6;
    let (none, some, all) = (fill(0.0), fill(20.0 * one_mb), fill(100.0));
    for _ in 0..3 {
        let decoded = |store: &KeyframeStore| -> Vec<Arc<DecodedFrame>> {
            let keyframes: Vec<_> = store.keyframes().cloned().collect();
            keyframes
                .par_iter()
                .map(|k| store.decode(k).unwrap())
                .collect()
        };
        let expected = decoded(&none);
        assert_eq!(decoded(&some), expected);
        assert_eq!(decoded(&all), expected);
    }
    assert_eq!(none.cache_report().num_decoded, 90);
    let some = some.cache_report();
    assert!(some.peak_bytes as f64 <= 20.0 * one_mb * 1e6 && some.num_decoded < 90);
    // Room for all depth images first: admission has decoded them.
    assert_eq!(
        (
            none.cache_report().num_depths_decoded,
            some.num_depths_decoded
        ),
        (90, 0)
    );
    assert!(all.cache_report().num_decoded < 60);
}

#[test]
fn a_stale_cache_takes_newcomers() {
    let mut store = KeyframeStore::new(&KeyframeParams {
        decode_cache_mb: 1.5 * 64.0 * 48.0 * 5.0 * 1e-6,
        ..KeyframeParams::default()
    });
    store.offer(frame(0, 0.0, image(0, 0)));
    store.offer(frame(1, 1.0, image(1, 0)));
    let keyframes: Vec<_> = store.keyframes().cloned().collect();
    store.decode(&keyframes[0]).unwrap();
    for _ in 0..200 {
        store.decode(&keyframes[1]).unwrap();
    }
    assert!(store.cache_report().num_decoded < 100);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_sequence_keeps_the_budget_and_the_counts(
        poses in prop::collection::vec((-3.2f64..3.2, 0i64..400, 0u32..6), 1..40),
        num_frames in 1.2f64..8.0,
    ) {
        let one = encoded_bytes(&image(0, 0), Some(&depth()));
        let budget_mb = num_frames * one as f64 * 1e-6;
        let mut store = KeyframeStore::new(&KeyframeParams {
            budget_mb,
            ..KeyframeParams::default()
        });
        for (angle, time, blur) in poses {
            store.offer(frame(time, angle, image(7, blur)));
            prop_assert!(store.num_bytes() as f64 <= budget_mb * 1e6);
            let held: usize = store
                .keyframes()
                .map(|k| encoded_bytes(&k.color, k.depth.as_ref()))
                .sum();
            prop_assert_eq!(held, store.num_bytes());
        }
        // The counts kept up to date equal the counts made anew.
        for stored in store.stored.values() {
            let mut counts = [0; NUM_SAMPLES];
            for other in store.stored.values().filter(|o| o.keyframe.id != stored.keyframe.id) {
                let shown = stored.view.shown_by(&other.view);
                for (i, count) in counts.iter_mut().enumerate() {
                    *count += shown >> i & 1;
                }
            }
            prop_assert_eq!(counts, stored.num_shown_by);
        }
        let report = store.report();
        let num_rejected: u64 = report.rejected_by_reason.values().sum();
        prop_assert_eq!(report.num_admitted + num_rejected, report.num_offered);
    }
}

#[test]
fn a_restored_store_goes_on_as_the_one_before() {
    let one = encoded_bytes(&image(0, 0), Some(&depth()));
    let budget_mb = 14.5 * one as f64 * 1e-6;
    let mut before = ring(budget_mb);
    let params = KeyframeParams {
        budget_mb,
        ..KeyframeParams::default()
    };
    let mut after = KeyframeStore::new(&params);
    let mut kept: Vec<_> = before.keyframes().cloned().collect();
    // The order does not matter.
    kept.reverse();
    kept.into_iter()
        .for_each(|keyframe| after.restore(keyframe));
    after.reserve_ids(KeyframeId(before.next_id));
    assert_eq!(after.report().num_restored, before.len() as u64);
    assert_eq!(after.num_bytes(), before.num_bytes());
    let shown = |store: &KeyframeStore| -> Vec<_> {
        let stored = store.stored.values();
        stored
            .map(|s| (s.keyframe.clone(), s.num_shown_by))
            .collect()
    };
    assert_eq!(shown(&after), shown(&before));
    // The running median of sharpness begins anew; these frames are alike.
    for i in 108..140u32 {
        let angle = f64::from(i) * 0.77;
        let offered = || frame(i64::from(i), angle, image(i, 0));
        assert_eq!(after.offer(offered()), before.offer(offered()), "frame {i}");
    }
    assert_eq!(shown(&after), shown(&before));
}

#[test]
fn a_smaller_budget_keeps_less_of_what_is_restored() {
    let before = ring(512.0);
    let one = encoded_bytes(&image(0, 0), Some(&depth()));
    let mut after = KeyframeStore::new(&KeyframeParams {
        budget_mb: 8.5 * one as f64 * 1e-6,
        ..KeyframeParams::default()
    });
    before
        .keyframes()
        .for_each(|keyframe| after.restore(keyframe.clone()));
    assert!(after.num_bytes() as f64 <= 8.5 * one as f64);
    assert!(after.len() >= 7, "{}", after.len());
    let num_evicted = (before.len() - after.len()) as u64;
    assert_eq!(after.report().num_evicted, num_evicted);
    // 8 views of 56° can show all of the ring.
    assert!(largest_gap_rad(&after).to_degrees() < 75.0);
}

/// Counts at every sample of every view, which decide what goes when the budget is full.
fn overlaps(store: &KeyframeStore) -> Vec<[u32; NUM_SAMPLES]> {
    store.stored.values().map(|s| s.num_shown_by).collect()
}

#[test]
fn a_store_of_corrected_frames_is_that_of_frames_that_were_right_from_the_start() {
    let angles: Vec<f64> = (0..12).map(|i| f64::from(i) * 0.3).collect();
    let off = |i: usize| if i % 3 == 1 { 0.07 } else { 0.0 };
    let stamped = |i: usize, angle| frame(i64::try_from(i).unwrap() * 10, angle, image(1, 0));
    let mut store = KeyframeStore::new(&KeyframeParams::default());
    let mut right = KeyframeStore::new(&KeyframeParams::default());
    let mut poses = Vec::new();
    for (i, angle) in angles.iter().enumerate() {
        store.offer(stamped(i, angle + off(i)));
        let frame = stamped(i, *angle);
        // Floating point took the stamp a little off.
        let stamp = Stamp::from_nanos(frame.stamp.as_nanos() + 900_000);
        poses.push((stamp, frame.world_from_camera));
        right.offer(frame);
    }
    assert_eq!((store.len(), right.len()), (12, 12));
    assert_eq!(store.correct_poses(&poses), 4);
    let of_nobody = (Stamp::from_nanos(-5_000_000), RigidTransform::identity());
    assert_eq!(store.correct_poses(&[of_nobody]), 0);
    assert!(store.keyframes().eq(right.keyframes()));
    assert_eq!(overlaps(&store), overlaps(&right));
    let report = store.report();
    assert_eq!(report.num_poses_corrected, 4);
    assert_eq!(report.num_corrections_unmatched, 1);
}

#[test]
fn of_several_poses_for_a_keyframe_the_last_holds() {
    let mut store = KeyframeStore::new(&KeyframeParams::default());
    store.offer(frame(0, 0.0, image(1, 0)));
    let stamp = Stamp::from_nanos(0);
    let [first, last] = [0.1, 0.2].map(|angle| frame(0, angle, image(1, 0)).world_from_camera);
    assert_eq!(store.correct_poses(&[(stamp, first), (stamp, last)]), 1);
    assert_eq!(store.correct_poses(&[(stamp, last)]), 0);
    let keyframe = store.keyframes().next().unwrap();
    assert_eq!(keyframe.world_from_camera, last);
    assert_eq!(keyframe.id, KeyframeId(0));
}

#[test]
fn frames_that_see_nothing_of_the_part_are_refused_and_counted() {
    // The depth images show a wall 1.5 m from the camera, all around.
    let params = KeyframeParams {
        must_see: Some(SightBox::new([0.5, -1.0, 0.5], [1.5, 1.0, 1.5])),
        ..KeyframeParams::default()
    };
    let mut store = KeyframeStore::new(&params);
    let mut kept_at = Vec::new();
    for i in 0..24 {
        let angle_rad = f64::from(i) / 24.0 * TAU;
        let seed = u32::try_from(i).unwrap();
        match store.offer(frame(i64::from(i), angle_rad, image(seed, 0))) {
            Admission::Kept(_) => kept_at.push(i),
            other => assert_eq!(other, Admission::Rejected(RejectReason::OutsideRegion)),
        }
    }
    // It lies at an eighth of a turn, and the view is an eighth wide.
    assert!((2..=4).all(|i| kept_at.contains(&i)), "{kept_at:?}");
    assert!(!kept_at.iter().any(|i| (8..=22).contains(i)), "{kept_at:?}");
    let report = store.report();
    let num_refused = report.rejected_by_reason["sees nothing of region.box"];
    assert_eq!(num_refused + kept_at.len() as u64, 24);
    assert_eq!(report.num_offered, 24);

    let behind_the_wall = SightBox::new([3.0, -1.0, 3.0], [4.0, 1.0, 4.0]);
    let mut store = KeyframeStore::new(&KeyframeParams {
        must_see: Some(behind_the_wall),
        ..params
    });
    let refused = Admission::Rejected(RejectReason::OutsideRegion);
    let toward = |depth| PosedFrame {
        depth,
        ..frame(0, TAU / 8.0, image(1, 0))
    };
    assert_eq!(store.offer(toward(Some(depth()))), refused);
    // Without depth nothing ends the view.
    assert!(matches!(store.offer(toward(None)), Admission::Kept(_)));
}

#[test]
fn what_was_decoded_of_a_keyframe_goes_with_it() {
    let mut keeps = KeyframeStore::new(&KeyframeParams::default());
    // As the painter has it, which decodes what another store keeps.
    let mut decodes = KeyframeStore::new(&KeyframeParams::default());
    for i in 0..10u32 {
        keeps.offer(frame(i64::from(i), f64::from(i) * 0.3, image(i, 0)));
    }
    let keyframes: Vec<_> = keeps.keyframes().cloned().collect();
    for keyframe in &keyframes {
        decodes.decode(keyframe).unwrap();
    }
    let num_bytes = decodes.cache_report().num_bytes;
    assert!(num_bytes > 0);
    decodes.set_decode_cache_bytes(10 * num_bytes);
    assert_eq!(decodes.cache_report().num_bytes, num_bytes);
    drop((keyframes, keeps));
    decodes.set_decode_cache_bytes(10 * num_bytes);
    assert_eq!(decodes.cache_report().num_bytes, 0);
}
