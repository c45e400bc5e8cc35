//! What came in, what was used, and what was refused and why.
//!
//! For every topic, `num_received = num_used + num_refused() + pending`, where pending is what
//! still waits for a partner or a pose; after [`super::Assembler::finish`] nothing is pending.

use std::collections::{BTreeMap, BTreeSet};

use super::params::ReportLimits;
use crate::geom::Stamp;

/// Reason that stands for all past [`ReportLimits::reasons`].
const OTHER_REASONS: &str = "other reasons";

/// Counts of one reason, with a few examples that name stamp and values.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RefusalCount {
    /// How many messages.
    pub num: u64,
    /// The first few, each `stamp: text`.
    pub examples: Vec<String>,
}

/// Counts of one topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicReport {
    /// Messages that arrived.
    pub num_received: u64,
    /// Messages that reached a frame, the mesh or the transform buffer.
    pub num_used: u64,
    /// Messages that did not, by reason.
    pub refused_by_reason: BTreeMap<String, RefusalCount>,
    limits: ReportLimits,
}

impl TopicReport {
    fn new(limits: ReportLimits) -> Self {
        Self {
            limits,
            ..Self::default()
        }
    }

    /// Messages that were refused, for any reason.
    pub fn num_refused(&self) -> u64 {
        self.refused_by_reason.values().map(|count| count.num).sum()
    }

    pub(super) fn refuse(&mut self, reason: &str, stamp: Stamp, text: &str) {
        let is_known = self.refused_by_reason.contains_key(reason);
        let reason = if is_known || self.refused_by_reason.len() < self.limits.reasons {
            reason
        } else {
            OTHER_REASONS
        };
        let count = self.refused_by_reason.entry(reason.to_owned()).or_default();
        count.num += 1;
        if count.examples.len() < self.limits.examples {
            count.examples.push(format!("{stamp}: {text}"));
        }
    }
}

/// How well colour, depth and camera infos fit together in time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SyncReport {
    /// Frames of colour with depth.
    pub num_pairs: u64,
    /// Frames of colour alone.
    pub num_without_depth: u64,
    /// Mean difference of the stamps of a pair, seconds.
    pub mean_interval_s: f64,
    /// Largest difference of the stamps of a pair, seconds.
    pub max_interval_s: f64,
    /// Colour and depth images whose camera info had another stamp.
    pub num_info_of_other_stamp: u64,
    /// How often a clock was set back.
    pub num_clock_set_back: u64,
    /// Depth images whose pose was not known at their own stamp, so that the colour image's
    /// serves.
    pub num_depth_at_color_pose: u64,
}

/// The whole stage's counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IngestReport {
    /// Counts by topic.
    pub topics: BTreeMap<String, TopicReport>,
    /// Single transforms of the TF messages, counted as messages are in [`Self::topics`].
    pub transforms: TopicReport,
    /// Time synchronisation.
    pub sync: SyncReport,
    /// Posed frames that were given out.
    pub num_frames: u64,
    /// Poses that were taken from the nearest transform, a little outside the known ones.
    pub num_poses_extrapolated: u64,
    /// The world frame, once it was settled.
    pub world_frame: Option<String>,
    /// What gave the poses, once it was settled.
    pub pose_source: Option<&'static str>,
    /// Mesh vertices that were not finite.
    pub num_non_finite_vertices: u64,
    /// Mesh triangles that used one of them.
    pub num_dropped_triangles: u64,
    /// What was assumed where the stream was silent, in words; each once.
    pub assumptions: BTreeSet<String>,
    limits: ReportLimits,
}

impl IngestReport {
    pub(super) fn new(limits: ReportLimits) -> Self {
        Self {
            transforms: TopicReport::new(limits),
            limits,
            ..Self::default()
        }
    }

    pub(super) fn topic(&mut self, name: &str) -> &mut TopicReport {
        let topic = self.topics.entry(name.to_owned());
        topic.or_insert_with(|| TopicReport::new(self.limits))
    }

    pub(super) fn count_pair(&mut self, interval_s: f64) {
        let sync = &mut self.sync;
        sync.num_pairs += 1;
        sync.mean_interval_s += (interval_s - sync.mean_interval_s) / sync.num_pairs as f64;
        sync.max_interval_s = sync.max_interval_s.max(interval_s);
    }
}

/// The text with every number replaced by `#`: messages that differ in values only count as one
/// reason.
pub(super) fn reason_class(text: &str) -> String {
    let mut class = String::with_capacity(text.len());
    let mut is_in_number = false;
    for c in text.chars() {
        let continues = is_in_number && matches!(c, '.' | 'e' | '-' | '+');
        if c.is_ascii_digit() {
            if !is_in_number {
                class.push('#');
            }
            is_in_number = true;
        } else if !continues {
            is_in_number = false;
            class.push(c);
        }
    }
    class
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_and_examples_are_bounded_and_nothing_is_uncounted() {
        let limits = ReportLimits {
            reasons: 5,
            examples: 2,
        };
        let mut report = IngestReport::new(limits);
        let topic = report.topic("/a");
        for i in 0..1000u32 {
            let reason = format!("reason {}", char::from_u32(0x4e00 + i % 100).unwrap());
            topic.refuse(&reason, Stamp::from_nanos(0), "text");
        }
        assert_eq!(topic.num_refused(), 1000);
        assert_eq!(topic.refused_by_reason.len(), 6);
        let mut counts = topic.refused_by_reason.values();
        assert!(counts.all(|count| count.examples.len() == 2));
    }

    #[test]
    fn numbers_do_not_make_reasons_differ() {
        assert_eq!(
            reason_class("rotation quaternion [0.0, 1e-3, -2] has norm 1.5, not 1"),
            "rotation quaternion [#, #, -#] has norm #, not #"
        );
    }
}
