//! The cells that a piece must have for itself.
//!
//! A piece touches a texel when one of its triangles does, owner or not: a lookup may fall anywhere
//! in a triangle. Its footprint is every cell that has a texel within the gutter, across and down,
//! of a touched one. Cells are aligned to the page, so how many there are depends on where in its
//! first cell the piece starts; of all starts the one with the fewest cells is taken.

use crate::atlas::cells::CellMask;
use crate::atlas::texels::{SUBTEXELS, SubtexelPoint};

/// Cells of a piece, and where the piece lies in them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Footprint {
    pub(super) cells: CellMask,
    /// Texels from the upper left of the cells to the piece's own.
    pub(super) start_texel: [u32; 2],
}

/// Side of a cell for a gutter: the largest power of two up to twice the gutter. A lookup in mipmap
/// level k, whose texels are 2ᵏ a side, reads texels whose centres are less than 2ᵏ away and so
/// reach into cells of that side less than 2ᵏ⁻¹ away.
pub(super) const fn cell_texel(gutter_texel: u32) -> u32 {
    if gutter_texel == 0 {
        1
    } else {
        2 << gutter_texel.ilog2()
    }
}

/// The one cell of a triangle with a texel of its own.
pub(super) fn single_cell(cell_texel: u32) -> Footprint {
    Footprint {
        cells: CellMask::full([1, 1]),
        start_texel: [(cell_texel - 1) / 2; 2],
    }
}

/// The footprint of triangles that lie in the first `size_texel` texels.
pub(super) fn footprint(
    corners: &[[SubtexelPoint; 3]],
    size_texel: [u32; 2],
    gutter_texel: u32,
) -> Footprint {
    let cell = cell_texel(gutter_texel);
    // A blank cell's width around what is near lets every start shift into it.
    let margin = cell - 1;
    let border = gutter_texel + margin;
    let near = near_texels(corners, size_texel, gutter_texel, border);
    let [width, height] = near.size();
    let mut best: Option<(usize, [u32; 2])> = None;
    for first_row in 0..cell {
        let mut num_by_column = vec![0; cell as usize];
        let mut y = first_row;
        while y < height {
            let merged = merged_rows(&near, y, cell);
            let windows = or_of_following(merged, cell);
            for (first_column, num) in (0u32..).zip(num_by_column.iter_mut()) {
                *num += count_every(&windows, cell, first_column);
            }
            y += cell;
        }
        for (first_column, num) in (0u32..).zip(num_by_column) {
            if best.is_none_or(|(least, _)| num < least) {
                best = Some((num, [first_column, first_row]));
            }
        }
    }
    let (_, first) = best.unwrap_or_default();
    // Rows and columns before the first are blank; so may be some after it.
    let size = [width, height];
    let num_cells: [u32; 2] =
        std::array::from_fn(|axis| (size[axis] - first[axis]).div_ceil(cell).max(1));
    let mut cells = CellMask::empty(num_cells);
    for cell_row in 0..num_cells[1] {
        let windows = or_of_following(merged_rows(&near, first[1] + cell_row * cell, cell), cell);
        for cell_column in 0..num_cells[0] {
            let x = first[0] + cell_column * cell;
            if windows
                .get(x as usize / 64)
                .is_some_and(|w| w >> (x % 64) & 1 == 1)
            {
                cells.insert(cell_column, cell_row);
            }
        }
    }
    cropped(
        &cells,
        first.map(|f| i64::from(border) - i64::from(f)),
        cell,
    )
}

/// The cells without blank rows and columns around them. The piece starts `start` texels from the
/// upper left of what is given.
fn cropped(cells: &CellMask, start: [i64; 2], cell_texel: u32) -> Footprint {
    let mut low = cells.size();
    let mut high = [0; 2];
    for (y, first, len) in cells.runs() {
        low = [low[0].min(first), low[1].min(y)];
        high = [high[0].max(first + len), high[1].max(y + 1)];
    }
    let mut kept = CellMask::empty([0, 1].map(|axis| high[axis].saturating_sub(low[axis])));
    for (y, first, len) in cells.runs() {
        for x in first..first + len {
            kept.insert(x - low[0], y - low[1]);
        }
    }
    let start_texel = std::array::from_fn(|axis| {
        u32::try_from(start[axis] - i64::from(low[axis] * cell_texel)).unwrap_or(0)
    });
    Footprint {
        cells: kept,
        start_texel,
    }
}

/// Texels within the gutter of touched ones, `border` texels right and down of where they are.
fn near_texels(
    corners: &[[SubtexelPoint; 3]],
    size_texel: [u32; 2],
    gutter_texel: u32,
    border: u32,
) -> CellMask {
    let size = size_texel.map(|side| side + 2 * border);
    let mut across = CellMask::empty(size);
    for corners in corners {
        for_each_touched_span(corners, size_texel, |y, first, end| {
            let row = across.row_mut(y + border);
            set_bits(
                row,
                first + border - gutter_texel,
                end + border + gutter_texel,
            );
        });
    }
    let mut near = CellMask::empty(size);
    for y in 0..size[1] {
        let row = near.row_mut(y);
        for from in y.saturating_sub(gutter_texel)..=(y + gutter_texel).min(size[1] - 1) {
            for (near, touched) in row.iter_mut().zip(across.row(from)) {
                *near |= touched;
            }
        }
    }
    near
}

fn set_bits(row: &mut [u64], first: u32, end: u32) {
    let mut x = first;
    while x < end {
        let stop = end.min((x / 64 + 1) * 64);
        row[x as usize / 64] |= (u64::MAX >> (64 - (stop - x))) << (x % 64);
        x = stop;
    }
}

/// Calls `visit(row, first column, column after the last)` for each row of texels that the triangle
/// touches, clipped to `size_texel`.
fn for_each_touched_span(
    corners: &[SubtexelPoint; 3],
    size_texel: [u32; 2],
    mut visit: impl FnMut(u32, u32, u32),
) {
    let side = i64::from(SUBTEXELS);
    let ys = corners.map(|c| c[1]);
    let (low, high) = (ys[0].min(ys[1]).min(ys[2]), ys[0].max(ys[1]).max(ys[2]));
    let first_row = low.div_euclid(side).max(0);
    let last_row = ((high - 1).max(low))
        .div_euclid(side)
        .min(i64::from(size_texel[1]) - 1);
    for y in first_row..=last_row {
        let (top, bottom) = (y * side, (y + 1) * side);
        let (mut min_x, mut max_x) = (i64::MAX, i64::MIN);
        let mut include = |low_x: i64, high_x: i64| {
            min_x = min_x.min(low_x);
            max_x = max_x.max(high_x);
        };
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            if (top..=bottom).contains(&a[1]) {
                include(a[0], a[0]);
            }
            let (upper, lower) = if a[1] <= b[1] { (a, b) } else { (b, a) };
            for line in [top, bottom] {
                if upper[1] < line && line < lower[1] {
                    let run = (lower[0] - upper[0]) * (line - upper[1]);
                    let height = lower[1] - upper[1];
                    let x = upper[0] + run.div_euclid(height);
                    include(x, x + i64::from(run.rem_euclid(height) != 0));
                }
            }
        }
        if min_x > max_x {
            continue;
        }
        let first = min_x.div_euclid(side).max(0);
        let end = (-(-max_x).div_euclid(side))
            .max(first + 1)
            .min(i64::from(size_texel[0]));
        if let (Ok(y), Ok(first), Ok(end)) =
            (u32::try_from(y), u32::try_from(first), u32::try_from(end))
            && first < end
        {
            visit(y, first, end);
        }
    }
}

/// Union of `num` rows from `y` on, those past the end blank.
fn merged_rows(mask: &CellMask, y: u32, num: u32) -> Vec<u64> {
    let [_, height] = mask.size();
    let mut merged = vec![0; mask.row(0).len()];
    for y in y..(y + num).min(height) {
        for (merged, word) in merged.iter_mut().zip(mask.row(y)) {
            *merged |= word;
        }
    }
    merged
}

/// One bit per column: whether any of the `num` columns from there on is set. `num` is a power of
/// two of at most 32.
fn or_of_following(mut row: Vec<u64>, num: u32) -> Vec<u64> {
    let mut reach = 1;
    while reach < num {
        for index in 0..row.len() {
            let next = row.get(index + 1).copied().unwrap_or(0);
            row[index] |= row[index] >> reach | next << (64 - reach);
        }
        reach *= 2;
    }
    row
}

/// Number of set bits at `first`, `first + step`, …; `step` is a power of two of at most 32.
fn count_every(row: &[u64], step: u32, first: u32) -> usize {
    // One bit in `step`: 1 + 2^step + 2^(2·step) + …
    let pattern = if step == 1 {
        u64::MAX
    } else {
        u64::MAX / ((1 << step) - 1)
    };
    row.iter()
        .map(|word| (word >> first & pattern).count_ones() as usize)
        .sum()
}
