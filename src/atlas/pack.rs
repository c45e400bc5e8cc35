//! Charts into rectangles of the atlas, at one density.
//!
//! Each chart is turned to its smallest rectangle, longer side across; scaled by `texels_per_m`;
//! flipped (charts are y up, pages v down, so they are not mirrored); put on the grid of
//! [`super::texels`]; given a gutter; and placed from the largest to the smallest rectangle. A
//! chart larger than a page is drawn smaller. All is deterministic.
//!
//! No two triangles own one texel ([`super::num_shared_texels`]): rectangles are disjoint, and
//! within each chart every claim is checked after rounding. Where rounding makes triangles of a
//! chart share a texel, the chart starts elsewhere within its first texel, and if that does not
//! help, the later triangle is placed apart. A triangle of no area on the grid, or of
//! a chart so small that it owns no texel, gets one texel of its own, around whose centre its
//! corners are put, so that colour transfer paints it like any other. Other thin or small triangles may
//! own no texel; they are drawn from their neighbours'. Every rectangle owns one.

mod bounding_rect;
mod place;
mod shape;

use rayon::prelude::*;

use super::layout::{AtlasLayout, ChartId, PlacedChart, TexelRect};
use super::texels::{MAX_PAGE_TEXEL, SUBTEXELS};
use crate::mesh::TriangleId;
use place::Placement;
use shape::{ChartFrame, ShapedChart};

/// A chart laid out in the plane.
pub trait PlaneChart: Sync {
    /// Its triangles.
    fn triangles(&self) -> &[TriangleId];
    /// Per triangle of [`Self::triangles`]: its corners in metres on the surface, y up.
    fn corners_m(&self) -> &[[[f64; 2]; 3]];
}

/// How charts are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PackParams {
    /// Largest page side in texels: a power of two, 64 to 16,384.
    pub page_size_texel: u32,
    /// Texels on each side of each chart, 2 to 16: two charts are twice as far apart.
    pub gutter_texel: u32,
    /// Texels of all pages together, at most. A texel takes 8 bytes while it is painted.
    pub max_texels: u64,
}

impl Default for PackParams {
    fn default() -> Self {
        Self {
            page_size_texel: 4096,
            gutter_texel: 4,
            max_texels: 2 * 4096 * 4096,
        }
    }
}

/// Why charts were not packed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PackError {
    /// The page size is out of range.
    #[error("page size {page_size_texel} is not a power of two from 64 to {MAX_PAGE_TEXEL}")]
    PageSize {
        /// As given.
        page_size_texel: u32,
    },
    /// The gutter is out of range.
    #[error("gutter of {gutter_texel} texels is not in 2..=16")]
    Gutter {
        /// As given.
        gutter_texel: u32,
    },
    /// The density is no positive number.
    #[error("density of {texels_per_m} texels per metre is not a positive number")]
    Density {
        /// As given.
        texels_per_m: f64,
    },
    /// A chart's lists disagree.
    #[error("chart {chart} has {num_triangles} triangles but corners for {num_corners}")]
    CornersMissing {
        /// Which chart.
        chart: usize,
        /// How many triangles it names.
        num_triangles: usize,
        /// For how many it has corners.
        num_corners: usize,
    },
    /// A triangle is not in exactly one chart.
    #[error("triangle {triangle} of {num_triangles} is in {num_charts} charts, not in one")]
    NotInOneChart {
        /// Which triangle.
        triangle: u32,
        /// How many triangles the mesh has.
        num_triangles: usize,
        /// In how many charts it is.
        num_charts: usize,
    },
    /// The pages would be too large.
    #[error(
        "{num_charts} charts at {texels_per_m} texels per metre do not fit into {max_texels} texels"
    )]
    OverBudget {
        /// How many rectangles there are.
        num_charts: usize,
        /// The density as given.
        texels_per_m: f64,
        /// [`PackParams::max_texels`].
        max_texels: u64,
    },
}

/// How the packing went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PackReport {
    /// Rectangles on the pages.
    pub num_rects: usize,
    /// Share of the pages' texels that lie in a rectangle.
    pub page_fill: f64,
    /// Texels that a triangle owns.
    pub num_owned_texels: usize,
    /// Charts larger than a page, drawn smaller.
    pub num_scaled_charts: usize,
    /// Smallest factor of these; 1 when there are none.
    pub smallest_scale: f64,
    /// Triangles with a texel of their own: of no area, or in a chart that would own no texel.
    pub num_own_texel_triangles: usize,
    /// Triangles that own no texel: smaller than one, or between centres.
    pub num_subtexel_triangles: usize,
    /// Triangles placed apart from their chart because they would have shared a texel.
    pub num_moved_triangles: usize,
}

/// Places the charts, which hold each of the mesh's triangles once. Charts of the layout come in
/// the order of `charts`, each followed by the triangles that could not stay in it.
///
/// # Errors
/// [`PackError`] when a parameter is out of range, a triangle is missing, doubled or unknown, or
/// the charts do not fit into the budget (see [`texels_per_m_for_budget`]).
pub fn pack<C: PlaneChart>(
    charts: &[C],
    num_triangles: usize,
    texels_per_m: f64,
    params: &PackParams,
) -> Result<(AtlasLayout, PackReport), PackError> {
    check_params(texels_per_m, params)?;
    check_charts(charts, num_triangles)?;
    let frames = frames(charts);
    let shaped = shape_all(charts, &frames, texels_per_m, params);
    let placement = place_all(&shaped, params).ok_or_else(|| PackError::OverBudget {
        num_charts: shaped.iter().map(|s| s.pieces.len()).sum(),
        texels_per_m,
        max_texels: params.max_texels,
    })?;
    let report = report(&frames, &shaped, &placement, texels_per_m, params);
    let layout = lay_out(shaped, &placement, num_triangles, texels_per_m);
    Ok((layout, report))
}

/// The density wanted, or the largest one found below it at which [`pack`] keeps to its budget:
/// within some percent of the largest there is. When even the gutters do not fit, a density at
/// which `pack` will say so.
///
/// # Errors
/// [`PackError`] when a parameter is out of range or a chart's lists disagree.
pub fn texels_per_m_for_budget<C: PlaneChart>(
    charts: &[C],
    wanted_texels_per_m: f64,
    params: &PackParams,
) -> Result<f64, PackError> {
    /// Placement fills pages to some 0.95; each step down gives 6 % of the area.
    const STEP: f64 = 0.97;
    const MAX_STEPS: usize = 40;
    const MAX_HALVINGS: i32 = 200;
    check_params(wanted_texels_per_m, params)?;
    check_corners(charts)?;
    let frames = frames(charts);
    let mut texels_per_m = density_for_area(&frames, wanted_texels_per_m, params);
    let fits = |texels_per_m: f64| {
        let shaped = shape_all(charts, &frames, texels_per_m, params);
        place_all(&shaped, params).is_some()
    };
    for _ in 0..MAX_STEPS {
        if fits(texels_per_m) {
            return Ok(texels_per_m);
        }
        texels_per_m *= STEP;
    }
    // Charts that are drawn smaller to fit a page take the same room until the density has fallen
    // by as much: a mesh in the wrong unit.
    if fits(texels_per_m * 0.5_f64.powi(MAX_HALVINGS)) {
        while !fits(texels_per_m) {
            texels_per_m *= 0.5;
        }
    }
    Ok(texels_per_m)
}

/// The largest density up to the one wanted at which the rectangles' area alone fits.
fn density_for_area(frames: &[ChartFrame], wanted: f64, params: &PackParams) -> f64 {
    let fits = |texels_per_m: f64| {
        let side = |extent_m: f64, scale: f64| {
            (extent_m * texels_per_m * scale).ceil() + f64::from(2 * params.gutter_texel)
        };
        let area: f64 = frames
            .iter()
            .map(|frame| {
                let scale = frame.scale(texels_per_m, params);
                frame
                    .extent_m
                    .map(|m| side(m, scale))
                    .iter()
                    .product::<f64>()
            })
            .sum();
        area <= params.max_texels as f64
    };
    if fits(wanted) {
        return wanted;
    }
    // First the power of two: a mesh in the wrong unit may be off by many.
    const MAX_HALVINGS: usize = 200;
    let mut low = 0.5 * wanted;
    for _ in 0..MAX_HALVINGS {
        if fits(low) {
            break;
        }
        low *= 0.5;
    }
    let mut high = 2.0 * low;
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if fits(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

fn check_params(texels_per_m: f64, params: &PackParams) -> Result<(), PackError> {
    let page_size_texel = params.page_size_texel;
    if !page_size_texel.is_power_of_two() || !(64..=MAX_PAGE_TEXEL).contains(&page_size_texel) {
        return Err(PackError::PageSize { page_size_texel });
    }
    if !(2..=16).contains(&params.gutter_texel) {
        return Err(PackError::Gutter {
            gutter_texel: params.gutter_texel,
        });
    }
    if !texels_per_m.is_finite() || texels_per_m <= 0.0 {
        return Err(PackError::Density { texels_per_m });
    }
    Ok(())
}

fn check_corners<C: PlaneChart>(charts: &[C]) -> Result<(), PackError> {
    for (index, chart) in charts.iter().enumerate() {
        let (num_triangles, num_corners) = (chart.triangles().len(), chart.corners_m().len());
        if num_triangles != num_corners {
            return Err(PackError::CornersMissing {
                chart: index,
                num_triangles,
                num_corners,
            });
        }
    }
    Ok(())
}

fn check_charts<C: PlaneChart>(charts: &[C], num_triangles: usize) -> Result<(), PackError> {
    check_corners(charts)?;
    let not_in_one = |triangle: u32, num_charts: usize| PackError::NotInOneChart {
        triangle,
        num_triangles,
        num_charts,
    };
    let mut num_charts_of = vec![0usize; num_triangles];
    for triangle in charts.iter().flat_map(PlaneChart::triangles) {
        match num_charts_of.get_mut(triangle.index()) {
            Some(count) => *count += 1,
            None => return Err(not_in_one(triangle.0, 1)),
        }
    }
    match (0u32..).zip(&num_charts_of).find(|(_, count)| **count != 1) {
        Some((triangle, &count)) => Err(not_in_one(triangle, count)),
        None => Ok(()),
    }
}

fn frames<C: PlaneChart>(charts: &[C]) -> Vec<ChartFrame> {
    charts
        .par_iter()
        .map(|chart| ChartFrame::of(chart))
        .collect()
}

fn shape_all<C: PlaneChart>(
    charts: &[C],
    frames: &[ChartFrame],
    texels_per_m: f64,
    params: &PackParams,
) -> Vec<ShapedChart> {
    charts
        .par_iter()
        .zip(frames)
        .map(|(chart, frame)| shape::shape(chart, frame, texels_per_m, params))
        .collect()
}

fn place_all(shaped: &[ShapedChart], params: &PackParams) -> Option<Placement> {
    let rects: Vec<[u32; 2]> = shaped
        .iter()
        .flat_map(|s| &s.pieces)
        .map(shape::Piece::rect_texel)
        .collect();
    place::place(&rects, params.page_size_texel, params.max_texels)
}

fn report(
    frames: &[ChartFrame],
    shaped: &[ShapedChart],
    placement: &Placement,
    texels_per_m: f64,
    params: &PackParams,
) -> PackReport {
    let scales = frames.iter().map(|f| f.scale(texels_per_m, params));
    let num_texels = |[width, height]: [u32; 2]| f64::from(width) * f64::from(height);
    let in_rects: f64 = shaped
        .iter()
        .flat_map(|s| &s.pieces)
        .map(|piece| num_texels(piece.rect_texel()))
        .sum();
    let on_pages = num_texels(placement.page_size_texel) * f64::from(placement.num_pages);
    let count = |of: fn(&ShapedChart) -> usize| shaped.iter().map(of).sum();
    PackReport {
        num_rects: placement.spots.len(),
        page_fill: in_rects / on_pages,
        num_owned_texels: count(|s| s.num_owned_texels),
        num_scaled_charts: scales.clone().filter(|scale| *scale < 1.0).count(),
        smallest_scale: scales.fold(1.0, f64::min),
        num_own_texel_triangles: count(|s| s.num_own_texel_triangles),
        num_subtexel_triangles: count(|s| s.num_subtexel_triangles),
        num_moved_triangles: count(|s| s.num_moved_triangles),
    }
}

fn lay_out(
    shaped: Vec<ShapedChart>,
    placement: &Placement,
    num_triangles: usize,
    texels_per_m: f64,
) -> AtlasLayout {
    let mut chart_of_triangle = vec![ChartId(0); num_triangles];
    let mut corners_texel = vec![[[0.0; 2]; 3]; num_triangles];
    let mut charts = Vec::with_capacity(placement.spots.len());
    let pieces = shaped.into_iter().flat_map(|s| s.pieces);
    for (id, (piece, spot)) in (0u32..).zip(pieces.zip(&placement.spots)) {
        let [width, height] = piece.rect_texel();
        let origin = [spot.x, spot.y].map(|v| i64::from(v + piece.gutter_texel));
        for (triangle, corners) in piece.triangles.iter().zip(&piece.corners) {
            chart_of_triangle[triangle.index()] = ChartId(id);
            corners_texel[triangle.index()] = corners.map(|corner| {
                std::array::from_fn(|axis| {
                    let subtexels = origin[axis] * i64::from(SUBTEXELS) + corner[axis];
                    // At most 24 bits: exact.
                    subtexels as f32 / SUBTEXELS as f32
                })
            });
        }
        charts.push(PlacedChart {
            page: spot.page,
            rect: TexelRect {
                x: spot.x,
                y: spot.y,
                width,
                height,
            },
            triangles: piece.triangles,
        });
    }
    AtlasLayout {
        page_size_texel: placement.page_size_texel,
        num_pages: placement.num_pages,
        texels_per_m,
        charts,
        chart_of_triangle,
        corners_texel,
    }
}

#[cfg(test)]
mod tests;
