//! What is done while nothing new is to be painted: an idle step refines a bounded part of what the
//! updates left.
//!
//! 1. Poses ([`super::poses`]): a few keyframes are measured and turned; the next update of the state
//!    redoes what depends on them, as for any late correction of a pose.
//! 2. Seams ([`super::refined`]), once no keyframe waits: a correction would undo what was levelled.
//! 3. Steps of the optimisation ([`super::smoothed`]), once no chart waits to be levelled: levelling starts
//!    from TexInit's texels.

use std::sync::Arc;

use super::super::clock::StageClock;
use super::super::progress::Progress;
use super::super::refine::{self, SEAM_PHOTO_WIDTH_PX};
use super::super::run::{PipelineError, PipelineParams};
use super::refined::{Refined, Wanted, tell};
use super::smoothed::StreamSmoothing;
use super::{Kept, StreamPainter, Streamed};
use crate::keyframe::{Keyframe, KeyframeStore};
use crate::photometric::{PhotometricError, SeamPhoto};
use crate::texinit::Decode;
use crate::texinit::stream::{StreamChartId, StreamInit, StreamUpdate};
use crate::texsmooth::SmoothScene;

/// What a change makes be painted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StreamMode {
    /// What changed while a scan goes on, where the settings allow it; the whole of a recording.
    #[default]
    Auto,
    /// What changed.
    Changes,
    /// The whole.
    Whole,
}

impl PipelineParams {
    /// Whether only what changed is painted; [`StreamMode::Auto`] is the whole here.
    pub fn follows_changes(&self) -> bool {
        self.stream_mode == StreamMode::Changes
    }

    /// Why these settings cannot follow changes, in words; `None` where they can.
    pub fn whole_scan_only(&self) -> Option<String> {
        let refused = super::check(self).map_err(|error| error.to_string());
        let state = refused.and_then(|()| {
            StreamInit::new(&self.texinit, &self.stream).map_err(|error| error.to_string())
        });
        state.err()
    }

    /// The settings for a scan that goes on, and why it is painted whole where that was not asked for.
    #[must_use]
    pub fn for_live(mut self) -> (Self, Option<String>) {
        let why_whole = match self.stream_mode {
            StreamMode::Auto => self.whole_scan_only(),
            StreamMode::Changes | StreamMode::Whole => None,
        };
        if self.stream_mode == StreamMode::Auto {
            self.stream_mode = match why_whole {
                Some(_) => StreamMode::Whole,
                None => StreamMode::Changes,
            };
        }
        (self, why_whole)
    }
}

/// How much an idle step does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdleParams {
    /// Keyframes whose pose a step measures, ≥ 1.
    pub max_keyframes: usize,
    /// Triangles that a step levels; at least one chart, whatever its size.
    pub max_triangles: usize,
    /// Steps of the optimisation that it makes, ≥ 1.
    pub max_steps: usize,
    /// Texels that the optimisation works on at a time, over several steps; at least one chart, whatever
    /// its size.
    pub max_texels: usize,
}

impl Default for IdleParams {
    fn default() -> Self {
        Self {
            max_keyframes: 4,
            max_triangles: 20_000,
            max_steps: 2,
            max_texels: 500_000,
        }
    }
}

impl StreamPainter {
    /// Charts that wait to be refined.
    pub fn num_charts_waiting(&self) -> usize {
        let refined = self.kept.as_ref().and_then(|kept| kept.refined.as_ref());
        refined.map_or(0, Refined::num_waiting)
    }

    /// Keyframes whose pose waits to be measured.
    pub fn num_poses_waiting(&self) -> usize {
        let poses = self.kept.as_ref().and_then(|kept| kept.poses.as_ref());
        poses.map_or(0, super::poses::StreamPoses::num_waiting)
    }

    /// Whether [`Self::refine_some`] has something to do.
    pub fn has_idle_work(&self) -> bool {
        self.num_waiting() == 0 && (self.num_charts_waiting() > 0 || self.num_poses_waiting() > 0)
    }

    /// All charts of what is painted wait for `num_steps` steps of the optimisation, of which each group
    /// makes its share, or for more where they wait for more; `params` are those it was painted with.
    /// What changes later goes by the settings again.
    pub fn smooth_all(&mut self, num_steps: usize, params: &PipelineParams) {
        let Some(kept) = &mut self.kept else {
            return;
        };
        let refined = kept.refined.get_or_insert_with(Refined::default);
        refined.follow(&kept.state, &StreamUpdate::default());
        refined.ask_for_steps(num_steps);
        kept.is_smoothed_more = true;
        if let Some(capture) = kept.capture.clone() {
            let decode_cache = kept.divide_memory(&capture, params);
            self.store.set_decode_cache_bytes(decode_cache);
        }
    }

    /// With the next painting all charts go by the settings again, where [`Self::smooth_all`] asked for
    /// more.
    pub fn take_back_smooth_all(&mut self) {
        if let Some(kept) = &mut self.kept
            && kept.is_smoothed_more
        {
            kept.begin_refining_anew();
        }
    }

    /// With the next painting all charts show TexInit's texels, and wait.
    pub(super) fn begin_refining_anew(&mut self) {
        if let Some(kept) = &mut self.kept {
            kept.begin_refining_anew();
        }
    }

    /// One idle step: bounded by [`IdleParams`]. `None` when there is nothing to refine, and where
    /// what is painted was painted with other settings. With the same captures and steps between them
    /// the result is the same.
    ///
    /// # Errors
    /// [`PipelineError`] when a stage refuses its parameters. What is painted is forgotten then.
    pub fn refine_some(
        &mut self,
        params: &PipelineParams,
        progress: &dyn Progress,
    ) -> Result<Option<Streamed>, PipelineError> {
        if !self.has_idle_work() {
            return Ok(None);
        }
        let painted = self.kept.take_if(|kept| kept.is_for(params));
        let Some((mut kept, capture)) = painted.and_then(|kept| {
            let capture = kept.capture.clone()?;
            Some((kept, capture))
        }) else {
            return Ok(None);
        };
        let clock = StageClock::new(progress);
        let update = kept.refine_some(&self.store, params, &clock)?;
        let keyframes = kept.painting(&capture.keyframes);
        self.kept = Some(kept);
        Ok(Some(Streamed {
            capture,
            keyframes,
            update,
            is_idle_step: true,
            stages: clock.finish(),
        }))
    }
}

impl Kept {
    fn begin_refining_anew(&mut self) {
        self.refined = Refined::new(Wanted::by(&self.refine, &self.texsmooth));
        self.smoothing = StreamSmoothing::default();
        (self.is_smoothed_more, self.is_begun_anew) = (false, true);
    }

    fn refine_some(
        &mut self,
        store: &KeyframeStore,
        params: &PipelineParams,
        clock: &StageClock<'_>,
    ) -> Result<StreamUpdate, PipelineError> {
        let recorded = |keyframe: &Keyframe| store.decode(keyframe);
        let gains = std::mem::take(&mut self.gains);
        let corrected = refine::corrected(&recorded, &gains, &params.refine);
        let decode = |keyframe: &Keyframe| corrected.decode(keyframe);
        let is_pose = self.poses.as_ref().is_some_and(|p| p.num_waiting() > 0);
        let is_seam = self.refined.as_ref().is_some_and(Refined::has_unlevelled);
        let update = if is_pose {
            self.turn_some(&decode, params, clock)
        } else if is_seam {
            self.level_some(&decode, params, clock)
        } else {
            self.smooth_some(&decode, params, clock)
        };
        self.gains = gains;
        update
    }

    fn turn_some(
        &mut self,
        decode: &Decode<'_>,
        params: &PipelineParams,
        clock: &StageClock<'_>,
    ) -> Result<StreamUpdate, PipelineError> {
        let (Some(poses), Some((_, mesh))) = (&mut self.poses, &self.prepared) else {
            return Ok(StreamUpdate::default());
        };
        let max_keyframes = params.idle.max_keyframes;
        clock.begin("correct poses", max_keyframes);
        let has_turned = poses.round(
            &self.state,
            max_keyframes,
            &mut self.photos,
            decode,
            &params.refine.pose,
        )?;
        if !has_turned {
            return Ok(StreamUpdate::default());
        }
        let keyframes: Vec<Arc<Keyframe>> = poses.painting().collect();
        let mesh = Arc::clone(mesh);
        self.update(&mesh, &keyframes, decode, clock)
    }

    /// Those of what is painted, as they paint.
    fn shown_keyframes(&self) -> Vec<Arc<Keyframe>> {
        let capture = self.capture.as_ref();
        capture.map_or_else(Vec::new, |capture| self.painting(&capture.keyframes))
    }

    fn level_some(
        &mut self,
        decode: &Decode<'_>,
        params: &PipelineParams,
        clock: &StageClock<'_>,
    ) -> Result<StreamUpdate, PipelineError> {
        let keyframes = self.shown_keyframes();
        let Some(refined) = &mut self.refined else {
            return Ok(StreamUpdate::default());
        };
        clock.begin("level seams", 0);
        let photos = &mut self.photos;
        let photos_of = |numbers: &[u32]| {
            let index_of = |number: &u32| keyframes.binary_search_by_key(number, |k| k.id.0).ok();
            let painting: Vec<Option<usize>> = numbers.iter().map(index_of).collect();
            let chosen: Vec<Arc<Keyframe>> = painting
                .iter()
                .flatten()
                .map(|index| Arc::clone(&keyframes[*index]))
                .collect();
            let mut made = chosen
                .iter()
                .zip(photos.of(&chosen, SEAM_PHOTO_WIDTH_PX, decode))
                .map(|(keyframe, photo)| {
                    let photo = photo?;
                    Some(SeamPhoto {
                        color: photo.color.clone(),
                        camera: photo.camera,
                        camera_from_world: keyframe.world_from_camera.inverse(),
                    })
                });
            // One for each number, of those that are no keyframe's none.
            let photo_of = |index: &Option<usize>| index.and_then(|_| made.next().flatten());
            painting.iter().map(photo_of).collect()
        };
        let levelled: Result<_, PhotometricError> = refined.level_some(
            &self.state,
            params.idle.max_triangles,
            photos_of,
            &params.refine.seams,
            params.texinit.has_gutters,
        );
        Ok(levelled?.map(|(update, _)| update).unwrap_or_default())
    }

    fn smooth_some(
        &mut self,
        decode: &Decode<'_>,
        params: &PipelineParams,
        clock: &StageClock<'_>,
    ) -> Result<StreamUpdate, PipelineError> {
        let keyframes = self.shown_keyframes();
        let Some(refined) = &mut self.refined else {
            return Ok(StreamUpdate::default());
        };
        clock.begin("refine the texture", params.idle.max_steps);
        let scene = SmoothScene {
            mesh: self.state.mesh(),
            layout: self.state.layout(),
            frames: &keyframes,
            decode,
        };
        let ids: Vec<StreamChartId> = self.state.chart_ids().collect();
        let (settings, idle) = (&params.texsmooth, &params.idle);
        let smoothing = &mut self.smoothing;
        let changed = smoothing.smooth_some(&scene, &ids, refined, settings, idle, clock)?;
        let mut update = StreamUpdate::default();
        tell(&self.state, &changed, &mut update);
        Ok(update)
    }
}
