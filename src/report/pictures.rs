//! Drawing on plain images: smaller, different, hatched, labelled.

use rayon::prelude::*;

use crate::atlas::TexelSource;
use crate::export::TexturedMesh;
use crate::geom::ColorImage;
use crate::geom::color::{linear_from_srgb, srgb_from_linear};
use crate::mesh::TriangleId;

use super::measure::middle_texel;
use super::{ReportView, colors};

/// Size that fits into `max_side_px` with the sides' ratio kept; never larger, never zero.
pub fn fitted_size(width: u32, height: u32, max_side_px: u32) -> [u32; 2] {
    let longest = width.max(height).max(1);
    if longest <= max_side_px {
        return [width.max(1), height.max(1)];
    }
    [width, height].map(|side| {
        let scaled = u64::from(side) * u64::from(max_side_px) / u64::from(longest);
        u32::try_from(scaled).unwrap_or(max_side_px).max(1)
    })
}

/// Mean in linear light over the pixels that each new pixel covers, those that `is_counted` (by
/// index); [`colors::BACKGROUND`] where none is. Rows in parallel.
pub fn downscale_where(
    pixels: &[[u8; 3]],
    [width, height]: [u32; 2],
    [new_width, new_height]: [u32; 2],
    is_counted: impl Fn(usize) -> bool + Sync,
) -> Vec<[u8; 3]> {
    // Pixel `i` of `new` covers [start(i), start(i + 1)) of `old`, in whole pixels.
    let range = |i: u32, new: u32, old: u32| {
        let bound = |i: u32| i as usize * old as usize / new as usize;
        bound(i)..bound(i + 1).max(bound(i) + 1).min(old as usize)
    };
    let columns: Vec<_> = (0..new_width).map(|x| range(x, new_width, width)).collect();
    let rows: Vec<Vec<[u8; 3]>> = (0..new_height)
        .into_par_iter()
        .map(|new_y| {
            let mut row = Vec::with_capacity(new_width as usize);
            for columns in &columns {
                let mut sum = [0f32; 3];
                let mut count = 0u32;
                for y in range(new_y, new_height, height) {
                    for x in columns.clone() {
                        let index = y * width as usize + x;
                        if is_counted(index) {
                            for (total, &byte) in sum.iter_mut().zip(&pixels[index]) {
                                *total += linear_from_srgb(byte);
                            }
                            count += 1;
                        }
                    }
                }
                row.push(match count {
                    0 => colors::BACKGROUND,
                    _ => sum.map(|total| srgb_from_linear(total / count as f32)),
                });
            }
            row
        })
        .collect();
    rows.concat()
}

/// The image with its longer side at most `max_side_px`.
pub fn downscale(image: &ColorImage, max_side_px: u32) -> ColorImage {
    let size = fitted_size(image.width(), image.height(), max_side_px);
    if size == [image.width(), image.height()] {
        return image.clone();
    }
    let pixels = downscale_where(
        image.pixels(),
        [image.width(), image.height()],
        size,
        |_| true,
    );
    ColorImage::new(size[0], size[1], pixels).unwrap_or_else(|_| image.clone())
}

/// Two greys in diagonal stripes: here is no mesh.
pub fn hatch(x: usize, y: usize) -> [u8; 3] {
    if ((x + y) / 6).is_multiple_of(2) {
        [44, 46, 51]
    } else {
        [54, 57, 63]
    }
}

/// The rendering, hatched where the mesh is not.
pub fn masked_render(view: &ReportView) -> ColorImage {
    map_view(view, |index, _| view.render.pixels()[index])
}

/// The largest difference of a channel, on the scale of [`colors::of_difference`].
pub fn difference(view: &ReportView) -> ColorImage {
    map_view(view, |index, _| {
        let (a, b) = (view.photo.pixels()[index], view.render.pixels()[index]);
        let channels = a.iter().zip(b).map(|(a, b)| a.abs_diff(b));
        colors::of_difference(channels.max().unwrap_or(0))
    })
}

/// The charts on the surface, seams drawn between them; `None` without triangle ids.
pub fn charts(view: &ReportView, textured: &TexturedMesh<'_>) -> Option<ColorImage> {
    let chart_of_triangle = &textured.layout().chart_of_triangle;
    let chart_at = |index: usize| {
        let triangle = *view.triangle.get(index)?;
        chart_of_triangle
            .get(triangle as usize)
            .map(|chart| chart.0)
    };
    let width = view.photo.width() as usize;
    (!view.triangle.is_empty()).then(|| {
        map_view(view, |index, [x, _]| {
            let Some(chart) = chart_at(index) else {
                return colors::BACKGROUND;
            };
            let differs = |other: Option<u32>| other.is_some_and(|other| other != chart);
            let on_seam =
                (x + 1 < width && differs(chart_at(index + 1))) || differs(chart_at(index + width));
            if on_seam {
                colors::SEAM
            } else {
                shade(colors::of_chart(chart), view.render.pixels()[index])
            }
        })
    })
}

/// Keyframes on the surface, one colour each, by the texel in the middle of each triangle; `None`
/// without triangle ids.
pub fn provenance(view: &ReportView, textured: &TexturedMesh<'_>) -> Option<ColorImage> {
    (!view.triangle.is_empty()).then(|| {
        map_view(view, |index, _| {
            let source = source_of(textured, view.triangle[index]);
            shade(colors::of_source(source), view.render.pixels()[index])
        })
    })
}

fn source_of(textured: &TexturedMesh<'_>, triangle: u32) -> TexelSource {
    let triangle = TriangleId(triangle);
    if triangle.index() >= textured.mesh().num_triangles() {
        return TexelSource::NONE;
    }
    let page = &textured.texture().pages[textured.layout().page_of(triangle) as usize];
    let [x, y] = middle_texel(textured, triangle);
    page.source[y as usize * page.width as usize + x as usize]
}

/// The label's colour with some of the picture's light in it, so that shapes stay readable.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a product of bytes over 255 times at most 255"
)]
fn shade(label: [u8; 3], [r, g, b]: [u8; 3]) -> [u8; 3] {
    // BT.601 luma in 8 bits of fraction.
    let luma = (u32::from(r) * 77 + u32::from(g) * 150 + u32::from(b) * 29) >> 8;
    let light = 150 + luma * 105 / 255;
    label.map(|c| (u32::from(c) * light / 255) as u8)
}

fn map_view(view: &ReportView, color: impl Fn(usize, [usize; 2]) -> [u8; 3] + Sync) -> ColorImage {
    let width = view.photo.width() as usize;
    let pixels = (0..view.photo.pixels().len())
        .into_par_iter()
        .map(|index| {
            let (x, y) = (index % width, index / width);
            if view.mask[index] {
                color(index, [x, y])
            } else {
                hatch(x, y)
            }
        })
        .collect();
    ColorImage::new(view.photo.width(), view.photo.height(), pixels)
        .unwrap_or_else(|_| view.photo.clone())
}
