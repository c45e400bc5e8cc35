//! Shapes of cells onto pages, one by one, without moving what lies there.
//!
//! A page is a grid of cells, each free or held by one shape. A shape is put where its lower edge
//! is highest on the page, over all open pages and four turns; of equals on the first page, in the
//! first turn, in the highest row, farthest left. A page is opened when no open one has room. What
//! is taken out leaves its cells free and nothing else changed. Everything is determined by the
//! order of operations.
//!
//! Speed: for each row of a page and each power of two 2ᵏ, one bit per cell says whether any of
//! the 2ᵏ cells from there on is held. A stretch of a shape's row is then tested against all
//! columns of a page's row by two shifted reads of these words. Most rows of a page need no such
//! test: a second set of bits says the same for squares of some sides, and a row is passed over
//! where its longest free stretch, or the longest stretch of beginnings of free squares, is shorter
//! than that of the shape.

use std::collections::BTreeMap;

use super::super::cells::{CellMask, QuarterTurn, next_bit};

/// Names a shape on the pages; never given twice by one allocator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SlotId(u64);

/// Where a shape lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// Its name.
    pub id: SlotId,
    /// Which page.
    pub page: u32,
    /// Column and row of the upper left cell of the turned shape's rectangle.
    pub cell: [u32; 2],
    /// How the shape was turned.
    pub turn: QuarterTurn,
}

/// Pages of one size and the shapes on them.
#[derive(Clone, Debug)]
pub struct PageAllocator {
    size_cells: [u32; 2],
    max_pages: u32,
    pages: Vec<Page>,
    next_id: u64,
    held: BTreeMap<SlotId, (Slot, CellMask)>,
}

impl PageAllocator {
    /// No pages yet; up to `max_pages` of `size_cells` = (columns, rows).
    pub fn new(size_cells: [u32; 2], max_pages: u32) -> Self {
        Self {
            size_cells,
            max_pages,
            pages: Vec::new(),
            next_id: 0,
            held: BTreeMap::new(),
        }
    }

    /// As many pages of `page_size_texel` as `max_texels` allow, in cells of `cell_texel` a side.
    pub fn for_budget(page_size_texel: [u32; 2], cell_texel: u32, max_texels: u64) -> Self {
        let num_texels = page_size_texel.map(u64::from).iter().product::<u64>();
        let max_pages = max_texels.checked_div(num_texels).unwrap_or(0);
        Self::new(
            page_size_texel.map(|side| side / cell_texel.max(1)),
            u32::try_from(max_pages).unwrap_or(u32::MAX),
        )
    }

    /// Opens a page, unless all are open.
    pub fn open_page(&mut self) -> bool {
        let may_open = self.num_pages() < self.max_pages;
        if may_open {
            self.pages.push(Page::new(self.size_cells));
        }
        may_open
    }

    /// Columns and rows of each page.
    pub const fn page_size_cells(&self) -> [u32; 2] {
        self.size_cells
    }

    /// Pages open.
    pub fn num_pages(&self) -> u32 {
        u32::try_from(self.pages.len()).unwrap_or(u32::MAX)
    }

    /// Shapes on the pages.
    pub fn num_slots(&self) -> usize {
        self.held.len()
    }

    /// Where a shape lies.
    pub fn slot(&self, id: SlotId) -> Option<Slot> {
        self.held.get(&id).map(|(slot, _)| *slot)
    }

    /// Cells of the open pages that no shape holds.
    pub fn num_free_cells(&self) -> usize {
        self.pages.iter().map(Page::num_free_cells).sum()
    }

    /// Rows of a page down to the last that holds a shape.
    pub fn used_rows(&self, page: u32) -> u32 {
        self.pages.get(page as usize).map_or(0, Page::used_rows)
    }

    /// Puts a shape on a page; nothing, and nothing changed, when it has room nowhere.
    pub fn insert(&mut self, shape: &CellMask) -> Option<Slot> {
        self.insert_turned(shape, &QuarterTurn::ALL)
    }

    /// [`Self::insert`] in one of the given turns.
    pub fn insert_turned(&mut self, shape: &CellMask, turns: &[QuarterTurn]) -> Option<Slot> {
        self.insert_where(shape, turns, |_| true, true)
    }

    /// [`Self::insert`] as the shape stands, on an open page other than `page`.
    pub fn insert_off(&mut self, shape: &CellMask, page: u32) -> Option<Slot> {
        self.insert_where(shape, &[QuarterTurn::None], |other| other != page, false)
    }

    fn insert_where(
        &mut self,
        shape: &CellMask,
        turns: &[QuarterTurn],
        may_use: impl Fn(u32) -> bool,
        may_open: bool,
    ) -> Option<Slot> {
        if shape.num_cells() == 0 {
            return None;
        }
        let turned: Vec<TurnedShape> = turns
            .iter()
            .map(|&turn| TurnedShape::new(shape, turn))
            .collect();
        let mut best = None;
        for (page_index, page) in (0u32..).zip(&self.pages) {
            if may_use(page_index) {
                best = best_fit(page, page_index, &turned, best);
            }
        }
        if best.is_none() {
            if !may_open || self.num_pages() >= self.max_pages {
                return None;
            }
            let page = Page::new(self.size_cells);
            best = Some(best_fit(&page, self.num_pages(), &turned, None)?);
            self.pages.push(page);
        }
        let fit = best?;
        let TurnedShape { mask, turn, .. } = turned.into_iter().nth(fit.shape)?;
        let slot = Slot {
            id: SlotId(self.next_id),
            page: fit.page,
            cell: fit.cell,
            turn,
        };
        self.next_id += 1;
        self.pages[fit.page as usize].change(&mask, fit.cell, |held, cells| held | cells);
        self.held.insert(slot.id, (slot, mask));
        Some(slot)
    }

    /// Takes a shape off its page; nothing when there is none of that name.
    pub fn remove(&mut self, id: SlotId) -> Option<Slot> {
        let (slot, mask) = self.held.remove(&id)?;
        self.pages[slot.page as usize].change(&mask, slot.cell, |held, cells| held & !cells);
        Some(slot)
    }

    /// Closes a page without shapes; the last page takes its number. Whether that was done: not where
    /// there is no such page or it holds a shape.
    pub fn close_page(&mut self, page: u32) -> bool {
        let is_held = self.held.values().any(|(slot, _)| slot.page == page);
        if is_held || page >= self.num_pages() {
            return false;
        }
        self.pages.swap_remove(page as usize);
        let last = self.num_pages();
        for (slot, _) in self.held.values_mut() {
            if slot.page == last {
                slot.page = page;
            }
        }
        true
    }

    /// Cells of a page that a shape holds.
    pub fn num_held_cells(&self, page: u32) -> usize {
        let num_cells = self.size_cells[0] as usize * self.size_cells[1] as usize;
        let page = self.pages.get(page as usize);
        page.map_or(0, |page| num_cells - page.num_free_cells())
    }

    /// Share of the free cells of the open pages that no free square of `side_cells` reaches: 0 when
    /// all free room can take shapes of that size, 1 when none of it can.
    pub fn fragmentation(&self, side_cells: u32) -> f64 {
        let num_free = self.num_free_cells();
        if num_free == 0 {
            return 0.0;
        }
        let num_reached: usize = self
            .pages
            .iter()
            .map(|page| page.num_cells_in_free_squares(side_cells.max(1)))
            .sum();
        (num_free - num_reached) as f64 / num_free as f64
    }
}

/// A stretch of a row of a shape.
struct Run {
    row: usize,
    first: u32,
    len: u32,
    /// The largest power of two of cells, as its exponent, that the stretch holds.
    level: usize,
}

/// A shape in one turn.
struct TurnedShape {
    mask: CellMask,
    turn: QuarterTurn,
    /// The longest first, the others in an order in which neighbours are far apart: what one row
    /// leaves open the next one would too.
    runs: Vec<Run>,
    bars: Vec<Bar>,
}

impl TurnedShape {
    fn new(shape: &CellMask, turn: QuarterTurn) -> Self {
        let mask = shape.turned(turn);
        let mut runs: Vec<Run> = mask
            .runs()
            .map(|(row, first, len)| Run {
                row: row as usize,
                first,
                len,
                level: len.ilog2() as usize,
            })
            .collect();
        let longest = (0..runs.len()).max_by_key(|&k| (runs[k].len, std::cmp::Reverse(k)));
        if let Some(longest) = longest {
            runs.swap(0, longest);
            let num_bits = usize::BITS - (mask.size()[1] as usize).leading_zeros();
            let shuffled = |row: usize| row.reverse_bits() >> (usize::BITS - num_bits);
            runs[1..].sort_by_key(|run| (shuffled(run.row), run.first));
        }
        Self {
            bars: widest_bars(&mask),
            mask,
            turn,
            runs,
        }
    }
}

/// Sides of the squares that are looked for; each at most twice the one before.
const SQUARE_SIDES: [u32; 10] = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32];

/// A rectangle as high as `SQUARE_SIDES[side]` and at least as wide.
struct Bar {
    side: usize,
    x: u32,
    y: u32,
    len: u32,
}

impl Bar {
    /// How many squares begin in it.
    fn num_squares(&self) -> u32 {
        self.len + 1 - SQUARE_SIDES[self.side]
    }

    fn num_cells(&self) -> u32 {
        self.len * SQUARE_SIDES[self.side]
    }
}

/// The widest bar in the set of each height in [`SQUARE_SIDES`] but the first; the first in the
/// list has the most cells, the others follow from the highest to the lowest.
fn widest_bars(mask: &CellMask) -> Vec<Bar> {
    let num_words = mask.row(0).len();
    let mut num_rows = mask.size()[1];
    // Bits where a square of the current side begins.
    let mut begins: Vec<u64> = (0..num_rows).flat_map(|y| mask.row(y)).copied().collect();
    let mut bars = Vec::new();
    for (side, sides) in (1..).zip(SQUARE_SIDES.windows(2)) {
        let by = sides[1] - sides[0];
        num_rows = num_rows.saturating_sub(by);
        let end = num_rows as usize * num_words;
        for at in 0..end {
            let is_last = (at + 1) % num_words == 0;
            let lower = at + by as usize * num_words;
            let next = if is_last {
                0
            } else {
                begins[at + 1] & begins[lower + 1]
            };
            let both = begins[at] & begins[lower];
            begins[at] = both & (both >> by | next << (64 - by));
        }
        begins.truncate(end);
        let rows = (0u32..).zip(begins.chunks_exact(num_words));
        let longest_of_rows = rows.map(|(y, row)| (longest_run(row, true), y));
        match longest_of_rows.max_by_key(|((len, _), y)| (*len, std::cmp::Reverse(*y))) {
            Some(((num_squares, x), y)) if num_squares > 0 => bars.push(Bar {
                side,
                x,
                y,
                len: num_squares + sides[1] - 1,
            }),
            _ => break,
        }
    }
    bars.reverse();
    if let Some(largest) = (0..bars.len()).max_by_key(|&k| (bars[k].num_cells(), k)) {
        bars[..=largest].rotate_right(1);
    }
    bars
}

/// The longest stretch of bits that are set (or not), the first of equals: length and first bit.
/// Bits past the last word are as if of the other kind.
fn longest_run(row: &[u64], is_set: bool) -> (u32, u32) {
    let past_end = u32::try_from(64 * row.len()).unwrap_or(u32::MAX);
    let mut longest = (0, 0);
    let mut x = 0;
    while let Some(first) = next_bit(row, x, is_set) {
        x = next_bit(row, first, !is_set).unwrap_or(past_end);
        if x - first > longest.0 {
            longest = (x - first, first);
        }
    }
    longest
}

#[derive(Clone, Copy)]
struct Fit {
    /// The row below the shape's rectangle.
    bottom: u32,
    page: u32,
    /// Which of the turned shapes.
    shape: usize,
    cell: [u32; 2],
}

fn best_fit(
    page: &Page,
    page_index: u32,
    shapes: &[TurnedShape],
    best: Option<Fit>,
) -> Option<Fit> {
    let mut best = best;
    for (index, shape) in shapes.iter().enumerate() {
        // Only better ones.
        let max_bottom = best.map_or(page.size[1], |fit| fit.bottom - 1);
        if let Some(cell) = page.highest_fit(shape, max_bottom) {
            best = Some(Fit {
                bottom: cell[1] + shape.mask.size()[1],
                page: page_index,
                shape: index,
                cell,
            });
        }
    }
    best
}

/// One page.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Page {
    size: [u32; 2],
    /// Words to a row: one more than the cells take, with all bits set.
    stride: usize,
    /// `levels[k]` has, row by row, one bit per cell: whether any of the 2ᵏ cells from there on is
    /// held or past the right border.
    levels: Vec<Vec<u64>>,
    /// Per row: its longest free stretch.
    longest_free: Vec<u32>,
    /// `squares[k]` has, row by row, one bit per cell: whether a square of `SQUARE_SIDES[k + 1]` that
    /// begins there has a held cell or leaves the page.
    squares: Vec<Vec<u64>>,
    /// `longest_bar[k]` has for each row its longest stretch of bits in `squares[k]` that are not set.
    longest_bar: Vec<Vec<u32>>,
    /// The longest of `longest_free`, and of each of `longest_bar`: most pages are passed over for these.
    longest_of_page: (u32, Vec<u32>),
}

impl Page {
    fn new(size: [u32; 2]) -> Self {
        let [width, height] = size;
        let stride = (width as usize).div_ceil(64) + 1;
        let mut row = vec![u64::MAX; stride];
        for x in 0..width {
            row[x as usize / 64] &= !(1 << (x % 64));
        }
        let num_levels = width.max(1).ilog2() as usize + 1;
        let mut page = Self {
            size,
            stride,
            levels: vec![row.repeat(height as usize); num_levels],
            longest_free: vec![width; height as usize],
            squares: vec![vec![u64::MAX; stride * height as usize]; SQUARE_SIDES.len() - 1],
            longest_bar: vec![vec![0; height as usize]; SQUARE_SIDES.len() - 1],
            longest_of_page: (0, Vec::new()),
        };
        for y in 0..height as usize {
            page.refresh_row(y);
        }
        page.refresh_squares(0, height as usize);
        page.refresh_longest();
        page
    }

    fn row(&self, level: usize, y: usize) -> &[u64] {
        &self.levels[level][y * self.stride..(y + 1) * self.stride]
    }

    /// What follows from which cells of a row are held.
    fn refresh_row(&mut self, y: usize) {
        let range = y * self.stride..(y + 1) * self.stride;
        for level in 1..self.levels.len() {
            let (lower, upper) = self.levels.split_at_mut(level);
            let half = &lower[level - 1][range.clone()];
            let by = 1u32 << (level - 1);
            for (index, word) in upper[0][range.clone()].iter_mut().enumerate() {
                *word = half[index] | shifted_word(half, index, by, u64::MAX);
            }
        }
        self.longest_free[y] = longest_run(&self.levels[0][range], false).0;
    }

    /// What follows for squares from the cells of rows `first..end` that changed.
    fn refresh_squares(&mut self, first: usize, end: usize) {
        let (stride, num_rows) = (self.stride, self.size[1] as usize);
        for (index, sides) in SQUARE_SIDES.windows(2).enumerate() {
            let (by, side) = (sides[1] - sides[0], sides[1] as usize);
            let (smaller, larger) = self.squares.split_at_mut(index);
            let smaller = smaller.last().unwrap_or(&self.levels[0]);
            for y in (first + 1).saturating_sub(side)..end.min((num_rows + 1).saturating_sub(side))
            {
                let upper = &smaller[y * stride..(y + 1) * stride];
                let lower_y = y + by as usize;
                let lower = &smaller[lower_y * stride..(lower_y + 1) * stride];
                let row = &mut larger[0][y * stride..(y + 1) * stride];
                for (k, word) in row[..stride - 1].iter_mut().enumerate() {
                    let here = upper[k] | lower[k];
                    let next = upper[k + 1] | lower[k + 1];
                    *word = here | here >> by | next << (64 - by);
                }
                self.longest_bar[index][y] = longest_run(row, false).0;
            }
        }
    }

    /// What follows for the page from its rows.
    fn refresh_longest(&mut self) {
        let longest = |of_rows: &Vec<u32>| of_rows.iter().copied().max().unwrap_or(0);
        let bars = self.longest_bar.iter().map(longest).collect();
        self.longest_of_page = (longest(&self.longest_free), bars);
    }

    /// Whether some row has a free stretch, and some each of the bars, as long as a shape's.
    fn may_hold(&self, shape: &TurnedShape) -> bool {
        let (longest_free, longest_bar) = &self.longest_of_page;
        let longest = shape.runs.first().map_or(0, |run| run.len);
        let mut bars = shape.bars.iter();
        longest <= *longest_free && bars.all(|bar| bar.num_squares() <= longest_bar[bar.side - 1])
    }

    /// The highest, then leftmost place of a shape whose rectangle ends by row `max_bottom`.
    fn highest_fit(&self, shape: &TurnedShape, max_bottom: u32) -> Option<[u32; 2]> {
        if !self.may_hold(shape) {
            return None;
        }
        let [width, height] = shape.mask.size();
        let last_row = self.size[1].min(max_bottom).checked_sub(height)?;
        let last_column = self.size[0].checked_sub(width)?;
        let num_words = last_column as usize / 64 + 1;
        let past_last = u64::MAX.checked_shl(last_column % 64 + 1).unwrap_or(0);
        let longest = shape.runs.first()?;
        let mut is_blocked = vec![0u64; num_words];
        // Words with columns that are not blocked.
        let mut open_words: Vec<usize> = Vec::with_capacity(num_words);
        for y in 0..=last_row {
            let row_of = |row: usize| y as usize + row;
            let has_bar = |bar: &Bar| {
                self.longest_bar[bar.side - 1][row_of(bar.y as usize)] >= bar.num_squares()
            };
            if self.longest_free[row_of(longest.row)] < longest.len
                || !shape.bars.iter().all(has_bar)
            {
                continue;
            }
            is_blocked.fill(0);
            is_blocked[num_words - 1] = past_last;
            if let Some(bar) = shape.bars.first() {
                let start = row_of(bar.y as usize) * self.stride;
                let row = &self.squares[bar.side - 1][start..start + self.stride];
                let last = bar.num_squares() - 1;
                for by in (0..last)
                    .step_by(SQUARE_SIDES[bar.side] as usize)
                    .chain([last])
                {
                    block(&mut is_blocked, row, bar.x + by);
                }
            }
            open_words.clear();
            open_words.extend((0..num_words).filter(|&k| is_blocked[k] != u64::MAX));
            for run in &shape.runs {
                let row = self.row(run.level, row_of(run.row));
                let second = run.first + run.len - (1 << run.level);
                open_words.retain(|&k| {
                    is_blocked[k] |= word_at(row, k, run.first) | word_at(row, k, second);
                    is_blocked[k] != u64::MAX
                });
                if open_words.is_empty() {
                    break;
                }
            }
            if !open_words.is_empty() {
                return next_bit(&is_blocked, 0, false).map(|x| [x, y]);
            }
        }
        None
    }

    fn change(&mut self, mask: &CellMask, cell: [u32; 2], how: fn(u64, u64) -> u64) {
        let [_, height] = mask.size();
        let (first_word, shift) = (cell[0] as usize / 64, cell[0] % 64);
        for row in 0..height {
            let y = (cell[1] + row) as usize;
            let words = &mut self.levels[0][y * self.stride + first_word..(y + 1) * self.stride];
            for (index, &cells) in mask.row(row).iter().enumerate() {
                words[index] = how(words[index], cells << shift);
                if shift > 0 && cells >> (64 - shift) != 0 {
                    words[index + 1] = how(words[index + 1], cells >> (64 - shift));
                }
            }
            self.refresh_row(y);
        }
        self.refresh_squares(cell[1] as usize, (cell[1] + height) as usize);
        self.refresh_longest();
    }

    fn num_free_cells(&self) -> usize {
        self.levels[0]
            .iter()
            .map(|w| w.count_zeros() as usize)
            .sum()
    }

    fn used_rows(&self) -> u32 {
        let is_used = |free: &u32| *free < self.size[0];
        let last = self.longest_free.iter().rposition(is_used);
        last.and_then(|y| u32::try_from(y + 1).ok()).unwrap_or(0)
    }

    /// Morphological opening by a square: shrinks the free cells to the upper left cells of free
    /// squares and grows them again.
    fn num_cells_in_free_squares(&self, side: u32) -> usize {
        if self.size.iter().any(|extent| *extent < side) {
            return 0;
        }
        let level = side.ilog2() as usize;
        let num_rows = self.size[1] as usize;
        let is_blocked_across: Vec<Vec<u64>> = (0..num_rows)
            .map(|y| {
                let mut row = vec![0; self.stride - 1];
                block(&mut row, self.row(level, y), 0);
                block_past_end(&mut row, self.row(level, y), side - (1 << level));
                row
            })
            .collect();
        let mut reached = vec![vec![0u64; self.stride - 1]; num_rows];
        for rows in 0..=num_rows - side as usize {
            let mut corner = vec![0u64; self.stride - 1];
            for row in &is_blocked_across[rows..rows + side as usize] {
                for (corner, blocked) in corner.iter_mut().zip(row) {
                    *corner |= blocked;
                }
            }
            let spread = spread_right(&corner, side);
            for row in &mut reached[rows..rows + side as usize] {
                for (reached, spread) in row.iter_mut().zip(&spread) {
                    *reached |= spread;
                }
            }
        }
        let words = reached.iter().flatten();
        words.map(|word| word.count_ones() as usize).sum()
    }
}

/// Word `index` of a row moved left by `by` cells; `past_end` is what comes in from the right.
fn shifted_word(row: &[u64], index: usize, by: u32, past_end: u64) -> u64 {
    let (words, bits) = (by as usize / 64, by % 64);
    let word = |k: usize| row.get(k).copied().unwrap_or(past_end);
    let low = word(index + words) >> bits;
    if bits == 0 {
        low
    } else {
        low | word(index + words + 1) << (64 - bits)
    }
}

/// Word `index` of a row moved left by `by` cells; the row reaches far enough.
fn word_at(row: &[u64], index: usize, by: u32) -> u64 {
    let (first, bits) = (index + by as usize / 64, by % 64);
    row[first] >> bits | row[first + 1] << 1 << (63 - bits)
}

/// Adds a row moved left by `by` cells to the blocked columns; the row reaches far enough.
fn block(is_blocked: &mut [u64], row: &[u64], by: u32) {
    let (words, bits) = (by as usize / 64, by % 64);
    let from = &row[words..];
    if bits == 0 {
        for (blocked, word) in is_blocked.iter_mut().zip(from) {
            *blocked |= word;
        }
    } else {
        let next = &from[1..];
        for ((blocked, low), high) in is_blocked.iter_mut().zip(from).zip(next) {
            *blocked |= low >> bits | high << (64 - bits);
        }
    }
}

fn block_past_end(is_blocked: &mut [u64], row: &[u64], by: u32) {
    for (index, blocked) in is_blocked.iter_mut().enumerate() {
        *blocked |= shifted_word(row, index, by, u64::MAX);
    }
}

/// Cells within `side` to the right of the unblocked ones, those included.
fn spread_right(is_blocked: &[u64], side: u32) -> Vec<u64> {
    let mut spread: Vec<u64> = is_blocked.iter().map(|word| !word).collect();
    let mut reach = 1;
    while reach < side {
        let by = reach.min(side - reach);
        let (words, bits) = (by as usize / 64, by % 64);
        for index in (0..spread.len()).rev() {
            let word = |back: usize| {
                let from = index.checked_sub(back);
                from.map_or(0, |k| spread[k])
            };
            let low = word(words) << bits;
            let high = if bits == 0 {
                0
            } else {
                word(words + 1) >> (64 - bits)
            };
            spread[index] |= low | high;
        }
        reach += by;
    }
    spread
}

#[cfg(test)]
mod tests;
