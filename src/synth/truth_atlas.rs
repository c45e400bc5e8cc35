//! The truth as a textured mesh of its own: one chart per surface, unrolled.

use crate::atlas::{
    AtlasLayout, AtlasTexture, ChartId, PlacedChart, TexelRect, TexelSource, TexturePage,
};
use crate::mesh::{TriMesh, TriangleId};
use rayon::prelude::*;

use super::options::SynthError;
use super::surface::Surface;
use super::tessellate::{Patch, visible_patches};
use super::truth::{GroundTruth, srgb_255};

const GUTTER_TEXEL: u32 = 2;
const MAX_PAGE_TEXEL: u32 = 4096;

impl GroundTruth {
    /// The scene's mesh with its true texture at `texels_per_m`; lowered so that the largest
    /// surface fits onto a page of 4096². Painted texels carry `TexelSource::keyframe(0)`, so that
    /// the truth can be scored like any other atlas.
    ///
    /// # Errors
    /// [`SynthError::Option`] when the density is not positive, [`SynthError::Mesh`] when the mesh
    /// cannot be indexed.
    pub fn atlas(
        &self,
        texels_per_m: f64,
    ) -> Result<(TriMesh, AtlasLayout, AtlasTexture), SynthError> {
        if !(texels_per_m.is_finite() && texels_per_m > 0.0) {
            return Err(SynthError::Option {
                name: "texels_per_m",
                value: texels_per_m.to_string(),
                range: "greater than 0",
            });
        }
        let surfaces = &self.scene.surfaces;
        let largest_m = surfaces
            .iter()
            .flat_map(|surface| surface.shape.uv_size_m())
            .fold(0.0, f64::max);
        let texels_per_m =
            texels_per_m.min(f64::from(MAX_PAGE_TEXEL - 2 * GUTTER_TEXEL - 2) / largest_m);
        let patches = visible_patches(&self.scene, self.scene.edge_m);
        let placement = place(surfaces, texels_per_m);
        let mesh = join(&patches)?;
        let layout = layout(&patches, &placement, texels_per_m);
        let mut pages = vec![
            TexturePage::blank(placement.page_texel, placement.page_texel);
            placement.num_pages as usize
        ];
        let charts: Vec<Vec<([u8; 3], TexelSource)>> = surfaces
            .par_iter()
            .zip(&placement.slots)
            .map(|(surface, slot)| paint(surface, &slot.1, texels_per_m))
            .collect();
        for ((page, rect), texels) in placement.slots.iter().zip(charts) {
            blit(&mut pages[*page as usize], rect, &texels);
        }
        Ok((mesh, layout, pages.into_iter().collect()))
    }
}

struct Placement {
    page_texel: u32,
    num_pages: u32,
    /// Page and rectangle of each surface.
    slots: Vec<(u32, TexelRect)>,
}

/// Shelves of falling height, on the smallest page that holds everything or on several of 4096².
fn place(surfaces: &[Surface], texels_per_m: f64) -> Placement {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to a page"
    )]
    let sizes: Vec<[u32; 2]> = surfaces
        .iter()
        .map(|surface| {
            surface.shape.uv_size_m().map(|side| {
                let texels = (side * texels_per_m)
                    .ceil()
                    .clamp(1.0, f64::from(MAX_PAGE_TEXEL));
                (texels as u32 + 2 * GUTTER_TEXEL).min(MAX_PAGE_TEXEL)
            })
        })
        .collect();
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&index| (std::cmp::Reverse(sizes[index][1]), index));
    let mut page_texel = 256;
    loop {
        let (num_pages, slots) = shelves(&sizes, &order, page_texel);
        if (num_pages == 1 && !slots.is_empty()) || page_texel >= MAX_PAGE_TEXEL {
            return Placement {
                page_texel,
                num_pages,
                slots,
            };
        }
        page_texel *= 2;
    }
}

fn shelves(sizes: &[[u32; 2]], order: &[usize], page_texel: u32) -> (u32, Vec<(u32, TexelRect)>) {
    let empty = TexelRect {
        x: 0,
        y: 0,
        width: 0,
        height: 0,
    };
    let mut slots = vec![(0, empty); sizes.len()];
    let (mut page, mut x, mut y, mut shelf) = (0, 0, 0, 0);
    for &index in order {
        let [width, height] = sizes[index];
        if width > page_texel || height > page_texel {
            return (u32::MAX, Vec::new());
        }
        if x + width > page_texel {
            (x, y, shelf) = (0, y + shelf, 0);
        }
        if y + height > page_texel {
            (page, x, y, shelf) = (page + 1, 0, 0, 0);
        }
        slots[index] = (
            page,
            TexelRect {
                x,
                y,
                width,
                height,
            },
        );
        x += width;
        shelf = shelf.max(height);
    }
    (page + 1, slots)
}

fn join(patches: &[Patch]) -> Result<TriMesh, SynthError> {
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    for patch in patches {
        let first = u32::try_from(points.len()).unwrap_or(u32::MAX);
        points.extend_from_slice(&patch.points_in_world);
        triangles.extend(
            patch
                .triangles
                .iter()
                .map(|t| t.map(|v| v.saturating_add(first))),
        );
    }
    Ok(TriMesh::from_soup(points, triangles)?.0)
}

fn layout(patches: &[Patch], placement: &Placement, texels_per_m: f64) -> AtlasLayout {
    let mut layout = AtlasLayout {
        page_size_texel: [placement.page_texel; 2],
        num_pages: placement.num_pages,
        texels_per_m,
        charts: Vec::new(),
        chart_of_triangle: Vec::new(),
        corners_texel: Vec::new(),
    };
    let mut next_triangle = 0u32;
    for (chart, (patch, (page, rect))) in (0..).zip(patches.iter().zip(&placement.slots)) {
        let mut triangles = Vec::with_capacity(patch.triangles.len());
        for corners in &patch.corners_uv_m {
            triangles.push(TriangleId(next_triangle));
            next_triangle += 1;
            layout.chart_of_triangle.push(ChartId(chart));
            layout.corners_texel.push(corners.map(|[u, v]| {
                #[expect(clippy::cast_possible_truncation, reason = "texel positions are f32")]
                let corner = [
                    (f64::from(rect.x + GUTTER_TEXEL) + u * texels_per_m) as f32,
                    (f64::from(rect.y + GUTTER_TEXEL) + v * texels_per_m) as f32,
                ];
                corner
            }));
        }
        let placed = PlacedChart::whole_rect(*page, *rect, texels_per_m, triangles);
        layout.charts.push(placed);
    }
    layout
}

fn paint(surface: &Surface, rect: &TexelRect, texels_per_m: f64) -> Vec<([u8; 3], TexelSource)> {
    let [width_m, height_m] = surface.shape.uv_size_m();
    let mut texels = Vec::with_capacity(rect.width as usize * rect.height as usize);
    for y in 0..rect.height {
        for x in 0..rect.width {
            let at = |k: u32| (f64::from(k) - f64::from(GUTTER_TEXEL) + 0.5) / texels_per_m;
            let uv = [at(x), at(y)];
            let inside = [uv[0].clamp(0.0, width_m), uv[1].clamp(0.0, height_m)];
            let source = if inside == uv {
                TexelSource::keyframe(0)
            } else {
                TexelSource::GUTTER
            };
            let color = surface.average(inside, 1.0 / texels_per_m);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "on the scale 0–255"
            )]
            let bytes = color.map(|c| srgb_255(c).round() as u8);
            texels.push((bytes, source));
        }
    }
    texels
}

fn blit(page: &mut TexturePage, rect: &TexelRect, texels: &[([u8; 3], TexelSource)]) {
    for (row, line) in (rect.y..).zip(texels.chunks_exact(rect.width.max(1) as usize)) {
        let start = row as usize * page.width as usize + rect.x as usize;
        for (at, (srgb, source)) in (start..).zip(line) {
            page.srgb[at] = *srgb;
            page.source[at] = *source;
            page.confidence[at] = 255;
        }
    }
}
