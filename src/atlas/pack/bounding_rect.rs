//! The direction of the smallest rectangle around a set of points: rotating calipers on the convex
//! hull (Toussaint 1983); one side of the smallest rectangle lies along an edge of the hull
//! (Freeman and Shapira 1975).

use robust::{Coord, orient2d};

type Point = [f64; 2];

/// Unit vector along the longer side of the smallest rectangle; (1, 0) when the points have no
/// extent. Points are finite.
pub(super) fn longer_side(points: Vec<Point>) -> Point {
    let hull = convex_hull(points);
    let mut best: Option<(f64, Point)> = None;
    for_each_rectangle(&hull, |direction, width, height| {
        let along = if width >= height {
            direction
        } else {
            [-direction[1], direction[0]]
        };
        if best.is_none_or(|(area, _)| width * height < area) {
            best = Some((width * height, along));
        }
    });
    best.map_or([1.0, 0.0], |(_, along)| along)
}

/// Corners of the hull, counter-clockwise, none in line with its neighbours (Andrew's chain).
fn convex_hull(mut points: Vec<Point>) -> Vec<Point> {
    points.sort_unstable_by(|p, q| p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1])));
    points.dedup();
    let coord = |p: Point| Coord { x: p[0], y: p[1] };
    let mut hull: Vec<Point> = Vec::new();
    let extend = |hull: &mut Vec<Point>, keep: usize, point: Point| {
        while hull.len() > keep {
            let [a, b] = [hull[hull.len() - 2], hull[hull.len() - 1]];
            if orient2d(coord(a), coord(b), coord(point)) > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(point);
    };
    for &point in &points {
        extend(&mut hull, 1, point);
    }
    let lower = hull.len();
    for &point in points.iter().rev().skip(1) {
        extend(&mut hull, lower, point);
    }
    if hull.len() > 1 {
        hull.pop();
    }
    hull
}

/// Calls `visit(direction, width, height)` for the rectangle along each edge of the hull.
fn for_each_rectangle(hull: &[Point], mut visit: impl FnMut(Point, f64, f64)) {
    let n = hull.len();
    if n < 2 {
        return;
    }
    let dot = |p: Point, q: Point| p[0] * q[0] + p[1] * q[1];
    let [mut right, mut top, mut left] = [0; 3];
    for edge in 0..n {
        let (from, to) = (hull[edge], hull[(edge + 1) % n]);
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        if length <= 0.0 || !length.is_finite() {
            continue;
        }
        let along = [(to[0] - from[0]) / length, (to[1] - from[1]) / length];
        let across = [-along[1], along[0]];
        // Each pointer walks on while its direction still gains; it goes round the hull once.
        let climb = |start: usize, direction: Point| {
            let mut at = start;
            for _ in 0..n {
                let next = (at + 1) % n;
                if dot(hull[next], direction) < dot(hull[at], direction) {
                    break;
                }
                at = next;
            }
            at
        };
        right = climb(if edge == 0 { 1 % n } else { right }, along);
        top = climb(if edge == 0 { right } else { top }, across);
        left = climb(if edge == 0 { top } else { left }, along.map(|v| -v));
        let width = dot(hull[right], along) - dot(hull[left], along);
        let height = dot(hull[top], across) - dot(from, across);
        visit(along, width, height);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn area_along(points: &[Point], along: Point) -> f64 {
        let extent = |d: Point| {
            let dots = points.iter().map(|p| p[0] * d[0] + p[1] * d[1]);
            let (low, high) = dots.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
                (l.min(v), h.max(v))
            });
            high - low
        };
        extent(along) * extent([-along[1], along[0]])
    }

    #[test]
    fn a_turned_rectangle_is_found() {
        let (sin, cos) = 0.3f64.sin_cos();
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 5.0], [0.0, 5.0], [0.5, 2.0]];
        let turned = corners.map(|[x, y]| [cos * x - sin * y, sin * x + cos * y]);
        let along = longer_side(turned.to_vec());
        assert!((along[0] * -sin + along[1] * cos).abs() > 1.0 - 1e-12);
    }

    #[test]
    fn points_without_extent_have_a_direction() {
        assert_eq!(longer_side(vec![]), [1.0, 0.0]);
        assert_eq!(longer_side(vec![[2.0, 3.0]; 4]), [1.0, 0.0]);
        let line = longer_side(vec![[0.0, 0.0], [3.0, 4.0], [1.5, 2.0]]);
        assert!((line[0] * 0.6 + line[1] * 0.8).abs() > 1.0 - 1e-12);
    }

    proptest! {
        #[test]
        fn no_direction_between_a_pair_of_points_is_smaller(
            points in proptest::collection::vec([-8i32..8, -8i32..8], 3..30),
        ) {
            let points: Vec<Point> = points.iter().map(|p| p.map(f64::from)).collect();
            let found = area_along(&points, longer_side(points.clone()));
            for p in &points {
                for q in &points {
                    let d = [q[0] - p[0], q[1] - p[1]];
                    let length = d[0].hypot(d[1]);
                    if length > 0.0 {
                        let area = area_along(&points, d.map(|v| v / length));
                        prop_assert!(found <= area + 1e-9, "{} is not under {}", found, area);
                    }
                }
            }
        }
    }
}
