//! Charts onto the pages of the atlas, at one density.
//!
//! Each chart is turned so that the smallest rectangle around it is upright; scaled by
//! `texels_per_m`; flipped (charts are y up, pages v down, so they are not mirrored); and put on the
//! grid of [`super::texels`]. Its footprint is the set of cells, aligned to the page, that have a
//! texel within the gutter of one that a triangle touches. Footprints are placed by
//! [`allocator::PageAllocator`] from the largest to the smallest, in one of four turns, so that no two share
//! a cell; small charts lie in the holes and bays of large ones. A chart larger than a page is drawn
//! smaller. All is deterministic.
//!
//! With a gutter of 2ᵏ⁻¹ texels a cell is 2ᵏ texels wide, and a bilinear lookup anywhere in a
//! triangle reads cells of its chart only, in the page itself and its box-filtered mipmaps 1 to k
//! alike. From level k + 1 on charts mix. Triangles with a texel of their own, which have no area to
//! speak of, have a cell of their own and nothing around it: at level k a lookup in one mixes.
//!
//! No two triangles own one texel ([`super::num_shared_texels`]): cells are disjoint, and
//! within each chart every claim is checked after rounding, as the chart lies on the page. Where
//! rounding makes triangles of a
//! chart share a texel, the chart starts elsewhere within its first texel, and if that does not
//! help, the later triangle is placed apart. A triangle of no area on the grid, or of
//! a chart so small that it owns no texel, gets one texel of its own, around whose centre its
//! corners are put, so that colour transfer paints it like any other. Other thin or small triangles may
//! own no texel; they are drawn from their neighbours'. Every chart of the layout owns one.
//!
//! [`pack_plates`] is the paper's form: square plates, each with a density of its own.

pub mod allocator;
mod arrange;
mod bounding_rect;
mod density;
mod footprint;
pub mod placer;
mod plates;
mod shape;

use rayon::prelude::*;

use super::cells::{CellMask, QuarterTurn};
use super::layout::{AtlasLayout, ChartId, PlacedChart, TexelRect};
use super::texels::{MAX_PAGE_TEXEL, SUBTEXELS, SubtexelPoint};
use crate::mesh::TriangleId;
use arrange::{Arrangement, PageLimits};
use footprint::Footprint;
use shape::{ChartFrame, Claims, Piece, ShapedChart};

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
    /// Texels around each chart that are its own, 1 to 8, rounded up to whole cells. A gutter of 1, 2,
    /// 4 or 8 keeps charts apart in the mipmaps up to level 1, 2, 3 or 4.
    pub gutter_texel: u32,
    /// Texels of all pages together, at most. A texel takes 8 bytes while it is painted.
    pub max_texels: u64,
}

impl PackParams {
    /// Side of the cells that charts own.
    pub const fn cell_texel(&self) -> u32 {
        footprint::cell_texel(self.gutter_texel)
    }

    /// Longest chart that fits a page wherever it starts in its first cell: one texel less, as a
    /// start within the first texel may need another one.
    const fn room_texel(&self) -> u32 {
        self.page_size_texel - 2 * self.gutter_texel - self.cell_texel()
    }
}

impl Default for PackParams {
    fn default() -> Self {
        Self {
            page_size_texel: 4096,
            gutter_texel: 2,
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
    #[error("gutter of {gutter_texel} texels is not in 1..=8")]
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
    /// Even the smallest plates would be too large together.
    #[error("{num_plates} plates do not fit into {max_texels} texels")]
    PlatesOverBudget {
        /// How many plates there are.
        num_plates: usize,
        /// [`PackParams::max_texels`].
        max_texels: u64,
    },
    /// A plate has more triangles to set apart than texels.
    #[error("a plate of {side_texel} texels a side does not hold its charts at any density")]
    PlateTooSmall {
        /// Width and height of the plate.
        side_texel: u32,
    },
}

/// How the packing went.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PackReport {
    /// Charts on the pages, those set apart included.
    pub num_charts: usize,
    /// Side of the cells that charts own.
    pub cell_texel: u32,
    /// Share of the pages' texels that triangles own.
    pub covered_share: f64,
    /// Share of the pages' texels that charts own: those of triangles, the gutter, and what
    /// rounding it to whole cells adds. No other chart may use them.
    pub footprint_share: f64,
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
/// the charts do not fit into the budget (see [`pack_to_budget`]).
pub fn pack<C: PlaneChart>(
    charts: &[C],
    num_triangles: usize,
    texels_per_m: f64,
    params: &PackParams,
) -> Result<(AtlasLayout, PackReport), PackError> {
    check_params(texels_per_m, params)?;
    check_charts(charts, num_triangles)?;
    let frames = frames(charts);
    let shapes = Shapes::at(charts, &frames, texels_per_m, params);
    match shapes.arrange(params) {
        Some(arranged) => Ok(arranged.lay_out(&frames, num_triangles, texels_per_m, params)),
        None => Err(shapes.over_budget(texels_per_m, params)),
    }
}

/// [`pack`] at the density wanted, or at the largest one found below it that keeps to the budget:
/// within some percent of the largest there is. The layout says which.
///
/// # Errors
/// As [`pack`]; [`PackError::OverBudget`] when even the gutters do not fit.
pub fn pack_to_budget<C: PlaneChart>(
    charts: &[C],
    num_triangles: usize,
    wanted_texels_per_m: f64,
    params: &PackParams,
) -> Result<(AtlasLayout, PackReport), PackError> {
    /// Where pages turn out fuller than they can be; each step gives 6 % of the area.
    const STEP: f64 = 0.97;
    const MAX_STEPS: usize = 6;
    const MAX_HALVINGS: i32 = 200;
    check_params(wanted_texels_per_m, params)?;
    check_charts(charts, num_triangles)?;
    let frames = frames(charts);
    let mut texels_per_m = density::first_guess(&frames, wanted_texels_per_m, params);
    let mut shapes = Shapes::at(charts, &frames, texels_per_m, params);
    for _ in 0..density::MAX_CORRECTIONS {
        let num_texels = shapes.num_texels(params);
        let corrected = density::corrected(
            &frames,
            wanted_texels_per_m,
            texels_per_m,
            num_texels,
            params,
        );
        let Some(corrected) = corrected else {
            break;
        };
        texels_per_m = corrected;
        shapes = Shapes::at(charts, &frames, texels_per_m, params);
    }
    for _ in 0..MAX_STEPS {
        if let Some(arranged) = shapes.arrange(params) {
            return Ok(arranged.lay_out(&frames, num_triangles, texels_per_m, params));
        }
        texels_per_m *= STEP;
        shapes = Shapes::at(charts, &frames, texels_per_m, params);
    }
    // Charts that are drawn smaller to fit a page take the same room until the density has fallen
    // by as much: a mesh in the wrong unit.
    let least = texels_per_m * 0.5_f64.powi(MAX_HALVINGS);
    let can_fit = Shapes::at(charts, &frames, least, params)
        .arrange(params)
        .is_some();
    for _ in 0..if can_fit { MAX_HALVINGS } else { 0 } {
        if let Some(arranged) = shapes.arrange(params) {
            return Ok(arranged.lay_out(&frames, num_triangles, texels_per_m, params));
        }
        texels_per_m *= 0.5;
        shapes = Shapes::at(charts, &frames, texels_per_m, params);
    }
    Err(shapes.over_budget(texels_per_m, params))
}

/// The paper's form: plates of `side_texel` (halved until they keep to `max_texels`, the only one of
/// `params` that counts), 500 charts to a plate from the smallest to the largest, each plate scaled
/// by itself to fill its square, no gutter. Each plate is a page.
///
/// # Errors
/// As [`pack`], and [`PackError`] when not even plates of 64² keep to the budget.
pub fn pack_plates<C: PlaneChart>(
    charts: &[C],
    num_triangles: usize,
    side_texel: u32,
    params: &PackParams,
) -> Result<(AtlasLayout, PackReport), PackError> {
    check_page_size(side_texel)?;
    check_charts(charts, num_triangles)?;
    let frames = frames(charts);
    let plates = plates::fill_plates(charts, &frames, side_texel, params)?;
    let pages = Pages {
        size_texel: [plates.side_texel; 2],
        num_pages: plates.num_plates,
        cell_texel: 1,
    };
    let laid: Vec<LaidPiece<'_>> = plates
        .pieces
        .par_iter()
        .map(|on_plate| LaidPiece::in_rect(&on_plate.piece, on_plate.page, on_plate.rect))
        .collect();
    let (mut layout, mut report) = lay_out(laid, &pages, num_triangles, 0.0);
    let in_plane_m2: f64 = frames.iter().map(|frame| frame.area_m2).sum();
    if in_plane_m2 > 0.0 {
        layout.texels_per_m = (report.num_owned_texels as f64 / in_plane_m2).sqrt();
    }
    report.num_moved_triangles = plates.num_moved_triangles;
    Ok((layout, report))
}

fn check_params(texels_per_m: f64, params: &PackParams) -> Result<(), PackError> {
    check_page_size(params.page_size_texel)?;
    if !(1..=8).contains(&params.gutter_texel) {
        return Err(PackError::Gutter {
            gutter_texel: params.gutter_texel,
        });
    }
    if !texels_per_m.is_finite() || texels_per_m <= 0.0 {
        return Err(PackError::Density { texels_per_m });
    }
    Ok(())
}

fn check_page_size(page_size_texel: u32) -> Result<(), PackError> {
    if !page_size_texel.is_power_of_two() || !(64..=MAX_PAGE_TEXEL).contains(&page_size_texel) {
        return Err(PackError::PageSize { page_size_texel });
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

/// All charts at one density: their pieces and the cells that these need.
struct Shapes {
    pieces: Vec<Piece>,
    footprints: Vec<Footprint>,
    num_moved_triangles: usize,
}

impl Shapes {
    fn at<C: PlaneChart>(
        charts: &[C],
        frames: &[ChartFrame],
        texels_per_m: f64,
        params: &PackParams,
    ) -> Self {
        let room_texel = params.room_texel();
        let shaped: Vec<ShapedChart> = charts
            .par_iter()
            .zip(frames)
            .map(|(chart, frame)| shape::shape(chart, frame, texels_per_m, room_texel))
            .collect();
        let num_moved_triangles = shaped.iter().map(|s| s.num_moved_triangles).sum();
        let pieces: Vec<Piece> = shaped.into_iter().flat_map(|s| s.pieces).collect();
        let footprints = pieces
            .par_iter()
            .map(|piece| {
                if piece.is_own_texel {
                    footprint::single_cell(params.cell_texel())
                } else {
                    footprint::footprint(&piece.corners, piece.size_texel, params.gutter_texel)
                }
            })
            .collect();
        Self {
            pieces,
            footprints,
            num_moved_triangles,
        }
    }

    fn num_texels(&self, params: &PackParams) -> f64 {
        let num_cells: usize = self.footprints.iter().map(|f| f.cells.num_cells()).sum();
        num_cells as f64 * f64::from(params.cell_texel()).powi(2)
    }

    fn over_budget(&self, texels_per_m: f64, params: &PackParams) -> PackError {
        PackError::OverBudget {
            num_charts: self.pieces.len(),
            texels_per_m,
            max_texels: params.max_texels,
        }
    }

    /// Places all; nothing when the budget does not hold them. What a turn makes two triangles
    /// claim, because a texel's centre lies on an edge, is placed anew without a turn.
    fn arrange(&self, params: &PackParams) -> Option<Arranged<'_>> {
        let limits = PageLimits {
            cell_texel: params.cell_texel(),
            max_side_texel: params.page_size_texel,
            max_texels: params.max_texels,
        };
        let mut arrangement = arrange::arrange(&self.footprints, &limits)?;
        let turns: Vec<QuarterTurn> = arrangement.slots.iter().map(|slot| slot.turn).collect();
        let claims_if_kept: Vec<Option<Claims>> = self
            .pieces
            .par_iter()
            .zip(&self.footprints)
            .zip(turns)
            .map(|((piece, footprint), turn)| {
                if turn == QuarterTurn::None {
                    return Some(piece.claims);
                }
                let frame_texel = footprint.cells.size().map(|n| n * limits.cell_texel);
                let corners = turned(piece, footprint.start_texel, frame_texel, turn);
                shape::claim_all(&corners, turn.size(frame_texel))
            })
            .collect();
        let mut claims = Vec::with_capacity(self.pieces.len());
        for (index, kept) in claims_if_kept.into_iter().enumerate() {
            if kept.is_none() && !arrangement.replace_upright(index, &self.footprints[index]) {
                return None;
            }
            claims.push(kept.unwrap_or(self.pieces[index].claims));
        }
        let [width, height] = arrangement.page_size_texel().map(u64::from);
        let num_texels = width * height * u64::from(arrangement.num_pages());
        (num_texels <= params.max_texels).then_some(Arranged {
            shapes: self,
            arrangement,
            claims,
        })
    }
}

struct Arranged<'a> {
    shapes: &'a Shapes,
    arrangement: Arrangement,
    /// What each piece owns as it lies.
    claims: Vec<Claims>,
}

impl Arranged<'_> {
    fn lay_out(
        &self,
        frames: &[ChartFrame],
        num_triangles: usize,
        texels_per_m: f64,
        params: &PackParams,
    ) -> (AtlasLayout, PackReport) {
        let pages = Pages {
            size_texel: self.arrangement.page_size_texel(),
            num_pages: self.arrangement.num_pages(),
            cell_texel: params.cell_texel(),
        };
        let laid: Vec<LaidPiece<'_>> = (0..self.shapes.pieces.len())
            .into_par_iter()
            .map(|index| {
                let footprint = &self.shapes.footprints[index];
                let slot = &self.arrangement.slots[index];
                let piece = &self.shapes.pieces[index];
                LaidPiece {
                    claims: self.claims[index],
                    ..LaidPiece::in_slot(piece, footprint, slot, pages.cell_texel)
                }
            })
            .collect();
        let (layout, mut report) = lay_out(laid, &pages, num_triangles, texels_per_m);
        let scales = frames
            .iter()
            .map(|f| f.scale(texels_per_m, params.room_texel()));
        report.num_scaled_charts = scales.clone().filter(|scale| *scale < 1.0).count();
        report.smallest_scale = scales.fold(1.0, f64::min);
        report.num_moved_triangles = self.shapes.num_moved_triangles;
        (layout, report)
    }
}

/// Corners within the turned rectangle of a piece's cells, which is `frame_texel` before the turn.
fn turned(
    piece: &Piece,
    start_texel: [u32; 2],
    frame_texel: [u32; 2],
    turn: QuarterTurn,
) -> Vec<[SubtexelPoint; 3]> {
    let subtexels = |texels: u32| i64::from(texels) * i64::from(SUBTEXELS);
    let start = start_texel.map(subtexels);
    let frame = frame_texel.map(subtexels);
    let place = |[x, y]: SubtexelPoint| turn.point([x + start[0], y + start[1]], frame);
    piece
        .corners
        .iter()
        .map(|corners| corners.map(place))
        .collect()
}

struct Pages {
    size_texel: [u32; 2],
    num_pages: u32,
    cell_texel: u32,
}

/// A piece where it lies on its page.
struct LaidPiece<'a> {
    piece: &'a Piece,
    page: u32,
    rect: TexelRect,
    cells: CellMask,
    /// Within the rectangle.
    corners: Vec<[SubtexelPoint; 3]>,
    claims: Claims,
}

impl<'a> LaidPiece<'a> {
    fn in_slot(
        piece: &'a Piece,
        footprint: &Footprint,
        slot: &allocator::Slot,
        cell_texel: u32,
    ) -> Self {
        let frame_texel = footprint.cells.size().map(|side| side * cell_texel);
        let corners = turned(piece, footprint.start_texel, frame_texel, slot.turn);
        let [width, height] = slot.turn.size(frame_texel);
        Self {
            piece,
            page: slot.page,
            rect: TexelRect {
                x: slot.cell[0] * cell_texel,
                y: slot.cell[1] * cell_texel,
                width,
                height,
            },
            cells: footprint.cells.turned(slot.turn),
            claims: piece.claims,
            corners,
        }
    }

    fn in_rect(piece: &'a Piece, page: u32, rect: TexelRect) -> Self {
        Self {
            piece,
            page,
            rect,
            cells: CellMask::full([1, 1]),
            claims: piece.claims,
            corners: piece.corners.clone(),
        }
    }
}

impl LaidPiece<'_> {
    /// Per triangle: its corners on the page.
    fn corners_texel(&self) -> impl Iterator<Item = [[f32; 2]; 3]> {
        let origin = [self.rect.x, self.rect.y].map(i64::from);
        let on_page = move |corner: SubtexelPoint| {
            std::array::from_fn(|axis| {
                let subtexels = origin[axis] * i64::from(SUBTEXELS) + corner[axis];
                // At most 24 bits: exact.
                subtexels as f32 / SUBTEXELS as f32
            })
        };
        self.corners.iter().map(move |corners| corners.map(on_page))
    }

    fn into_chart(self) -> PlacedChart {
        PlacedChart {
            page: self.page,
            rect: self.rect,
            cells: self.cells,
            texels_per_m: self.piece.texels_per_m,
            triangles: self.piece.triangles.clone(),
        }
    }
}

/// The layout, and the part of the report that can be read off it.
fn lay_out(
    laid: Vec<LaidPiece<'_>>,
    pages: &Pages,
    num_triangles: usize,
    texels_per_m: f64,
) -> (AtlasLayout, PackReport) {
    let mut chart_of_triangle = vec![ChartId(0); num_triangles];
    let mut corners_texel = vec![[[0.0; 2]; 3]; num_triangles];
    let mut charts = Vec::with_capacity(laid.len());
    let mut report = PackReport {
        num_charts: laid.len(),
        cell_texel: pages.cell_texel,
        covered_share: 0.0,
        footprint_share: 0.0,
        num_owned_texels: 0,
        num_scaled_charts: 0,
        smallest_scale: 1.0,
        num_own_texel_triangles: 0,
        num_subtexel_triangles: 0,
        num_moved_triangles: 0,
    };
    let mut num_in_charts = 0;
    for (id, laid) in (0u32..).zip(laid) {
        for (triangle, corners) in laid.piece.triangles.iter().zip(laid.corners_texel()) {
            chart_of_triangle[triangle.index()] = ChartId(id);
            corners_texel[triangle.index()] = corners;
        }
        report.num_owned_texels += laid.claims.num_owned_texels;
        report.num_subtexel_triangles += laid.claims.num_subtexel_triangles;
        report.num_own_texel_triangles += usize::from(laid.piece.is_own_texel);
        let chart = laid.into_chart();
        let [width, height] = chart.cell_size_texel();
        num_in_charts += chart.cells.num_cells() * (width * height) as usize;
        charts.push(chart);
    }
    let [width, height] = pages.size_texel.map(f64::from);
    let on_pages = width * height * f64::from(pages.num_pages);
    report.covered_share = report.num_owned_texels as f64 / on_pages;
    report.footprint_share = num_in_charts as f64 / on_pages;
    let layout = AtlasLayout {
        page_size_texel: pages.size_texel,
        num_pages: pages.num_pages,
        texels_per_m,
        charts,
        chart_of_triangle,
        corners_texel,
    };
    (layout, report)
}

#[cfg(test)]
mod tests;
