//! Pairs colour with depth images by their stamps: a state machine without I/O.
//!
//! The method is `message_filters::sync_policies::ApproximateTime` for two streams: the later of
//! the two oldest images is the pivot; every pair that contains it is a candidate; the candidate
//! that spans the least time wins as soon as no later image can beat it. Each image is used at
//! most once and pairs never cross. A largest interval of zero is exact synchronisation.
//!
//! Streams are in order or nearly so: an image that arrives out of order is put in its place as
//! long as no later one of its stream was paired or dropped, and is refused as late otherwise.
//! While no depth image was ever seen, colour images wait in the queue and leave it alone when it
//! is full or the stream ends. Every image that is pushed leaves in exactly one output.

use std::collections::VecDeque;

use super::clock::{ClockGuard, ClockVerdict, nanos_from_seconds};
use crate::geom::Stamp;

/// Settings of [`Synchronizer`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SyncParams {
    /// Largest difference of the stamps of a pair, seconds, ≥ 0; 0 pairs equal stamps only.
    pub max_interval_s: f64,
    /// Most images of one stream that wait, ≥ 1.
    pub queue_size: usize,
    /// A stream whose stamps fall back by more than this, seconds, > 0, twice in a row has
    /// restarted its clock.
    pub clock_jump_back_s: f64,
}

/// Which stream an image belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SyncStream {
    /// Colour.
    Color,
    /// Depth.
    Depth,
}

/// Why an image leaves without a partner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SyncDrop {
    /// The stream has an image of the same stamp.
    Duplicate,
    /// A later image of the stream has left already.
    Late,
    /// No image of the other stream is near enough.
    Unmatched,
    /// The queue was full and this was the oldest in it.
    QueueFull,
    /// The clock was set back while it waited.
    ClockSetBack,
}

impl SyncDrop {
    /// The reason in words.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Duplicate => "duplicate stamp",
            Self::Late => "late: a newer image of the topic was used or dropped before it came",
            Self::Unmatched => "no partner within the sync interval",
            Self::QueueFull => "sync queue full, oldest dropped",
            Self::ClockSetBack => "clock was set back",
        }
    }
}

/// An image, or whatever stands for it, and its stamp.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamped<P> {
    /// When it was taken.
    pub stamp: Stamp,
    /// What was taken.
    pub payload: P,
}

/// What leaves the synchroniser.
#[derive(Clone, Debug, PartialEq)]
pub enum SyncOutput<P> {
    /// A colour image and, where the stream has depth, the depth image that goes with it.
    Frame {
        /// The colour image.
        color: Stamped<P>,
        /// The depth image.
        depth: Option<Stamped<P>>,
    },
    /// An image that goes unused.
    Dropped {
        /// Its stream.
        stream: SyncStream,
        /// The image.
        image: Stamped<P>,
        /// Why.
        reason: SyncDrop,
    },
    /// The clock was set back; the images before it have been dropped.
    ClockSetBack,
}

#[derive(Debug)]
struct Queue<P> {
    images: VecDeque<Stamped<P>>,
    /// The first `num_past` images were passed over in the search around the current pivot.
    num_past: usize,
    /// The newest stamp that has left.
    last_out: Option<Stamp>,
    /// An image was dropped for room: it might have been the better partner of the next pivot.
    has_dropped: bool,
    clock: ClockGuard,
}

impl<P> Queue<P> {
    fn new() -> Self {
        Self {
            images: VecDeque::new(),
            num_past: 0,
            last_out: None,
            has_dropped: false,
            clock: ClockGuard::default(),
        }
    }

    fn front_stamp(&self) -> Option<Stamp> {
        self.images.get(self.num_past).map(|image| image.stamp)
    }

    fn pop_first(&mut self) -> Option<Stamped<P>> {
        let image = self.images.pop_front()?;
        self.num_past = self.num_past.saturating_sub(1);
        self.last_out = self.last_out.max(Some(image.stamp));
        Some(image)
    }
}

#[derive(Clone, Copy, Debug)]
struct Candidate {
    pivot: usize,
    pivot_stamp: Stamp,
    start: Stamp,
    end: Stamp,
}

/// The oldest image still to be tried of each stream, as an interval.
struct Fronts {
    start_stream: usize,
    start: Stamp,
    end_stream: usize,
    end: Stamp,
}

/// Pairs colour with depth images. `P` is what an image is to the caller.
#[derive(Debug)]
pub struct Synchronizer<P> {
    max_interval_ns: u64,
    queue_size: usize,
    jump_back_ns: u64,
    queues: [Queue<P>; 2],
    candidate: Option<Candidate>,
    has_seen_depth: bool,
}

const COLOR: usize = 0;
const DEPTH: usize = 1;

impl SyncStream {
    const fn index(self) -> usize {
        match self {
            Self::Color => COLOR,
            Self::Depth => DEPTH,
        }
    }

    const fn from_index(index: usize) -> Self {
        if index == COLOR {
            Self::Color
        } else {
            Self::Depth
        }
    }
}

impl<P> Synchronizer<P> {
    /// An empty synchroniser.
    pub fn new(params: &SyncParams) -> Self {
        Self {
            max_interval_ns: nanos_from_seconds(params.max_interval_s),
            queue_size: params.queue_size.max(1),
            jump_back_ns: nanos_from_seconds(params.clock_jump_back_s),
            queues: [Queue::new(), Queue::new()],
            candidate: None,
            has_seen_depth: false,
        }
    }

    /// How many images wait.
    pub fn num_pending(&self) -> usize {
        self.queues.iter().map(|queue| queue.images.len()).sum()
    }

    /// Takes an image; what became certain by it is appended to `out`.
    pub fn push(&mut self, stream: SyncStream, image: Stamped<P>, out: &mut Vec<SyncOutput<P>>) {
        let s = stream.index();
        match self.queues[s].clock.judge(image.stamp, self.jump_back_ns) {
            ClockVerdict::Running => {}
            ClockVerdict::Straggler => return out.push(dropped(s, image, SyncDrop::Late)),
            ClockVerdict::SetBack => self.reset_after_jump(s, out),
        }
        self.has_seen_depth |= s == DEPTH;
        let queue = &mut self.queues[s];
        let at = queue
            .images
            .partition_point(|other| other.stamp < image.stamp);
        let is_duplicate = queue
            .images
            .get(at)
            .is_some_and(|other| other.stamp == image.stamp);
        if is_duplicate || queue.last_out == Some(image.stamp) {
            return out.push(dropped(s, image, SyncDrop::Duplicate));
        }
        if queue.last_out.is_some_and(|last| image.stamp < last) {
            return out.push(dropped(s, image, SyncDrop::Late));
        }
        let is_in_order = at == queue.images.len();
        queue.images.insert(at, image);
        if !is_in_order {
            self.cancel_candidate();
        }
        self.search(out);
        self.make_room(s, out);
    }

    /// Ends the stream: the best pairs that are left are made, the rest is dropped.
    pub fn finish(&mut self, out: &mut Vec<SyncOutput<P>>) {
        while self.candidate.is_some() {
            self.emit_candidate(out);
            self.search(out);
        }
        self.emit_alone(usize::MAX, out);
        self.drop_all(SyncDrop::Unmatched, out);
    }

    fn emit_alone(&mut self, most: usize, out: &mut Vec<SyncOutput<P>>) {
        if self.has_seen_depth {
            return;
        }
        for _ in 0..most {
            let Some(color) = self.queues[COLOR].pop_first() else {
                break;
            };
            out.push(SyncOutput::Frame { color, depth: None });
        }
    }

    fn drop_all(&mut self, reason: SyncDrop, out: &mut Vec<SyncOutput<P>>) {
        self.cancel_candidate();
        for s in [COLOR, DEPTH] {
            while let Some(image) = self.queues[s].pop_first() {
                out.push(dropped(s, image, reason));
            }
        }
    }

    /// The stream `jumped` has judged its first stamp of the new clock; the other one starts with
    /// no expectation.
    fn reset_after_jump(&mut self, jumped: usize, out: &mut Vec<SyncOutput<P>>) {
        self.drop_all(SyncDrop::ClockSetBack, out);
        let clock = self.queues[jumped].clock;
        self.queues = [Queue::new(), Queue::new()];
        self.queues[jumped].clock = clock;
        out.push(SyncOutput::ClockSetBack);
    }

    fn make_room(&mut self, s: usize, out: &mut Vec<SyncOutput<P>>) {
        if self.queues[s].images.len() <= self.queue_size {
            return;
        }
        if !self.has_seen_depth {
            return self.emit_alone(1, out);
        }
        let had_candidate = self.candidate.is_some();
        self.cancel_candidate();
        if let Some(image) = self.queues[s].pop_first() {
            out.push(dropped(s, image, SyncDrop::QueueFull));
        }
        self.queues[s].has_dropped = true;
        if had_candidate {
            self.search(out);
        }
    }

    fn cancel_candidate(&mut self) {
        self.candidate = None;
        for queue in &mut self.queues {
            queue.num_past = 0;
        }
    }

    fn fronts(&self) -> Option<Fronts> {
        let color = self.queues[COLOR].front_stamp()?;
        let depth = self.queues[DEPTH].front_stamp()?;
        Some(if depth < color {
            Fronts {
                start_stream: DEPTH,
                start: depth,
                end_stream: COLOR,
                end: color,
            }
        } else {
            Fronts {
                start_stream: COLOR,
                start: color,
                end_stream: DEPTH,
                end: depth,
            }
        })
    }

    fn search(&mut self, out: &mut Vec<SyncOutput<P>>) {
        while let Some(fronts) = self.fronts() {
            // An image that was dropped earlier could not have been better than what starts now.
            self.queues[fronts.start_stream].has_dropped = false;
            let candidate = match self.candidate {
                None => {
                    let is_too_long =
                        fronts.end.abs_diff_nanos(fronts.start) > self.max_interval_ns;
                    if is_too_long || self.queues[fronts.end_stream].has_dropped {
                        self.drop_first(fronts.start_stream, out);
                        continue;
                    }
                    self.take_candidate(fronts.end_stream, fronts.end, &fronts, out)
                }
                Some(candidate) if is_no_better(&fronts, candidate.start, &candidate) => candidate,
                Some(candidate) => {
                    self.take_candidate(candidate.pivot, candidate.pivot_stamp, &fronts, out)
                }
            };
            self.queues[fronts.start_stream].num_past += 1;
            let is_exhausted = fronts.start_stream == candidate.pivot;
            if is_exhausted || is_provably_best(&fronts, &candidate) {
                self.emit_candidate(out);
            }
        }
    }

    /// The fronts become the candidate; what was passed over before them can be in no pair.
    fn take_candidate(
        &mut self,
        pivot: usize,
        pivot_stamp: Stamp,
        fronts: &Fronts,
        out: &mut Vec<SyncOutput<P>>,
    ) -> Candidate {
        for s in [COLOR, DEPTH] {
            while self.queues[s].num_past > 0 {
                self.drop_first(s, out);
            }
        }
        let candidate = Candidate {
            pivot,
            pivot_stamp,
            start: fronts.start,
            end: fronts.end,
        };
        self.candidate = Some(candidate);
        candidate
    }

    fn drop_first(&mut self, s: usize, out: &mut Vec<SyncOutput<P>>) {
        if let Some(image) = self.queues[s].pop_first() {
            out.push(dropped(s, image, SyncDrop::Unmatched));
        }
    }

    /// The candidate's images are the first of both queues: see [`Self::take_candidate`].
    fn emit_candidate(&mut self, out: &mut Vec<SyncOutput<P>>) {
        self.cancel_candidate();
        let [color, depth] = &mut self.queues;
        if let (Some(color), Some(depth)) = (color.pop_first(), depth.pop_first()) {
            out.push(SyncOutput::Frame {
                color,
                depth: Some(depth),
            });
        }
    }
}

fn dropped<P>(s: usize, image: Stamped<P>, reason: SyncDrop) -> SyncOutput<P> {
    SyncOutput::Dropped {
        stream: SyncStream::from_index(s),
        image,
        reason,
    }
}

/// message_filters' age penalty of 10 %: an interval must be shorter by that much for each
/// nanosecond it ends later.
fn is_no_better(fronts: &Fronts, start: Stamp, candidate: &Candidate) -> bool {
    let ends_later = i128::from(fronts.end.as_nanos()) - i128::from(candidate.end.as_nanos());
    let starts_later = i128::from(fronts.start.as_nanos()) - i128::from(start.as_nanos());
    ends_later * 11 >= starts_later * 10
}

/// The best that is still to come starts no later than the pivot and ends no earlier than now.
fn is_provably_best(fronts: &Fronts, candidate: &Candidate) -> bool {
    let pivot_only = Fronts {
        start: candidate.pivot_stamp,
        ..*fronts
    };
    is_no_better(&pivot_only, candidate.start, candidate)
}

#[cfg(test)]
mod tests {
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

    /// Runs a script of (stream, milliseconds) and returns pairs and drops, in milliseconds.
    fn run(
        mut sync: Synchronizer<u32>,
        script: &[(SyncStream, i64)],
    ) -> (Vec<(i64, Option<i64>)>, Vec<(SyncStream, i64, SyncDrop)>) {
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
}
