//! Adversarial optimisation of the texture (ECCV 2022, section 3.2, Eq. adv optim loss; after Huang
//! et al. 2020, "Adversarial Texture Optimization from RGB-D Scans").
//!
//! A step draws a view and a partner, renders a crop of the view from the texture, and lets a
//! discriminator tell [photo, partner − photo] from [photo, rendering − photo]; the texture goes down
//! the gradient of λ · L1 − log D(rendering). The paper's step covers a whole image. A crop covers
//! as much as the discriminator can look at (its receptive field is 70 px) many times over, and a
//! step costs what its crop costs.
//!
//! Where the mesh is not seen, nothing is painted, or the partner does not see the same surface,
//! photo, projection and rendering are all −1, and neither loss counts it.

mod crop;
mod partner;
mod step;

use std::sync::Arc;
use std::time::Instant;

use super::align::AlignError;
use super::checkpoint::{self, CheckpointError};
use super::discriminator::{self, CriticError};
use super::loss_curve::RunningMeans;
use super::offsets::{OffsetReport, Offsets};
use super::texels::Texels;
use super::view::Surface;
use super::views::{Views, partners};
use super::{Decode, SmoothStart, TexSmoothParams};
use crate::atlas::{AtlasLayout, AtlasTexture, TextureMismatch};
use crate::geom::ColorImage;
use crate::keyframe::Keyframe;
use crate::mesh::TriMesh;
use crate::render::{GpuError, ViewRasterizer};
use step::Optimisation;

/// Why the texture was not refined.
#[derive(Debug, thiserror::Error)]
pub enum SmoothError {
    /// The texture is another layout's.
    #[error(transparent)]
    Texture(#[from] TextureMismatch),
    /// The layout is another mesh's.
    #[error("mesh has {num_triangles} triangles, layout {num_in_layout}")]
    Layout {
        /// Triangles of the mesh.
        num_triangles: usize,
        /// Triangles of the layout.
        num_in_layout: usize,
    },
    /// There are more texels than addresses.
    #[error("the atlas has more than 2^32 texels in tiles of 64")]
    TooManyTexels,
    /// The alignment's settings are out of range.
    #[error("alignment: {0}")]
    Align(#[from] AlignError),
    /// The discriminator refused.
    #[error("discriminator: {0}")]
    Critic(#[from] CriticError),
    /// The device that was asked for is not there, or failed.
    #[error(transparent)]
    Device(#[from] GpuError),
    /// The checkpoint is damaged, or another run's.
    #[error("checkpoint: {0}")]
    Checkpoint(#[from] CheckpointError),
}

/// The losses of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepLosses {
    /// Mean absolute difference of rendering and target on the scale of [−1, 1], without λ.
    pub l1: f32,
    /// −log D of the rendering, after the discriminator's step.
    pub adversarial: f32,
    /// −log D of the partner's projection.
    pub real: f32,
    /// −log(1 − D) of the rendering.
    pub fake: f32,
    /// Whether the discriminator's gradients counted.
    pub has_critic_stepped: bool,
}

/// Where the optimisation is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepProgress {
    /// Steps done, those before a checkpoint included.
    pub num_done: usize,
    /// Steps in all.
    pub num_steps: usize,
    /// Running means of the losses over about the last hundred steps.
    pub losses: StepLosses,
    /// λ.
    pub lambda: f32,
}

/// Is told where TexSmooth is; must not influence it.
pub trait Observer: Sync {
    /// A step is done.
    fn step(&self, progress: &StepProgress);
    /// A preview is due: a photo, and beside it its rendering as it is now.
    fn preview(&self, num_done: usize, image: &ColorImage);
    /// A checkpoint is due.
    fn checkpoint(&self, num_done: usize, bytes: &[u8]);
}

/// What is known before the first step.
#[derive(Clone, Copy, Debug, Default)]
pub enum SmoothFrom<'a> {
    /// Nothing.
    #[default]
    Nothing,
    /// A discriminator that has learnt on another texture ([`SmoothReport::critic`]).
    Critic(&'a [u8]),
    /// A checkpoint of the same run, to be gone on with.
    Checkpoint(&'a [u8]),
}

/// Tells nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoObserver;

impl Observer for NoObserver {
    fn step(&self, _progress: &StepProgress) {}
    fn preview(&self, _num_done: usize, _image: &ColorImage) {}
    fn checkpoint(&self, _num_done: usize, _bytes: &[u8]) {}
}

/// How the optimisation went.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothReport {
    /// Steps done, those before a checkpoint included.
    pub num_steps: usize,
    /// Steps of these whose crop showed no painted surface.
    pub num_empty: usize,
    /// Steps whose partner saw too little of the crop, so that the view was its own partner.
    pub num_self_partnered: usize,
    /// Frames that did not decode; their steps were left out.
    pub num_undecodable: usize,
    /// Steps whose discriminator loss counted.
    pub num_critic_steps: usize,
    /// Mean losses by stretches of a hundredth of the run.
    pub curve: Vec<(usize, StepLosses)>,
    /// Texels that changed.
    pub num_texels: u64,
    /// Steps that each of them made, on average.
    pub num_steps_per_texel: f64,
    /// Offsets at the end.
    pub offsets: OffsetReport,
    /// What the discriminator ran on.
    pub backend: String,
    /// Whether the time budget ended it.
    pub is_cut_short: bool,
    /// The discriminator as it was at the end, for [`SmoothFrom::Critic`].
    pub critic: Vec<u8>,
    /// Wall time of this call, seconds.
    pub seconds: f64,
}

/// Refines `texture` in place.
///
/// # Errors
/// [`SmoothError`] for a layout, texture, setting or checkpoint that does not fit. Frames that do not
/// decode are no error: they are counted.
#[expect(
    clippy::too_many_arguments,
    reason = "a mesh with its layout and texture, the photos, and how to go about it"
)]
pub fn smooth(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &mut AtlasTexture,
    frames: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    params: &TexSmoothParams,
    from: SmoothFrom<'_>,
    observer: &dyn Observer,
) -> Result<SmoothReport, SmoothError> {
    texture.check_fits(layout)?;
    if layout.corners_texel.len() != mesh.num_triangles() {
        return Err(SmoothError::Layout {
            num_triangles: mesh.num_triangles(),
            num_in_layout: layout.corners_texel.len(),
        });
    }
    let begun = Instant::now();
    let on = Surface { mesh, layout };
    let mut run = prepare(on, texture, frames, decode, params, from)?;
    let first_step = run.report.num_steps;
    let mut means = RunningMeans::new(params.num_steps);
    if !frames.is_empty() {
        for step in first_step..params.num_steps {
            let is_late =
                params.time_budget_s > 0.0 && begun.elapsed().as_secs_f64() >= params.time_budget_s;
            if is_late {
                run.report.is_cut_short = true;
                break;
            }
            let losses = run.step(step)?;
            let num_done = step + 1;
            run.report.num_steps = num_done;
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
                && let Some(image) = run.preview()
            {
                observer.preview(num_done, &image);
            }
            if is_due(params.checkpoint_interval) {
                observer.checkpoint(num_done, &run.checkpoint()?);
            }
        }
    }

    let mut report = std::mem::take(&mut run.report);
    if params.checkpoint_interval > 0
        && !report.num_steps.is_multiple_of(params.checkpoint_interval)
    {
        observer.checkpoint(report.num_steps, &run.checkpoint_at(report.num_steps)?);
    }
    if let Some(critic) = &run.critic {
        report.critic = critic.save()?;
    }
    report.curve = means.curve();
    let written = run.texels.write_back(texture);
    report.num_texels = written.num_texels;
    report.num_steps_per_texel = written.num_steps as f64 / written.num_texels.max(1) as f64;
    report.offsets = run.offsets.report();
    report.seconds = begun.elapsed().as_secs_f64();
    Ok(report)
}

/// The state before the first step, or as a checkpoint has it.
fn prepare<'a>(
    on: Surface<'a>,
    texture: &AtlasTexture,
    frames: &'a [Arc<Keyframe>],
    decode: &'a Decode<'a>,
    params: &'a TexSmoothParams,
    from: SmoothFrom<'_>,
) -> Result<Optimisation<'a>, SmoothError> {
    let mut texels = Texels::from_texture(texture).ok_or(SmoothError::TooManyTexels)?;
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
    let views = Views::new(
        rasterizer.load(on.mesh)?,
        frames,
        decode,
        budget_bytes as usize,
    );
    Ok(Optimisation {
        params,
        on,
        texels,
        critic,
        offsets: Offsets::new(
            params.align,
            params.align_grid,
            params.align_interval,
            frames.len(),
        ),
        partners: partners(frames, params.max_partner_angle_rad, params.partner_rule),
        views,
        report: SmoothReport {
            num_steps: first_step,
            backend: backend.to_owned(),
            ..SmoothReport::default()
        },
    })
}

#[cfg(test)]
mod tests;
