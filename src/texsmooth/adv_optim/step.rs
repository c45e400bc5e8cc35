//! One step, and what may be asked of the texture between steps.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::crop::{Crop, photo_crop};
use super::draw::Drawn;
use super::{SmoothError, SmoothReport, StepLosses};
use crate::atlas::TexelSource;
use crate::geom::ColorImage;
use crate::texsmooth::discriminator::Critic;
use crate::texsmooth::focus::Focus;
use crate::texsmooth::offsets::Offsets;
use crate::texsmooth::random::StepDraws;
use crate::texsmooth::texels::{AdamStep, Texels, to_byte};
use crate::texsmooth::view::{CropSurface, PixelRect, Surface};
use crate::texsmooth::views::{Seen, Views};
use crate::texsmooth::{L1Target, TexSmoothParams};

/// What a step looks at and what it changes: a [`super::Smoothing`] on its scene.
pub(super) struct Optimisation<'a> {
    pub(super) params: &'a TexSmoothParams,
    pub(super) on: Surface<'a>,
    pub(super) texels: &'a mut Texels,
    pub(super) critic: &'a mut Option<Box<dyn Critic>>,
    pub(super) offsets: &'a mut Offsets,
    /// Says which views may be partners.
    pub(super) axes: &'a [Vector3<f64>],
    pub(super) views: Views<'a>,
    /// Where the charts are that may change; `None` where all may.
    pub(super) focus: &'a mut Option<Focus>,
    pub(super) report: &'a mut SmoothReport,
}

impl Optimisation<'_> {
    /// One step; nothing where its crop shows nothing or a photo does not decode.
    pub(super) fn step(&mut self, step: usize) -> Result<Option<StepLosses>, SmoothError> {
        let draws = StepDraws::new(self.params.seed, step as u64);
        let Some(Drawn { index, seen, rect }) = self.draw(draws)? else {
            return Ok(None);
        };
        let offset_px = self.offset(index, &seen, rect)?;
        let surface = seen.view.surface(self.on, self.texels, rect, 1, offset_px);
        let num_seen = surface.footprint.iter().filter(|f| f.is_some()).count();
        if !(0..surface.footprint.len()).any(|pixel| surface.may_change(pixel)) {
            self.report.num_empty += 1;
            return Ok(None);
        }

        let photo = photo_crop(&seen.photo.color, rect);
        let has_partner = self.critic.is_some() || self.params.l1_target == L1Target::Partner;
        let partner = if has_partner {
            self.partner(draws, index, &seen, rect, &surface, num_seen, &photo)?
        } else {
            Vec::new()
        };
        let mut render = vec![0.0f32; photo.len()];
        self.texels
            .gather(self.on.texture, &surface.footprint, &mut render);

        let crop = Crop {
            rect,
            photo: &photo,
            partner: &partner,
            render: &render,
            surface: &surface,
        };
        let mut gradient = vec![0.0f32; photo.len()];
        let mut losses = StepLosses {
            l1: self.add_l1(step, &crop, &mut gradient),
            ..StepLosses::default()
        };
        if let Some(critic) = self.critic {
            crop.judge(critic.as_mut(), self.params, &mut losses, &mut gradient)?;
            self.report.num_critic_steps += usize::from(losses.has_critic_stepped);
        }
        let painter = TexelSource::keyframe(self.views.frame(index).id.0);
        self.weigh(&mut gradient, &surface, painter);
        let adam = AdamStep {
            learning_rate: self.params.learning_rate_at(step),
            betas: self.params.betas,
        };
        let (footprints, is_fixed) = (&surface.footprint, &surface.is_fixed);
        self.texels.step(footprints, is_fixed, &gradient, &adam);
        Ok(Some(losses))
    }

    pub(super) fn offset(
        &mut self,
        index: usize,
        seen: &Seen,
        rect: PixelRect,
    ) -> Result<[f32; 2], SmoothError> {
        if !self.params.has_alignment {
            return Ok([0.0; 2]);
        }
        let middle = [rect.x + rect.width / 2, rect.y + rect.height / 2];
        let at = self.offsets.at(index, seen, self.on, self.texels, middle)?;
        Ok(at)
    }

    /// Adds λ times the gradient of the mean absolute difference; returns that mean over what may
    /// change. The gradient's is over all that is seen, so that a pixel weighs as much as it does where
    /// all may change.
    fn add_l1(&self, step: usize, crop: &Crop<'_>, gradient: &mut [f32]) -> f32 {
        let footprints = &crop.surface.footprint;
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
        let (mut sum, mut num_summed) = (0.0f64, 0);
        let may_change = |i: usize| counts(i) && crop.surface.may_change(i);
        for i in (0..num_pixels).filter(|&i| may_change(i)) {
            num_summed += 3;
            for at in [i, num_pixels + i, 2 * num_pixels + i] {
                let difference = crop.render[at] - target[at];
                sum += f64::from(difference.abs());
                if difference != 0.0 {
                    gradient[at] += slope.copysign(difference);
                }
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let mean = (sum / f64::from(num_summed.max(1))) as f32;
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
        let texels = &*self.texels;
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
    pub(super) fn preview(&mut self) -> Option<ColorImage> {
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
            .surface(self.on, self.texels, rect, factor, [0.0; 2]);
        let num = rect.num_pixels();
        let mut render = vec![0.0; 3 * num];
        self.texels
            .gather(self.on.texture, &surface.footprint, &mut render);
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
}
