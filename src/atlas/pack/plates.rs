//! Charts onto square plates of given size, as the published program of the paper does it (method,
//! 1.3): from the smallest to the largest, 500 to a plate, each plate scaled by itself to fill its
//! square, their rectangles side by side without a gap.
//!
//! Density therefore differs from plate to plate, and bilinear lookup at the border of a chart mixes
//! with its neighbour. How the program places rectangles within the square is not reproduced: they
//! go from the largest to the smallest into guillotiere's free lists.

use guillotiere::{AtlasAllocator, Size};
use rayon::prelude::*;

use super::shape::{self, ChartFrame, Piece};
use super::{PackError, PackParams, PlaneChart};
use crate::atlas::layout::TexelRect;

/// Connected pieces to a plate.
const CHARTS_PER_PLATE: usize = 500;

/// Smallest plate that a budget may ask for.
const MIN_PLATE_TEXEL: u32 = 64;

/// A piece and its rectangle; `page` is its plate.
pub(super) struct OnPlate {
    pub(super) piece: Piece,
    pub(super) page: u32,
    pub(super) rect: TexelRect,
}

/// All plates.
pub(super) struct Plates {
    pub(super) side_texel: u32,
    pub(super) num_plates: u32,
    /// In the order of the charts, each followed by what could not stay in it.
    pub(super) pieces: Vec<OnPlate>,
    pub(super) num_moved_triangles: usize,
}

/// Fills plates of `side_texel`, halved until all plates keep to the budget.
pub(super) fn fill_plates<C: PlaneChart>(
    charts: &[C],
    frames: &[ChartFrame],
    side_texel: u32,
    params: &PackParams,
) -> Result<Plates, PackError> {
    let mut order: Vec<usize> = (0..charts.len()).collect();
    order.sort_by(|&a, &b| {
        frames[a]
            .area_m2
            .total_cmp(&frames[b].area_m2)
            .then(a.cmp(&b))
    });
    let num_plates = charts.len().div_ceil(CHARTS_PER_PLATE).max(1);
    let mut side_texel = side_texel;
    let num_texels = |side: u32| num_plates as u64 * u64::from(side).pow(2);
    while num_texels(side_texel) > params.max_texels {
        side_texel /= 2;
        if side_texel < MIN_PLATE_TEXEL {
            return Err(PackError::PlatesOverBudget {
                num_plates,
                max_texels: params.max_texels,
            });
        }
    }
    let plates: Vec<Plate> = order
        .par_chunks(CHARTS_PER_PLATE)
        .map(|members| Plate::fill(charts, frames, members, side_texel))
        .collect::<Option<_>>()
        .ok_or(PackError::PlateTooSmall { side_texel })?;
    let num_moved_triangles = plates.iter().map(|plate| plate.num_moved_triangles).sum();
    let mut pieces: Vec<(usize, OnPlate)> = Vec::new();
    for (page, plate) in (0u32..).zip(plates) {
        let on_plate = plate
            .pieces
            .into_iter()
            .map(|(chart, piece, rect)| (chart, OnPlate { piece, page, rect }));
        pieces.extend(on_plate);
    }
    pieces.sort_by_key(|(chart, _)| *chart);
    Ok(Plates {
        side_texel,
        num_plates: u32::try_from(num_plates).unwrap_or(u32::MAX),
        pieces: pieces.into_iter().map(|(_, piece)| piece).collect(),
        num_moved_triangles,
    })
}

struct Plate {
    /// With the index of the chart.
    pieces: Vec<(usize, Piece, TexelRect)>,
    num_moved_triangles: usize,
}

impl Plate {
    /// At the largest density found; nothing when there are more pieces than texels.
    fn fill<C: PlaneChart>(
        charts: &[C],
        frames: &[ChartFrame],
        members: &[usize],
        side_texel: u32,
    ) -> Option<Self> {
        /// What is lost where rounding and pieces set apart need more room than was foreseen.
        const STEP: f64 = 0.98;
        const MAX_STEPS: usize = 400;
        let extents_m: Vec<[f64; 2]> = members.iter().map(|&k| frames[k].extent_m).collect();
        let mut texels_per_m = largest_density(&extents_m, side_texel);
        for _ in 0..MAX_STEPS {
            let plate = Self::at_density(charts, frames, members, side_texel, texels_per_m);
            if plate.is_some() {
                return plate;
            }
            texels_per_m *= STEP;
        }
        None
    }

    fn at_density<C: PlaneChart>(
        charts: &[C],
        frames: &[ChartFrame],
        members: &[usize],
        side_texel: u32,
        texels_per_m: f64,
    ) -> Option<Self> {
        let mut num_moved_triangles = 0;
        let mut pieces = Vec::new();
        for &chart in members {
            // One texel less: a start within the first texel may need another one.
            let room_texel = side_texel - 1;
            let shaped = shape::shape(&charts[chart], &frames[chart], texels_per_m, room_texel);
            num_moved_triangles += shaped.num_moved_triangles;
            pieces.extend(shaped.pieces.into_iter().map(|piece| (chart, piece)));
        }
        let sizes: Vec<[u32; 2]> = pieces.iter().map(|(_, piece)| piece.size_texel).collect();
        let rects = place(&sizes, side_texel)?;
        let with_rect = pieces.into_iter().zip(rects);
        Some(Self {
            pieces: with_rect
                .map(|((chart, piece), rect)| (chart, piece, rect))
                .collect(),
            num_moved_triangles,
        })
    }
}

/// Texels per metre at which rectangles of these sides still fit, within a percent.
fn largest_density(extents_m: &[[f64; 2]], side_texel: u32) -> f64 {
    const MAX_HALVINGS: usize = 1000;
    const BISECTIONS: usize = 7;
    let longest_m = extents_m.iter().flatten().copied().fold(0.0, f64::max);
    if longest_m <= 0.0 {
        return 1.0;
    }
    let fits = |texels_per_m: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates, and is then too large for the plate"
        )]
        let side = |m: f64| ((m * texels_per_m).ceil() as u32).max(1);
        let sizes: Vec<[u32; 2]> = extents_m.iter().map(|extent| extent.map(side)).collect();
        place(&sizes, side_texel).is_some()
    };
    let mut high = f64::from(side_texel) / longest_m;
    let mut low = high;
    for _ in 0..MAX_HALVINGS {
        if fits(low) {
            break;
        }
        high = low;
        low *= 0.5;
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if fits(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// Rectangles side by side in a square, from the largest perimeter to the smallest.
fn place(sizes: &[[u32; 2]], side_texel: u32) -> Option<Vec<TexelRect>> {
    let area: u64 = sizes
        .iter()
        .map(|s| u64::from(s[0]) * u64::from(s[1]))
        .sum();
    if area > u64::from(side_texel).pow(2) {
        return None;
    }
    let as_size = |[width, height]: [u32; 2]| {
        let side = |v: u32| i32::try_from(v).unwrap_or(i32::MAX);
        Size::new(side(width), side(height))
    };
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    let perimeter = |k: usize| u64::from(sizes[k][0]) + u64::from(sizes[k][1]);
    order.sort_by_key(|&k| (std::cmp::Reverse((perimeter(k), sizes[k])), k));
    let mut allocator = AtlasAllocator::new(as_size([side_texel; 2]));
    let mut rects: Vec<Option<TexelRect>> = vec![None; sizes.len()];
    for k in order {
        let corner = allocator.allocate(as_size(sizes[k]))?.rectangle.min;
        rects[k] = Some(TexelRect {
            x: u32::try_from(corner.x).ok()?,
            y: u32::try_from(corner.y).ok()?,
            width: sizes[k][0],
            height: sizes[k][1],
        });
    }
    rects.into_iter().collect()
}
