//! Charts that come and go: placed on pages and taken off again, without moving the others.
//!
//! Charts are drawn at one density, and placed as [`super::pack()`] does it: shaped on the texel
//! grid, from the largest to the smallest, each where [`PageAllocator`] finds it room. All pages have
//! the full size. What goes leaves holes; [`ChartPlacer::compact`] moves what is on the emptiest page
//! into the holes of others and closes the page. A chart moves by whole cells and is not turned, so
//! that it owns the same texels as before, elsewhere.

use super::allocator::{PageAllocator, SlotId};
use super::arrange::from_the_largest;
use super::{LaidPiece, PackError, PackParams, PlaneChart, QuarterTurn, Shapes};
use super::{check_corners, check_params, frames, shape, turned};
use crate::atlas::layout::PlacedChart;

/// A chart on its page, or a part of one that had to be placed apart.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedPiece {
    /// Its name.
    pub slot: SlotId,
    /// Where it lies; its triangles are named as in the chart placed.
    pub chart: PlacedChart,
    /// Per triangle of the chart: its corners on the page, texels.
    pub corners_texel: Vec<[[f32; 2]; 3]>,
}

/// What [`ChartPlacer::compact`] did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Compaction {
    /// The page that was closed.
    pub closed_page: u32,
    /// The page that took its number; the closed one itself where that was the last.
    pub renumbered_page: u32,
    /// Which of the pieces lie elsewhere on another page, as indices, ascending.
    pub moved: Vec<usize>,
}

/// Pages and the charts on them.
#[derive(Clone, Debug)]
pub struct ChartPlacer {
    params: PackParams,
    texels_per_m: f64,
    allocator: PageAllocator,
}

impl ChartPlacer {
    /// No charts, to be drawn at `texels_per_m`.
    ///
    /// # Errors
    /// [`PackError`] for a parameter out of range.
    pub fn new(texels_per_m: f64, params: &PackParams) -> Result<Self, PackError> {
        check_params(texels_per_m, params)?;
        Ok(Self {
            params: *params,
            texels_per_m,
            allocator: PageAllocator::for_budget(
                [params.page_size_texel; 2],
                params.cell_texel(),
                params.max_texels,
            ),
        })
    }

    /// Texels per metre of the charts that fit a page.
    pub fn texels_per_m(&self) -> f64 {
        self.texels_per_m
    }

    /// Pages open.
    pub fn num_pages(&self) -> u32 {
        self.allocator.num_pages()
    }

    /// Width and height of each page in texels.
    pub fn page_size_texel(&self) -> [u32; 2] {
        [self.params.page_size_texel; 2]
    }

    /// Share of the open pages' cells that charts hold; 1 without a page.
    pub fn used_share(&self) -> f64 {
        let num_cells: u64 = self
            .allocator
            .page_size_cells()
            .map(u64::from)
            .iter()
            .product();
        let num_cells = num_cells * u64::from(self.num_pages());
        let num_free = self.allocator.num_free_cells() as u64;
        if num_cells == 0 {
            1.0
        } else {
            (num_cells - num_free) as f64 / num_cells as f64
        }
    }

    /// Places all charts, or none where they do not fit the budget.
    ///
    /// # Errors
    /// [`PackError`] for charts whose lists disagree or that have no room.
    pub fn place<C: PlaneChart>(&mut self, charts: &[C]) -> Result<Vec<PlacedPiece>, PackError> {
        check_corners(charts)?;
        let shapes = Shapes::at(charts, &frames(charts), self.texels_per_m, &self.params);
        let mut placed: Vec<Option<PlacedPiece>> = shapes.pieces.iter().map(|_| None).collect();
        for index in from_the_largest(&shapes.footprints) {
            let Some(piece) = self.place_piece(&shapes, index) else {
                for piece in placed.into_iter().flatten() {
                    self.remove(piece.slot);
                }
                return Err(shapes.over_budget(self.texels_per_m, &self.params));
            };
            placed[index] = Some(piece);
        }
        Ok(placed.into_iter().flatten().collect())
    }

    fn place_piece(&mut self, shapes: &Shapes, index: usize) -> Option<PlacedPiece> {
        let (piece, footprint) = (&shapes.pieces[index], &shapes.footprints[index]);
        let cell_texel = self.params.cell_texel();
        let mut slot = self.allocator.insert(&footprint.cells)?;
        if slot.turn != QuarterTurn::None {
            // A turn may put a texel's centre on an edge that rounding gives to two triangles.
            let frame_texel = footprint.cells.size().map(|n| n * cell_texel);
            let corners = turned(piece, footprint.start_texel, frame_texel, slot.turn);
            if shape::claim_all(&corners, slot.turn.size(frame_texel)).is_none() {
                self.allocator.remove(slot.id);
                let upright = [QuarterTurn::None];
                slot = self.allocator.insert_turned(&footprint.cells, &upright)?;
            }
        }
        let laid = LaidPiece::in_slot(piece, footprint, &slot, cell_texel);
        Some(PlacedPiece {
            slot: slot.id,
            corners_texel: laid.corners_texel().collect(),
            chart: laid.into_chart(),
        })
    }

    /// Takes a piece off its page.
    pub fn remove(&mut self, slot: SlotId) {
        self.allocator.remove(slot);
    }

    /// Empties the page on which the fewest cells are held, by moving its pieces into the holes of
    /// other pages, and closes it. `pieces` are all there are. Nothing, and nothing changed, where
    /// there is one page only or the others have no room.
    pub fn compact(&mut self, pieces: &mut [&mut PlacedPiece]) -> Option<Compaction> {
        let page = self.emptiest_page().filter(|_| self.num_pages() > 1)?;
        let mut on_page: Vec<usize> = (0..pieces.len())
            .filter(|&k| pieces[k].chart.page == page)
            .collect();
        on_page.sort_by_key(|&k| (std::cmp::Reverse(pieces[k].chart.cells.num_cells()), k));
        let mut moves = Vec::with_capacity(on_page.len());
        for index in on_page {
            match self.allocator.insert_off(&pieces[index].chart.cells, page) {
                Some(slot) => moves.push((index, slot)),
                None => {
                    for (_, slot) in moves {
                        self.allocator.remove(slot.id);
                    }
                    return None;
                }
            }
        }
        for (index, slot) in &moves {
            self.allocator.remove(pieces[*index].slot);
            let corner_texel = slot.cell.map(|cell| cell * self.params.cell_texel());
            pieces[*index].move_to(slot.id, slot.page, corner_texel);
        }
        let renumbered_page = self.num_pages() - 1;
        self.allocator.close_page(page);
        for piece in pieces.iter_mut() {
            if piece.chart.page == renumbered_page {
                piece.chart.page = page;
            }
        }
        let mut moved: Vec<usize> = moves.into_iter().map(|(index, _)| index).collect();
        moved.sort_unstable();
        Some(Compaction {
            closed_page: page,
            renumbered_page,
            moved,
        })
    }

    fn emptiest_page(&self) -> Option<u32> {
        (0..self.num_pages()).min_by_key(|&page| self.allocator.num_held_cells(page))
    }
}

impl PlacedPiece {
    /// Moves by whole texels.
    fn move_to(&mut self, slot: SlotId, page: u32, [x, y]: [u32; 2]) {
        let rect = &mut self.chart.rect;
        // Whole texels below 2¹⁴ and their differences are exact.
        let by = [x as f32 - rect.x as f32, y as f32 - rect.y as f32];
        (rect.x, rect.y) = (x, y);
        for corner in self.corners_texel.iter_mut().flatten() {
            for axis in 0..2 {
                corner[axis] += by[axis];
            }
        }
        self.slot = slot;
        self.chart.page = page;
    }
}

#[cfg(test)]
mod tests;
