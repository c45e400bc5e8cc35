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

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::align::AlignError;
use super::checkpoint::{self, CheckpointError};
use super::discriminator::{self, Critic, CriticError, PatchView};
use super::loss_curve::RunningMeans;
use super::offsets::{OffsetReport, Offsets};
use super::random::{Purpose, StepDraws};
use super::texels::{AdamStep, Footprint, Texels, to_byte};
use super::view::{CropSurface, PixelRect, Surface};
use super::views::{Seen, UnseenError, Views, partners};
use super::{Decode, L1Target, PartnerOffset, PartnerRule, SmoothStart, TexSmoothParams};
use crate::atlas::{AtlasLayout, AtlasTexture, TexelSource, TextureMismatch};
use crate::geom::ColorImage;
use crate::keyframe::Keyframe;
use crate::mesh::TriMesh;
use crate::render::{GpuError, ViewRasterizer};

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
        rasterizer.load(mesh)?,
        frames,
        decode,
        budget_bytes as usize,
    );
    let mut run = Optimisation {
        params,
        on: Surface { mesh, layout },
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
    };
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
    report.num_texels = run.texels.write_back(texture);
    report.offsets = run.offsets.report();
    report.seconds = begun.elapsed().as_secs_f64();
    Ok(report)
}

/// A partner that sees less of the crop than this share is none.
const MIN_PARTNER_SHARE: usize = 10;
/// Rows of points, along each side of a crop, that a partner is looked for by.
const PARTNER_PROBES: usize = 3;

struct Optimisation<'a> {
    params: &'a TexSmoothParams,
    on: Surface<'a>,
    texels: Texels,
    critic: Option<Box<dyn Critic>>,
    offsets: Offsets,
    partners: Vec<Vec<usize>>,
    views: Views<'a>,
    report: SmoothReport,
}

impl Optimisation<'_> {
    /// One step; nothing where its crop shows nothing or a photo does not decode.
    fn step(&mut self, step: usize) -> Result<Option<StepLosses>, SmoothError> {
        let draws = StepDraws::new(self.params.seed, step as u64);
        let index = draws.below(Purpose::View, self.views.len());
        let seen = match self.views.get(index) {
            Ok(seen) => seen,
            Err(UnseenError::Photo(_)) => {
                self.report.num_undecodable += 1;
                return Ok(None);
            }
            Err(UnseenError::Device(error)) => return Err(error.into()),
        };
        let rect = self.draw_crop(draws, &seen.photo.color);
        let offset_px = self.offset(index, &seen, rect)?;
        let surface = seen.view.surface(self.on, &self.texels, rect, 1, offset_px);
        let num_seen = surface.footprint.iter().filter(|f| f.is_some()).count();
        if num_seen == 0 {
            self.report.num_empty += 1;
            return Ok(None);
        }

        let photo = photo_crop(&seen.photo.color, rect);
        let partner = self.partner(draws, index, &seen, rect, &surface, num_seen, &photo)?;
        let mut render = vec![0.0f32; photo.len()];
        self.texels.gather(&surface.footprint, &mut render);

        let crop = Crop {
            rect,
            photo: &photo,
            partner: &partner,
            render: &render,
            footprints: &surface.footprint,
        };
        let mut gradient = vec![0.0f32; photo.len()];
        let mut losses = StepLosses {
            l1: self.add_l1(step, &crop, &mut gradient),
            ..StepLosses::default()
        };
        if let Some(critic) = &mut self.critic {
            crop.judge(critic.as_mut(), self.params, &mut losses, &mut gradient)?;
            self.report.num_critic_steps += usize::from(losses.has_critic_stepped);
        }
        let painter = TexelSource::keyframe(self.views.frame(index).id.0);
        self.weigh(&mut gradient, &surface, painter);
        let adam = AdamStep {
            learning_rate: self.params.learning_rate_at(step),
            betas: self.params.betas,
        };
        self.texels.step(&surface.footprint, &gradient, &adam);
        Ok(Some(losses))
    }

    fn draw_crop(&self, draws: StepDraws, photo: &ColorImage) -> PixelRect {
        let (width, height) = (photo.width() as usize, photo.height() as usize);
        if self.params.crop_px == 0 {
            let jitter = |purpose, size: usize| {
                draws.below(purpose, (self.params.max_jitter_px + 1).min(size.max(1)))
            };
            let (x, y) = (
                jitter(Purpose::CropX, width),
                jitter(Purpose::CropY, height),
            );
            return PixelRect {
                x,
                y,
                width: width - x,
                height: height - y,
            };
        }
        let side = |size: usize| self.params.crop_px.min(size);
        PixelRect {
            x: draws.below(Purpose::CropX, width - side(width) + 1),
            y: draws.below(Purpose::CropY, height - side(height) + 1),
            width: side(width),
            height: side(height),
        }
    }

    fn offset(
        &mut self,
        index: usize,
        seen: &Seen,
        rect: PixelRect,
    ) -> Result<[f32; 2], SmoothError> {
        if !self.params.has_alignment {
            return Ok([0.0; 2]);
        }
        let middle = [rect.x + rect.width / 2, rect.y + rect.height / 2];
        let at = self
            .offsets
            .at(index, seen, self.on, &self.texels, middle)?;
        Ok(at)
    }

    /// A partner's photo, projected into the crop: planar, NaN where it does not see the same surface.
    #[expect(
        clippy::too_many_arguments,
        reason = "all that a step has drawn so far"
    )]
    fn partner(
        &mut self,
        draws: StepDraws,
        index: usize,
        seen: &Seen,
        rect: PixelRect,
        surface: &CropSurface,
        num_seen: usize,
        photo: &[f32],
    ) -> Result<Vec<f32>, SmoothError> {
        let candidates = match self.params.partner_rule {
            PartnerRule::WorldAxis => self.partners[index].clone(),
            PartnerRule::ViewingAxis => self.partners_before(index, seen, rect, surface),
        };
        let drawn = candidates
            .get(draws.below(Purpose::Partner, candidates.len()))
            .copied()
            .unwrap_or(index);
        if drawn != index
            && let Ok(partner) = self.views.get(drawn)
        {
            let projected = match self.params.partner_offset {
                PartnerOffset::Own => {
                    let whole = PixelRect {
                        x: 0,
                        y: 0,
                        width: partner.photo.color.width() as usize,
                        height: partner.photo.color.height() as usize,
                    };
                    let offset_px = self.offset(drawn, &partner, whole)?;
                    self.project(&partner, seen, &surface.point_in_camera, offset_px)
                }
                PartnerOffset::View => {
                    let unshifted = seen.view.surface(self.on, &self.texels, rect, 1, [0.0; 2]);
                    self.project(&partner, seen, &unshifted.point_in_camera, [0.0; 2])
                }
            };
            let num_common = projected[..rect.num_pixels()]
                .iter()
                .zip(&surface.footprint)
                .filter(|(value, footprint)| footprint.is_some() && !value.is_nan())
                .count();
            if num_common * MIN_PARTNER_SHARE >= num_seen {
                return Ok(projected);
            }
        }
        self.report.num_self_partnered += 1;
        Ok(photo.to_vec())
    }

    /// Partners that may see the crop: some of a few points of it lie in their image.
    fn partners_before(
        &self,
        index: usize,
        seen: &Seen,
        rect: PixelRect,
        surface: &CropSurface,
    ) -> Vec<usize> {
        let world_from_camera = seen.view.camera_from_world.inverse();
        let probe = |at: usize, size: usize| (2 * at + 1) * size / (2 * PARTNER_PROBES);
        let points: Vec<_> = (0..PARTNER_PROBES * PARTNER_PROBES)
            .filter_map(|i| {
                let x = probe(i % PARTNER_PROBES, rect.width);
                let y = probe(i / PARTNER_PROBES, rect.height);
                let point = surface.point_in_camera.get(y * rect.width + x)?;
                (!point[0].is_nan())
                    .then(|| world_from_camera.transform_point(&point.map(f64::from).into()))
            })
            .collect();
        let sees_most = |other: &usize| {
            let frame = self.views.frame(*other);
            let camera = &frame.color_camera.pinhole;
            let camera_from_world = frame.world_from_camera.inverse();
            let num_inside = points
                .iter()
                .filter(|point| {
                    camera
                        .project(&camera_from_world.transform_point(point))
                        .is_some_and(|pixel| camera.contains(pixel))
                })
                .count();
            *other == index || 2 * num_inside > points.len()
        };
        self.partners[index]
            .iter()
            .copied()
            .filter(sees_most)
            .collect()
    }

    fn project(
        &self,
        partner: &Seen,
        seen: &Seen,
        points_in_camera: &[[f32; 3]],
        offset_px: [f32; 2],
    ) -> Vec<f32> {
        let positions = partner.view.project_from(
            &seen.view,
            self.on.mesh,
            points_in_camera,
            self.params.max_depth_difference_m,
        );
        let num = positions.len();
        let mut out = vec![f32::NAN; 3 * num];
        let colors: Vec<Option<[f32; 3]>> = positions
            .par_iter()
            .map(|position| {
                let [x, y] = (*position)?;
                let at = [x + offset_px[0], y + offset_px[1]];
                let sampled = partner.photo.color.sample_bilinear(at);
                Some(sampled.map(|value| value / 127.5 - 1.0))
            })
            .collect();
        for (i, color) in colors.iter().enumerate() {
            if let Some(color) = color {
                for (channel, &value) in color.iter().enumerate() {
                    out[channel * num + i] = value;
                }
            }
        }
        out
    }

    /// Adds λ times the gradient of the mean absolute difference; returns that mean.
    fn add_l1(&self, step: usize, crop: &Crop<'_>, gradient: &mut [f32]) -> f32 {
        let footprints = crop.footprints;
        let num_pixels = footprints.len();
        let target = match self.params.l1_target {
            L1Target::Photo => crop.photo,
            L1Target::Partner => crop.partner,
        };
        let counts = |i: usize| footprints[i].is_some() && !target[i].is_nan();
        let num_values = 3 * (0..num_pixels).filter(|&i| counts(i)).count();
        if num_values == 0 {
            return 0.0;
        }
        let slope = self.params.lambda_at(step) / num_values as f32;
        let mut sum = 0.0f64;
        for i in (0..num_pixels).filter(|&i| counts(i)) {
            for at in [i, num_pixels + i, 2 * num_pixels + i] {
                let difference = crop.render[at] - target[at];
                sum += f64::from(difference.abs());
                if difference != 0.0 {
                    gradient[at] += slope.copysign(difference);
                }
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let mean = (sum / num_values as f64) as f32;
        mean
    }

    /// Scales each pixel's gradient by what it is worth: less where it covers many texels, more where
    /// its photo, that of `painter`, is what the texel was painted from.
    fn weigh(&self, gradient: &mut [f32], surface: &CropSurface, painter: TexelSource) {
        let exponent = self.params.resolution_exponent;
        let own_weight = self.params.own_weight;
        if exponent == 0.0 && own_weight == 1.0 {
            return;
        }
        let texels = &self.texels;
        let weights: Vec<f32> = surface
            .footprint
            .par_iter()
            .zip(&surface.texels_per_px)
            .map(|(footprint, texels_per_px)| {
                let is_own = texels.source(footprint) == painter;
                let weight = texels_per_px.max(1.0).powf(-exponent);
                if is_own { weight * own_weight } else { weight }
            })
            .collect();
        for channel in gradient.chunks_exact_mut(weights.len()) {
            for (value, weight) in channel.iter_mut().zip(&weights) {
                *value *= weight;
            }
        }
    }

    /// The first view that decodes: its photo, and beside it the rendering.
    fn preview(&mut self) -> Option<ColorImage> {
        let index = self.views.len() / 2;
        let seen = self.views.get(index).ok()?;
        let photo = &seen.photo.color;
        let (width, height) = (photo.width() as usize, photo.height() as usize);
        let factor = width.div_ceil(640).max(1);
        let rect = PixelRect {
            x: 0,
            y: 0,
            width: width / factor,
            height: height / factor,
        };
        let surface = seen
            .view
            .surface(self.on, &self.texels, rect, factor, [0.0; 2]);
        let num = rect.num_pixels();
        let mut render = vec![0.0; 3 * num];
        self.texels.gather(&surface.footprint, &mut render);
        let factor = u32::try_from(factor).ok()?;
        let photo = photo.reduced(factor);
        let mut pixels = Vec::with_capacity(2 * num);
        for y in 0..rect.height {
            let row = y * rect.width..(y + 1) * rect.width;
            pixels.extend_from_slice(photo.pixels().get(row.clone())?);
            pixels.extend(row.map(|i| [0, 1, 2].map(|c| to_byte(render[c * num + i]))));
        }
        let size = |px: usize| u32::try_from(px).ok();
        ColorImage::new(size(2 * rect.width)?, size(rect.height)?, pixels).ok()
    }

    fn checkpoint(&self) -> Result<Vec<u8>, SmoothError> {
        self.checkpoint_at(self.report.num_steps)
    }

    fn checkpoint_at(&self, num_steps: usize) -> Result<Vec<u8>, SmoothError> {
        let critic = match &self.critic {
            Some(critic) => critic.save()?,
            None => Vec::new(),
        };
        Ok(checkpoint::write(num_steps, &critic, &self.texels))
    }
}

/// The images of a step, planar [channel][row][column] in [−1, 1]; the partner's is NaN where it does
/// not see the same surface.
struct Crop<'a> {
    rect: PixelRect,
    photo: &'a [f32],
    partner: &'a [f32],
    render: &'a [f32],
    footprints: &'a [Footprint],
}

impl Crop<'_> {
    /// The discriminator's step, then its verdict on the rendering: adds the gradient of −log D.
    fn judge(
        &self,
        critic: &mut dyn Critic,
        params: &TexSmoothParams,
        losses: &mut StepLosses,
        gradient: &mut [f32],
    ) -> Result<(), CriticError> {
        let num = self.rect.num_pixels();
        let mask: Vec<f32> = self
            .footprints
            .iter()
            .zip(self.partner)
            .map(|(footprint, partner)| {
                let counts = footprint.is_some() && !partner.is_nan();
                f32::from(u8::from(counts))
            })
            .collect();
        let stacked = |image: &[f32]| {
            let mut patch = vec![0.0f32; 6 * num];
            for c in 0..3 {
                for (i, counts) in mask.iter().enumerate() {
                    let at = c * num + i;
                    let (photo, value) = if *counts > 0.0 {
                        (self.photo[at], image[at])
                    } else {
                        (-1.0, -1.0)
                    };
                    patch[at] = photo;
                    patch[3 * num + at] = value - photo;
                }
            }
            patch
        };
        let (real, fake) = rayon::join(|| stacked(self.partner), || stacked(self.render));
        let patch = |data| PatchView {
            data,
            height: self.rect.height,
            width: self.rect.width,
        };
        let judged = critic.step(patch(&real), patch(&fake), &mask, params.gate)?;
        let mut by_render = vec![0.0f32; 3 * num];
        losses.adversarial = critic.texture_gradient(patch(&fake), &mask, &mut by_render)?;
        (losses.real, losses.fake) = (judged.real, judged.fake);
        losses.has_critic_stepped = judged.stepped;
        for (sum, value) in gradient.iter_mut().zip(by_render) {
            *sum += value;
        }
        Ok(())
    }
}

fn photo_crop(photo: &ColorImage, rect: PixelRect) -> Vec<f32> {
    let num = rect.num_pixels();
    let width = photo.width() as usize;
    let mut out = vec![0.0f32; 3 * num];
    for row in 0..rect.height {
        let from = (rect.y + row) * width + rect.x;
        for (column, pixel) in photo.pixels()[from..from + rect.width].iter().enumerate() {
            for (channel, &byte) in pixel.iter().enumerate() {
                out[channel * num + row * rect.width + column] = super::texels::from_byte(byte);
            }
        }
    }
    out
}
