//! Where frames were, and when: the TF tree, and single tracks of poses.
//!
//! Each frame has one edge to its parent: static (valid at all times) or moving (samples by
//! stamp). A lookup climbs from both frames to their nearest common ancestor and composes the
//! edges below it; each moving edge is interpolated at the stamp (slerp and lerp), which is exact
//! for motion of constant angular velocity and constant velocity of the child's origin. Stamps
//! outside the samples are refused, but for a bounded tolerance that the caller grants; so are gaps that are
//! long and in which the frame moved. Edges above the common ancestor need not be known.
//!
//! Behaviour follows `tf2::BufferCore`, whose sample also holds its parent, so that a frame may be
//! reparented; a stamp between samples of different parents is refused.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use super::clock::{ClockGuard, ClockVerdict, nanos_from_seconds};
use super::event::StampedTransform;
use super::params::IngestParams;
use crate::geom::{RigidTransform, Stamp};

/// Motion that a long gap may hide: a camera on a stand trembles less.
const STILL_M: f64 = 0.01;
const STILL_RAD: f64 = 0.01;

/// Why a transform is not known.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LookupError {
    /// No transform ever named the frame.
    #[error("frame '{frame}' is not in the transform tree")]
    UnknownFrame {
        /// The frame.
        frame: String,
    },
    /// The frames are in different trees.
    #[error(
        "no chain of transforms from '{source_frame}' (root '{source_root}') to '{target_frame}' (root '{target_root}')"
    )]
    Disconnected {
        /// Where from.
        source_frame: String,
        /// The root above it.
        source_root: String,
        /// Where to.
        target_frame: String,
        /// The root above it.
        target_root: String,
    },
    /// The stamp is after the newest sample.
    #[error("transform '{child}' in '{parent}' is {by_s:.3} s too old for {stamp}")]
    AfterNewest {
        /// The edge's child.
        child: String,
        /// The edge's parent.
        parent: String,
        /// The stamp asked for.
        stamp: Stamp,
        /// By how much it lies outside.
        by_s: f64,
    },
    /// The stamp is before the oldest sample.
    #[error("transform '{child}' in '{parent}' begins {by_s:.3} s after {stamp}")]
    BeforeOldest {
        /// The edge's child.
        child: String,
        /// The edge's parent.
        parent: String,
        /// The stamp asked for.
        stamp: Stamp,
        /// By how much it lies outside.
        by_s: f64,
    },
    /// The samples around the stamp are far apart in time and in space.
    #[error(
        "transform '{child}' in '{parent}' has a gap of {gap_s:.3} s at {stamp} in which it moved {moved_m:.3} m and {moved_rad:.3} rad"
    )]
    Gap {
        /// The edge's child.
        child: String,
        /// The edge's parent.
        parent: String,
        /// The stamp asked for.
        stamp: Stamp,
        /// Time between the samples.
        gap_s: f64,
        /// Distance between the samples.
        moved_m: f64,
        /// Angle between the samples.
        moved_rad: f64,
    },
    /// The samples around the stamp have different parents.
    #[error("frame '{child}' changed its parent from '{before}' to '{after}' around {stamp}")]
    Reparented {
        /// The frame.
        child: String,
        /// Its parent before.
        before: String,
        /// Its parent after.
        after: String,
        /// The stamp asked for.
        stamp: Stamp,
    },
    /// A frame is its own ancestor.
    #[error("the transform tree has a cycle through '{frame}'")]
    Cycle {
        /// A frame of the cycle.
        frame: String,
    },
}

impl LookupError {
    /// Whether transforms that are still to come may help.
    pub fn may_resolve(&self) -> bool {
        matches!(
            self,
            Self::UnknownFrame { .. } | Self::Disconnected { .. } | Self::AfterNewest { .. }
        )
    }

    /// Whether the stamp lies outside the known transforms.
    pub fn is_outside(&self) -> bool {
        matches!(self, Self::AfterNewest { .. } | Self::BeforeOldest { .. })
    }

    /// The reason without its numbers, to count by.
    pub fn class(&self) -> &'static str {
        match self {
            Self::UnknownFrame { .. } => "no pose: frame unknown",
            Self::Disconnected { .. } => "no pose: no chain of transforms",
            Self::AfterNewest { .. } => "no pose: transform too old",
            Self::BeforeOldest { .. } => "no pose: before the first transform",
            Self::Gap { .. } => "no pose: gap in the transforms",
            Self::Reparented { .. } => "no pose: parent changed",
            Self::Cycle { .. } => "no pose: cycle of transforms",
        }
    }
}

/// Why a transform was not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TransformRefusal {
    /// A frame name is empty.
    EmptyName,
    /// Parent and child are the same frame.
    SelfParent,
    /// The edge has a sample of this stamp.
    Repeated,
    /// Older than the buffer reaches, or a straggler.
    TooOld,
    /// The tree has as many frames as it may have.
    TooManyFrames,
}

impl TransformRefusal {
    /// The reason in words.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::EmptyName => "transform with an empty frame name",
            Self::SelfParent => "transform of a frame to itself",
            Self::Repeated => "repeated transform (same stamp)",
            Self::TooOld => "transform older than the buffer",
            Self::TooManyFrames => "too many frames",
        }
    }
}

/// Limits of lookups and of what is kept.
#[derive(Clone, Copy, Debug)]
struct Limits {
    buffer_ns: u64,
    max_gap_ns: u64,
    jump_back_ns: u64,
    /// Of one moving edge, whatever their rate.
    max_samples: usize,
    /// A publisher that invents names must not fill the memory.
    max_frames: usize,
}

impl Limits {
    fn new(params: &IngestParams) -> Self {
        Self {
            buffer_ns: nanos_from_seconds(params.tf_buffer_s),
            max_gap_ns: nanos_from_seconds(params.max_interpolation_gap_s),
            jump_back_ns: nanos_from_seconds(params.clock_jump_back_s),
            max_samples: params.limits.tf_samples,
            max_frames: params.limits.tf_frames,
        }
    }
}

#[derive(Clone, Debug)]
struct Sample {
    stamp: Stamp,
    parent: Arc<str>,
    parent_from_child: RigidTransform,
}

/// The samples of one moving frame, ascending by stamp; never empty once one was stored.
#[derive(Clone, Debug, Default)]
struct Track {
    samples: VecDeque<Sample>,
    clock: ClockGuard,
}

impl Track {
    fn insert(&mut self, sample: Sample, limits: &Limits) -> Result<(), TransformRefusal> {
        match self.clock.judge(sample.stamp, limits.jump_back_ns) {
            ClockVerdict::Running => {}
            ClockVerdict::Straggler => return Err(TransformRefusal::TooOld),
            ClockVerdict::SetBack => self.samples.clear(),
        }
        let at = self.samples.partition_point(|s| s.stamp < sample.stamp);
        if self
            .samples
            .get(at)
            .is_some_and(|s| s.stamp == sample.stamp)
        {
            return Err(TransformRefusal::Repeated);
        }
        self.samples.insert(at, sample);
        self.expire(limits);
        Ok(())
    }

    fn expire(&mut self, limits: &Limits) {
        let Some(newest) = self.samples.back().map(|s| s.stamp) else {
            return;
        };
        // Two samples always stay: slow transforms would otherwise never bracket a stamp.
        while self.samples.len() > 2
            && (self.samples.len() > limits.max_samples
                || self
                    .samples
                    .front()
                    .is_some_and(|s| newest.abs_diff_nanos(s.stamp) > limits.buffer_ns))
        {
            self.samples.pop_front();
        }
    }

    fn forget_after(&mut self, stamp: Stamp) {
        let num_kept = self.samples.partition_point(|s| s.stamp <= stamp);
        self.samples.truncate(num_kept);
        self.clock = ClockGuard::default();
    }

    fn parent_at(&self, stamp: Stamp) -> Option<&Arc<str>> {
        let after = self.samples.partition_point(|s| s.stamp <= stamp);
        let sample = self.samples.get(after.saturating_sub(1))?;
        Some(&sample.parent)
    }

    /// The pose at a stamp, and the parent it is in.
    fn at(
        &self,
        child: &str,
        stamp: Stamp,
        tolerance_ns: u64,
        limits: &Limits,
    ) -> Result<(&Arc<str>, RigidTransform), LookupError> {
        let after = self.samples.partition_point(|s| s.stamp < stamp);
        let before = after.checked_sub(1).and_then(|i| self.samples.get(i));
        match (before, self.samples.get(after)) {
            (_, Some(b)) if b.stamp == stamp => Ok((&b.parent, b.parent_from_child)),
            (Some(a), Some(b)) => interpolate(child, a, b, stamp, limits),
            (Some(nearest), None) | (None, Some(nearest)) => {
                if nearest.stamp.abs_diff_nanos(stamp) <= tolerance_ns {
                    return Ok((&nearest.parent, nearest.parent_from_child));
                }
                let (child, parent) = (child.to_owned(), nearest.parent.to_string());
                let by_s = nearest.stamp.abs_diff_nanos(stamp) as f64 * 1e-9;
                Err(if before.is_some() {
                    LookupError::AfterNewest {
                        child,
                        parent,
                        stamp,
                        by_s,
                    }
                } else {
                    LookupError::BeforeOldest {
                        child,
                        parent,
                        stamp,
                        by_s,
                    }
                })
            }
            (None, None) => Err(LookupError::UnknownFrame {
                frame: child.to_owned(),
            }),
        }
    }
}

fn interpolate<'a>(
    child: &str,
    a: &'a Sample,
    b: &Sample,
    stamp: Stamp,
    limits: &Limits,
) -> Result<(&'a Arc<str>, RigidTransform), LookupError> {
    if a.parent != b.parent {
        return Err(LookupError::Reparented {
            child: child.to_owned(),
            before: a.parent.to_string(),
            after: b.parent.to_string(),
            stamp,
        });
    }
    let gap_ns = b.stamp.abs_diff_nanos(a.stamp);
    let (moved_rad, moved_m) = a.parent_from_child.distance_to(&b.parent_from_child);
    if gap_ns > limits.max_gap_ns && (moved_m > STILL_M || moved_rad > STILL_RAD) {
        return Err(LookupError::Gap {
            child: child.to_owned(),
            parent: a.parent.to_string(),
            stamp,
            gap_s: gap_ns as f64 * 1e-9,
            moved_m,
            moved_rad,
        });
    }
    let t = stamp.abs_diff_nanos(a.stamp) as f64 / gap_ns as f64;
    Ok((
        &a.parent,
        a.parent_from_child.interpolate(&b.parent_from_child, t),
    ))
}

#[derive(Clone, Debug)]
enum Edge {
    Static {
        parent: Arc<str>,
        parent_from_child: RigidTransform,
    },
    Moving(Track),
}

impl Edge {
    fn parent_at(&self, stamp: Stamp) -> Option<&Arc<str>> {
        match self {
            Self::Static { parent, .. } => Some(parent),
            Self::Moving(track) => track.parent_at(stamp),
        }
    }
}

/// Frame names are compared without the leading slash that ROS 1 allowed.
pub fn normalized_frame(frame_id: &str) -> &str {
    frame_id.strip_prefix('/').unwrap_or(frame_id)
}

/// The transform tree of `/tf` and `/tf_static`.
#[derive(Clone, Debug)]
pub struct TransformTree {
    edge_by_child: BTreeMap<Arc<str>, Edge>,
    limits: Limits,
}

impl TransformTree {
    /// An empty tree.
    pub fn new(params: &IngestParams) -> Self {
        Self {
            edge_by_child: BTreeMap::new(),
            limits: Limits::new(params),
        }
    }

    /// Stores a transform; the last kind (static or moving) given for a child holds.
    ///
    /// # Errors
    /// [`TransformRefusal`]; the tree is then as it was.
    pub fn insert(
        &mut self,
        transform: &StampedTransform,
        is_static: bool,
    ) -> Result<(), TransformRefusal> {
        let parent = interned(&transform.header.frame_id);
        let child = interned(&transform.child_frame_id);
        if parent.is_empty() || child.is_empty() {
            return Err(TransformRefusal::EmptyName);
        }
        if parent == child {
            return Err(TransformRefusal::SelfParent);
        }
        let is_full = self.edge_by_child.len() >= self.limits.max_frames;
        if is_full && !self.edge_by_child.contains_key(&child) {
            return Err(TransformRefusal::TooManyFrames);
        }
        let parent_from_child = transform.parent_from_child;
        if is_static {
            self.edge_by_child.insert(
                child,
                Edge::Static {
                    parent,
                    parent_from_child,
                },
            );
            return Ok(());
        }
        let sample = Sample {
            stamp: transform.header.stamp,
            parent,
            parent_from_child,
        };
        match self.edge_by_child.get_mut(&child) {
            Some(Edge::Moving(track)) => track.insert(sample, &self.limits),
            _ => {
                let mut track = Track::default();
                track.insert(sample, &self.limits)?;
                self.edge_by_child.insert(child, Edge::Moving(track));
                Ok(())
            }
        }
    }

    /// Forgets the samples after a stamp: the clock was set back to it.
    pub fn forget_after(&mut self, stamp: Stamp) {
        self.edge_by_child.retain(|_, edge| match edge {
            Edge::Static { .. } => true,
            Edge::Moving(track) => {
                track.forget_after(stamp);
                !track.samples.is_empty()
            }
        });
    }

    /// Whether any transform names the frame as a child.
    pub fn has_parent(&self, frame: &str) -> bool {
        self.edge_by_child.contains_key(normalized_frame(frame))
    }

    /// The topmost ancestor of a frame at a stamp: the frame itself where nothing is above it.
    ///
    /// # Errors
    /// [`LookupError::Cycle`].
    pub fn root_of(&self, frame: &str, stamp: Stamp) -> Result<Arc<str>, LookupError> {
        let (ancestors, is_cyclic) = self.ancestors(frame, stamp);
        match ancestors.last() {
            Some(root) if !is_cyclic => Ok(root.clone()),
            _ => Err(LookupError::Cycle {
                frame: frame.to_owned(),
            }),
        }
    }

    /// `target_from_source` at a stamp. Up to `tolerance_s` outside the samples of a moving edge
    /// its nearest sample holds.
    ///
    /// # Errors
    /// [`LookupError`].
    pub fn lookup(
        &self,
        target: &str,
        source: &str,
        stamp: Stamp,
        tolerance_s: f64,
    ) -> Result<RigidTransform, LookupError> {
        let (target, source) = (normalized_frame(target), normalized_frame(source));
        if target == source {
            return Ok(RigidTransform::identity());
        }
        let (above_source, source_cyclic) = self.ancestors(source, stamp);
        let (above_target, target_cyclic) = self.ancestors(target, stamp);
        let common = above_source.iter().enumerate().find_map(|(i, frame)| {
            let j = above_target.iter().position(|other| other == frame)?;
            Some((i, j))
        });
        let Some((num_source_edges, num_target_edges)) = common else {
            let frame_of_cycle = [(source_cyclic, source), (target_cyclic, target)];
            if let Some((_, frame)) = frame_of_cycle.iter().find(|(is_cyclic, _)| *is_cyclic) {
                return Err(LookupError::Cycle {
                    frame: (*frame).to_owned(),
                });
            }
            return Err(self.disconnected(target, &above_target, source, &above_source));
        };
        let tolerance_ns = nanos_from_seconds(tolerance_s);
        let common_from_source =
            self.composed(&above_source[..num_source_edges], stamp, tolerance_ns)?;
        let common_from_target =
            self.composed(&above_target[..num_target_edges], stamp, tolerance_ns)?;
        Ok(common_from_target.inverse() * common_from_source)
    }

    /// The frame, its parent, and so on up to the root, or until a frame would come twice.
    fn ancestors(&self, frame: &str, stamp: Stamp) -> (Vec<Arc<str>>, bool) {
        let mut chain = vec![Arc::<str>::from(normalized_frame(frame))];
        while let Some(parent) = chain
            .last()
            .and_then(|child| self.edge_by_child.get(child))
            .and_then(|edge| edge.parent_at(stamp))
        {
            if chain.contains(parent) {
                return (chain, true);
            }
            chain.push(parent.clone());
        }
        (chain, false)
    }

    fn composed(
        &self,
        children: &[Arc<str>],
        stamp: Stamp,
        tolerance_ns: u64,
    ) -> Result<RigidTransform, LookupError> {
        let mut top_from_bottom = RigidTransform::identity();
        for child in children {
            let parent_from_child = match self.edge_by_child.get(child) {
                Some(Edge::Static {
                    parent_from_child, ..
                }) => *parent_from_child,
                Some(Edge::Moving(track)) => track.at(child, stamp, tolerance_ns, &self.limits)?.1,
                None => {
                    return Err(LookupError::UnknownFrame {
                        frame: child.to_string(),
                    });
                }
            };
            top_from_bottom = parent_from_child * top_from_bottom;
        }
        Ok(top_from_bottom)
    }

    fn disconnected(
        &self,
        target: &str,
        above_target: &[Arc<str>],
        source: &str,
        above_source: &[Arc<str>],
    ) -> LookupError {
        for frame in [source, target] {
            let is_parent = |edge: &Edge| match edge {
                Edge::Static { parent, .. } => &**parent == frame,
                Edge::Moving(track) => track.samples.iter().any(|s| &*s.parent == frame),
            };
            if !self.edge_by_child.contains_key(frame)
                && !self.edge_by_child.values().any(is_parent)
            {
                return LookupError::UnknownFrame {
                    frame: frame.to_owned(),
                };
            }
        }
        let root = |chain: &[Arc<str>]| chain.last().map_or_else(String::new, ToString::to_string);
        LookupError::Disconnected {
            source_frame: source.to_owned(),
            source_root: root(above_source),
            target_frame: target.to_owned(),
            target_root: root(above_target),
        }
    }
}

fn interned(frame_id: &Arc<str>) -> Arc<str> {
    if frame_id.starts_with('/') {
        Arc::from(normalized_frame(frame_id))
    } else {
        frame_id.clone()
    }
}

/// The poses of one frame from a pose or odometry topic.
#[derive(Clone, Debug)]
pub struct PoseTrack {
    track: Track,
    child: Option<Arc<str>>,
    limits: Limits,
}

impl PoseTrack {
    /// An empty track.
    pub fn new(params: &IngestParams) -> Self {
        Self {
            track: Track::default(),
            child: None,
            limits: Limits::new(params),
        }
    }

    /// Whether a pose was ever stored.
    pub fn is_empty(&self) -> bool {
        self.track.samples.is_empty()
    }

    /// The frame whose poses these are, where the messages name it.
    pub fn child(&self) -> Option<&Arc<str>> {
        self.child.as_ref()
    }

    /// Stores a pose of `child` in the header's frame; poses of another child start a new track.
    ///
    /// # Errors
    /// [`TransformRefusal`]; the track is then as it was.
    pub fn insert(
        &mut self,
        header: &super::event::Header,
        child: Option<&Arc<str>>,
        parent_from_child: RigidTransform,
    ) -> Result<(), TransformRefusal> {
        let child = child.map(interned).filter(|name| !name.is_empty());
        if self.child != child {
            self.track = Track::default();
            self.child = child;
        }
        let sample = Sample {
            stamp: header.stamp,
            parent: interned(&header.frame_id),
            parent_from_child,
        };
        self.track.insert(sample, &self.limits)
    }

    /// The pose at a stamp and the frame it is in.
    ///
    /// # Errors
    /// [`LookupError`].
    pub fn at(
        &self,
        stamp: Stamp,
        tolerance_s: f64,
    ) -> Result<(Arc<str>, RigidTransform), LookupError> {
        let name = self.child.as_deref().unwrap_or("pose");
        let tolerance_ns = nanos_from_seconds(tolerance_s);
        let (parent, pose) = self.track.at(name, stamp, tolerance_ns, &self.limits)?;
        Ok((parent.clone(), pose))
    }

    /// Forgets the poses after a stamp: the clock was set back to it.
    pub fn forget_after(&mut self, stamp: Stamp) {
        self.track.forget_after(stamp);
    }
}

#[cfg(test)]
mod tests;
