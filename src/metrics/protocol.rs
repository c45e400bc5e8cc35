//! How several textures are judged by photos that none of them has seen (ECCV 2022, section 4.1).
//!
//! Per view, in: the photo, and each method's rendering at its pose with the mask of what is
//! textured. Then:
//!
//! 1. Each rendering is aligned with the photo ([`crate::texsmooth::align`]), by whole pixels.
//! 2. All are cut to the part of the photo that every aligned rendering reaches, and everything is
//!    black outside the intersection of their masks, the photo too.
//! 3. On these 8-bit images: SSIM, LPIPS, the mean difference of S3 maps and of gradient norms
//!    over the whole cut; PSNR over the unmasked pixels alone.
//!
//! SSIM and S3 are given in two forms where the paper's text and its authors' program differ:
//! [`MethodScore::ssim`] under the Gaussian window of its authors and [`MethodScore::ssim_uniform`]
//! under the uniform one; [`MethodScore::s3`] of the masked cut, and [`MethodScore::s3_whole`] of
//! maps made of the whole images, cut and masked afterwards.

use rayon::prelude::*;

use super::lpips::{Lpips, LpipsFeatures};
use super::{
    LpipsError, MetricError, PixelError, SharpnessMap, SsimChannels, SsimWindow,
    gradient_difference, sharpness_map, ssim_windowed,
};
use crate::geom::{ColorImage, ImageError, RigidTransform};
use crate::texsmooth::align::{AlignError, AlignParams, Alignment, align};

/// Why a view cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum ProtocolError {
    /// No rendering was given.
    #[error("there is nothing to compare with the photo")]
    NoRender,
    /// The aligned renderings have no pixel of the photo in common.
    #[error("the aligned renderings have no pixel in common")]
    NothingInCommon,
    /// Sizes differ.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// The alignment refused.
    #[error(transparent)]
    Align(#[from] AlignError),
    /// LPIPS refused.
    #[error(transparent)]
    Lpips(#[from] LpipsError),
    /// An image could not be made.
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// What one method shows of a view.
#[derive(Clone, Debug)]
pub struct MethodView {
    /// The rendering, of the photo's size.
    pub render: ColorImage,
    /// Per pixel: whether there is texture.
    pub mask: Vec<bool>,
}

/// A part of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// One method on one view.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodScore {
    /// How the rendering was aligned; pixels.
    pub alignment: Alignment,
    /// Share of the view where the method has texture, before anything is cut.
    pub coverage: f64,
    /// Structural similarity, Gaussian window, mean of red, green and blue.
    pub ssim: Option<f64>,
    /// The same under the uniform window, as the authors' program has it.
    pub ssim_uniform: Option<f64>,
    /// Learned perceptual similarity; `None` without weights.
    pub lpips: Option<f64>,
    /// Mean absolute difference of the S3 maps of the masked cut.
    pub s3: f64,
    /// The same of maps made of the whole images, cut and masked afterwards.
    pub s3_whole: f64,
    /// Mean absolute difference of gradient norms, luma steps per pixel.
    pub grad: f64,
    /// Peak signal-to-noise ratio over the common pixels, dB; `None` when infinite or without
    /// pixels.
    pub psnr_db: Option<f64>,
}

/// One view, all methods.
#[derive(Clone, Debug)]
pub struct ViewScores {
    /// What of the photo was compared.
    pub cut: Cut,
    /// Share of the cut that no method's mask leaves out.
    pub common_share: f64,
    /// The photo's cut, masked.
    pub photo: ColorImage,
    /// Per method: the aligned rendering's cut, masked.
    pub renders: Vec<ColorImage>,
    /// Per method.
    pub scores: Vec<MethodScore>,
}

/// Compares the renderings with the photo; without `lpips` that measure is left out.
///
/// # Errors
/// [`ProtocolError`] when sizes differ or nothing is left to compare.
pub fn score_view(
    photo: &ColorImage,
    methods: &[MethodView],
    align_params: &AlignParams,
    lpips: Option<&Lpips>,
) -> Result<ViewScores, ProtocolError> {
    if methods.is_empty() {
        return Err(ProtocolError::NoRender);
    }
    let alignments = methods
        .iter()
        .map(|method| {
            super::check(photo, &method.render, Some(&method.mask))?;
            Ok(align(
                photo,
                &method.render,
                Some(&method.mask),
                align_params,
            )?)
        })
        .collect::<Result<Vec<Alignment>, ProtocolError>>()?;
    let offsets: Vec<[i64; 2]> = alignments
        .iter()
        .map(|alignment| alignment.whole_px().map(i64::from))
        .collect();
    let size = [photo.width(), photo.height()];
    let cut = common_cut(size, &offsets).ok_or(ProtocolError::NothingInCommon)?;
    let placed: Vec<Placed> = offsets
        .iter()
        .map(|&offset| Placed::new(size, cut, offset))
        .collect();
    let at_photo = Placed::new(size, cut, [0, 0]);

    let common: Vec<bool> = (0..cut.width as usize * cut.height as usize)
        .map(|i| {
            let mut all = methods.iter().zip(&placed);
            all.all(|(method, placed)| method.mask[placed.source(i)])
        })
        .collect();
    let photo_cut = masked(photo, &at_photo, cut, &common)?;
    let reference = Reference {
        whole_map: sharpness_map(photo),
        map: sharpness_map(&photo_cut),
        features: lpips.map(|lpips| lpips.features(&photo_cut)).transpose()?,
        lpips,
        photo: photo_cut,
        placed: at_photo,
        common,
    };

    let mut renders = Vec::with_capacity(methods.len());
    let mut scores = Vec::with_capacity(methods.len());
    for ((method, placed), alignment) in methods.iter().zip(&placed).zip(alignments) {
        let render = masked(&method.render, placed, cut, &reference.common)?;
        scores.push(reference.score(method, placed, alignment, &render)?);
        renders.push(render);
    }
    let num_common = reference.common.iter().filter(|&&c| c).count();
    Ok(ViewScores {
        cut,
        common_share: num_common as f64 / reference.common.len() as f64,
        photo: reference.photo,
        renders,
        scores,
    })
}

/// The cut of an image, black where `common` is false.
fn masked(
    image: &ColorImage,
    placed: &Placed,
    cut: Cut,
    common: &[bool],
) -> Result<ColorImage, ImageError> {
    let pixels = common.iter().enumerate().map(|(i, &is_common)| {
        if is_common {
            image.pixels()[placed.source(i)]
        } else {
            [0; 3]
        }
    });
    ColorImage::new(cut.width, cut.height, pixels.collect())
}

/// The photo and what is made of it once for all methods.
struct Reference<'a> {
    photo: ColorImage,
    placed: Placed,
    common: Vec<bool>,
    map: SharpnessMap,
    whole_map: SharpnessMap,
    lpips: Option<&'a Lpips>,
    features: Option<LpipsFeatures>,
}

impl Reference<'_> {
    fn score(
        &self,
        method: &MethodView,
        placed: &Placed,
        alignment: Alignment,
        render: &ColorImage,
    ) -> Result<MethodScore, ProtocolError> {
        let similarity =
            |window| ssim_windowed(&self.photo, render, None, SsimChannels::Rgb, window);
        let lpips = match (self.lpips, &self.features) {
            (Some(lpips), Some(features)) => {
                let distance = lpips.distance(features, &lpips.features(render)?)?;
                Some(distance.total())
            }
            _ => None,
        };
        let map = sharpness_map(render);
        let whole_map = sharpness_map(&method.render);
        let num_pixels = self.common.len() as f64;
        let whole_difference: Vec<f64> = self
            .common
            .par_iter()
            .enumerate()
            .map(|(i, &is_common)| {
                let theirs = whole_map.s3[placed.source(i)];
                let ours = self.whole_map.s3[self.placed.source(i)];
                if is_common {
                    f64::from((ours - theirs).abs())
                } else {
                    0.0
                }
            })
            .collect();
        let difference = |(a, b): (&f32, &f32)| f64::from((a - b).abs());
        let covered = method.mask.iter().filter(|&&is_there| is_there).count();
        Ok(MethodScore {
            alignment,
            coverage: covered as f64 / method.mask.len() as f64,
            ssim: similarity(SsimWindow::Gaussian)?,
            ssim_uniform: similarity(SsimWindow::Uniform)?,
            lpips,
            s3: self.map.s3.iter().zip(&map.s3).map(difference).sum::<f64>() / num_pixels,
            s3_whole: whole_difference.iter().sum::<f64>() / num_pixels,
            grad: gradient_difference(&self.photo, render)?,
            psnr_db: PixelError::between(&self.photo, render, Some(&self.common))?
                .psnr_db()
                .filter(|psnr| psnr.is_finite()),
        })
    }
}

/// Where the pixels of a cut come from.
#[derive(Clone, Copy, Debug)]
struct Placed {
    /// Index of the cut's first pixel in the image.
    first: usize,
    cut_width: usize,
    image_width: usize,
}

impl Placed {
    /// An image of `size` that is moved by `offset` to lie on the photo.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the cut lies within every moved image"
    )]
    fn new([width, _]: [u32; 2], cut: Cut, [dx, dy]: [i64; 2]) -> Self {
        let x = i64::from(cut.x) - dx;
        let y = i64::from(cut.y) - dy;
        Self {
            first: (y * i64::from(width) + x) as usize,
            cut_width: cut.width as usize,
            image_width: width as usize,
        }
    }

    /// Index in the image of a pixel of the cut.
    fn source(&self, index: usize) -> usize {
        self.first + index / self.cut_width * self.image_width + index % self.cut_width
    }
}

/// The photo's pixels that every moved rendering reaches.
fn common_cut([width, height]: [u32; 2], offsets: &[[i64; 2]]) -> Option<Cut> {
    let range = |axis: usize, size: u32| {
        let size = i64::from(size);
        let first = offsets.iter().map(|o| o[axis]).max()?.max(0);
        let end = offsets.iter().map(|o| o[axis]).min()?.min(0) + size;
        let len = u32::try_from(end - first).ok().filter(|&len| len > 0)?;
        Some((u32::try_from(first).ok()?, len))
    };
    let ((x, width), (y, height)) = (range(0, width)?, range(1, height)?);
    Some(Cut {
        x,
        y,
        width,
        height,
    })
}

/// Angle between a camera and the nearest of others: the turn from one orientation to the other
/// (Huynh 2009, "Metrics for 3D rotations", Φ6), radians; `None` without others.
pub fn nearest_angle_rad<'a>(
    world_from_camera: &RigidTransform,
    others: impl Iterator<Item = &'a RigidTransform>,
) -> Option<f64> {
    others
        .map(|other| world_from_camera.rotation().angle_to(other.rotation()))
        .min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests;
