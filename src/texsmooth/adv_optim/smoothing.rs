//! A refinement that is done in pieces, of all charts or of some.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::Vector3;

use super::step::Optimisation;
use super::{Observer, SmoothError, SmoothFrom, SmoothReport, StepProgress};
use crate::atlas::{AtlasLayout, AtlasTexture};
use crate::keyframe::{Keyframe, KeyframeId};
use crate::mesh::TriMesh;
use crate::render::ViewRasterizer;
use crate::texsmooth::discriminator::{self, Critic};
use crate::texsmooth::focus::Focus;
use crate::texsmooth::loss_curve::RunningMeans;
use crate::texsmooth::offsets::Offsets;
use crate::texsmooth::texels::Texels;
use crate::texsmooth::view::Surface;
use crate::texsmooth::views::{ViewCache, Views, partner_axes};
use crate::texsmooth::{Decode, SmoothStart, TexSmoothParams, checkpoint};

/// What a texture is refined by.
#[derive(Clone, Copy)]
pub struct SmoothScene<'a> {
    /// The surface. All of it hides what lies behind.
    pub mesh: &'a TriMesh,
    /// Where its triangles lie in the texture.
    pub layout: &'a AtlasLayout,
    /// The photos.
    pub frames: &'a [Arc<Keyframe>],
    /// How they are decoded. A step asks for one or two of them; what was decoded is best kept for a
    /// while.
    pub decode: &'a Decode<'a>,
}

/// A refinement of some charts, as far as it has come: for a scan that goes on, whose charts are
/// refined where they changed, a few steps at a time.
///
/// ```no_run
/// # use veneer::texsmooth::*;
/// # fn refine(
/// #     scene: &SmoothScene<'_>,
/// #     texture: &mut veneer::atlas::AtlasTexture,
/// #     may_change: &[bool],
/// #     has_time: impl Fn() -> bool,
/// # ) -> Result<(), SmoothError> {
/// let params = TexSmoothParams {
///     num_steps: 300,
///     ..TexSmoothParams::default()
/// };
/// let mut smoothing =
///     Smoothing::of_charts(scene, texture, may_change, &params, SmoothFrom::Nothing)?;
/// while has_time() && !smoothing.is_done() {
///     smoothing.advance(scene, texture, 4, &NoObserver)?;
/// }
/// let report = smoothing.finish(&NoObserver)?;
/// // The next refinement begins with what the discriminator has learnt.
/// let next = SmoothFrom::Critic(&report.critic);
/// # Ok(())
/// # }
/// ```
///
/// * Only texels that the charts own may change, gutters included: as in the whole form those of a
///   gutter follow that a lookup at the chart's border reads. All others stay to the last bit, and cost
///   no memory and no work but what it takes to look at them.
/// * Views are drawn among those that show the charts, and crops around pixels that do
///   (`texsmooth::focus`). Of a crop all is rendered, and all counts for alignment and discriminator;
///   only pixels that show the charts are a reason for a step. A pixel's weight is what it is in
///   the whole form.
/// * In how many calls the steps are made does not matter, nor how many threads make them: the bytes are
///   the same. Where all charts may change, they are those of [`super::smooth`].
/// * Between two calls nothing of the scene may change but the decoder, and of the texture no texel of
///   the charts; when the scan has gone on, begin anew. That is cheap: the views are drawn one by one
///   as steps ask for them.
/// * Steps are made on texels of its own. Where the texture is not to show them one by one, make them
///   with [`Self::make_steps`], and write what they came to by [`Self::write_to`].
pub struct Smoothing {
    params: TexSmoothParams,
    /// Per chart; `None` where all may.
    may_change: Option<Vec<bool>>,
    scene: SceneMark,
    rasterizer: ViewRasterizer,
    texels: Texels,
    critic: Option<Box<dyn Critic>>,
    offsets: Offsets,
    axes: Vec<Vector3<f64>>,
    cache: ViewCache,
    focus: Option<Focus>,
    means: RunningMeans,
    report: SmoothReport,
}

impl fmt::Debug for Smoothing {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut told = formatter.debug_struct("Smoothing");
        told.field("num_steps", &self.report.num_steps)
            .finish_non_exhaustive()
    }
}

/// Enough of a scene to tell most others from it.
#[derive(PartialEq, Eq)]
struct SceneMark {
    num_triangles: usize,
    num_charts: usize,
    frames: Vec<KeyframeId>,
}

impl SceneMark {
    fn of(scene: &SmoothScene<'_>, texture: &AtlasTexture) -> Result<Self, SmoothError> {
        texture.check_fits(scene.layout)?;
        let num_triangles = scene.mesh.num_triangles();
        if scene.layout.corners_texel.len() != num_triangles {
            return Err(SmoothError::Layout {
                num_triangles,
                num_in_layout: scene.layout.corners_texel.len(),
            });
        }
        Ok(Self {
            num_triangles,
            num_charts: scene.layout.charts.len(),
            frames: scene.frames.iter().map(|frame| frame.id).collect(),
        })
    }

    fn check(&self, now: &Self) -> Result<(), SmoothError> {
        let what = if self.num_triangles != now.num_triangles {
            "mesh"
        } else if self.num_charts != now.num_charts {
            "layout"
        } else if self.frames != now.frames {
            "list of photos"
        } else {
            return Ok(());
        };
        Err(SmoothError::Changed { what })
    }
}

impl Smoothing {
    /// Before the first step of a refinement of the charts that `may_change` says yes to.
    ///
    /// # Errors
    /// [`SmoothError`] for a layout, texture, setting, checkpoint or number of charts that does not
    /// fit.
    pub fn of_charts(
        scene: &SmoothScene<'_>,
        texture: &AtlasTexture,
        may_change: &[bool],
        params: &TexSmoothParams,
        from: SmoothFrom<'_>,
    ) -> Result<Self, SmoothError> {
        let num_charts = scene.layout.charts.len();
        if may_change.len() != num_charts {
            return Err(SmoothError::Charts {
                num_flags: may_change.len(),
                num_charts,
            });
        }
        let is_part = may_change.contains(&false);
        Self::new(scene, texture, is_part.then_some(may_change), params, from)
    }

    /// The same of all charts.
    pub(super) fn of_all(
        scene: &SmoothScene<'_>,
        texture: &AtlasTexture,
        params: &TexSmoothParams,
        from: SmoothFrom<'_>,
    ) -> Result<Self, SmoothError> {
        Self::new(scene, texture, None, params, from)
    }

    fn new(
        scene: &SmoothScene<'_>,
        texture: &AtlasTexture,
        may_change: Option<&[bool]>,
        params: &TexSmoothParams,
        from: SmoothFrom<'_>,
    ) -> Result<Self, SmoothError> {
        let begun = Instant::now();
        let mark = SceneMark::of(scene, texture)?;
        let (texels, focus) = match may_change {
            None => (Texels::from_texture(texture), None),
            Some(charts) => (
                Texels::of_charts(texture, scene.layout, charts),
                Some(Focus::guess(scene.mesh, scene.layout, charts, scene.frames)),
            ),
        };
        let mut texels = texels.ok_or(SmoothError::TooManyTexels)?;
        if params.start == SmoothStart::Blank {
            texels.fill(0.0);
        }
        let mut first_step = 0;
        let mut known_critic = match from {
            SmoothFrom::Critic(bytes) => Some(bytes.to_vec()),
            _ => None,
        };
        if let SmoothFrom::Checkpoint(bytes) = from {
            let saved = checkpoint::read(bytes, &mut texels)?;
            first_step = saved.num_steps;
            known_critic = Some(saved.critic);
        }
        let rasterizer = ViewRasterizer::new(params.backend)?;
        let (critic, backend) = if params.has_discriminator {
            let known = known_critic.as_deref();
            let made = discriminator::make(&rasterizer, &params.discriminator, params.seed, known)?;
            (Some(made), rasterizer.device_name())
        } else {
            (None, "none")
        };
        let budget_bytes = (params.view_cache_mb.max(0.0) * 1e6).min(1e15);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped above"
        )]
        let cache = ViewCache::new(scene.frames.len(), budget_bytes as usize);
        Ok(Self {
            may_change: may_change.map(<[bool]>::to_vec),
            scene: mark,
            texels,
            critic,
            offsets: Offsets::new(
                params.align,
                params.align_grid,
                params.align_interval,
                scene.frames.len(),
            ),
            axes: partner_axes(scene.frames, params.partner_rule),
            cache,
            focus,
            means: RunningMeans::new(params.num_steps),
            report: SmoothReport {
                num_steps: first_step,
                backend: backend.to_owned(),
                seconds: begun.elapsed().as_secs_f64(),
                ..SmoothReport::default()
            },
            rasterizer,
            params: params.clone(),
        })
    }

    /// Whether there is nothing left to do: all steps are done, or no photo shows any of the charts.
    pub fn is_done(&self) -> bool {
        let num_views = num_views(self.focus.as_ref(), self.scene.frames.len());
        self.report.num_steps >= self.params.num_steps || num_views == 0
    }

    /// Makes up to `max_steps` of the steps that are left, and writes to `texture` what they came to.
    /// [`TexSmoothParams::time_budget_s`] is the time of one call.
    ///
    /// # Errors
    /// [`SmoothError`] for another scene than before, and where a device fails. Frames that do not
    /// decode are no error: they are counted.
    pub fn advance(
        &mut self,
        scene: &SmoothScene<'_>,
        texture: &mut AtlasTexture,
        max_steps: usize,
        observer: &dyn Observer,
    ) -> Result<(), SmoothError> {
        self.make_steps(scene, texture, max_steps, observer)?;
        self.write_to(texture);
        Ok(())
    }

    /// [`Self::advance`] without writing to the texture.
    ///
    /// # Errors
    /// As [`Self::advance`].
    pub fn make_steps(
        &mut self,
        scene: &SmoothScene<'_>,
        texture: &AtlasTexture,
        max_steps: usize,
        observer: &dyn Observer,
    ) -> Result<(), SmoothError> {
        self.scene.check(&SceneMark::of(scene, texture)?)?;
        self.run(scene, texture, max_steps, 0.0, observer)
    }

    /// Writes to the texture that the refinement was begun on what steps changed since it was written
    /// last.
    pub fn write_to(&mut self, texture: &mut AtlasTexture) {
        self.texels.write_back(texture);
    }

    /// Steps done.
    pub fn num_done(&self) -> usize {
        self.report.num_steps
    }

    /// Makes all steps; the time budget is that of the whole refinement.
    pub(super) fn advance_whole(
        &mut self,
        scene: &SmoothScene<'_>,
        texture: &mut AtlasTexture,
        observer: &dyn Observer,
    ) -> Result<(), SmoothError> {
        let passed_s = self.report.seconds;
        self.run(scene, texture, usize::MAX, passed_s, observer)?;
        self.write_to(texture);
        Ok(())
    }

    fn run(
        &mut self,
        scene: &SmoothScene<'_>,
        texture: &AtlasTexture,
        max_steps: usize,
        passed_s: f64,
        observer: &dyn Observer,
    ) -> Result<(), SmoothError> {
        let begun = Instant::now();
        let num_steps = self.params.num_steps;
        let num_done = self.report.num_steps;
        let end = num_done.saturating_add(max_steps).min(num_steps);
        let budget_s = self.params.time_budget_s;
        let is_late = || budget_s > 0.0 && passed_s + begun.elapsed().as_secs_f64() >= budget_s;
        let on = Surface {
            mesh: scene.mesh,
            layout: scene.layout,
            texture,
            may_change: self.may_change.as_deref(),
        };
        let mut run = Optimisation {
            params: &self.params,
            on,
            texels: &mut self.texels,
            critic: &mut self.critic,
            offsets: &mut self.offsets,
            axes: &self.axes,
            views: Views {
                on,
                rasterizer: &self.rasterizer,
                mesh: None,
                frames: scene.frames,
                decode: scene.decode,
                cache: &mut self.cache,
            },
            focus: &mut self.focus,
            report: &mut self.report,
        };
        run.steps(num_done..end, &is_late, &mut self.means, observer)?;
        self.report.seconds += begun.elapsed().as_secs_f64();
        Ok(())
    }

    /// How the refinement went.
    ///
    /// # Errors
    /// [`SmoothError`] where the device does not give the discriminator.
    pub fn finish(self, observer: &dyn Observer) -> Result<SmoothReport, SmoothError> {
        let begun = Instant::now();
        let mut report = self.report;
        let num_done = report.num_steps;
        let critic = saved(self.critic.as_deref())?;
        let interval = self.params.checkpoint_interval;
        if interval > 0 && !num_done.is_multiple_of(interval) {
            let bytes = checkpoint::write(num_done, &critic, &self.texels);
            observer.checkpoint(num_done, &bytes);
        }
        let made = self.texels.steps_made();
        report.critic = critic;
        report.curve = self.means.curve();
        report.num_views = num_views(self.focus.as_ref(), self.scene.frames.len());
        report.num_texels = made.num_texels;
        report.num_steps_per_texel = made.num_steps as f64 / made.num_texels.max(1) as f64;
        report.offsets = self.offsets.report();
        report.seconds += begun.elapsed().as_secs_f64();
        Ok(report)
    }
}

impl Optimisation<'_> {
    /// Makes the steps of these numbers, unless it is late, or nothing can be seen.
    fn steps(
        &mut self,
        steps: Range<usize>,
        is_late: &dyn Fn() -> bool,
        means: &mut RunningMeans,
        observer: &dyn Observer,
    ) -> Result<(), SmoothError> {
        let params = self.params;
        self.report.is_cut_short = false;
        for step in steps {
            if num_views(self.focus.as_ref(), self.views.len()) == 0 {
                break;
            }
            if is_late() {
                self.report.is_cut_short = true;
                break;
            }
            let losses = self.step(step)?;
            let num_done = step + 1;
            self.report.num_steps = num_done;
            if let Some(losses) = losses {
                means.add(num_done, &losses);
            }
            observer.step(&StepProgress {
                num_done,
                num_steps: params.num_steps,
                losses: means.recent,
                lambda: params.lambda_at(step),
            });
            let is_due = |interval: usize| interval > 0 && num_done.is_multiple_of(interval);
            if is_due(params.preview_interval)
                && let Some(image) = self.preview()
            {
                observer.preview(num_done, &image);
            }
            if is_due(params.checkpoint_interval) {
                let critic = saved(self.critic.as_deref())?;
                let bytes = checkpoint::write(num_done, &critic, self.texels);
                observer.checkpoint(num_done, &bytes);
            }
        }
        Ok(())
    }
}

/// Views that can be drawn.
fn num_views(focus: Option<&Focus>, num_frames: usize) -> usize {
    focus.map_or(num_frames, Focus::num_views)
}

/// A discriminator's bytes; none where there is none.
fn saved(critic: Option<&dyn Critic>) -> Result<Vec<u8>, SmoothError> {
    let bytes = critic.map(Critic::save).transpose()?;
    Ok(bytes.unwrap_or_default())
}

#[cfg(test)]
mod tests;
