//! How many triangles lie on one another at one place: |Y| of Eq. MRFPlane.
//!
//! Where most triangles lie on one another, the place is the open intersection of these, a convex
//! polygon. Each of its sides is part of a side of one of them. So it is enough to walk along
//! every side of every triangle, just inside, and count the others: each of them covers an
//! interval. Time: overlapping pairs, and a sort per side. What covers a side, wholly or
//! in part, is decided exactly; the ends of intervals are rounded to 1e-16 of the side.

use super::detect::{PlaneTriangles, orientation};
use super::graph::Neighbours;

type Point = [f64; 2];

/// The largest number of triangles whose interiors have a point in common; 0 for none.
pub(super) fn max_stacked(layer: &PlaneTriangles, overlaps: &Neighbours) -> usize {
    let mut most = usize::from(!layer.is_empty());
    let mut ends: Vec<(f64, bool)> = Vec::new();
    for triangle in 0..layer.len() {
        let Some([a, b, c]) = layer.counter_clockwise(triangle) else {
            continue;
        };
        for side in [[a, b], [b, c], [c, a]] {
            ends.clear();
            for other in overlaps.of(triangle) {
                let covered = layer.counter_clockwise(other);
                if let Some([from, to]) = covered.and_then(|other| covered_part(side, other)) {
                    ends.extend([(from, true), (to, false)]);
                }
            }
            // At one place, first those that end.
            ends.sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
            let mut num_there = 1;
            for (_, begins) in &ends {
                if *begins {
                    num_there += 1;
                    most = most.max(num_there);
                } else {
                    num_there -= 1;
                }
            }
        }
    }
    most
}

/// The part of a side, as shares of its length, whose left is inside a counter-clockwise triangle.
fn covered_part([start, end]: [Point; 2], [a, b, c]: [Point; 3]) -> Option<[f64; 2]> {
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    for (p, q) in [(a, b), (b, c), (c, a)] {
        let at = [start, end].map(|point| orientation(p, q, point));
        let crossing = at[0] / (at[0] - at[1]);
        if at == [0.0, 0.0] {
            let along = (end[0] - start[0]) * (q[0] - p[0]) + (end[1] - start[1]) * (q[1] - p[1]);
            if along <= 0.0 {
                return None;
            }
        } else if at[0] <= 0.0 && at[1] <= 0.0 {
            return None;
        } else if at[0] < 0.0 {
            from = from.max(crossing);
        } else if at[1] < 0.0 {
            to = to.min(crossing);
        }
    }
    (from < to).then_some([from, to])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::detect::overlapping_pairs;
    use super::*;

    fn stacked(corners_m: &[[Point; 3]]) -> usize {
        let layer = PlaneTriangles::new(corners_m);
        let pairs = overlapping_pairs(&layer, usize::MAX).unwrap();
        max_stacked(&layer, &Neighbours::new(corners_m.len(), &pairs))
    }

    /// Independent: each cell of the arrangement has three corners that are not in line, and their
    /// centroid is inside it.
    fn stacked_by_enumeration(corners: &[[Point; 3]]) -> usize {
        let side = |a: Point, b: Point, p: Point| {
            (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
        };
        let sides = |[a, b, c]: [Point; 3]| [[a, b], [b, c], [c, a]];
        let mut points: Vec<Point> = corners.iter().flatten().copied().collect();
        let all: Vec<[Point; 2]> = corners.iter().flat_map(|t| sides(*t)).collect();
        for (k, &[p, q]) in all.iter().enumerate() {
            for &[r, s] in &all[..k] {
                let (from, to) = (side(r, s, p), side(r, s, q));
                let other = side(p, q, r) * side(p, q, s);
                if from * to <= 0.0 && other <= 0.0 && from != to {
                    let share = from / (from - to);
                    points.push([0, 1].map(|axis| p[axis] + share * (q[axis] - p[axis])));
                }
            }
        }
        points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        points.dedup_by(|a, b| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-9);
        let depth = |p: Point| {
            let covers = |t: &&[Point; 3]| {
                let at = sides(**t).map(|[a, b]| side(a, b, p));
                at.iter().all(|s| *s > 1e-7) || at.iter().all(|s| *s < -1e-7)
            };
            corners.iter().filter(covers).count()
        };
        let mut most = usize::from(!corners.is_empty());
        for (i, a) in points.iter().enumerate() {
            for (j, b) in points[..i].iter().enumerate() {
                for c in &points[..j] {
                    let middle = [0, 1].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0);
                    most = most.max(depth(middle));
                }
            }
        }
        most
    }

    #[test]
    fn pairs_that_meet_two_by_two_are_no_stack() {
        // Three bars round a hole.
        let bars = [
            [[0.0, 0.0], [10.0, 0.0], [10.0, 1.0]],
            [[9.0, -1.0], [10.0, 0.5], [4.0, 9.0]],
            [[0.0, -1.0], [6.0, 8.0], [5.0, 9.0]],
        ];
        assert_eq!(stacked(&bars), 2);
        assert_eq!(stacked(&[bars[0]; 7]), 7);
        assert_eq!(stacked(&bars[..1]), 1);
        assert_eq!(stacked(&[]), 0);
        let fan = [[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0], [0.0, 1.0]];
        let fan: Vec<_> = fan.windows(2).map(|p| [[0.0; 2], p[0], p[1]]).collect();
        assert_eq!(stacked(&fan), 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]
        #[test]
        fn agrees_with_the_cells_of_the_arrangement(
            triangles in proptest::collection::vec([[0i32..6, 0..6], [0..6, 0..6], [0..6, 0..6]], 1..6),
        ) {
            let corners: Vec<[Point; 3]> = triangles
                .iter()
                .map(|t| t.map(|p| p.map(f64::from)))
                .collect();
            prop_assert_eq!(stacked(&corners), stacked_by_enumeration(&corners));
        }
    }
}
