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
mod tests;
