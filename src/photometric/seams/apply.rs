//! Adds corrections to texels.

use rayon::prelude::*;

use crate::atlas::AtlasTexture;
use crate::atlas::texels::for_each_texel_within;
use crate::geom::color::{linear_from_srgb, srgb_from_linear};

use super::surface::Surface;

/// Triangles done at a time; bounds what is held before it is written.
const TRIANGLES_PER_BATCH: u32 = 8192;

/// A correction takes at most this share of the way to black or to white.
const MAX_WAY: f32 = 0.7;

/// A texel and its new colour.
type Written = (u32, [u8; 3]);

impl Surface<'_> {
    /// Adds to each texel that shows its triangle's label what `correction_of(triangle)` gives for
    /// its barycentric weights, in triangles that are levelled now. Returns how many changed.
    pub(super) fn paint<F: FnMut([f32; 3]) -> Option<[f32; 3]>>(
        &self,
        texture: &mut AtlasTexture,
        correction_of: impl Fn(u32) -> Option<F> + Sync,
    ) -> usize {
        let mut num_changed = 0;
        #[expect(clippy::cast_possible_truncation, reason = "triangles are u32")]
        let num_triangles = self.sources.len() as u32;
        let batches = (0..num_triangles).step_by(TRIANGLES_PER_BATCH as usize);
        for first in batches {
            let last = num_triangles.min(first + TRIANGLES_PER_BATCH);
            let pages = &*texture;
            let written: Vec<(u32, Vec<Written>)> = (first..last)
                .into_par_iter()
                .filter(|triangle| self.is_levelled(*triangle))
                .filter_map(|triangle| {
                    let correction = correction_of(triangle)?;
                    let page = self.page_of(triangle);
                    Some((page, self.corrected(triangle, page, pages, correction)?))
                })
                .collect();
            for (page, texels) in written {
                num_changed += texels.len();
                if let Some(page) = texture.pages.get_mut(page as usize) {
                    let page = page.to_mut();
                    for (index, srgb) in texels {
                        page.srgb[index as usize] = srgb;
                    }
                }
            }
        }
        num_changed
    }

    fn corrected(
        &self,
        triangle: u32,
        page: u32,
        texture: &AtlasTexture,
        mut correction: impl FnMut([f32; 3]) -> Option<[f32; 3]>,
    ) -> Option<Vec<Written>> {
        let source = self.sources[triangle as usize]?;
        let page = texture.pages.get(page as usize)?;
        let corners = self.corners_texel(triangle);
        let mut texels = Vec::new();
        for_each_texel_within(corners, self.layout.page_size_texel, |x, y, weights| {
            let index = y * page.width + x;
            let old = page.srgb[index as usize];
            if page.source[index as usize] != source {
                return;
            }
            let Some(added) = correction(weights) else {
                return;
            };
            let new = std::array::from_fn(|c| {
                srgb_from_linear(shifted(linear_from_srgb(old[c]), added[c]))
            });
            if new != old {
                texels.push((index, new));
            }
        });
        Some(texels)
    }
}

fn shifted(linear: f32, added: f32) -> f32 {
    let lowest = linear * (1.0 - MAX_WAY);
    let highest = linear + (1.0 - linear) * MAX_WAY;
    (linear + added).clamp(lowest, highest)
}
