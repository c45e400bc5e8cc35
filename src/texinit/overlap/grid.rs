//! A grid over the plane, finer where many triangles lie.
//!
//! Its cells are square, about one per triangle. A triangle is entered only in the cells that it
//! touches, so that slivers do not flood it. A cell that many triangles touch is divided by a grid
//! of its own, and so on, unless that would only repeat the entries (slivers round one vertex):
//! triangles of mixed sizes cost as little as those of one.

type Point = [f64; 2];

/// A grid as fine as one cell per triangle holds a few entries per triangle; slivers and mixed
/// sizes more. Above this the grid is made coarser.
const MAX_ENTRIES_PER_TRIANGLE: usize = 32;

/// Cells that more triangles touch are divided, where that is possible.
const MAX_MEMBERS: usize = 64;

/// Cells of a finer grid are fewer: large triangles touch all of them.
const TRIANGLES_PER_FINER_CELL: usize = 4;

/// A divided cell may have so many times as many entries.
const MAX_REPEATS: usize = 4;

/// Rounding in the walk over cells is some 1e-16 times the number of cells (of order 1e6); this
/// much of a cell covers it.
const CELL_MARGIN: f64 = 1e-6;

/// Cells are at least this large, by the largest coordinate, so that the margin covers rounding.
const MIN_RELATIVE_SIDE: f64 = 1e-9;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) min: Point,
    pub(super) max: Point,
}

impl Bounds {
    pub(super) const EMPTY: Self = Self {
        min: [f64::INFINITY; 2],
        max: [f64::NEG_INFINITY; 2],
    };

    fn including(self, p: Point) -> Self {
        Self {
            min: [self.min[0].min(p[0]), self.min[1].min(p[1])],
            max: [self.max[0].max(p[0]), self.max[1].max(p[1])],
        }
    }

    pub(super) fn of(corners: &[Point; 3]) -> Self {
        corners.iter().fold(Self::EMPTY, |b, &p| b.including(p))
    }

    pub(super) fn interior_intersects(&self, other: &Self) -> bool {
        (0..2).all(|k| self.min[k] < other.max[k] && other.min[k] < self.max[k])
    }
}

/// Per cell: the shapes that touch it, in order.
pub(super) struct CellLists {
    start: Vec<usize>,
    members: Vec<u32>,
}

impl CellLists {
    /// `for_each_cell` visits the cells of a shape.
    pub(super) fn new(
        num_shapes: usize,
        num_cells: usize,
        for_each_cell: impl Fn(usize, &mut dyn FnMut(usize)),
    ) -> Self {
        let mut start = vec![0usize; num_cells + 1];
        for shape in 0..num_shapes {
            for_each_cell(shape, &mut |cell| start[cell + 1] += 1);
        }
        for cell in 1..start.len() {
            start[cell] += start[cell - 1];
        }
        let num_entries = start.last().copied().unwrap_or(0);
        let mut members = vec![0u32; num_entries];
        let mut next = start.clone();
        for (shape, id) in (0..num_shapes).zip(0u32..) {
            for_each_cell(shape, &mut |cell| {
                members[next[cell]] = id;
                next[cell] += 1;
            });
        }
        Self { start, members }
    }

    pub(super) fn members(&self, cell: usize) -> &[u32] {
        &self.members[self.start[cell]..self.start[cell + 1]]
    }
}

/// No level: the cell is not divided.
const WHOLE: u32 = u32::MAX;

/// A grid of grids. Cells are numbered through all levels; those that are divided are never visited.
pub(super) struct Grid {
    levels: Vec<Level>,
    /// Per cell of all levels: the level that divides it.
    divided_by: Vec<u32>,
}

impl Grid {
    /// About one cell per triangle, coarser where triangles would touch too many, finer where many
    /// lie. Segments are triangles of two equal corners.
    pub(super) fn fit(corners: &[Option<[Point; 3]>], bounds: &[Bounds]) -> Self {
        let mut all = Bounds::EMPTY;
        let mut members = Vec::new();
        for (id, corners) in (0u32..).zip(corners) {
            if let Some(b) = corners.as_ref().map(Bounds::of) {
                all = all.including(b.min).including(b.max);
                members.push(id);
            }
        }
        let shapes = Shapes { corners, bounds };
        let mut num_cells = members.len();
        let top = loop {
            let level = Level::with_cells(&all, num_cells, 0);
            let limit = MAX_ENTRIES_PER_TRIANGLE * members.len();
            if num_cells <= 1 || shapes.num_entries_up_to(&level, &members, limit).is_some() {
                break level;
            }
            num_cells /= 4;
        };
        let largest = all
            .min
            .iter()
            .chain(&all.max)
            .fold(0.0, |m: f64, v| m.max(v.abs()));
        let mut grid = Self {
            divided_by: vec![WHOLE; top.num_cells()],
            levels: vec![top],
        };
        grid.divide(0, &members, &shapes, MIN_RELATIVE_SIDE * largest);
        grid
    }

    pub(super) fn num_cells(&self) -> usize {
        self.divided_by.len()
    }

    #[cfg(test)]
    pub(super) fn num_levels(&self) -> usize {
        self.levels.len()
    }

    pub(super) fn for_each_cell(
        &self,
        corners: &[Point; 3],
        bounds: &Bounds,
        visit: &mut dyn FnMut(usize),
    ) {
        self.for_each_cell_of(0, corners, bounds, visit);
    }

    fn for_each_cell_of(
        &self,
        level: usize,
        corners: &[Point; 3],
        bounds: &Bounds,
        visit: &mut dyn FnMut(usize),
    ) {
        self.levels[level].for_each_cell(corners, bounds, |cell| match self.divided_by[cell] {
            WHOLE => visit(cell),
            finer => self.for_each_cell_of(finer as usize, corners, bounds, visit),
        });
    }

    /// Divides the crowded cells of a level, and theirs. Levels end with the size of their cells.
    fn divide(&mut self, level: usize, members: &[u32], shapes: &Shapes<'_>, min_side: f64) {
        let Level { first_cell, .. } = self.levels[level];
        let num_cells = self.levels[level].num_cells();
        if members.len() <= MAX_MEMBERS {
            return;
        }
        let lists = CellLists::new(members.len(), num_cells, |member, visit| {
            shapes.for_each_cell(&self.levels[level], members[member], &mut |cell| {
                visit(cell - first_cell);
            });
        });
        for cell in 0..num_cells {
            let crowd = lists.members(cell);
            if crowd.len() <= MAX_MEMBERS {
                continue;
            }
            let crowd: Vec<u32> = crowd.iter().map(|&m| members[m as usize]).collect();
            let bounds = self.levels[level].bounds_of(cell);
            let num_finer = crowd.len() / TRIANGLES_PER_FINER_CELL;
            let finer = Level::with_cells(&bounds, num_finer, self.divided_by.len());
            let limit = MAX_REPEATS * crowd.len();
            let is_fine = finer.num_cells() > 1 && finer.side() >= min_side;
            if !is_fine || shapes.num_entries_up_to(&finer, &crowd, limit).is_none() {
                continue;
            }
            let Ok(index) = u32::try_from(self.levels.len()) else {
                return;
            };
            self.divided_by[first_cell + cell] = index;
            let num_all = self.divided_by.len() + finer.num_cells();
            self.divided_by.resize(num_all, WHOLE);
            self.levels.push(finer);
            self.divide(index as usize, &crowd, shapes, min_side);
        }
    }
}

struct Shapes<'a> {
    corners: &'a [Option<[Point; 3]>],
    bounds: &'a [Bounds],
}

impl Shapes<'_> {
    fn for_each_cell(&self, level: &Level, shape: u32, visit: &mut dyn FnMut(usize)) {
        if let Some(corners) = &self.corners[shape as usize] {
            level.for_each_cell(corners, &self.bounds[shape as usize], visit);
        }
    }

    fn num_entries_up_to(&self, level: &Level, members: &[u32], limit: usize) -> Option<usize> {
        let mut num_entries = 0;
        for &member in members {
            self.for_each_cell(level, member, &mut |_| num_entries += 1);
            if num_entries > limit {
                return None;
            }
        }
        Some(num_entries)
    }
}

/// A uniform grid over a box.
struct Level {
    origin: Point,
    cells_per_m: Point,
    num_columns: usize,
    num_rows: usize,
    first_cell: usize,
}

impl Level {
    fn with_cells(all: &Bounds, num_cells: usize, first_cell: usize) -> Self {
        let extent = [all.max[0] - all.min[0], all.max[1] - all.min[1]];
        let longer = extent[0].max(extent[1]);
        if num_cells <= 1 || longer.is_nan() || longer <= 0.0 {
            return Self {
                origin: [0.0; 2],
                cells_per_m: [0.0; 2],
                num_columns: 1,
                num_rows: 1,
                first_cell,
            };
        }
        // A long thin box gets one row of at most `num_cells` columns.
        let side = (extent[0] * (extent[1] / num_cells as f64))
            .sqrt()
            .max(longer / num_cells as f64);
        let count = |length: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "at most num_cells; casts saturate"
            )]
            let count = (length / side).ceil() as usize;
            count.clamp(1, num_cells)
        };
        Self {
            origin: all.min,
            cells_per_m: [1.0 / side; 2],
            num_columns: count(extent[0]),
            num_rows: count(extent[1]),
            first_cell,
        }
    }

    fn num_cells(&self) -> usize {
        self.num_columns * self.num_rows
    }

    /// Of a cell; infinite where there is but one.
    fn side(&self) -> f64 {
        1.0 / self.cells_per_m[0]
    }

    fn bounds_of(&self, cell: usize) -> Bounds {
        let at = [cell % self.num_columns, cell / self.num_columns];
        let corner = |more: usize| {
            [0, 1].map(|axis| self.origin[axis] + (at[axis] + more) as f64 / self.cells_per_m[axis])
        };
        Bounds {
            min: corner(0),
            max: corner(1),
        }
    }

    /// Fractional column or row.
    fn position(&self, axis: usize, coordinate_m: f64) -> f64 {
        (coordinate_m - self.origin[axis]) * self.cells_per_m[axis]
    }

    /// Columns or rows that the interval of fractional ones touches.
    fn range(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
        if low > count as f64 + CELL_MARGIN || high < -CELL_MARGIN {
            return 0..0;
        }
        let clamp = |cell: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "casts saturate, NaN becomes 0"
            )]
            let index = cell as usize;
            index.min(count - 1)
        };
        clamp(low - CELL_MARGIN)..clamp(high + CELL_MARGIN) + 1
    }

    fn for_each_cell(&self, corners: &[Point; 3], bounds: &Bounds, mut visit: impl FnMut(usize)) {
        let low = [0, 1].map(|axis| self.position(axis, bounds.min[axis]));
        let high = [0, 1].map(|axis| self.position(axis, bounds.max[axis]));
        let rows = Self::range(low[1], high[1], self.num_rows);
        let in_cells = corners.map(|p| [self.position(0, p[0]), self.position(1, p[1])]);
        let is_one_row = low[1].floor() == high[1].floor();
        for row in rows {
            let columns = if is_one_row {
                Self::range(low[0], high[0], self.num_columns)
            } else {
                let (left, right) = extent_in_row(&in_cells, row);
                Self::range(left, right, self.num_columns)
            };
            for column in columns {
                visit(self.first_cell + row * self.num_columns + column);
            }
        }
    }
}

/// Leftmost and rightmost point, in cells, of the part of a triangle inside a row of cells.
fn extent_in_row(corners_in_cells: &[Point; 3], row: usize) -> (f64, f64) {
    let bottom = row as f64 - CELL_MARGIN;
    let top = (row + 1) as f64 + CELL_MARGIN;
    let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
    let [a, b, c] = *corners_in_cells;
    for (p, q) in [(a, b), (b, c), (c, a)] {
        let (low, high) = if p[1] <= q[1] { (p, q) } else { (q, p) };
        if high[1] < bottom || low[1] > top {
            continue;
        }
        let x_at = |y: f64| {
            let share = ((y - low[1]) / (high[1] - low[1])).clamp(0.0, 1.0);
            low[0] + share * (high[0] - low[0])
        };
        let ends = if high[1] > low[1] {
            [x_at(bottom.max(low[1])), x_at(top.min(high[1]))]
        } else {
            [low[0], high[0]]
        };
        left = left.min(ends[0]).min(ends[1]);
        right = right.max(ends[0]).max(ends[1]);
    }
    (left, right)
}
