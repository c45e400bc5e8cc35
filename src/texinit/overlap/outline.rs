//! A proof that no triangles overlap, by their outline alone, whatever their shapes.
//!
//! Counter-clockwise triangles cover a point as often as their sides wind around it, those that
//! run in opposite directions cancelled. Where the sides left over are simple loops that do not
//! meet, what is left of each is covered once more than what is right of it; and where nothing is
//! right of any, no point is covered twice. Orientation signs decide all of it: exact.
//!
//! Time: sorting the sides, and a grid over the outline. A fan of thousands of slivers, in which
//! every two triangles are candidates for each other, has a tame outline.

use super::detect::orientation;
use super::grid::{Bounds, CellLists, Grid};

type Point = [f64; 2];

/// Whether the outline proves that no two of some counter-clockwise triangles overlap. `false`
/// says nothing: loops may merely touch, or cost more than `max_tests`.
pub(super) fn covers_nothing_twice(triangles: &[Option<[Point; 3]>], max_tests: usize) -> bool {
    let Some(sides) = uncancelled_sides(triangles) else {
        return false;
    };
    let Some(outline) = Outline::new(sides) else {
        return false;
    };
    outline.is_simple(max_tests) && outline.has_nothing_outside(max_tests)
}

fn bits(p: Point) -> [u64; 2] {
    // Adding zero makes −0 and 0 the same.
    p.map(|v| (v + 0.0).to_bits())
}

/// Sides without one in the opposite direction, ordered by their start; nothing when one is
/// there more than once.
fn uncancelled_sides(triangles: &[Option<[Point; 3]>]) -> Option<Vec<[Point; 2]>> {
    let mut sides: Vec<([[u64; 2]; 2], bool, [Point; 2])> = Vec::new();
    for [a, b, c] in triangles.iter().flatten() {
        for side in [[*a, *b], [*b, *c], [*c, *a]] {
            let [from, to] = side.map(bits);
            sides.push(([from.min(to), from.max(to)], from < to, side));
        }
    }
    sides.sort_unstable_by(|x, y| x.0.cmp(&y.0).then(x.1.cmp(&y.1)));
    let mut left = Vec::new();
    for group in sides.chunk_by(|x, y| x.0 == y.0) {
        let num_forth = group.iter().filter(|side| side.1).count();
        let num_back = group.len() - num_forth;
        match num_forth.abs_diff(num_back) {
            0 => {}
            1 => {
                let is_forth = num_forth > num_back;
                left.extend(group.iter().find(|side| side.1 == is_forth).map(|s| s.2));
            }
            _ => return None,
        }
    }
    left.sort_unstable_by_key(|side| bits(side[0]));
    Some(left)
}

/// Loops of directed sides.
struct Outline {
    sides: Vec<[Point; 2]>,
    /// Per side: the one that follows it.
    next: Vec<usize>,
    /// Per loop: one of its sides.
    first: Vec<usize>,
    /// Per side: its loop.
    loop_of: Vec<usize>,
}

impl Outline {
    /// From sides ordered by their start; nothing when two start at one point.
    fn new(sides: Vec<[Point; 2]>) -> Option<Self> {
        let starts: Vec<[u64; 2]> = sides.iter().map(|side| bits(side[0])).collect();
        if starts.windows(2).any(|pair| pair[0] == pair[1]) {
            return None;
        }
        // As many sides end at a point as start there.
        let next = sides
            .iter()
            .map(|side| starts.binary_search(&bits(side[1])));
        let next: Vec<usize> = next.collect::<Result<_, _>>().ok()?;
        let mut loop_of = vec![usize::MAX; sides.len()];
        let mut first = Vec::new();
        for start in 0..sides.len() {
            let mut at = start;
            while loop_of[at] == usize::MAX {
                loop_of[at] = first.len();
                at = next[at];
            }
            if at == start && loop_of[start] == first.len() {
                first.push(start);
            }
        }
        Some(Self {
            sides,
            next,
            first,
            loop_of,
        })
    }

    /// Whether no two sides meet but where one follows the other.
    fn is_simple(&self, max_tests: usize) -> bool {
        let shapes: Vec<_> = self.sides.iter().map(|&[a, b]| Some([a, b, b])).collect();
        let bounds: Vec<Bounds> = shapes.iter().flatten().map(Bounds::of).collect();
        let grid = Grid::fit(&shapes, &bounds);
        let for_each_cell = |side: usize, visit: &mut dyn FnMut(usize)| {
            let [a, b] = self.sides[side];
            grid.for_each_cell(&[a, b, b], &bounds[side], visit);
        };
        let lists = CellLists::new(self.sides.len(), grid.num_cells(), for_each_cell);
        let mut num_tests = 0;
        for cell in 0..grid.num_cells() {
            let members = lists.members(cell);
            num_tests += members.len() * members.len() / 2;
            if num_tests > max_tests {
                return false;
            }
            for (k, &first) in members.iter().enumerate() {
                let others = &members[k + 1..];
                if others
                    .iter()
                    .any(|&o| self.meet(first as usize, o as usize))
                {
                    return false;
                }
            }
        }
        true
    }

    fn meet(&self, first: usize, second: usize) -> bool {
        if self.next[first] == second {
            return turns_back(self.sides[first], self.sides[second][1]);
        }
        if self.next[second] == first {
            return turns_back(self.sides[second], self.sides[first][1]);
        }
        segments_meet(self.sides[first], self.sides[second])
    }

    /// Whether nothing is covered just right of each loop, for loops that do not meet.
    fn has_nothing_outside(&self, max_tests: usize) -> bool {
        if self.first.len().saturating_mul(self.sides.len()) > max_tests {
            return false;
        }
        let windings = (0..self.first.len()).map(|index| {
            let point = self.sides[self.first[index]][0];
            let mut winding = 0i64;
            let mut lowest = self.first[index];
            for (side, &[from, to]) in self.sides.iter().enumerate() {
                if self.loop_of[side] == index {
                    if to < self.sides[lowest][1] {
                        lowest = side;
                    }
                } else if (from[1] <= point[1]) != (to[1] <= point[1]) {
                    // A side that crosses the ray from the point to the right.
                    let is_up = to[1] > point[1];
                    let side = orientation(from, to, point);
                    winding += i64::from(is_up && side > 0.0) - i64::from(!is_up && side < 0.0);
                }
            }
            // At its lowest corner a loop turns the way it goes round; right of a clockwise one is
            // its inside, which it winds around once less.
            let [before, corner] = self.sides[lowest];
            let is_clockwise = orientation(before, corner, self.sides[self.next[lowest]][1]) < 0.0;
            winding - i64::from(is_clockwise)
        });
        windings.into_iter().all(|winding| winding == 0)
    }
}

/// Whether a side is followed by one that runs back over it.
fn turns_back([from, corner]: [Point; 2], to: Point) -> bool {
    let is_same_way = |axis: usize| (from[axis] < corner[axis]) == (to[axis] < corner[axis]);
    let is_upright = from[0] == corner[0];
    orientation(from, corner, to) == 0.0 && is_same_way(usize::from(is_upright))
}

/// Whether two closed segments have a point in common.
fn segments_meet([a, b]: [Point; 2], [c, d]: [Point; 2]) -> bool {
    let apart = |axis: usize| {
        a[axis].max(b[axis]) < c[axis].min(d[axis]) || c[axis].max(d[axis]) < a[axis].min(b[axis])
    };
    if apart(0) || apart(1) {
        return false;
    }
    let on_one_side = |x: f64, y: f64| (x > 0.0 && y > 0.0) || (x < 0.0 && y < 0.0);
    !on_one_side(orientation(a, b, c), orientation(a, b, d))
        && !on_one_side(orientation(c, d, a), orientation(c, d, b))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::detect::counter_clockwise;
    use super::super::detect::tests::pairs_by_brute_force;
    use super::*;

    fn proved(corners: &[[Point; 3]]) -> bool {
        let ccw: Vec<_> = corners.iter().map(|c| counter_clockwise(*c)).collect();
        covers_nothing_twice(&ccw, 1 << 20)
    }

    fn at(angle: f64, radius: f64) -> Point {
        [radius * angle.cos(), radius * angle.sin()]
    }

    /// A strip of quads between two circles.
    fn ring(inner: f64, outer: f64, num_turns: f64) -> Vec<[Point; 3]> {
        let num = (40.0 * num_turns) as usize;
        let corner = |k: usize, radius| {
            let k = if num_turns == 1.0 { k % num } else { k };
            at(k as f64 / 40.0 * std::f64::consts::TAU, radius)
        };
        (0..num)
            .flat_map(|k| {
                let [a, b] = [corner(k, inner), corner(k, outer)];
                let [d, c] = [corner(k + 1, inner), corner(k + 1, outer)];
                [[a, b, c], [a, c, d]]
            })
            .collect()
    }

    #[test]
    fn rings_within_rings_are_proved_and_laid_over_each_other_not() {
        let apart = [ring(1.0, 2.0, 1.0), ring(2.5, 3.0, 1.0)].concat();
        assert!(proved(&apart));
        let over = [ring(1.0, 2.0, 1.0), ring(0.5, 3.0, 1.0)].concat();
        assert!(!proved(&over));
        assert!(proved(&ring(1.0, 2.0, 0.9)));
        assert!(!proved(&ring(1.0, 2.0, 1.5)));
        let moved = ring(1.0, 2.0, 1.0);
        let moved = moved.iter().map(|t| t.map(|p| [p[0] + 10.0, p[1]]));
        let beside: Vec<_> = ring(1.0, 2.0, 1.0).into_iter().chain(moved).collect();
        assert!(proved(&beside));
    }

    #[test]
    fn a_fan_is_proved_and_a_fold_in_it_not() {
        let spoke = |k: usize| at(k as f64 / 2000.0 * std::f64::consts::TAU, 1.0);
        let mut fan: Vec<_> = (0..2000)
            .map(|k| [[0.0, 0.0], spoke(k), spoke((k + 1) % 2000)])
            .collect();
        assert!(proved(&fan));
        fan[700][2] = spoke(703);
        fan[701][1] = spoke(703);
        assert!(!proved(&fan));
        assert!(proved(&[]));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(512))]
        /// A proof is never wrong, and a grid whose vertices hardly move is proved.
        #[test]
        fn what_is_proved_does_not_overlap(
            moved in proptest::collection::vec([-4i32..5, -4i32..5], 36),
            by in 0u32..3,
            flipped in any::<u64>(),
        ) {
            let vertex = |i: usize, j: usize| {
                let [x, y] = moved[j * 6 + i].map(|m| f64::from(m) * [0.0, 0.06, 0.4][by as usize]);
                [i as f64 + x, j as f64 + y]
            };
            let mut corners = Vec::new();
            for (i, j) in (0..5).flat_map(|j| (0..5).map(move |i| (i, j))) {
                let [a, b, c, d] =
                    [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
                corners.extend([[a, b, c], [a, c, d]]);
            }
            // Holes.
            let mut keep = (0..64).map(|k| by == 0 || flipped >> k & 3 != 3).cycle();
            corners.retain(|_| keep.next() == Some(true));
            let is_proved = proved(&corners);
            if is_proved {
                prop_assert_eq!(pairs_by_brute_force(&corners).len(), 0);
            }
            prop_assert!(is_proved || by > 0);
        }
    }
}
