//! Which frames are worth keeping: a policy on motion, sharpness and exposure.
//!
//! - Exposure: a frame that is nearly black, nearly white or mostly clipped is refused.
//! - Motion: a frame is a new view when it is far from every kept one in distance or in angle.
//!   When no frame was kept for a while, a fraction of that motion suffices, so that slow and
//!   sparse recordings are kept too, and a camera at rest is not.
//! - Sharpness is judged against the running median of recent frames. A blurred frame is refused
//!   when kept frames show most of what it shows; it is better than nothing otherwise.
//! - A frame of nearly the same view as a kept one replaces it when it is much sharper.

use std::collections::VecDeque;

use super::frame::{FrameQuality, Keyframe, KeyframeId};
use super::sight::SightBox;
use crate::geom::{RigidTransform, Stamp};

/// Settings of the choice of keyframes and of their store.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeParams {
    /// Most bytes of encoded colour and depth kept, MB (10⁶ bytes), > 0.
    pub budget_mb: f64,
    /// Most bytes of decoded frames kept for reuse, MB (10⁶ bytes), ≥ 0.
    pub decode_cache_mb: f64,
    /// Distance to every kept frame that makes a new view, metres, ≥ 0.
    pub min_translation_m: f64,
    /// Angle to every kept frame that makes a new view, radians, ≥ 0.
    pub min_rotation_rad: f64,
    /// Time since the last kept frame after which less motion suffices, seconds, ≥ 0.
    pub sparse_interval_s: f64,
    /// The share of the motion that then suffices, 0–1.
    pub sparse_motion_share: f64,
    /// Least sharpness as a share of the running median, ≥ 0; 0 keeps blurred frames.
    pub min_relative_sharpness: f64,
    /// Recent frames whose sharpness the median is of, ≥ 1.
    pub sharpness_window: usize,
    /// How many times as sharp a frame must be to replace one of nearly the same view, ≥ 1.
    pub replace_sharpness_ratio: f64,
    /// Least mean luma, 0–1.
    pub min_mean_luma: f64,
    /// Largest mean luma, 0–1.
    pub max_mean_luma: f64,
    /// Largest share of clipped pixels, 0–1.
    pub max_clipped: f64,
    /// How far the stamp of a corrected pose may lie from a keyframe's, seconds, ≥ 0: stamps that
    /// went through floating point come back a little off.
    pub max_correction_interval_s: f64,
    /// Frames that see nothing of it are refused; `None` keeps them.
    pub must_see: Option<SightBox>,
}

impl Default for KeyframeParams {
    fn default() -> Self {
        Self {
            budget_mb: 512.0,
            decode_cache_mb: 700.0,
            min_translation_m: 0.10,
            min_rotation_rad: 0.17,
            sparse_interval_s: 0.4,
            sparse_motion_share: 0.1,
            min_relative_sharpness: 0.5,
            sharpness_window: 31,
            replace_sharpness_ratio: 1.3,
            min_mean_luma: 0.03,
            max_mean_luma: 0.97,
            max_clipped: 0.8,
            max_correction_interval_s: 0.001,
            must_see: None,
        }
    }
}

/// Frames judged before sharpness is compared with their median.
const MIN_WINDOW: usize = 5;
/// A blurred frame is refused when kept frames show this share of its view.
const MAX_COVERED_SHARE: f64 = 0.5;

/// What becomes of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Choice {
    Keep,
    Replace(KeyframeId),
    BadExposure,
    Blurred,
    SameView,
}

/// The policy and its memory of recent frames.
#[derive(Clone, Debug)]
pub(super) struct Selector {
    params: KeyframeParams,
    recent_sharpness: VecDeque<f32>,
    last_kept: Option<Stamp>,
}

impl Selector {
    pub(super) fn new(params: &KeyframeParams) -> Self {
        Self {
            params: params.clone(),
            recent_sharpness: VecDeque::new(),
            last_kept: None,
        }
    }

    /// Judges a frame against the kept ones. `covered_share` says how much of its view they show;
    /// it is asked only where it matters.
    pub(super) fn choose<'a>(
        &mut self,
        stamp: Stamp,
        world_from_camera: &RigidTransform,
        quality: &FrameQuality,
        kept: impl Iterator<Item = &'a Keyframe>,
        covered_share: impl FnOnce() -> f64,
    ) -> Choice {
        if !self.is_well_exposed(quality) {
            return Choice::BadExposure;
        }
        let is_blurred = self.is_blurred(quality.sharpness);
        let motion_share = self.motion_share(stamp);
        match self.nearest_of_same_view(world_from_camera, kept) {
            None if is_blurred && covered_share() >= MAX_COVERED_SHARE => Choice::Blurred,
            None => Choice::Keep,
            Some(nearest) if nearest.motion >= motion_share => {
                // A sparse frame: its view overlaps with a kept one by all but the motion.
                if is_blurred {
                    Choice::Blurred
                } else {
                    Choice::Keep
                }
            }
            Some(nearest) => {
                let ratio = self.params.replace_sharpness_ratio;
                let is_sharper =
                    f64::from(quality.sharpness) >= ratio * f64::from(nearest.sharpness);
                if is_sharper && !is_blurred {
                    Choice::Replace(nearest.id)
                } else {
                    Choice::SameView
                }
            }
        }
    }

    /// Tells the policy that the frame of this stamp was kept.
    pub(super) fn note_kept(&mut self, stamp: Stamp) {
        self.last_kept = Some(stamp);
    }

    fn is_well_exposed(&self, quality: &FrameQuality) -> bool {
        let luma = f64::from(quality.mean_luma);
        (self.params.min_mean_luma..=self.params.max_mean_luma).contains(&luma)
            && f64::from(quality.clipped) <= self.params.max_clipped
    }

    /// Takes the frame into the running median and compares it.
    fn is_blurred(&mut self, sharpness: f32) -> bool {
        self.recent_sharpness.push_back(sharpness);
        if self.recent_sharpness.len() > self.params.sharpness_window.max(1) {
            self.recent_sharpness.pop_front();
        }
        if self.recent_sharpness.len() < MIN_WINDOW.min(self.params.sharpness_window) {
            return false;
        }
        let mut sorted: Vec<f32> = self.recent_sharpness.iter().copied().collect();
        sorted.sort_by(f32::total_cmp);
        let median = sorted[sorted.len() / 2];
        f64::from(sharpness) < self.params.min_relative_sharpness * f64::from(median)
    }

    fn motion_share(&self, stamp: Stamp) -> f64 {
        match self.last_kept {
            Some(last) if stamp.seconds_since(last).abs() < self.params.sparse_interval_s => 1.0,
            _ => self.params.sparse_motion_share,
        }
    }

    /// The kept frame nearest in motion, where both its distance and its angle are under the
    /// limits.
    fn nearest_of_same_view<'a>(
        &self,
        world_from_camera: &RigidTransform,
        kept: impl Iterator<Item = &'a Keyframe>,
    ) -> Option<SameView> {
        let share_of = |value: f64, limit: f64| if limit > 0.0 { value / limit } else { 1.0 };
        kept.map(|keyframe| {
            let (rotation_rad, translation_m) =
                world_from_camera.distance_to(&keyframe.world_from_camera);
            SameView {
                id: keyframe.id,
                sharpness: keyframe.quality.sharpness,
                motion: share_of(translation_m, self.params.min_translation_m)
                    .max(share_of(rotation_rad, self.params.min_rotation_rad)),
            }
        })
        .filter(|view| view.motion < 1.0)
        .min_by(|a, b| a.motion.total_cmp(&b.motion))
    }
}

struct SameView {
    id: KeyframeId,
    sharpness: f32,
    /// The larger of distance and angle as shares of their limits.
    motion: f64,
}
