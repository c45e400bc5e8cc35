//! Which triangles of a chart overlap in the plane: exactly, and in near-linear time.
//!
//! Two triangles overlap when their open interiors intersect, which for triangles of positive area
//! is the same as intersecting in positive area; a shared corner or edge is not overlap. Two open
//! convex sets are disjoint just when a line separates them, and for polygons one through an edge
//! will do (separating axes), so the question is decided by orientation signs alone: Shewchuk's
//! adaptive predicates (crate `robust`) give them without error, short of underflow of
//! differences below 1e-140 m.
//!
//! Candidates come from a uniform grid of about one cell per triangle; a triangle is entered only
//! in the cells that it touches, so that slivers do not flood it.

use robust::{Coord, orient2d};

type Point = [f64; 2];

/// Corners farther out than this are not a flattening, and their products would overflow.
const MAX_COORDINATE_M: f64 = 1e100;

/// A grid as fine as one cell per triangle holds a few entries per triangle; slivers and mixed
/// sizes more. Above this the grid is made coarser.
const MAX_ENTRIES_PER_TRIANGLE: usize = 32;

/// Candidate pairs tested, per allowed overlapping pair and per triangle.
const MAX_TESTS_PER_PAIR: usize = 16;

/// Candidate pairs that any chart may test (some 0.1 s): fans of 2,000 triangles need as many.
const MIN_TEST_BUDGET: usize = 1 << 22;

/// Rounding in the walk over cells is some 1e-16 times the number of cells (of order 1e6); this
/// much of a cell covers it.
const CELL_MARGIN: f64 = 1e-6;

/// Sign of the area of (a, b, c): positive when counter-clockwise, y up. Exact.
pub fn orientation(a: Point, b: Point, c: Point) -> f64 {
    let coord = |p: Point| Coord { x: p[0], y: p[1] };
    orient2d(coord(a), coord(b), coord(c))
}

/// The corners in counter-clockwise order; nothing for a triangle of no area.
pub fn counter_clockwise([a, b, c]: [Point; 3]) -> Option<[Point; 3]> {
    let in_range = [a, b, c]
        .iter()
        .flatten()
        .all(|v| v.abs() <= MAX_COORDINATE_M);
    if !in_range {
        return None;
    }
    let side = orientation(a, b, c);
    if side > 0.0 {
        Some([a, b, c])
    } else if side < 0.0 {
        Some([a, c, b])
    } else {
        None
    }
}

/// Whether the interiors of two counter-clockwise triangles intersect. Exact.
pub fn interiors_intersect(first: &[Point; 3], second: &[Point; 3]) -> bool {
    let separates = |edges_of: &[Point; 3], other: &[Point; 3]| {
        let [a, b, c] = *edges_of;
        [(a, b), (b, c), (c, a)]
            .iter()
            .any(|&(from, to)| other.iter().all(|&p| orientation(from, to, p) <= 0.0))
    };
    !separates(first, second) && !separates(second, first)
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: Point,
    max: Point,
}

impl Bounds {
    const EMPTY: Self = Self {
        min: [f64::INFINITY; 2],
        max: [f64::NEG_INFINITY; 2],
    };

    fn including(self, p: Point) -> Self {
        Self {
            min: [self.min[0].min(p[0]), self.min[1].min(p[1])],
            max: [self.max[0].max(p[0]), self.max[1].max(p[1])],
        }
    }

    fn of(corners: &[Point; 3]) -> Self {
        corners.iter().fold(Self::EMPTY, |b, &p| b.including(p))
    }

    fn interior_intersects(&self, other: &Self) -> bool {
        (0..2).all(|k| self.min[k] < other.max[k] && other.min[k] < self.max[k])
    }
}

/// Triangles of one plane, ready to be tested against each other.
pub struct PlaneTriangles {
    counter_clockwise: Vec<Option<[Point; 3]>>,
    bounds: Vec<Bounds>,
    grid: Grid,
}

impl PlaneTriangles {
    /// From corners in metres, either orientation; triangles of no area, or with a corner that is
    /// not finite, overlap nothing.
    pub fn new(corners_m: &[[Point; 3]]) -> Self {
        let counter_clockwise: Vec<_> = corners_m.iter().map(|c| counter_clockwise(*c)).collect();
        let bounds: Vec<Bounds> = counter_clockwise
            .iter()
            .map(|corners| corners.as_ref().map_or(Bounds::EMPTY, Bounds::of))
            .collect();
        let grid = Grid::fit(&counter_clockwise, &bounds);
        Self {
            counter_clockwise,
            bounds,
            grid,
        }
    }

    /// How many triangles there are.
    pub fn len(&self) -> usize {
        self.counter_clockwise.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.counter_clockwise.is_empty()
    }

    /// Whether two of them overlap. Exact.
    pub fn overlap(&self, first: usize, second: usize) -> bool {
        self.bounds[first].interior_intersects(&self.bounds[second])
            && match (
                &self.counter_clockwise[first],
                &self.counter_clockwise[second],
            ) {
                (Some(a), Some(b)) => interiors_intersect(a, b),
                _ => false,
            }
    }

    /// A triangle's corners in counter-clockwise order; nothing where it has no area.
    pub(super) fn counter_clockwise(&self, triangle: usize) -> Option<[Point; 3]> {
        self.counter_clockwise[triangle]
    }

    /// Number of cells of the grid.
    pub(super) fn num_cells(&self) -> usize {
        self.grid.num_cells()
    }

    /// The cells of the grid that a triangle touches; two triangles that overlap share one.
    pub(super) fn for_each_cell(&self, triangle: usize, visit: impl FnMut(usize)) {
        if let Some(corners) = &self.counter_clockwise[triangle] {
            self.grid
                .for_each_cell(corners, &self.bounds[triangle], visit);
        }
    }
}

/// All pairs (lower index first, in order) of triangles that overlap; nothing when there are more
/// than `max_pairs`, or so many candidates that there soon would be.
pub fn overlapping_pairs(triangles: &PlaneTriangles, max_pairs: usize) -> Option<Vec<[u32; 2]>> {
    let cells = CellLists::new(triangles);
    let max_tests = max_pairs
        .saturating_add(triangles.len())
        .saturating_mul(MAX_TESTS_PER_PAIR)
        .max(MIN_TEST_BUDGET);
    let mut num_tests = 0;
    let mut pairs = Vec::new();
    // Which triangle each one was last a candidate for.
    let mut candidate_of = vec![u32::MAX; triangles.len()];
    for (first, first_id) in (0..triangles.len()).zip(0u32..) {
        triangles.for_each_cell(first, |cell| {
            for &second_id in cells.members(cell) {
                let second = second_id as usize;
                if second <= first || candidate_of[second] == first_id {
                    continue;
                }
                candidate_of[second] = first_id;
                num_tests += 1;
                if pairs.len() <= max_pairs
                    && num_tests <= max_tests
                    && triangles.overlap(first, second)
                {
                    pairs.push([first_id, second_id]);
                }
            }
        });
        if pairs.len() > max_pairs || num_tests > max_tests {
            return None;
        }
    }
    pairs.sort_unstable();
    Some(pairs)
}

/// Per cell: the triangles that touch it, in order.
struct CellLists {
    start: Vec<usize>,
    members: Vec<u32>,
}

impl CellLists {
    fn new(triangles: &PlaneTriangles) -> Self {
        let mut start = vec![0usize; triangles.num_cells() + 1];
        for triangle in 0..triangles.len() {
            triangles.for_each_cell(triangle, |cell| start[cell + 1] += 1);
        }
        for cell in 1..start.len() {
            start[cell] += start[cell - 1];
        }
        let num_entries = start.last().copied().unwrap_or(0);
        let mut members = vec![0u32; num_entries];
        let mut next = start.clone();
        for (triangle, id) in (0..triangles.len()).zip(0u32..) {
            triangles.for_each_cell(triangle, |cell| {
                members[next[cell]] = id;
                next[cell] += 1;
            });
        }
        Self { start, members }
    }

    fn members(&self, cell: usize) -> &[u32] {
        &self.members[self.start[cell]..self.start[cell + 1]]
    }
}

/// A uniform grid over a box.
struct Grid {
    origin: Point,
    cells_per_m: Point,
    num_columns: usize,
    num_rows: usize,
}

impl Grid {
    /// About one cell per triangle, square, coarser where triangles would touch too many.
    fn fit(corners: &[Option<[Point; 3]>], bounds: &[Bounds]) -> Self {
        let mut all = Bounds::EMPTY;
        let mut num_triangles = 0usize;
        for b in corners.iter().flatten().map(Bounds::of) {
            all = all.including(b.min).including(b.max);
            num_triangles += 1;
        }
        let mut num_cells = num_triangles;
        loop {
            let grid = Self::with_cells(&all, num_cells);
            let limit = MAX_ENTRIES_PER_TRIANGLE * num_triangles;
            if num_cells <= 1 || grid.num_entries_up_to(corners, bounds, limit).is_some() {
                return grid;
            }
            num_cells /= 4;
        }
    }

    fn with_cells(all: &Bounds, num_cells: usize) -> Self {
        let extent = [all.max[0] - all.min[0], all.max[1] - all.min[1]];
        let longer = extent[0].max(extent[1]);
        if num_cells <= 1 || longer.is_nan() || longer <= 0.0 {
            return Self {
                origin: [0.0; 2],
                cells_per_m: [0.0; 2],
                num_columns: 1,
                num_rows: 1,
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
        }
    }

    fn num_cells(&self) -> usize {
        self.num_columns * self.num_rows
    }

    fn num_entries_up_to(
        &self,
        corners: &[Option<[Point; 3]>],
        bounds: &[Bounds],
        limit: usize,
    ) -> Option<usize> {
        let mut num_entries = 0;
        for (corners, bounds) in corners.iter().zip(bounds) {
            if let Some(corners) = corners {
                self.for_each_cell(corners, bounds, |_| num_entries += 1);
            }
            if num_entries > limit {
                return None;
            }
        }
        Some(num_entries)
    }

    /// Fractional column or row.
    fn position(&self, axis: usize, coordinate_m: f64) -> f64 {
        (coordinate_m - self.origin[axis]) * self.cells_per_m[axis]
    }

    /// Columns or rows that the interval of fractional ones touches.
    fn range(low: f64, high: f64, count: usize) -> (usize, usize) {
        let clamp = |cell: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "casts saturate, NaN becomes 0"
            )]
            let index = cell as usize;
            index.min(count - 1)
        };
        (clamp(low - CELL_MARGIN), clamp(high + CELL_MARGIN))
    }

    fn for_each_cell(&self, corners: &[Point; 3], bounds: &Bounds, mut visit: impl FnMut(usize)) {
        let low = [0, 1].map(|axis| self.position(axis, bounds.min[axis]));
        let high = [0, 1].map(|axis| self.position(axis, bounds.max[axis]));
        let (first_row, last_row) = Self::range(low[1], high[1], self.num_rows);
        let in_cells = corners.map(|p| [self.position(0, p[0]), self.position(1, p[1])]);
        for row in first_row..=last_row {
            let (first, last) = if first_row == last_row {
                Self::range(low[0], high[0], self.num_columns)
            } else {
                let (left, right) = extent_in_row(&in_cells, row);
                Self::range(left, right, self.num_columns)
            };
            for column in first..=last {
                visit(row * self.num_columns + column);
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

#[cfg(test)]
pub(super) mod tests {
    use proptest::prelude::*;

    use super::*;

    type Homogeneous = [i128; 3];

    fn side(a: [i64; 2], b: [i64; 2], p: [i64; 2]) -> i128 {
        let [a, b, p] = [a, b, p].map(|q| q.map(i128::from));
        (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
    }

    fn in_closed(triangle: &[[i64; 2]; 3], p: [i64; 2]) -> bool {
        let [a, b, c] = *triangle;
        let sides = [side(a, b, p), side(b, c, p), side(c, a, p)];
        sides.iter().all(|s| *s >= 0) || sides.iter().all(|s| *s <= 0)
    }

    /// The point where two segments cross, when their lines are not parallel.
    fn crossing(p: [[i64; 2]; 2], q: [[i64; 2]; 2]) -> Option<Homogeneous> {
        let from = side(q[0], q[1], p[0]);
        let to = side(q[0], q[1], p[1]);
        let other = [side(p[0], p[1], q[0]), side(p[0], p[1], q[1])];
        let weight = from - to;
        if weight == 0 || from.signum() * to.signum() > 0 {
            return None;
        }
        if other[0].signum() * other[1].signum() > 0 {
            return None;
        }
        let blend = |k: usize| from * i128::from(p[1][k]) - to * i128::from(p[0][k]);
        Some([blend(0), blend(1), weight])
    }

    /// Independent: every corner of the intersection polygon in exact rationals; area is positive
    /// when three of them are not in line.
    fn overlap_by_polygon(first: &[[i64; 2]; 3], second: &[[i64; 2]; 3]) -> bool {
        let area = |t: &[[i64; 2]; 3]| side(t[0], t[1], t[2]);
        if area(first) == 0 || area(second) == 0 {
            return false;
        }
        let mut points: Vec<Homogeneous> = Vec::new();
        let mut corners_inside = |of: &[[i64; 2]; 3], other: &[[i64; 2]; 3]| {
            let inside = of.iter().filter(|p| in_closed(other, **p));
            points.extend(inside.map(|p| [i128::from(p[0]), i128::from(p[1]), 1]));
        };
        corners_inside(first, second);
        corners_inside(second, first);
        for i in 0..3 {
            for j in 0..3 {
                points.extend(crossing(
                    [first[i], first[(i + 1) % 3]],
                    [second[j], second[(j + 1) % 3]],
                ));
            }
        }
        let det = |a: &Homogeneous, b: &Homogeneous, c: &Homogeneous| {
            a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
                + a[2] * (b[0] * c[1] - b[1] * c[0])
        };
        points.iter().enumerate().any(|(i, a)| {
            points[..i]
                .iter()
                .enumerate()
                .any(|(j, b)| points[..j].iter().any(|c| det(a, b, c) != 0))
        })
    }

    /// Every pair, each by the exact test alone.
    pub(in super::super) fn pairs_by_brute_force(corners_m: &[[Point; 3]]) -> Vec<[u32; 2]> {
        let ccw: Vec<_> = corners_m.iter().map(|c| counter_clockwise(*c)).collect();
        let mut pairs = Vec::new();
        for (i, first) in (0u32..).zip(&ccw) {
            for (j, second) in (0u32..).zip(&ccw).skip(i as usize + 1) {
                if let (Some(a), Some(b)) = (first, second)
                    && interiors_intersect(a, b)
                {
                    pairs.push([i, j]);
                }
            }
        }
        pairs
    }

    fn triangle(range: i64) -> impl Strategy<Value = [[i64; 2]; 3]> {
        let point = move || [0..range, 0..range];
        [point(), point(), point()]
    }

    fn as_metres(corners: &[[i64; 2]; 3]) -> [Point; 3] {
        corners.map(|p| p.map(|v| v as f64 / 1024.0))
    }

    #[test]
    fn touching_is_not_overlap() {
        let base = [[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]];
        let across = [[0.1, 0.0], [0.1, 0.1], [0.0, 0.1]];
        let at_corner = [[0.0, 0.0], [-0.1, 0.0], [0.0, -0.1]];
        // Its corner rests on the middle of the base's edge.
        let resting = [[0.05, 0.0], [0.0, -0.1], [0.1, -0.1]];
        let all = [base, across, at_corner, resting];
        let pairs = overlapping_pairs(&PlaneTriangles::new(&all), 100).unwrap();
        assert_eq!(pairs, Vec::<[u32; 2]>::new());
        let shifted = base.map(|p| [p[0] + f64::EPSILON, p[1]]);
        let pairs = overlapping_pairs(&PlaneTriangles::new(&[across, shifted]), 100).unwrap();
        assert_eq!(pairs, [[0, 1]]);
    }

    #[test]
    fn too_many_pairs_are_given_up() {
        let stack = vec![[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]; 100];
        let layer = PlaneTriangles::new(&stack);
        assert_eq!(overlapping_pairs(&layer, 4949), None);
        assert_eq!(overlapping_pairs(&layer, 4950).unwrap().len(), 4950);
    }

    #[test]
    fn wild_corners_overlap_nothing() {
        let good = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let mut corners = vec![good];
        for bad in [f64::NAN, f64::INFINITY, 1e300] {
            corners.push([[bad, 0.0], [1.0, 0.0], [0.0, 1.0]]);
        }
        corners.push([[0.3; 2]; 3]);
        let layer = PlaneTriangles::new(&corners);
        assert_eq!(
            overlapping_pairs(&layer, 100).unwrap(),
            Vec::<[u32; 2]>::new()
        );
        let none = PlaneTriangles::new(&[]);
        assert!(none.is_empty());
        assert_eq!(
            overlapping_pairs(&none, 100).unwrap(),
            Vec::<[u32; 2]>::new()
        );
    }

    #[test]
    fn fan_of_slivers_does_not_flood_the_grid() {
        let n = 2000;
        let spoke = |k: usize| {
            let angle = k as f64 / n as f64 * std::f64::consts::TAU;
            [angle.cos(), angle.sin()]
        };
        let fan: Vec<_> = (0..n)
            .map(|k| [[0.0, 0.0], spoke(k), spoke((k + 1) % n)])
            .collect();
        let pairs = overlapping_pairs(&PlaneTriangles::new(&fan), 0);
        assert_eq!(pairs, Some(vec![]));
    }

    proptest! {
        #[test]
        fn agrees_with_exact_polygons(a in triangle(6), b in triangle(6)) {
            let corners = [as_metres(&a), as_metres(&b)];
            let expected = if overlap_by_polygon(&a, &b) { vec![[0, 1]] } else { vec![] };
            prop_assert_eq!(pairs_by_brute_force(&corners), expected.clone());
            let layer = PlaneTriangles::new(&corners);
            prop_assert_eq!(overlapping_pairs(&layer, 10).unwrap(), expected);
        }

        #[test]
        fn agrees_with_exact_polygons_on_a_fine_grid(
            a in triangle(1 << 14),
            b in triangle(1 << 14),
            share in 0usize..4,
        ) {
            let mut b = b;
            b[..share.min(3)].copy_from_slice(&a[..share.min(3)]);
            let expected = usize::from(overlap_by_polygon(&a, &b));
            let corners = [as_metres(&a), as_metres(&b)];
            prop_assert_eq!(pairs_by_brute_force(&corners).len(), expected);
        }

        #[test]
        fn grid_misses_no_pair(
            triangles in proptest::collection::vec(
                (triangle(40), 0i64..2000, 0i64..60, 0u32..5), 0..60),
        ) {
            let corners: Vec<_> = triangles
                .iter()
                .map(|(t, x, y, shift)| as_metres(&t.map(|p| [(p[0] << shift) + x, p[1] + y])))
                .collect();
            let layer = PlaneTriangles::new(&corners);
            prop_assert_eq!(
                overlapping_pairs(&layer, usize::MAX).unwrap(),
                pairs_by_brute_force(&corners)
            );
        }
    }
}
