//! The keyframes that paint, and which came, went or were moved.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::surface::SurfaceChange;
use super::{StreamInit, StreamUpdate};
use crate::geom::PinholeCamera;
use crate::keyframe::Keyframe;
use crate::render::{DepthBound, Frustum};
use crate::texinit::assign::{FailedFrame, FramePose};

/// A keyframe that the state is of.
#[derive(Clone, Debug)]
pub(super) struct KnownFrame {
    pub(super) pose: FramePose,
    /// The camera of its decoded image, once it was decoded.
    pub(super) camera: Option<PinholeCamera>,
    /// Why it cannot be used.
    pub(super) failure: Option<String>,
    /// How far it sees at most, once it was drawn.
    pub(super) bound: Option<Arc<DepthBound>>,
}

impl KnownFrame {
    /// What it may see up to a depth; `None` before it is decoded, or when it cannot be.
    pub(super) fn frustum(&self, far_m: f64) -> Option<Frustum> {
        let camera = self.camera.filter(|_| self.failure.is_none())?;
        Some(Frustum::new(
            &camera,
            &self.pose.world_from_camera.inverse(),
            far_m,
        ))
    }
}

/// Keyframes by number.
#[derive(Debug, Default)]
pub(super) struct KnownFrames {
    by_number: BTreeMap<u32, KnownFrame>,
}

/// Which keyframes are others than before.
#[derive(Debug, Default)]
pub(super) struct Turnover {
    pub(super) added: BTreeSet<u32>,
    /// Those with another pose.
    pub(super) moved: BTreeSet<u32>,
}

impl Turnover {
    /// Whether nothing is known of what the keyframe sees.
    pub(super) fn is_unseen(&self, number: u32) -> bool {
        self.added.contains(&number) || self.moved.contains(&number)
    }
}

impl KnownFrames {
    pub(super) fn get(&self, number: u32) -> Option<&KnownFrame> {
        self.by_number.get(&number)
    }

    pub(super) fn get_mut(&mut self, number: u32) -> Option<&mut KnownFrame> {
        self.by_number.get_mut(&number)
    }

    pub(super) fn num_bytes(&self) -> usize {
        let bounds = self.by_number.values().flat_map(|frame| &frame.bound);
        bounds.map(|bound| bound.num_bytes()).sum()
    }

    pub(super) fn num_usable(&self) -> usize {
        let frames = self.by_number.values();
        frames.filter(|frame| frame.failure.is_none()).count()
    }

    pub(super) fn failed(&self) -> Vec<FailedFrame> {
        let failed = self.by_number.iter().filter_map(|(&frame, known)| {
            let reason = known.failure.clone()?;
            Some(FailedFrame { frame, reason })
        });
        failed.collect()
    }
}

impl StreamInit {
    /// Takes over the keyframes; what those that went or moved said is forgotten.
    pub(super) fn take_frames(
        &mut self,
        frames: &[Arc<Keyframe>],
        change: &mut SurfaceChange,
        update: &mut StreamUpdate,
    ) -> Turnover {
        let mut before = std::mem::take(&mut self.frames.by_number);
        let mut turnover = Turnover::default();
        for keyframe in frames {
            let (number, pose) = (keyframe.id.0, FramePose::from(&**keyframe));
            let known = match before.remove(&number) {
                Some(known) if known.pose == pose => known,
                Some(moved) => {
                    turnover.moved.insert(number);
                    self.forget(number, &moved, change);
                    KnownFrame {
                        pose,
                        bound: None,
                        ..moved
                    }
                }
                None => {
                    turnover.added.insert(number);
                    KnownFrame {
                        pose,
                        camera: None,
                        failure: None,
                        bound: None,
                    }
                }
            };
            self.frames.by_number.insert(number, known);
        }
        update.num_frames_added = turnover.added.len();
        update.num_frames_moved = turnover.moved.len();
        update.num_frames_removed = before.len();
        for (number, gone) in before {
            self.forget(number, &gone, change);
        }
        turnover
    }

    /// Forgets what a keyframe says of the charts.
    pub(super) fn forget(&mut self, number: u32, known: &KnownFrame, change: &mut SurfaceChange) {
        let Some(frustum) = known.frustum(self.far_m()) else {
            return;
        };
        for (chart, dirt) in self.charts.iter_mut().zip(&mut change.dirt) {
            chart.labels.remove(number);
            if frustum.may_see(&chart.bounds) {
                dirt.resighted.insert(number);
            }
        }
    }
}
