//! How far a rendering is displaced from the photo of the same view (ECCV 2022, section 3.2).
//!
//! In: a photo and a rendering of one size, and which pixels of the rendering show anything. Out:
//! the offset d for which `photo(x + d)` shows what `render(x)` shows, in pixels (columns, rows),
//! and how far to trust it.
//!
//! * [`AlignForm::Reference`], the published program's: per channel the arg max of
//!   FFT⁻¹(FFT(I) · conj(FFT(Î))) of the whole images, circular, values in [−1, 1] with −1 where
//!   nothing was rendered; wrapped to signed numbers; the mean over the channels whose offset is
//!   within bounds, cut to whole pixels.
//! * [`AlignForm::Refined`], ours: on luma, coarse to fine. At a coarse size the normalised
//!   correlation over the mask alone, for all offsets at once by real FFTs (Padfield 2012, "Masked
//!   object registration in the Fourier domain"); its peak by a parabola; then Gauss–Newton steps
//!   on half and on full size, which leave gain and brightness free and weigh outliers down.
//! * [`AlignForm::Phase`]: the same, with the phase of the cross-power spectrum at the coarse size.
//!
//! The offset is bounded by a share of the image's side. Sums run over fixed stretches of rows in
//! order, so that the result is the same for any thread count.

mod fft2;
mod gauss_newton;
mod masked_ncc;
mod plane;
mod reference;

use crate::geom::ColorImage;
use plane::Plane;

/// How the offset is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum AlignForm {
    /// As in the published program: whole pixels, unmasked.
    Reference,
    /// Masked, coarse to fine, to a fraction of a pixel.
    #[default]
    Refined,
    /// [`Self::Refined`] with phase correlation at the coarse size.
    Phase,
}

/// How to align.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignParams {
    /// How the offset is found.
    pub form: AlignForm,
    /// Largest offset as a share of the image's side, in (0, 0.5]; the paper has 0.05, and 0.1 and
    /// 0.2 for 2×2 and 4×4 patches.
    pub max_offset_share: f32,
    /// Offsets of less confidence are not trusted; the form of the reference has no confidence and
    /// trusts all within bounds.
    pub min_confidence: f32,
}

impl Default for AlignParams {
    fn default() -> Self {
        Self {
            form: AlignForm::Refined,
            max_offset_share: 0.05,
            min_confidence: 0.05,
        }
    }
}

/// Where the photo has what the rendering shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// `photo(x + offset_px)` shows what `render(x)` shows: columns, rows. Zero where it is not to
    /// be trusted.
    pub offset_px: [f32; 2],
    /// The correlation at the peak, in [0, 1], times the share by which it stands above the next
    /// peak. 1 for the reference's form.
    pub confidence: f32,
    /// Whether the offset is within bounds and its peak strong enough.
    pub is_trusted: bool,
}

impl Alignment {
    /// No offset, because none could be told.
    pub const UNKNOWN: Self = Self {
        offset_px: [0.0; 2],
        confidence: 0.0,
        is_trusted: false,
    };

    /// The offset in whole pixels, rounded.
    #[expect(clippy::cast_possible_truncation, reason = "bounded by half an image")]
    pub fn whole_px(&self) -> [i32; 2] {
        self.offset_px.map(|offset| offset.round() as i32)
    }
}

/// Why images cannot be aligned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AlignError {
    /// The images differ in size.
    #[error("photo of {photo:?} pixels and rendering of {render:?} cannot be aligned")]
    Size {
        /// Width and height of the photo.
        photo: [u32; 2],
        /// Width and height of the rendering.
        render: [u32; 2],
    },
    /// The mask does not have one value per pixel.
    #[error("mask of {actual} values for an image of {expected} pixels")]
    Mask {
        /// Pixels of the image.
        expected: usize,
        /// Values of the mask.
        actual: usize,
    },
    /// The bound is not one.
    #[error("largest offset must be a share of the side in (0, 0.5], not {0}")]
    MaxOffset(f32),
}

/// Finds the offset of `photo` from `render`; `mask` says which pixels of the rendering count.
///
/// # Errors
/// [`AlignError`] when sizes differ or the bound is out of range. Images without contrast, or with
/// too few pixels in common, are no error: the result is [`Alignment::UNKNOWN`].
pub fn align(
    photo: &ColorImage,
    render: &ColorImage,
    mask: Option<&[bool]>,
    params: &AlignParams,
) -> Result<Alignment, AlignError> {
    let size_of = |image: &ColorImage| [image.width(), image.height()];
    if size_of(photo) != size_of(render) {
        return Err(AlignError::Size {
            photo: size_of(photo),
            render: size_of(render),
        });
    }
    let num_pixels = photo.pixels().len();
    if let Some(mask) = mask.filter(|mask| mask.len() != num_pixels) {
        return Err(AlignError::Mask {
            expected: num_pixels,
            actual: mask.len(),
        });
    }
    let share = params.max_offset_share;
    if !(share > 0.0 && share <= 0.5) {
        return Err(AlignError::MaxOffset(share));
    }
    if num_pixels == 0 {
        return Ok(Alignment::UNKNOWN);
    }
    let max_offset_px = size_of(photo).map(|side| share * side as f32);
    let found = match params.form {
        AlignForm::Reference => reference::align(photo, render, mask, max_offset_px),
        AlignForm::Refined | AlignForm::Phase => {
            coarse_to_fine(photo, render, mask, max_offset_px, params)
        }
    };
    Ok(found.unwrap_or(Alignment::UNKNOWN))
}

/// Longer side of the coarse images, at most.
const COARSE_SIDE_PX: u32 = 400;
/// Shortest side that holds enough to correlate.
const MIN_SIDE_PX: usize = 8;

fn coarse_to_fine(
    photo: &ColorImage,
    render: &ColorImage,
    mask: Option<&[bool]>,
    max_offset_px: [f32; 2],
    params: &AlignParams,
) -> Option<Alignment> {
    let factor = photo.width().max(photo.height()).div_ceil(COARSE_SIDE_PX) as usize;
    let (photo, render) = rayon::join(|| Plane::luma(photo, None), || Plane::luma(render, mask));
    let reduced = |factor| rayon::join(|| photo.reduced(factor), || render.reduced(factor));

    let (coarse_photo, coarse_render) = reduced(factor);
    if coarse_photo.width.min(coarse_photo.height) < MIN_SIDE_PX {
        return None;
    }
    let peak = masked_ncc::find_peak(
        &coarse_photo,
        &coarse_render,
        max_offset_px.map(|px| px / factor as f32),
        params.form == AlignForm::Phase,
    )?;
    if peak.confidence < params.min_confidence {
        return None;
    }

    // Where steps lead away, what is known already is kept.
    let mut offset_px = peak.offset_px.map(|px| px * factor as f32);
    let mut uncertainty_px = 1.5 * factor as f32;
    if factor > 3 {
        let half = factor / 2;
        let (photo, render) = reduced(half);
        let start = offset_px.map(|px| px / half as f32);
        let bound = uncertainty_px / half as f32;
        if let Some(found) = gauss_newton::refine(&photo, &render, start, bound) {
            offset_px = found.map(|px| px * half as f32);
            uncertainty_px = 1.5 * half as f32;
        }
    }
    if let Some(found) = gauss_newton::refine(&photo, &render, offset_px, uncertainty_px) {
        offset_px = found;
    }
    let is_within = offset_px
        .iter()
        .zip(max_offset_px)
        .all(|(offset, max)| offset.abs() <= max);
    is_within.then_some(Alignment {
        offset_px,
        confidence: peak.confidence,
        is_trusted: true,
    })
}

#[cfg(test)]
mod tests;
