//! Footprints onto as few texels as they need: the [`PageAllocator`], fed from the largest to the
//! smallest.

use rayon::prelude::*;

use super::allocator::{PageAllocator, Slot};
use super::footprint::Footprint;
use crate::atlas::cells::QuarterTurn;

/// Sides of pages are multiples of this, which keeps the blocks of texture compression, the cells
/// and the first mipmaps whole; no viewer of today needs powers of two.
pub(super) const SIDE_STEP_TEXEL: u32 = 64;

/// What pages may be.
#[derive(Clone, Copy, Debug)]
pub(super) struct PageLimits {
    pub(super) cell_texel: u32,
    pub(super) max_side_texel: u32,
    pub(super) max_texels: u64,
}

impl PageLimits {
    fn allocator(&self, page_size_texel: [u32; 2], max_pages: u32) -> PageAllocator {
        PageAllocator::new(
            page_size_texel.map(|side| side / self.cell_texel),
            max_pages,
        )
    }
}

/// All footprints on pages of one size.
pub(super) struct Arrangement {
    allocator: PageAllocator,
    cell_texel: u32,
    /// In the order of the footprints.
    pub(super) slots: Vec<Slot>,
}

impl Arrangement {
    pub(super) fn num_pages(&self) -> u32 {
        self.allocator.num_pages().max(1)
    }

    /// Width, and the height that the fullest page needs.
    pub(super) fn page_size_texel(&self) -> [u32; 2] {
        let pages = 0..self.allocator.num_pages();
        let rows = pages.map(|page| self.allocator.used_rows(page)).max();
        let [width, _] = self.allocator.page_size_cells();
        [
            width * self.cell_texel,
            whole_steps(rows.unwrap_or(0) * self.cell_texel),
        ]
    }

    fn num_texels(&self) -> u64 {
        let [width, height] = self.page_size_texel().map(u64::from);
        width * height * u64::from(self.num_pages())
    }

    /// Places a footprint anew, as it stands; whether that was possible.
    pub(super) fn replace_upright(&mut self, index: usize, footprint: &Footprint) -> bool {
        self.allocator.remove(self.slots[index].id);
        let turns = [QuarterTurn::None];
        match self.allocator.insert_turned(&footprint.cells, &turns) {
            Some(slot) => self.slots[index] = slot,
            None => return false,
        }
        true
    }
}

fn whole_steps(texels: u32) -> u32 {
    texels
        .next_multiple_of(SIDE_STEP_TEXEL)
        .max(SIDE_STEP_TEXEL)
}

/// One page, nearly square, where that holds everything, else as few pages of full width as do, all
/// open from the start, so that they fill evenly and end at about one height;
/// nothing when `max_texels` do not hold it. Each footprint fits a page of full size.
pub(super) fn arrange(footprints: &[Footprint], limits: &PageLimits) -> Option<Arrangement> {
    let num_cells: usize = footprints.iter().map(|f| f.cells.num_cells()).sum();
    let area = num_cells as u64 * u64::from(limits.cell_texel).pow(2);
    if area > limits.max_texels {
        return None;
    }
    let order = from_the_largest(footprints);
    on_one_page(footprints, &order, area, limits)
        .or_else(|| on_pages_of_full_width(footprints, &order, area, limits))
}

pub(super) fn from_the_largest(footprints: &[Footprint]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..footprints.len()).collect();
    let num_cells: Vec<usize> = footprints.iter().map(|f| f.cells.num_cells()).collect();
    order.sort_by_key(|&k| (std::cmp::Reverse(num_cells[k]), k));
    order
}

/// Share of a page that footprints usually fill.
const USUAL_FILL: f64 = 0.95;

fn on_one_page(
    footprints: &[Footprint],
    order: &[usize],
    area: u64,
    limits: &PageLimits,
) -> Option<Arrangement> {
    let max_side = limits.max_side_texel;
    if area > u64::from(max_side).pow(2) {
        return None;
    }
    let on_width = |width: u32| {
        let max_height = u32::try_from(limits.max_texels / u64::from(width)).unwrap_or(u32::MAX);
        let height = max_side.min(max_height) / SIDE_STEP_TEXEL * SIDE_STEP_TEXEL;
        let allocator = limits.allocator([width, height], 1);
        place_all(footprints, order, allocator, limits)
    };
    let tries: Vec<Option<Arrangement>> = widths_to_try(footprints, area, limits)
        .into_par_iter()
        .map(on_width)
        .collect();
    // The first of equals.
    tries
        .into_iter()
        .flatten()
        .min_by_key(Arrangement::num_texels)
}

/// Widths around that of a square, and, while there are few footprints, those that suit the
/// longest of them.
fn widths_to_try(footprints: &[Footprint], area: u64, limits: &PageLimits) -> Vec<u32> {
    /// Footprints placed in all, roughly: each takes some hundred microseconds.
    const EFFORT: usize = 6000;
    let max_width = limits.max_side_texel;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the root of an area of at most a page"
    )]
    let square = whole_steps((area as f64 / USUAL_FILL).sqrt() as u32).min(max_width);
    let mut widths = vec![square];
    let longest_of = |pick: fn(u32, u32) -> u32| {
        let sides = footprints.iter().map(|f| f.cells.size());
        let longest = sides.map(|[width, height]| pick(width, height)).max();
        whole_steps(longest.unwrap_or(0) * limits.cell_texel)
    };
    widths.extend([longest_of(u32::max), longest_of(u32::min)]);
    widths.extend((1..=6).flat_map(|k| {
        let by = k * SIDE_STEP_TEXEL;
        [square.saturating_sub(by), square + by]
    }));
    widths.retain(|width| (SIDE_STEP_TEXEL..=max_width).contains(width));
    let mut is_first = std::collections::BTreeSet::new();
    widths.retain(|width| is_first.insert(*width));
    widths.truncate((EFFORT / footprints.len().max(1)).max(1));
    widths
}

fn on_pages_of_full_width(
    footprints: &[Footprint],
    order: &[usize],
    area: u64,
    limits: &PageLimits,
) -> Option<Arrangement> {
    let width = limits.max_side_texel;
    let full_page = u64::from(width).pow(2);
    let fewest = u32::try_from(area.div_ceil(full_page)).ok()?.max(1);
    let evenly = (fewest..fewest + 2).find_map(|num_pages| {
        let row_of_pages = u64::from(width) * u64::from(num_pages);
        let max_height = u32::try_from(limits.max_texels / row_of_pages).unwrap_or(u32::MAX);
        let height = width.min(max_height) / SIDE_STEP_TEXEL * SIDE_STEP_TEXEL;
        if row_of_pages * u64::from(height) < area {
            return None;
        }
        let mut allocator = limits.allocator([width, height], num_pages);
        while allocator.open_page() {}
        place_all(footprints, order, allocator, limits)
    });
    // Charts nearly as large as a page leave much of it empty, however small their area.
    evenly.or_else(|| {
        let max_pages = u32::try_from(limits.max_texels / full_page).unwrap_or(u32::MAX);
        let allocator = limits.allocator([width; 2], max_pages);
        place_all(footprints, order, allocator, limits)
    })
}

fn place_all(
    footprints: &[Footprint],
    order: &[usize],
    mut allocator: PageAllocator,
    limits: &PageLimits,
) -> Option<Arrangement> {
    let mut slots: Vec<Option<Slot>> = vec![None; footprints.len()];
    for &index in order {
        slots[index] = Some(allocator.insert(&footprints[index].cells)?);
    }
    Some(Arrangement {
        allocator,
        cell_texel: limits.cell_texel,
        slots: slots.into_iter().flatten().collect(),
    })
}
