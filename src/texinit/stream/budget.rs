//! Which new keyframes an update takes in, where it may not take them all.

use std::sync::Arc;

use super::StreamInit;
use crate::keyframe::Keyframe;
use crate::render::Frustum;

impl StreamInit {
    /// The keyframes that are known already and as many new ones as an update may take in: those
    /// first that see most triangles which no frame paints yet, of equal ones the newer. Ascending, with
    /// the number of those that wait.
    pub(super) fn within_budget(&self, frames: &[Arc<Keyframe>]) -> (Vec<Arc<Keyframe>>, usize) {
        let is_new = |frame: &&Arc<Keyframe>| self.frames.get(frame.id.0).is_none();
        let most = self.stream.max_new_frames;
        let num_new = frames.iter().filter(is_new).count();
        if most == 0 || num_new <= most {
            return (frames.to_vec(), 0);
        }
        let mut by_need: Vec<(usize, u32)> = frames
            .iter()
            .filter(is_new)
            .map(|frame| (self.num_unpainted_in(frame), frame.id.0))
            .collect();
        by_need.sort_unstable_by(|a, b| b.cmp(a));
        let mut waiting: Vec<u32> = by_need[most..].iter().map(|(_, number)| *number).collect();
        waiting.sort_unstable();
        let taken = frames
            .iter()
            .filter(|frame| waiting.binary_search(&frame.id.0).is_err());
        (taken.cloned().collect(), waiting.len())
    }

    /// Triangles without a frame in charts that a keyframe may see, were nothing in its way.
    fn num_unpainted_in(&self, frame: &Keyframe) -> usize {
        let frustum = Frustum::new(
            &frame.color_camera.pinhole,
            &frame.world_from_camera.inverse(),
            self.far_m(),
        );
        let charts = self.charts.iter();
        let in_view = charts.filter(|chart| frustum.may_see(&chart.bounds));
        let num_unpainted = |labels: &[Option<u32>]| labels.iter().filter(|l| l.is_none()).count();
        in_view
            .map(|chart| num_unpainted(&chart.labels.assignment().label))
            .sum()
    }
}
