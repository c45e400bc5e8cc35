//! Which new keyframes an update takes in, where it does not take them all.
//!
//! A keyframe that comes alone costs nearly what several cost that come together: each changes scores, and
//! with them labels and texels, of all that it sees, and what one paints the next often paints over. So
//! those that see little unpainted surface wait for others; and of very many some wait for the next
//! update.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::StreamInit;
use super::charts::Dirt;
use crate::keyframe::Keyframe;
use crate::render::Frustum;

/// What so many keyframes looked for and did not see is hidden, and no reason not to wait.
const MANY_LOOKS: usize = 4;

/// New keyframes that wait for others.
#[derive(Debug, Default)]
pub(super) struct Held {
    numbers: BTreeSet<u32>,
    /// Updates that went by since the first of them came.
    num_updates: usize,
}

/// Triangles in charts that a keyframe may see, were nothing in its way.
#[derive(Clone, Copy)]
struct InView {
    num_triangles: usize,
    /// Those that no frame paints.
    num_unpainted: usize,
    /// Those of them in charts that few keyframes looked at.
    num_untried: usize,
}

impl StreamInit {
    /// The keyframes that are known already, and the new ones that are taken in; ascending, with the number
    /// of those that wait. `has_other_surface` says whether the mesh is another than at the last call.
    pub(super) fn taken_in(
        &mut self,
        frames: &[Arc<Keyframe>],
        dirt: &[Dirt],
        has_other_surface: bool,
    ) -> (Vec<Arc<Keyframe>>, usize) {
        let is_new = |frame: &&Arc<Keyframe>| self.frames.get(frame.id.0).is_none();
        let new: Vec<Arc<Keyframe>> = frames.iter().filter(is_new).cloned().collect();
        if self.waits(&new, dirt, has_other_surface) {
            self.held.num_updates += 1;
            self.held.numbers = new.iter().map(|frame| frame.id.0).collect();
            let known = frames.iter().filter(|frame| !is_new(frame));
            return (known.cloned().collect(), new.len());
        }
        self.held = Held::default();
        self.within_budget(frames, &new, dirt)
    }

    /// Whether all new keyframes wait for others: not for long, nor where nothing else is to be done.
    fn waits(&self, new: &[Arc<Keyframe>], dirt: &[Dirt], has_other_surface: bool) -> bool {
        let (batch, held) = (self.stream.batch_frames, &self.held);
        let is_same_again =
            !has_other_surface && (new.iter()).all(|frame| held.numbers.contains(&frame.id.0));
        let is_due = new.is_empty() || new.len() >= batch || held.num_updates >= batch;
        !is_due && !is_same_again && !new.iter().any(|frame| self.is_urgent(frame, dirt))
    }

    fn is_urgent(&self, frame: &Keyframe, dirt: &[Dirt]) -> bool {
        let in_view = self.in_view(frame, dirt);
        in_view.num_untried as f64 > self.stream.urgent_share * in_view.num_triangles as f64
    }

    /// As many new keyframes as an update may take in, those first that see most triangles which no frame
    /// paints yet, of equal ones the newer.
    fn within_budget(
        &self,
        frames: &[Arc<Keyframe>],
        new: &[Arc<Keyframe>],
        dirt: &[Dirt],
    ) -> (Vec<Arc<Keyframe>>, usize) {
        let most = self.stream.max_new_frames;
        if most == 0 || new.len() <= most {
            return (frames.to_vec(), 0);
        }
        let mut by_need: Vec<(usize, u32)> = new
            .iter()
            .map(|frame| (self.in_view(frame, dirt).num_unpainted, frame.id.0))
            .collect();
        by_need.sort_unstable_by(|a, b| b.cmp(a));
        let mut waiting: Vec<u32> = by_need[most..].iter().map(|(_, number)| *number).collect();
        waiting.sort_unstable();
        let taken = frames
            .iter()
            .filter(|frame| waiting.binary_search(&frame.id.0).is_err());
        (taken.cloned().collect(), waiting.len())
    }

    /// A chart that was made anew has no labels yet; triangles in it that were scored before, in another
    /// chart, count as painted.
    fn in_view(&self, frame: &Keyframe, dirt: &[Dirt]) -> InView {
        let frustum = Frustum::new(
            &frame.color_camera.pinhole,
            &frame.world_from_camera.inverse(),
            self.far_m(),
        );
        let charts = self.charts.iter().zip(dirt);
        let mut in_view = InView {
            num_triangles: 0,
            num_unpainted: 0,
            num_untried: 0,
        };
        for (chart, dirt) in charts.filter(|(chart, _)| frustum.may_see(&chart.bounds)) {
            let labels = &chart.labels.assignment().label;
            in_view.num_triangles += labels.len();
            let num_unpainted = match dirt.is_fresh {
                true => dirt
                    .unscored
                    .iter()
                    .filter(|is_unscored| **is_unscored)
                    .count(),
                false => labels.iter().filter(|label| label.is_none()).count(),
            };
            in_view.num_unpainted += num_unpainted;
            if chart.num_looks < MANY_LOOKS {
                in_view.num_untried += num_unpainted;
            }
        }
        in_view
    }
}
