//! Poses while keyframes come and go: rounds of correction, a few keyframes at a time.
//!
//! The rounds of [`super::super::pose_rounds`], keyframe by keyframe: each is measured against the texture as it
//! is, turned by its offset, measured again when its turn comes, and put back where its residual rose.
//! Those go first that had the fewest rounds, of these the ones that paint most triangles. A keyframe is
//! settled when its offset is nothing, when a turn gained nothing, or when it had its rounds. One whose offset
//! cannot be told waits for other keyframes to come. One whose recorded pose is corrected begins anew.
//!
//! Corrections are the painter's own: what is recorded stays as it is.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rayon::prelude::*;

use super::small_photos::SmallPhotos;
use crate::keyframe::{Keyframe, KeyframeId};
use crate::photometric::{
    Painted, PhotometricError, PoseMeasure, PoseParams, measure_pose, turned,
};
use crate::pipeline::pose_rounds::has_risen;
use crate::texinit::Decode;
use crate::texinit::stream::StreamInit;

/// Offsets below this are nothing that a texel could show, pixels of the full photo.
const MIN_OFFSET_PX: f64 = 0.5;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct StreamPoses {
    by_id: BTreeMap<KeyframeId, Turning>,
}

/// A keyframe and its rounds.
#[derive(Debug)]
struct Turning {
    recorded: Arc<Keyframe>,
    /// As it paints.
    current: Arc<Keyframe>,
    num_turns: usize,
    /// As it painted before its last turn, and what it measured then.
    before: Option<(Arc<Keyframe>, PoseMeasure)>,
    stage: Stage,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// It is to be measured.
    Waiting,
    /// Its offset could not be told.
    Untold,
    /// It is left alone.
    Settled,
}

impl StreamPoses {
    /// Takes over which keyframes there are, and gives them as they paint.
    pub(super) fn keep_up(&mut self, keyframes: &[Arc<Keyframe>]) -> Vec<Arc<Keyframe>> {
        let present: BTreeSet<KeyframeId> = keyframes.iter().map(|keyframe| keyframe.id).collect();
        self.by_id.retain(|id, _| present.contains(id));
        let num_known = self.by_id.len();
        for keyframe in keyframes {
            let known = self.by_id.get(&keyframe.id);
            let pose = &keyframe.world_from_camera;
            if known.is_none_or(|known| known.recorded.world_from_camera != *pose) {
                self.by_id.insert(keyframe.id, Turning::new(keyframe));
            }
        }
        if self.by_id.len() > num_known {
            let untold = self.by_id.values_mut().filter(|t| t.stage == Stage::Untold);
            untold.for_each(|turning| turning.stage = Stage::Waiting);
        }
        self.painting().collect()
    }

    /// The keyframes as they paint, ascending.
    pub(super) fn painting(&self) -> impl Iterator<Item = Arc<Keyframe>> {
        let all = self.by_id.values();
        all.map(|turning| Arc::clone(&turning.current))
    }

    /// Keyframes that wait to be measured.
    pub(super) fn num_waiting(&self) -> usize {
        let all = self.by_id.values();
        all.filter(|turning| turning.stage == Stage::Waiting)
            .count()
    }

    /// A round of at most `max_keyframes`; whether any of them paints otherwise now.
    ///
    /// # Errors
    /// [`PhotometricError`] for alignment settings out of range.
    pub(super) fn round(
        &mut self,
        state: &StreamInit,
        max_keyframes: usize,
        photos: &mut SmallPhotos,
        decode: &Decode<'_>,
        params: &PoseParams,
    ) -> Result<bool, PhotometricError> {
        let label = state.labels();
        let chosen = self.next(&label, max_keyframes);
        let photos = photos.of(&chosen, params.max_width_px, decode);
        let painted = Painted {
            mesh: state.mesh(),
            layout: state.layout(),
            texture: state.texture(),
            label: &label,
        };
        let measures: Result<Vec<PoseMeasure>, _> = chosen
            .par_iter()
            .zip(&photos)
            .map(|(keyframe, photo)| match photo {
                Some(photo) => {
                    let camera_from_world = keyframe.world_from_camera.inverse();
                    let number = keyframe.id.0 as usize;
                    measure_pose(painted, number, &camera_from_world, photo, params)
                }
                None => Ok(PoseMeasure::default()),
            })
            .collect();
        let mut has_turned = false;
        for (keyframe, measure) in chosen.iter().zip(measures?) {
            if let Some(turning) = self.by_id.get_mut(&keyframe.id) {
                has_turned |= turning.take(measure, params);
            }
        }
        Ok(has_turned)
    }

    /// Those that are measured next, as they paint, ascending.
    fn next(&self, label: &[Option<u32>], max_keyframes: usize) -> Vec<Arc<Keyframe>> {
        let mut num_painted: BTreeMap<u32, usize> = BTreeMap::new();
        for number in label.iter().flatten() {
            *num_painted.entry(*number).or_default() += 1;
        }
        let waiting = self.by_id.iter();
        let waiting = waiting.filter(|(_, turning)| turning.stage == Stage::Waiting);
        let mut by_need: Vec<(usize, Reverse<usize>, KeyframeId)> = waiting
            .map(|(id, turning)| {
                let num = num_painted.get(&id.0).copied().unwrap_or(0);
                (turning.num_turns, Reverse(num), *id)
            })
            .collect();
        by_need.sort_unstable();
        by_need.truncate(max_keyframes.max(1));
        let mut chosen: Vec<KeyframeId> = by_need.into_iter().map(|(_, _, id)| id).collect();
        chosen.sort_unstable();
        let turning = chosen.iter().filter_map(|id| self.by_id.get(id));
        turning
            .map(|turning| Arc::clone(&turning.current))
            .collect()
    }
}

impl Turning {
    fn new(keyframe: &Arc<Keyframe>) -> Self {
        Self {
            recorded: Arc::clone(keyframe),
            current: Arc::clone(keyframe),
            num_turns: 0,
            before: None,
            stage: Stage::Waiting,
        }
    }

    /// Goes by what was measured; whether the pose is another now.
    fn take(&mut self, measure: PoseMeasure, params: &PoseParams) -> bool {
        let last = self.before.as_ref().and_then(|(_, last)| last.residual_255);
        if has_risen(last, measure.residual_255) {
            self.stage = Stage::Settled;
            let before = self.before.take();
            return before.is_some_and(|(before, _)| {
                self.current = before;
                true
            });
        }
        let has_gained = match (last, measure.residual_255) {
            (Some(last), Some(now)) => now <= last * (1.0 - params.min_gain),
            _ => true,
        };
        let Some(offset_px) = measure.offset_px else {
            self.stage = match self.before {
                Some(_) => Stage::Settled,
                None => Stage::Untold,
            };
            return false;
        };
        let [x, y] = offset_px;
        let goes_on = has_gained && self.num_turns < params.max_rounds;
        let turned = (goes_on && x.hypot(y) >= MIN_OFFSET_PX)
            .then(|| {
                turned(
                    &self.current,
                    &self.recorded.world_from_camera,
                    offset_px,
                    params,
                )
            })
            .flatten();
        let Some(turned) = turned else {
            self.stage = Stage::Settled;
            return false;
        };
        let before = std::mem::replace(&mut self.current, Arc::new(turned));
        self.before = Some((before, measure));
        self.num_turns += 1;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Stamp;
    use crate::geom::{CameraModel, ColorEncoding, EncodedColor, PinholeCamera, RigidTransform};
    use crate::keyframe::FrameQuality;

    fn keyframe(id: u32) -> Arc<Keyframe> {
        let camera = PinholeCamera::new([300.0, 300.0, 159.5, 119.5], 320, 240).unwrap();
        let bytes = vec![0; 320 * 240];
        Arc::new(Keyframe {
            id: KeyframeId(id),
            stamp: Stamp::from_nanos(0),
            world_from_camera: RigidTransform::identity(),
            color: EncodedColor::from_raw(ColorEncoding::Mono8, 320, 240, 320, bytes.into())
                .unwrap(),
            color_camera: CameraModel::ideal(camera),
            depth: None,
            quality: FrameQuality::default(),
        })
    }

    fn measure(residual_255: f64, x_px: f64) -> PoseMeasure {
        PoseMeasure {
            offset_px: Some([x_px, 0.0]),
            residual_255: Some(residual_255),
        }
    }

    #[test]
    fn a_turn_that_makes_it_worse_is_taken_back_for_good() {
        let params = PoseParams::default();
        let mut turning = Turning::new(&keyframe(3));
        assert!(turning.take(measure(10.0, 2.0), &params));
        let first = turning.current.world_from_camera;
        assert_ne!(first, turning.recorded.world_from_camera);
        assert!(turning.take(measure(6.0, 2.0), &params));
        assert!(turning.take(measure(7.0, 3.0), &params));
        assert_eq!(turning.current.world_from_camera, first);
        assert_eq!(turning.stage, Stage::Settled);
    }

    #[test]
    fn rounds_end_where_nothing_is_gained_or_left_or_allowed() {
        let params = PoseParams::default();
        let settled = |measures: &[PoseMeasure]| {
            let mut turning = Turning::new(&keyframe(3));
            let (last, turns) = measures.split_last().unwrap();
            assert!(turns.iter().all(|measure| turning.take(*measure, &params)));
            !turning.take(*last, &params) && turning.stage == Stage::Settled
        };
        assert!(settled(&[measure(10.0, 2.0), measure(9.99, 2.0)]));
        assert!(settled(&[measure(10.0, 2.0), measure(5.0, 0.4)]));
        // So far it may not be turned.
        assert!(settled(&[measure(10.0, 90.0)]));
        let rounds = 0..=params.max_rounds;
        let falling: Vec<_> = rounds.map(|n| measure(10.0 - n as f64, 1.0)).collect();
        assert!(settled(&falling));
    }

    #[test]
    fn what_cannot_be_told_waits_for_others_and_a_new_pose_begins_anew() {
        let params = PoseParams::default();
        let mut poses = StreamPoses::default();
        assert_eq!(poses.keep_up(&[keyframe(1)]).len(), 1);
        let first = poses.by_id.get_mut(&KeyframeId(1)).unwrap();
        assert!(!first.take(PoseMeasure::default(), &params));
        assert_eq!(poses.num_waiting(), 0);
        poses.keep_up(&[keyframe(1)]);
        assert_eq!(poses.num_waiting(), 0);
        poses.keep_up(&[keyframe(1), keyframe(2)]);
        assert_eq!(poses.num_waiting(), 2);
        let first = poses.by_id.get_mut(&KeyframeId(1)).unwrap();
        assert!(first.take(measure(10.0, 2.0), &params));
        assert!(!first.take(measure(9.99, 2.0), &params));
        let turned = poses.keep_up(&[keyframe(1), keyframe(2)]);
        assert_ne!(turned[0].world_from_camera, RigidTransform::identity());
        let moved = Arc::new(Keyframe {
            world_from_camera: turned[0].world_from_camera,
            ..(*keyframe(1)).clone()
        });
        assert_eq!(poses.num_waiting(), 1);
        poses.keep_up(&[moved]);
        assert_eq!((poses.num_waiting(), poses.by_id.len()), (1, 1));
    }

    #[test]
    fn those_with_fewest_rounds_and_most_triangles_go_first() {
        let mut poses = StreamPoses::default();
        poses.keep_up(&[0, 1, 2, 3].map(keyframe));
        let label = [Some(2), Some(2), Some(1), None];
        let next = |poses: &StreamPoses| {
            let next = poses.next(&label, 2).into_iter();
            next.map(|keyframe| keyframe.id.0).collect::<Vec<_>>()
        };
        assert_eq!(next(&poses), [1, 2]);
        let most = poses.by_id.get_mut(&KeyframeId(2)).unwrap();
        assert!(most.take(measure(10.0, 2.0), &PoseParams::default()));
        assert_eq!(next(&poses), [0, 1]);
    }
}
