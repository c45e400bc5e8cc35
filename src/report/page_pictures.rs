//! Pictures of atlas pages: the texels themselves, charts and seams, coverage, who painted what,
//! and confidence.
//!
//! Diagrams sample the texel in the middle of each of their pixels; the texels themselves are
//! averaged.

use crate::atlas::{TexelSource, TexturePage};
use crate::export::TexturedMesh;
use crate::geom::ColorImage;

use super::colors;
use super::pictures::{downscale_where, fitted_size};

/// The page, at most `max_side_px` a side; unpainted texels show the background.
pub fn texels(page: &TexturePage, max_side_px: u32) -> Option<ColorImage> {
    let size = fitted_size(page.width, page.height, max_side_px);
    let is_painted = |index: usize| page.source[index] != TexelSource::NONE;
    let pixels = downscale_where(&page.srgb, [page.width, page.height], size, is_painted);
    ColorImage::new(size[0], size[1], pixels).ok()
}

/// Which kind of source each texel has.
pub fn coverage(page: &TexturePage, max_side_px: u32) -> Option<ColorImage> {
    sampled(page, max_side_px, |index| {
        colors::of_coverage(page.source[index])
    })
}

/// Which keyframe painted each texel.
pub fn provenance(page: &TexturePage, max_side_px: u32) -> Option<ColorImage> {
    sampled(page, max_side_px, |index| {
        colors::of_source(page.source[index])
    })
}

/// How far each texel is to be trusted.
pub fn confidence(page: &TexturePage, max_side_px: u32) -> Option<ColorImage> {
    sampled(page, max_side_px, |index| match page.source[index] {
        TexelSource::NONE => colors::BACKGROUND,
        TexelSource::GUTTER => colors::GUTTER,
        _ => colors::of_confidence(page.confidence[index]),
    })
}

/// Each chart in a colour of its own, seams drawn around it.
pub fn charts(
    textured: &TexturedMesh<'_>,
    page_index: usize,
    max_side_px: u32,
) -> Option<ColorImage> {
    const NO_CHART: u32 = u32::MAX;
    let page = textured.texture().pages.get(page_index)?;
    let size @ [width, height] = fitted_size(page.width, page.height, max_side_px);
    let mut chart_at = vec![NO_CHART; width as usize * height as usize];
    for (chart, placed) in (0u32..).zip(&textured.layout().charts) {
        if placed.page as usize != page_index {
            continue;
        }
        let rect = placed.rect;
        let columns = scaled_range(rect.x, rect.width, page.width, width);
        for y in scaled_range(rect.y, rect.height, page.height, height) {
            for x in columns.clone() {
                let [column, row] = texel_at(page, size, [x, y]);
                let source = page.source[texel_under(page, size, [x, y])];
                let is_painted = source != TexelSource::NONE && source != TexelSource::GUTTER;
                if is_painted && placed.owns(column, row) {
                    chart_at[y as usize * width as usize + x as usize] = chart;
                }
            }
        }
    }
    let row = width as usize;
    let differs = |a: u32, b: Option<&u32>| b.is_some_and(|&b| b != a && b != NO_CHART);
    let color = |(index, &chart): (usize, &u32)| {
        let right = chart_at.get(index + 1).filter(|_| (index + 1) % row != 0);
        if chart == NO_CHART {
            colors::BACKGROUND
        } else if differs(chart, right) || differs(chart, chart_at.get(index + row)) {
            colors::SEAM
        } else {
            colors::of_chart(chart)
        }
    };
    let pixels = chart_at.iter().enumerate().map(color).collect();
    ColorImage::new(width, height, pixels).ok()
}

fn sampled(
    page: &TexturePage,
    max_side_px: u32,
    color: impl Fn(usize) -> [u8; 3],
) -> Option<ColorImage> {
    let size @ [width, height] = fitted_size(page.width, page.height, max_side_px);
    let mut pixels = Vec::with_capacity(width as usize * height as usize);
    for y in 0..height {
        for x in 0..width {
            pixels.push(color(texel_under(page, size, [x, y])));
        }
    }
    ColorImage::new(width, height, pixels).ok()
}

/// Index of the texel under the middle of a picture's pixel.
fn texel_under(page: &TexturePage, size: [u32; 2], pixel: [u32; 2]) -> usize {
    let [x, y] = texel_at(page, size, pixel);
    y as usize * page.width as usize + x as usize
}

/// Column and row of the texel under the middle of a picture's pixel.
fn texel_at(page: &TexturePage, [width, height]: [u32; 2], [x, y]: [u32; 2]) -> [u32; 2] {
    let middle = |i: u32, new: u32, old: u32| {
        let texel = (2 * u64::from(i) + 1) * u64::from(old) / (2 * u64::from(new));
        u32::try_from(texel).unwrap_or(u32::MAX)
    };
    [middle(x, width, page.width), middle(y, height, page.height)]
}

/// Pixels of the picture whose middle texel lies in `start..start + length`.
fn scaled_range(start: u32, length: u32, old: u32, new: u32) -> std::ops::Range<u32> {
    // Pixel i has its middle texel at floor((2i + 1)·old / 2new), which is at least `texel` from
    // i = ceil((2·new·texel − old) / 2old) on.
    let (old, new) = (u64::from(old.max(1)), u64::from(new));
    let first_at = |texel: u64| {
        let pixel = (2 * new * texel).saturating_sub(old).div_ceil(2 * old);
        u32::try_from(pixel.min(new)).unwrap_or(u32::MAX)
    };
    first_at(u64::from(start))..first_at(u64::from(start) + u64::from(length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn scaled_ranges_hold_the_pixels_whose_middle_is_inside(
            old in 1..300u32, new in 1..300u32, start in 0..300u32, length in 0..300u32,
        ) {
            let (new, start) = (new.min(old), start.min(old));
            let length = length.min(old - start);
            let range = scaled_range(start, length, old, new);
            for pixel in 0..new {
                let texel = (2 * pixel + 1) * old / (2 * new);
                prop_assert_eq!(range.contains(&pixel), (start..start + length).contains(&texel));
            }
        }
    }
}
