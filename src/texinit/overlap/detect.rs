//! Which triangles of a chart overlap in the plane: exactly, and in near-linear time.
//!
//! Two triangles overlap when their open interiors intersect, which for triangles of positive area
//! is the same as intersecting in positive area; a shared corner or edge is not overlap. Two open
//! convex sets are disjoint just when a line separates them, and for polygons one through an edge
//! will do (separating axes), so the question is decided by orientation signs alone: Shewchuk's
//! adaptive predicates (crate `robust`) give them without error, short of underflow of
//! differences below 1e-140 m.
//!
//! Candidates come from a grid of about one cell per triangle, finer where many lie ([`super::grid`]).
//! Slivers round one vertex are candidates for each other in any grid; where there are too many
//! candidates, the outline of the triangles may still prove that none overlap ([`super::outline`]).

use robust::{Coord, orient2d};

use super::grid::{Bounds, CellLists, Grid};
use super::outline::covers_nothing_twice;

type Point = [f64; 2];

/// Corners farther out than this are not a flattening, and their products would overflow.
const MAX_COORDINATE_M: f64 = 1e100;

/// Candidate pairs tested, per allowed overlapping pair and per triangle.
const MAX_TESTS_PER_PAIR: usize = 16;

/// Candidate pairs that any chart may test (some 0.1 s): fans of 2,000 triangles need as many.
const MIN_TEST_BUDGET: usize = 1 << 22;

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
    pub(super) fn for_each_cell(&self, triangle: usize, mut visit: impl FnMut(usize)) {
        if let Some(corners) = &self.counter_clockwise[triangle] {
            self.grid
                .for_each_cell(corners, &self.bounds[triangle], &mut visit);
        }
    }
}

/// All pairs (lower index first, in order) of triangles that overlap; nothing when there are more
/// than `max_pairs`, or so many candidates that there soon would be.
pub fn overlapping_pairs(triangles: &PlaneTriangles, max_pairs: usize) -> Option<Vec<[u32; 2]>> {
    let max_tests = max_pairs
        .saturating_add(triangles.len())
        .saturating_mul(MAX_TESTS_PER_PAIR)
        .max(MIN_TEST_BUDGET);
    match pairs_among_candidates(triangles, max_pairs, max_tests) {
        Ok(pairs) => Some(pairs),
        Err(GivenUp::TooManyPairs) => None,
        Err(GivenUp::TooManyTests) => {
            covers_nothing_twice(&triangles.counter_clockwise, max_tests).then(Vec::new)
        }
    }
}

enum GivenUp {
    TooManyPairs,
    TooManyTests,
}

fn pairs_among_candidates(
    triangles: &PlaneTriangles,
    max_pairs: usize,
    max_tests: usize,
) -> Result<Vec<[u32; 2]>, GivenUp> {
    let cells = CellLists::new(triangles.len(), triangles.num_cells(), |triangle, visit| {
        triangles.for_each_cell(triangle, visit);
    });
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
        if pairs.len() > max_pairs {
            return Err(GivenUp::TooManyPairs);
        }
        if num_tests > max_tests {
            return Err(if pairs.is_empty() {
                GivenUp::TooManyTests
            } else {
                GivenUp::TooManyPairs
            });
        }
    }
    pairs.sort_unstable();
    Ok(pairs)
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

    /// Rings of quads, each larger than the one within by the same factor: from a micrometre to a
    /// kilometre.
    fn rings_of_all_sizes() -> Vec<[Point; 3]> {
        let at = |i: usize, j: usize| {
            let radius = 10f64.powf(-6.0 + 9.0 * i as f64 / 200.0);
            let angle = j as f64 / 50.0 * 1.5;
            [radius * angle.cos(), radius * angle.sin()]
        };
        let quads = (0..200).flat_map(|i| (0..50).map(move |j| (i, j)));
        quads
            .flat_map(|(i, j)| {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect()
    }

    #[test]
    fn triangles_of_mixed_sizes_are_few_candidates() {
        let rings = rings_of_all_sizes();
        let layer = PlaneTriangles::new(&rings);
        let pairs = pairs_among_candidates(&layer, 0, 60 * rings.len());
        assert!(pairs.is_ok_and(|pairs| pairs.is_empty()));
    }

    #[test]
    fn a_fan_with_too_many_candidates_is_proved_by_its_outline() {
        let spoke = |k: usize| {
            let angle = k as f64 / 6000.0 * std::f64::consts::TAU;
            [angle.cos(), angle.sin()]
        };
        let mut fan: Vec<_> = (0..6000)
            .map(|k| [[0.0, 0.0], spoke(k), spoke((k + 1) % 6000)])
            .collect();
        let layer = PlaneTriangles::new(&fan);
        let candidates = pairs_among_candidates(&layer, 0, MIN_TEST_BUDGET);
        assert!(matches!(candidates, Err(GivenUp::TooManyTests)));
        assert_eq!(overlapping_pairs(&layer, 0), Some(vec![]));
        fan.push([[0.5, 0.5], [0.6, 0.5], [0.5, 0.6]]);
        assert_eq!(overlapping_pairs(&PlaneTriangles::new(&fan), 0), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn divided_cells_miss_no_pair(
            triangles in proptest::collection::vec((triangle(40), 0i32..28, 0u32..8), 400),
        ) {
            let corners: Vec<_> = triangles
                .iter()
                .map(|(t, shift, direction)| {
                    // Smaller towards one place, in steps of two.
                    let (sin, cos) = (0.2 * f64::from(*direction)).sin_cos();
                    let size = 0.5_f64.powi(*shift);
                    as_metres(t).map(|p| [size * (cos + p[0]), size * (sin + p[1])])
                })
                .collect();
            let layer = PlaneTriangles::new(&corners);
            prop_assert!(layer.grid.num_levels() > 3, "{} levels", layer.grid.num_levels());
            prop_assert_eq!(
                overlapping_pairs(&layer, usize::MAX).unwrap(),
                pairs_by_brute_force(&corners)
            );
        }
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
