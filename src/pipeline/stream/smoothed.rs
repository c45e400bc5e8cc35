//! Charts refined by the optimisation while nothing new comes, a group at a time.
//!
//! A group is of charts that wait, near one another, so that views and crops show many of them. It
//! begins with what the discriminator learnt on the group before, and makes its steps over several idle
//! steps, on texels of its own. The texture gets them once, when all are made: told after each
//! idle step, the same charts would be encoded and sent some twenty times over. An update ends the
//! group, as views, photos and what stands beside it may be others: the steps made are kept, those left
//! are made in a later group, so that a scan that hardly rests is refined all the same.
//!
//! Each texel makes about as many steps as it does where the whole is refined at once: a step of the whole
//! reaches what a crop covers of all texels, a step of a group what it covers of the group's.
//! Where all charts wait and fit into one group, the texels are those of the whole, byte for byte. Gutters
//! are not dilated afterwards, as they are not in the whole: those that a lookup reads are optimised
//! themselves.
//!
//! Memory: `smoothing` of [`crate::pipeline::MemoryPlan`].

use std::sync::{Mutex, PoisonError};

use nalgebra::Vector3;

use super::idle::IdleParams;
use super::refined::Refined;
use crate::keyframe::Keyframe;
use crate::mesh::{TriMesh, TriangleId};
use crate::texinit::stream::StreamChartId;
use crate::texsmooth::{
    NoObserver, Observer, SmoothError, SmoothFrom, SmoothScene, Smoothing, TexSmoothParams,
};

/// See the module.
#[derive(Debug, Default)]
pub(super) struct StreamSmoothing {
    group: Option<Group>,
    /// What the discriminator has learnt; empty while it has not.
    critic: Vec<u8>,
    num_groups: u64,
}

/// Charts that are refined now.
#[derive(Debug)]
struct Group {
    /// Ascending, with the steps that they wait for.
    charts: Vec<(StreamChartId, usize)>,
    /// A painter may be looked at by several threads, a device's discriminator may not.
    smoothing: Mutex<Smoothing>,
    num_steps: usize,
}

impl Group {
    fn smoothing(&mut self) -> &mut Smoothing {
        let smoothing = self.smoothing.get_mut();
        smoothing.unwrap_or_else(PoisonError::into_inner)
    }
}

impl StreamSmoothing {
    /// Some steps of the group in work, or of a new one. `ids` are those of the scene's charts. Gives
    /// the charts that show other texels now, ascending.
    ///
    /// # Errors
    /// [`SmoothError`] for settings out of range, and where a device fails.
    pub(super) fn smooth_some(
        &mut self,
        scene: &SmoothScene<'_>,
        ids: &[StreamChartId],
        refined: &mut Refined,
        params: &TexSmoothParams,
        idle: &IdleParams,
        observer: &dyn Observer,
    ) -> Result<Vec<StreamChartId>, SmoothError> {
        if self.group.is_none() {
            self.group = self.next_group(scene, ids, refined, params, idle.max_texels)?;
        }
        let Some(group) = &mut self.group else {
            return Ok(Vec::new());
        };
        let smoothing = group.smoothing();
        smoothing.make_steps(scene, refined.texture(), idle.max_steps, observer)?;
        if smoothing.is_done() {
            self.end(refined)
        } else {
            Ok(Vec::new())
        }
    }

    /// Ends the group in work: the texture shows what was made of it. Gives its charts, ascending,
    /// if that is anything.
    ///
    /// # Errors
    /// [`SmoothError`] where a device fails.
    pub(super) fn end(&mut self, refined: &mut Refined) -> Result<Vec<StreamChartId>, SmoothError> {
        let Some(mut group) = self.group.take() else {
            return Ok(Vec::new());
        };
        let smoothing = group.smoothing();
        smoothing.write_to(refined.texture_mut());
        let (is_done, num_done) = (smoothing.is_done(), smoothing.num_done());
        for &(id, num_waiting) in &group.charts {
            let num_made = if is_done {
                num_waiting
            } else {
                num_waiting * num_done / group.num_steps.max(1)
            };
            refined.note_steps(id, num_made);
        }
        let smoothing = group.smoothing.into_inner();
        let smoothing = smoothing.unwrap_or_else(PoisonError::into_inner);
        let report = smoothing.finish(&NoObserver)?;
        self.critic = report.critic;
        let ids = group.charts.into_iter().map(|(id, _)| id);
        Ok(ids.filter(|_| report.num_texels > 0).collect())
    }

    /// The next charts that wait, before their first step.
    fn next_group(
        &mut self,
        scene: &SmoothScene<'_>,
        ids: &[StreamChartId],
        refined: &Refined,
        params: &TexSmoothParams,
        max_texels: usize,
    ) -> Result<Option<Group>, SmoothError> {
        let chosen = chosen(scene, ids, refined, max_texels);
        if chosen.is_empty() {
            return Ok(None);
        }
        let charts: Vec<(StreamChartId, usize, u64)> = chosen
            .iter()
            .map(|index| {
                let (num_steps, num_texels) = refined.steps_and_texels(ids[*index]);
                (ids[*index], num_steps, num_texels)
            })
            .collect();
        let share = Share {
            num_own: charts.iter().map(|(.., num_texels)| num_texels).sum(),
            num_all: refined.num_texels(),
            num_in_crop: num_crop_px(params, scene.frames.iter().map(|frame| &**frame)),
        };
        let texel_steps = charts.iter().map(|&(_, num_steps, num_texels)| {
            u128::try_from(num_steps).unwrap_or(u128::MAX) * u128::from(num_texels)
        });
        let params = TexSmoothParams {
            num_steps: share.of_texel_steps(texel_steps.sum()),
            // λ falls as it does over the steps of the whole.
            lambda_period: share.of_steps(params.lambda_period),
            // Other views and crops than in the group before.
            seed: params.seed.wrapping_add(self.num_groups),
            ..params.clone()
        };
        let mut may_change = vec![false; ids.len()];
        for index in chosen {
            may_change[index] = true;
        }
        let from = match &*self.critic {
            [] => SmoothFrom::Nothing,
            critic => SmoothFrom::Critic(critic),
        };
        let smoothing = Smoothing::of_charts(scene, refined.texture(), &may_change, &params, from)?;
        self.num_groups += 1;
        Ok(Some(Group {
            charts: charts.into_iter().map(|(id, num, _)| (id, num)).collect(),
            smoothing: Mutex::new(smoothing),
            num_steps: params.num_steps,
        }))
    }
}

/// What part of the steps of the whole give each texel of a group as many.
#[derive(Clone, Copy, Debug)]
struct Share {
    /// Texels of the group.
    num_own: u64,
    /// Texels of all charts.
    num_all: u64,
    /// Texels that a crop covers at most.
    num_in_crop: u64,
}

impl Share {
    /// Of steps that all charts would make.
    fn of_steps(self, num_steps: usize) -> usize {
        let texel_steps = u128::try_from(num_steps).unwrap_or(u128::MAX);
        self.of_texel_steps(texel_steps.saturating_mul(u128::from(self.num_own)))
    }

    /// The same of the sum of such steps over the group's texels; at least one.
    fn of_texel_steps(self, texel_steps: u128) -> usize {
        let reached = |num_texels: u64| u128::from(num_texels.min(self.num_in_crop).max(1));
        let texel_steps = texel_steps.saturating_mul(reached(self.num_all));
        let all = u128::from(self.num_all.max(1)) * reached(self.num_own);
        usize::try_from(texel_steps.div_ceil(all).max(1)).unwrap_or(usize::MAX)
    }
}

fn num_crop_px<'a>(params: &TexSmoothParams, frames: impl Iterator<Item = &'a Keyframe>) -> u64 {
    let whole_px = frames.map(|frame| {
        let camera = &frame.color_camera.pinhole;
        u64::from(camera.width()) * u64::from(camera.height())
    });
    let crop_px = params.crop_px as u64;
    let whole_px = whole_px.max().unwrap_or(1);
    match crop_px {
        0 => whole_px,
        _ => crop_px.saturating_mul(crop_px).min(whole_px),
    }
}

/// Indices, ascending, of the chart that waits for steps longest, and of those nearest to it, until one
/// more would make it more than `max_texels`.
fn chosen(
    scene: &SmoothScene<'_>,
    ids: &[StreamChartId],
    refined: &Refined,
    max_texels: usize,
) -> Vec<usize> {
    let waiting = || (0..ids.len()).filter(|&index| refined.steps_and_texels(ids[index]).0 > 0);
    let Some(first) = waiting().next() else {
        return Vec::new();
    };
    let middle_m = |index: usize| middle_m(scene.mesh, &scene.layout.charts[index].triangles);
    let from_m = middle_m(first);
    let mut by_distance: Vec<(f64, usize)> = waiting()
        .map(|index| ((middle_m(index) - from_m).norm(), index))
        .collect();
    by_distance.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut num_texels = 0;
    let fits = |&(_, index): &(f64, usize)| {
        let is_first = num_texels == 0;
        num_texels += refined.steps_and_texels(ids[index]).1;
        is_first || num_texels <= max_texels as u64
    };
    let near = by_distance.into_iter().take_while(fits);
    let mut chosen: Vec<usize> = near.map(|(_, index)| index).collect();
    chosen.sort_unstable();
    chosen
}

/// The middle of a chart's triangles, metres.
fn middle_m(mesh: &TriMesh, triangles: &[TriangleId]) -> Vector3<f64> {
    let corners = triangles.iter().map(|t| mesh.corners_m(*t)[0].coords);
    corners.sum::<Vector3<f64>>() / triangles.len().max(1) as f64
}

#[cfg(test)]
mod tests;
