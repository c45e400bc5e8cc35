//! The images of a step, and the discriminator's verdict on them.

use super::StepLosses;
use crate::geom::ColorImage;
use crate::texsmooth::TexSmoothParams;
use crate::texsmooth::discriminator::{Critic, CriticError, PatchView};
use crate::texsmooth::texels::from_byte;
use crate::texsmooth::view::{CropSurface, PixelRect};

/// The images of a step, planar [channel][row][column] in [−1, 1]; the partner's is NaN where it does
/// not see the same surface.
pub(super) struct Crop<'a> {
    pub(super) rect: PixelRect,
    pub(super) photo: &'a [f32],
    pub(super) partner: &'a [f32],
    pub(super) render: &'a [f32],
    pub(super) surface: &'a CropSurface,
}

impl Crop<'_> {
    /// The discriminator's step, then its verdict on the rendering: adds the gradient of −log D.
    pub(super) fn judge(
        &self,
        critic: &mut dyn Critic,
        params: &TexSmoothParams,
        losses: &mut StepLosses,
        gradient: &mut [f32],
    ) -> Result<(), CriticError> {
        let num = self.rect.num_pixels();
        let mask: Vec<f32> = self
            .surface
            .footprint
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

pub(super) fn photo_crop(photo: &ColorImage, rect: PixelRect) -> Vec<f32> {
    let num = rect.num_pixels();
    let width = photo.width() as usize;
    let mut out = vec![0.0f32; 3 * num];
    for row in 0..rect.height {
        let from = (rect.y + row) * width + rect.x;
        for (column, pixel) in photo.pixels()[from..from + rect.width].iter().enumerate() {
            for (channel, &byte) in pixel.iter().enumerate() {
                out[channel * num + row * rect.width + column] = from_byte(byte);
            }
        }
    }
    out
}
