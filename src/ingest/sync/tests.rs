use proptest::prelude::*;

use super::*;

const MS: i64 = 1_000_000;

fn sync(max_interval_s: f64, queue_size: usize) -> Synchronizer<u32> {
    Synchronizer::new(&SyncParams {
        max_interval_s,
        queue_size,
        clock_jump_back_s: 1.0,
    })
}

fn at(ms: i64) -> Stamped<u32> {
    Stamped {
        stamp: Stamp::from_nanos(ms * MS),
        payload: 0,
    }
}

type Frame = (i64, Option<i64>);
type Drop = (SyncStream, i64, SyncDrop);

/// Runs a script of (stream, milliseconds) and returns pairs and drops, in milliseconds.
fn run(mut sync: Synchronizer<u32>, script: &[(SyncStream, i64)]) -> (Vec<Frame>, Vec<Drop>) {
    let mut out = Vec::new();
    for &(stream, ms) in script {
        sync.push(stream, at(ms), &mut out);
    }
    sync.finish(&mut out);
    assert_eq!(sync.num_pending(), 0);
    let mut frames = Vec::new();
    let mut drops = Vec::new();
    for output in out {
        match output {
            SyncOutput::Frame { color, depth } => frames.push((
                color.stamp.as_nanos() / MS,
                depth.map(|d| d.stamp.as_nanos() / MS),
            )),
            SyncOutput::Dropped {
                stream,
                image,
                reason,
            } => drops.push((stream, image.stamp.as_nanos() / MS, reason)),
            SyncOutput::ClockSetBack => {}
        }
    }
    (frames, drops)
}

use SyncStream::{Color, Depth};

#[test]
fn jittered_streams_pair_nearest() {
    let jitter = [3, -4, 0, 6, -6, 2, 5, -1];
    let mut script = Vec::new();
    for (i, jitter) in jitter.iter().enumerate() {
        let ms = 100 + 33 * i64::try_from(i).unwrap();
        script.push((Color, ms));
        script.push((Depth, ms + jitter));
    }
    let (frames, drops) = run(sync(0.02, 10), &script);
    let expected: Vec<_> = script
        .chunks(2)
        .map(|pair| (pair[0].1, Some(pair[1].1)))
        .collect();
    assert_eq!(frames, expected);
    assert!(drops.is_empty());
}

#[test]
fn a_later_better_partner_wins() {
    // Depth 20 comes within the interval of colour 0, but colour 19 is nearer.
    let script = [
        (Color, 0),
        (Depth, 20),
        (Color, 19),
        (Color, 40),
        (Depth, 41),
    ];
    let (frames, drops) = run(sync(0.03, 10), &script);
    assert_eq!(frames, [(19, Some(20)), (40, Some(41))]);
    assert_eq!(drops, [(Color, 0, SyncDrop::Unmatched)]);
}

#[test]
fn drops_on_one_side_leave_the_other_pairs_alone() {
    let script = [
        (Color, 0),
        (Depth, 1),
        (Color, 33),
        (Color, 66),
        (Depth, 67),
        (Depth, 100),
        (Color, 133),
        (Depth, 133),
    ];
    let (frames, drops) = run(sync(0.01, 10), &script);
    assert_eq!(frames, [(0, Some(1)), (66, Some(67)), (133, Some(133))]);
    assert_eq!(
        drops,
        [
            (Color, 33, SyncDrop::Unmatched),
            (Depth, 100, SyncDrop::Unmatched)
        ]
    );
}

#[test]
fn exact_mode_pairs_equal_stamps_only_and_at_once() {
    let mut sync = sync(0.0, 4);
    let mut out = Vec::new();
    sync.push(Depth, at(5), &mut out);
    sync.push(Color, at(5), &mut out);
    assert!(matches!(out[..], [SyncOutput::Frame { .. }]));
    let (frames, drops) = run(sync, &[(Color, 6), (Depth, 7), (Depth, 8), (Color, 8)]);
    assert_eq!(frames, [(8, Some(8))]);
    assert_eq!(drops.len(), 2);
}

#[test]
fn duplicates_and_late_images_are_named() {
    let script = [
        (Depth, 100),
        (Color, 100),
        (Color, 100),
        (Depth, 90),
        (Depth, 133),
        (Depth, 133),
        (Color, 133),
    ];
    let (frames, drops) = run(sync(0.01, 10), &script);
    assert_eq!(frames, [(100, Some(100)), (133, Some(133))]);
    assert_eq!(
        drops,
        [
            (Color, 100, SyncDrop::Duplicate),
            (Depth, 90, SyncDrop::Late),
            (Depth, 133, SyncDrop::Duplicate)
        ]
    );
}

#[test]
fn out_of_order_images_that_still_wait_are_put_in_place() {
    let script = [
        (Color, 33),
        (Color, 0),
        (Depth, 0),
        (Depth, 33),
        (Depth, 99),
        (Depth, 66),
        (Color, 66),
        (Color, 99),
    ];
    let (frames, drops) = run(sync(0.01, 10), &script);
    let expected = [0, 33, 66, 99].map(|ms| (ms, Some(ms)));
    assert_eq!((frames.as_slice(), drops.len()), (&expected[..], 0));
}

#[test]
fn colour_goes_alone_while_no_depth_was_seen() {
    let script: Vec<_> = (0..20).map(|i| (Color, i * 33)).collect();
    let (frames, drops) = run(sync(0.01, 3), &script);
    assert_eq!(frames.len(), 20);
    assert!(frames.iter().all(|f| f.1.is_none()) && drops.is_empty());
}

#[test]
fn full_queue_drops_the_oldest() {
    let mut script = vec![(Depth, 0), (Color, 0)];
    script.extend((1..=8).map(|i| (Color, i * 33)));
    let (frames, drops) = run(sync(0.01, 3), &script);
    assert_eq!(frames, [(0, Some(0))]);
    let num_full = drops.iter().filter(|d| d.2 == SyncDrop::QueueFull).count();
    assert_eq!(num_full, 5);
}

#[test]
fn a_clock_set_back_starts_over_and_a_straggler_does_not() {
    let mut script = vec![
        (Color, 60_000),
        (Depth, 60_000),
        (Color, 10),
        (Color, 60_033),
    ];
    script.extend([
        (Depth, 60_033),
        (Color, 0),
        (Color, 33),
        (Depth, 0),
        (Depth, 33),
    ]);
    script.extend([(Depth, 66), (Color, 66)]);
    let mut synchronizer = sync(0.01, 10);
    let mut out = Vec::new();
    for &(stream, ms) in &script {
        synchronizer.push(stream, at(ms), &mut out);
    }
    let num_resets = out
        .iter()
        .filter(|o| matches!(o, SyncOutput::ClockSetBack))
        .count();
    assert_eq!(num_resets, 1);
    let (frames, _) = run(sync(0.01, 10), &script);
    assert_eq!(
        frames,
        [
            (60_000, Some(60_000)),
            (60_033, Some(60_033)),
            (33, Some(33)),
            (66, Some(66))
        ]
    );
}

fn script() -> impl Strategy<Value = Vec<(bool, i64)>> {
    let step = prop_oneof![
        8 => 0i64..40 * MS,
        2 => -60 * MS..0,
        1 => -5_000 * MS..5_000 * MS,
        1 => Just(0),
        1 => any::<i64>(),
    ];
    prop::collection::vec((any::<bool>(), step), 0..200).prop_map(|steps| {
        let mut now = 0i64;
        steps
            .into_iter()
            .map(|(is_depth, step)| {
                now = now.wrapping_add(step);
                (is_depth, now)
            })
            .collect()
    })
}

proptest! {
    #[test]
    fn any_input_keeps_the_promises(
        script in script(),
        interval_ms in 0u32..40,
        queue_size in 0usize..6,
    ) {
        let max_interval_s = f64::from(interval_ms) * 1e-3;
        let mut sync = sync(max_interval_s, queue_size);
        let mut out = Vec::new();
        let mut last: [Option<Stamp>; 2] = [None; 2];
        let mut num_used = 0;
        let mut num_dropped = 0;
        for (i, &(is_depth, nanos)) in script.iter().enumerate() {
            let stream = if is_depth { Depth } else { Color };
            let payload = u32::try_from(i).unwrap();
            sync.push(stream, Stamped { stamp: Stamp::from_nanos(nanos), payload }, &mut out);
            prop_assert!(sync.num_pending() <= 2 * queue_size.max(1));
            if i + 1 == script.len() {
                sync.finish(&mut out);
            }
            for output in out.drain(..) {
                match output {
                    SyncOutput::Frame { color, depth } => {
                        num_used += 1 + usize::from(depth.is_some());
                        prop_assert!(last[0].is_none_or(|l| l < color.stamp));
                        last[0] = Some(color.stamp);
                        if let Some(depth) = depth {
                            let gap = color.stamp.abs_diff_nanos(depth.stamp);
                            prop_assert!(gap <= u64::from(interval_ms) * 1_000_000);
                            prop_assert!(last[1].is_none_or(|l| l < depth.stamp));
                            last[1] = Some(depth.stamp);
                        }
                    }
                    SyncOutput::Dropped { .. } => num_dropped += 1,
                    SyncOutput::ClockSetBack => last = [None; 2],
                }
            }
            let pending = sync.num_pending();
            prop_assert_eq!(num_used + num_dropped + pending, i + 1);
        }
    }
}
