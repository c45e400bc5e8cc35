//! How far each photo is displaced from the rendering, patch by patch, remembered between visits.
//!
//! The texture changes slowly and a whole rendering costs as much as several steps, so that a view
//! is aligned anew only after a number of visits. Photos wider than [`MAX_WIDTH_PX`] are aligned at
//! a whole fraction of their size.

use super::align::{AlignError, AlignParams, Alignment, align};
use super::texels::{Texels, to_byte};
use super::view::{PixelRect, Surface};
use super::views::Seen;
use crate::geom::ColorImage;

const MAX_WIDTH_PX: usize = 960;

/// Offsets of all views.
pub(super) struct Offsets {
    params: AlignParams,
    /// Patches along each side of an image.
    grid: usize,
    /// Visits until a view is aligned anew.
    interval: usize,
    views: Vec<Option<Known>>,
}

struct Known {
    num_visits: usize,
    patches: Vec<Alignment>,
}

/// Offsets as they stand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OffsetReport {
    /// Views that were aligned.
    pub num_views: usize,
    /// Share of their patches whose offset is trusted, in [0, 1].
    pub trusted_share: f64,
    /// Mean length of the trusted offsets, pixels.
    pub mean_px: f64,
    /// The longest trusted offset, pixels.
    pub max_px: f64,
}

impl Offsets {
    pub(super) fn new(params: AlignParams, grid: usize, interval: usize, num_views: usize) -> Self {
        Self {
            params,
            grid: grid.max(1),
            interval: interval.max(1),
            views: (0..num_views).map(|_| None).collect(),
        }
    }

    /// The offset at a pixel of a view's photo; aligns it where that is due.
    pub(super) fn at(
        &mut self,
        index: usize,
        seen: &Seen,
        on: Surface<'_>,
        texels: &Texels,
        [x, y]: [usize; 2],
    ) -> Result<[f32; 2], AlignError> {
        let is_due = self.views[index]
            .as_ref()
            .is_none_or(|known| known.num_visits >= self.interval);
        if is_due {
            let patches = self.align(seen, on, texels)?;
            self.views[index] = Some(Known {
                num_visits: 0,
                patches,
            });
        }
        let Some(known) = &mut self.views[index] else {
            return Ok([0.0; 2]);
        };
        known.num_visits += 1;
        let cell = |at: usize, size: u32| (at * self.grid / size as usize).min(self.grid - 1);
        let photo = &seen.photo.color;
        let patch = cell(y, photo.height()) * self.grid + cell(x, photo.width());
        Ok(known.patches[patch].offset_px)
    }

    fn align(
        &self,
        seen: &Seen,
        on: Surface<'_>,
        texels: &Texels,
    ) -> Result<Vec<Alignment>, AlignError> {
        let photo = &seen.photo.color;
        let factor = (photo.width() as usize).div_ceil(MAX_WIDTH_PX);
        let rect = PixelRect {
            x: 0,
            y: 0,
            width: photo.width() as usize / factor,
            height: photo.height() as usize / factor,
        };
        let surface = seen.view.surface(on, texels, rect, factor, [0.0; 2]);
        let mut render = vec![0.0; 3 * rect.num_pixels()];
        texels.gather(on.texture, &surface.footprint, &mut render);
        let mask: Vec<bool> = surface.footprint.iter().map(|f| f.is_some()).collect();
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a factor of an image's width"
        )]
        let photo = photo.reduced(factor as u32);

        let mut patches = Vec::with_capacity(self.grid * self.grid);
        for cell in 0..self.grid * self.grid {
            let part = self.patch(cell, rect);
            let (photo, render, mask) = (
                cut(rect, part, |i| photo.pixels()[i]),
                cut(rect, part, |i| {
                    [0, 1, 2].map(|c| to_byte(render[c * rect.num_pixels() + i]))
                }),
                cut(rect, part, |i| mask[i]),
            );
            let found = match (picture(part, photo), picture(part, render)) {
                (Some(photo), Some(render)) => align(&photo, &render, Some(&mask), &self.params)?,
                // A patch without pixels.
                _ => Alignment::UNKNOWN,
            };
            patches.push(Alignment {
                offset_px: found.offset_px.map(|px| px * factor as f32),
                ..found
            });
        }
        Ok(patches)
    }

    fn patch(&self, cell: usize, whole: PixelRect) -> PixelRect {
        let from = |at: usize, size: usize| at * size / self.grid;
        let (column, row) = (cell % self.grid, cell / self.grid);
        let (x, y) = (from(column, whole.width), from(row, whole.height));
        PixelRect {
            x,
            y,
            width: from(column + 1, whole.width) - x,
            height: from(row + 1, whole.height) - y,
        }
    }

    pub(super) fn report(&self) -> OffsetReport {
        let aligned: Vec<&Known> = self.views.iter().flatten().collect();
        let patches: Vec<&Alignment> = aligned.iter().flat_map(|known| &known.patches).collect();
        let lengths: Vec<f64> = patches
            .iter()
            .filter(|patch| patch.is_trusted)
            .map(|patch| f64::from(patch.offset_px[0]).hypot(f64::from(patch.offset_px[1])))
            .collect();
        let num_trusted = lengths.len().max(1) as f64;
        OffsetReport {
            num_views: aligned.len(),
            trusted_share: lengths.len() as f64 / patches.len().max(1) as f64,
            mean_px: lengths.iter().sum::<f64>() / num_trusted,
            max_px: lengths.iter().copied().fold(0.0, f64::max),
        }
    }
}

fn cut<T>(whole: PixelRect, part: PixelRect, at: impl Fn(usize) -> T) -> Vec<T> {
    let mut out = Vec::with_capacity(part.num_pixels());
    for y in part.y..part.y + part.height {
        out.extend((part.x..part.x + part.width).map(|x| at(y * whole.width + x)));
    }
    out
}

fn picture(size: PixelRect, pixels: Vec<[u8; 3]>) -> Option<ColorImage> {
    let side = |px: usize| u32::try_from(px).ok();
    ColorImage::new(side(size.width)?, side(size.height)?, pixels).ok()
}
