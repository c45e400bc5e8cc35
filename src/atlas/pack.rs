//! Charts into rectangles of the atlas, at one density.
//!
//! Each chart is turned to its smallest rectangle, longer side across; scaled by `texels_per_m`;
//! flipped (charts are y up, pages v down, so they are not mirrored); put on the grid of
//! [`super::texels`]; given a gutter; and placed from the highest to the lowest rectangle. A
//! chart larger than a page is drawn smaller. All is deterministic.
//!
//! No two triangles own one texel ([`super::num_shared_texels`]): rectangles are disjoint, and
//! within each chart every claim is checked after rounding. Where rounding makes triangles of a
//! chart share a texel, the chart starts elsewhere within its first texel, and if that does not
//! help, the later triangle is placed apart. A triangle of no area on the grid gets one texel of
//! its own, around whose centre its corners are put, so that colour transfer paints it like any
//! other. A thin or small triangle may still own no texel; it is drawn from its neighbours' texels.

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
    /// Triangles of no area, each with a texel of its own.
    pub num_degenerate_triangles: usize,
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
    check_params(wanted_texels_per_m, params)?;
    check_corners(charts)?;
    let frames = frames(charts);
    let mut texels_per_m = density_for_area(&frames, wanted_texels_per_m, params);
    for _ in 0..MAX_STEPS {
        let shaped = shape_all(charts, &frames, texels_per_m, params);
        if place_all(&shaped, params).is_some() {
            break;
        }
        texels_per_m *= STEP;
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
    let (mut low, mut high) = (0.0, wanted);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if fits(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    if low > 0.0 { low } else { high }
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
        num_degenerate_triangles: count(|s| s.num_degenerate_triangles),
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
mod tests {
    use proptest::prelude::*;

    use super::super::num_shared_texels;
    use super::super::texels::for_each_texel_within;
    use super::*;

    struct Chart {
        triangles: Vec<TriangleId>,
        corners_m: Vec<[[f64; 2]; 3]>,
    }

    impl PlaneChart for Chart {
        fn triangles(&self) -> &[TriangleId] {
            &self.triangles
        }

        fn corners_m(&self) -> &[[[f64; 2]; 3]] {
            &self.corners_m
        }
    }

    /// Charts of consecutive triangles.
    fn charts(corners_m: Vec<Vec<[[f64; 2]; 3]>>) -> (Vec<Chart>, usize) {
        let mut ids = (0u32..).map(TriangleId);
        let charts: Vec<Chart> = corners_m
            .into_iter()
            .map(|corners_m| Chart {
                triangles: ids.by_ref().take(corners_m.len()).collect(),
                corners_m,
            })
            .collect();
        let num_triangles = charts.iter().map(|c| c.triangles.len()).sum();
        (charts, num_triangles)
    }

    /// A round chart of rings of triangles about `radius_m` wide, turned and out of round.
    fn round_chart(radius_m: f64, num_rings: usize, phase: f64) -> Vec<[[f64; 2]; 3]> {
        let num_spokes = 12;
        let at = |ring: usize, spoke: usize| {
            let angle = phase + (spoke % num_spokes) as f64 / 12.0 * std::f64::consts::TAU;
            let wobble = 1.0 + 0.3 * (3.0 * angle + phase).sin();
            let radius = radius_m * ring as f64 / num_rings as f64 * wobble;
            [1.7 * radius * angle.cos(), radius * angle.sin()]
        };
        let mut corners = Vec::new();
        for ring in 0..num_rings {
            for spoke in 0..num_spokes {
                let (inner, outer) = (at(ring, spoke), at(ring + 1, spoke));
                let (inner_next, outer_next) = (at(ring, spoke + 1), at(ring + 1, spoke + 1));
                corners.push([inner, outer, outer_next]);
                if ring > 0 {
                    corners.push([inner, outer_next, inner_next]);
                }
            }
        }
        corners
    }

    /// Sizes as streaming charts have them: many small, some large.
    fn many_charts(num_charts: usize) -> (Vec<Chart>, usize) {
        charts(
            (0..num_charts)
                .map(|k| {
                    let radius_m = 0.03 + 0.5 / (1.0 + (k * 7919 % 97) as f64);
                    round_chart(radius_m, 1 + k % 5, k as f64)
                })
                .collect(),
        )
    }

    fn rects_intersect(a: &TexelRect, b: &TexelRect) -> bool {
        a.x < b.x + b.width && b.x < a.x + a.width && a.y < b.y + b.height && b.y < a.y + a.height
    }

    /// What every layout promises.
    fn check(charts: &[Chart], num_triangles: usize, layout: &AtlasLayout, params: &PackParams) {
        assert_eq!(num_shared_texels(layout), 0);
        for (index, a) in layout.charts.iter().enumerate() {
            assert!(a.page < layout.num_pages);
            assert!(a.rect.x + a.rect.width <= layout.page_size_texel[0]);
            assert!(a.rect.y + a.rect.height <= layout.page_size_texel[1]);
            for b in &layout.charts[..index] {
                assert!(a.page != b.page || !rects_intersect(&a.rect, &b.rect));
            }
        }
        let num_texels = u64::from(layout.page_size_texel[0])
            * u64::from(layout.page_size_texel[1])
            * u64::from(layout.num_pages);
        assert!(num_texels <= params.max_texels);
        let mut seen: Vec<TriangleId> = Vec::new();
        for (id, chart) in (0u32..).zip(&layout.charts) {
            for &triangle in &chart.triangles {
                assert_eq!(layout.chart_of_triangle[triangle.index()], ChartId(id));
                for corner in layout.corners_texel[triangle.index()] {
                    let low = [chart.rect.x, chart.rect.y];
                    let size = [chart.rect.width, chart.rect.height];
                    for axis in 0..2 {
                        let from_low = corner[axis] - low[axis] as f32;
                        assert!(from_low >= 2.0 && size[axis] as f32 - from_low >= 2.0);
                    }
                }
            }
            seen.extend(&chart.triangles);
        }
        seen.sort_unstable();
        assert!(
            seen.into_iter()
                .eq((0u32..).map(TriangleId).take(num_triangles))
        );
        assert_eq!(
            charts.iter().map(|c| c.triangles.len()).sum::<usize>(),
            num_triangles
        );
    }

    #[test]
    fn charts_keep_their_lengths_and_are_not_mirrored() {
        let (charts, num_triangles) = many_charts(40);
        let params = PackParams::default();
        let (layout, report) = pack(&charts, num_triangles, 200.0, &params).unwrap();
        check(&charts, num_triangles, &layout, &params);
        assert_eq!(report.num_degenerate_triangles, 0);
        for chart in &charts {
            for (triangle, corners_m) in chart.triangles.iter().zip(&chart.corners_m) {
                let texel = layout.corners_texel[triangle.index()].map(|c| c.map(f64::from));
                for k in 0..3 {
                    let length = |p: [f64; 2], q: [f64; 2]| (q[0] - p[0]).hypot(q[1] - p[1]);
                    let l = (k + 1) % 3;
                    let expected = 200.0 * length(corners_m[k], corners_m[l]);
                    assert!((length(texel[k], texel[l]) - expected).abs() < 2e-3);
                }
                let [a, b, c] = texel;
                let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
                assert!(area < 0.0, "counter-clockwise is clockwise with v down");
            }
        }
    }

    #[test]
    fn pages_are_well_filled_and_the_same_on_any_thread_count() {
        let (charts, num_triangles) = many_charts(1500);
        let params = PackParams {
            page_size_texel: 1024,
            ..PackParams::default()
        };
        let run = |num_threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(num_threads)
                .build();
            pool.unwrap()
                .install(|| pack(&charts, num_triangles, 300.0, &params).unwrap())
        };
        let (layout, report) = run(1);
        check(&charts, num_triangles, &layout, &params);
        assert!(layout.num_pages > 3);
        assert!(report.page_fill > 0.8, "{report:?}");
        assert!((layout, report) == run(4));
    }

    #[test]
    fn one_small_chart_gets_a_small_page() {
        let (charts, num_triangles) = charts(vec![vec![[[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]]]);
        let (layout, _) = pack(&charts, num_triangles, 100.0, &PackParams::default()).unwrap();
        assert_eq!((layout.page_size_texel, layout.num_pages), ([64, 64], 1));
        let (layout, _) = pack::<Chart>(&[], 0, 100.0, &PackParams::default()).unwrap();
        assert_eq!((layout.page_size_texel, layout.num_pages), ([64, 64], 1));
    }

    #[test]
    fn a_triangle_without_area_owns_one_texel() {
        let good = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let needle = [[0.0, 0.0], [1.0, 0.0], [0.5, 1e-9]];
        let wild = [[f64::NAN, 0.0], [1.0, 0.0], [0.0, f64::INFINITY]];
        let (charts, num_triangles) = charts(vec![
            vec![good, [[0.5; 2]; 3], needle],
            vec![wild],
            vec![[[3.0, 3.0], [4.0, 4.0], [5.0, 5.0]]],
        ]);
        let params = PackParams::default();
        let (layout, report) = pack(&charts, num_triangles, 50.0, &params).unwrap();
        check(&charts, num_triangles, &layout, &params);
        assert_eq!(report.num_degenerate_triangles, 4);
        for corners in &layout.corners_texel[1..] {
            let mut num_texels = 0;
            for_each_texel_within(corners, layout.page_size_texel, |_, _, _| num_texels += 1);
            assert_eq!(num_texels, 1);
        }
    }

    #[test]
    fn triangles_that_share_texels_are_placed_apart() {
        let (left, right) = (
            [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
            [[0.5, 0.0], [1.5, 0.0], [0.5, 1.0]],
        );
        let (charts, num_triangles) = charts(vec![vec![left, right, left]]);
        let params = PackParams::default();
        let (layout, report) = pack(&charts, num_triangles, 50.0, &params).unwrap();
        check(&charts, num_triangles, &layout, &params);
        assert_eq!((report.num_moved_triangles, layout.charts.len()), (2, 3));
    }

    #[test]
    fn a_chart_larger_than_a_page_is_drawn_smaller() {
        let (charts, num_triangles) = charts(vec![
            round_chart(10.0, 3, 0.0),
            round_chart(1e9, 2, 0.5),
            round_chart(0.5, 2, 1.0),
        ]);
        let params = PackParams {
            page_size_texel: 256,
            ..PackParams::default()
        };
        let (layout, report) = pack(&charts, num_triangles, 100.0, &params).unwrap();
        check(&charts, num_triangles, &layout, &params);
        assert_eq!(report.num_scaled_charts, 2);
        assert!(report.smallest_scale < 1e-6);
        assert!(layout.charts[0].rect.width > 240);
    }

    #[test]
    fn density_is_lowered_until_the_budget_holds() {
        let (charts, num_triangles) = many_charts(400);
        for max_texels in [1 << 14, 1 << 16, 1 << 18, 3 << 18] {
            let params = PackParams {
                page_size_texel: 512,
                max_texels,
                ..PackParams::default()
            };
            let too_much = pack(&charts, num_triangles, 2000.0, &params);
            assert!(matches!(too_much, Err(PackError::OverBudget { .. })));
            let density = texels_per_m_for_budget(&charts, 2000.0, &params).unwrap();
            let packed = pack(&charts, num_triangles, density, &params);
            if max_texels == 1 << 14 {
                // 400 gutters alone take more.
                assert!(packed.is_err());
            } else {
                let (layout, report) = packed.unwrap();
                check(&charts, num_triangles, &layout, &params);
                assert!(report.page_fill > 0.8, "{max_texels}: {report:?}");
            }
        }
        let roomy = texels_per_m_for_budget(&charts, 10.0, &PackParams::default());
        assert_eq!(roomy, Ok(10.0));
    }

    #[test]
    fn wrong_input_is_named() {
        let (mut charts, num_triangles) = many_charts(2);
        let params = PackParams::default();
        let error = |charts: &[Chart], n, density, params: &PackParams| {
            pack(charts, n, density, params).unwrap_err().to_string()
        };
        let odd_page = PackParams {
            page_size_texel: 1000,
            ..params
        };
        let thin_gutter = PackParams {
            gutter_texel: 1,
            ..params
        };
        for (message, part) in [
            (error(&charts, num_triangles, f64::NAN, &params), "NaN"),
            (error(&charts, num_triangles, 1.0, &odd_page), "1000"),
            (
                error(&charts, num_triangles, 1.0, &thin_gutter),
                "gutter of 1",
            ),
            (
                error(&charts, num_triangles - 1, 1.0, &params),
                "in 1 charts",
            ),
            (
                error(&charts, num_triangles + 1, 1.0, &params),
                "in 0 charts",
            ),
        ] {
            assert!(message.contains(part), "{message}");
        }
        charts[1].triangles[0] = TriangleId(0);
        assert!(error(&charts, num_triangles, 1.0, &params).contains("in 2 charts"));
        charts[1].triangles.pop();
        assert!(error(&charts, num_triangles, 1.0, &params).contains("corners for"));
    }

    /// Fans of triangles around a point, with spokes down to nothing and angles down to needles:
    /// no overlap before rounding, all sorts of it after.
    fn fan() -> impl Strategy<Value = Vec<[[f64; 2]; 3]>> {
        let spoke = (
            0.0..1.0f64,
            prop_oneof![0.0..0.05f64, 0.0..1.0f64, 0.0..0.002f64],
        );
        proptest::collection::vec(spoke, 3..40).prop_map(|mut spokes| {
            spokes.sort_by(|a, b| a.0.total_cmp(&b.0));
            let at = |(turn, radius): (f64, f64)| {
                let angle = turn * std::f64::consts::TAU;
                [radius * angle.cos(), radius * angle.sin()]
            };
            let pairs = spokes
                .windows(2)
                .filter(|pair| pair[1].0 - pair[0].0 < 0.49);
            pairs
                .map(|pair| [[0.0, 0.0], at(pair[0]), at(pair[1])])
                .collect()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]
        #[test]
        fn no_texel_is_shared_whatever_the_charts(
            fans in proptest::collection::vec(fan(), 0..8),
            texels_per_m in prop_oneof![0.01..5.0f64, 5.0..500.0f64],
            gutter_texel in 2u32..6,
        ) {
            let (charts, num_triangles) = charts(fans);
            let params = PackParams { page_size_texel: 512, gutter_texel, max_texels: 1 << 26 };
            let (layout, report) = pack(&charts, num_triangles, texels_per_m, &params).unwrap();
            check(&charts, num_triangles, &layout, &params);
            let mut num_owned_texels = 0;
            let mut num_without = 0;
            for corners in &layout.corners_texel {
                let before = num_owned_texels;
                for_each_texel_within(corners, layout.page_size_texel, |_, _, _| num_owned_texels += 1);
                num_without += usize::from(num_owned_texels == before);
            }
            prop_assert_eq!(report.num_owned_texels, num_owned_texels);
            prop_assert_eq!(report.num_subtexel_triangles, num_without);
        }
    }
}
