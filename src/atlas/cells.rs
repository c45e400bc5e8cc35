//! Sets of cells: which squares of whole texels a chart owns.

/// A turn of the page's plane, clockwise as seen with y down. Charts are turned, never mirrored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum QuarterTurn {
    /// As it was.
    None,
    /// (x, y) goes to (height − y, x).
    Right,
    /// Upside down.
    Half,
    /// (x, y) goes to (y, width − x).
    Left,
}

impl QuarterTurn {
    /// All of them, in the order in which places are tried.
    pub const ALL: [Self; 4] = [Self::None, Self::Right, Self::Half, Self::Left];

    /// Width and height after the turn.
    pub const fn size<T: Copy>(self, [width, height]: [T; 2]) -> [T; 2] {
        match self {
            Self::None | Self::Half => [width, height],
            Self::Right | Self::Left => [height, width],
        }
    }

    /// Where a point of a rectangle of `size` (before the turn) comes to lie.
    pub fn point<T>(self, [x, y]: [T; 2], [width, height]: [T; 2]) -> [T; 2]
    where
        T: Copy + std::ops::Sub<Output = T>,
    {
        match self {
            Self::None => [x, y],
            Self::Right => [height - y, x],
            Self::Half => [width - x, height - y],
            Self::Left => [y, width - x],
        }
    }
}

/// Some of the cells of a rectangle, row-major from the top left: one bit each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellMask {
    size: [u32; 2],
    words_per_row: usize,
    words: Vec<u64>,
}

impl CellMask {
    /// None of `size` = (columns, rows).
    pub fn empty(size: [u32; 2]) -> Self {
        let words_per_row = (size[0] as usize).div_ceil(64);
        Self {
            size,
            words_per_row,
            words: vec![0; words_per_row * size[1] as usize],
        }
    }

    /// All of `size` = (columns, rows).
    pub fn full(size: [u32; 2]) -> Self {
        let mut mask = Self::empty(size);
        for y in 0..size[1] {
            for x in 0..size[0] {
                mask.insert(x, y);
            }
        }
        mask
    }

    /// Columns and rows.
    pub const fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Adds a cell; one outside changes nothing.
    pub fn insert(&mut self, x: u32, y: u32) {
        if x < self.size[0] && y < self.size[1] {
            let word = y as usize * self.words_per_row + x as usize / 64;
            self.words[word] |= 1 << (x % 64);
        }
    }

    /// Whether the cell is in the set.
    pub fn contains(&self, x: u32, y: u32) -> bool {
        x < self.size[0]
            && y < self.size[1]
            && self.words[y as usize * self.words_per_row + x as usize / 64] >> (x % 64) & 1 == 1
    }

    /// How many cells are in the set.
    pub fn num_cells(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// Cells of one row, the leftmost in the lowest bit of the first word; bits past the width are 0.
    pub(crate) fn row(&self, y: u32) -> &[u64] {
        let start = y as usize * self.words_per_row;
        &self.words[start..start + self.words_per_row]
    }

    pub(crate) fn row_mut(&mut self, y: u32) -> &mut [u64] {
        let start = y as usize * self.words_per_row;
        &mut self.words[start..start + self.words_per_row]
    }

    /// The cells after a turn of the whole rectangle.
    pub fn turned(&self, turn: QuarterTurn) -> Self {
        if turn == QuarterTurn::None {
            return self.clone();
        }
        let mut turned = Self::empty(turn.size(self.size));
        let last = self.size.map(|side| side.wrapping_sub(1));
        for (y, first, len) in self.runs() {
            for x in first..first + len {
                let [x, y] = turn.point([x, y], last);
                turned.insert(x, y);
            }
        }
        turned
    }

    /// Stretches of neighbouring cells, row by row: (row, first column, columns).
    pub fn runs(&self) -> impl Iterator<Item = (u32, u32, u32)> + '_ {
        (0..self.size[1]).flat_map(move |y| {
            let row = self.row(y);
            let mut x = 0;
            std::iter::from_fn(move || {
                let first = next_bit(row, x, true)?;
                let end = next_bit(row, first, false).unwrap_or(self.size[0]);
                x = end;
                Some((y, first, end - first))
            })
        })
    }
}

/// The first bit from `from` on that is set (or is not), as a column.
pub(crate) fn next_bit(row: &[u64], from: u32, is_set: bool) -> Option<u32> {
    let wanted = |word: u64| if is_set { word } else { !word };
    let first = from as usize / 64;
    let mut word = wanted(*row.get(first)?) & (u64::MAX << (from % 64));
    let mut index = first;
    while word == 0 {
        index += 1;
        word = wanted(*row.get(index)?);
    }
    u32::try_from(index * 64)
        .ok()
        .map(|base| base + word.trailing_zeros())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn cells(mask: &CellMask) -> Vec<[u32; 2]> {
        let [width, height] = mask.size();
        (0..height)
            .flat_map(|y| (0..width).map(move |x| [x, y]))
            .filter(|&[x, y]| mask.contains(x, y))
            .collect()
    }

    proptest! {
        #[test]
        fn runs_and_turns_hold_the_cells(
            size in [1u32..140, 1u32..20],
            picks in proptest::collection::vec([0u32..140, 0u32..20], 0..300),
        ) {
            let mut mask = CellMask::empty(size);
            for [x, y] in picks {
                mask.insert(x, y);
            }
            let in_runs: Vec<[u32; 2]> = mask
                .runs()
                .flat_map(|(y, first, len)| (first..first + len).map(move |x| [x, y]))
                .collect();
            prop_assert_eq!(&in_runs, &cells(&mask));
            prop_assert_eq!(mask.num_cells(), in_runs.len());
            // The upper left corner of the page goes to the upper right by a turn to the right.
            let right = mask.turned(QuarterTurn::Right);
            for [x, y] in cells(&mask) {
                prop_assert!(right.contains(size[1] - 1 - y, x));
            }
            prop_assert_eq!(&right.turned(QuarterTurn::Right), &mask.turned(QuarterTurn::Half));
            prop_assert_eq!(&right.turned(QuarterTurn::Half), &mask.turned(QuarterTurn::Left));
            prop_assert_eq!(&right.turned(QuarterTurn::Left), &mask);
        }
    }

    #[test]
    fn the_full_mask_has_every_cell() {
        let full = CellMask::full([70, 3]);
        assert_eq!(full.num_cells(), 210);
        assert_eq!(
            full.runs().collect::<Vec<_>>(),
            [(0, 0, 70), (1, 0, 70), (2, 0, 70)]
        );
        assert!(!full.contains(70, 0) && !full.contains(0, 3));
    }
}
