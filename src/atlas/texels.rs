//! Which texels a triangle owns: the one rasteriser that colour transfer, fill, export and the
//! proof of num_shared_texels agree on.
//!
//! A triangle owns a texel when it contains the texel's centre (x + ½, y + ½). Corners are
//! rounded to a grid of [`SUBTEXELS`] steps per texel and everything after that is exact integer
//! arithmetic, so two triangles that share an edge never both own a texel on it and leave none
//! out: a centre that lies on an edge belongs to the triangle that contains the centre moved by
//! (ε, ε²), which is the top-left rule of graphics hardware for v down.
//!
//! pack puts corners on the grid before it writes them to the layout. The grid is
//! coarse enough for `f32` to hold every corner of a page of up to [`MAX_PAGE_TEXEL`] texels
//! exactly, so rounding here changes nothing in such a layout. Corners from elsewhere are rounded
//! to the nearest grid point and clamped to ±131 072 texels; a triangle with a corner that is not
//! finite owns nothing. Either orientation is accepted. A triangle of no area on the grid owns
//! nothing.

/// Grid steps per texel, a power of two.
pub const SUBTEXELS: i32 = 1024;

/// Largest page side: 14 bits of texel and 10 of subtexel fill an `f32`'s mantissa.
pub const MAX_PAGE_TEXEL: u32 = 1 << 14;

const SUBTEXELS_I64: i64 = SUBTEXELS as i64;

/// Differences of clamped corners stay under 2²⁸, so edge functions stay under 2⁵⁸.
const MAX_SUBTEXEL: f64 = (1u64 << 27) as f64;

/// A corner on the grid, in subtexels.
pub(crate) type SubtexelPoint = [i64; 2];

/// The nearest grid point, in texels; NaN stays NaN.
pub fn snap_to_grid(coordinate_texel: f64) -> f64 {
    (coordinate_texel * f64::from(SUBTEXELS)).round() / f64::from(SUBTEXELS)
}

/// Calls `visit(x, y, barycentric)` for each texel of a page of up to [`MAX_PAGE_TEXEL`]² that the
/// triangle owns, row by row from the top, left to right. Barycentric weights are those of the
/// texel's centre, in the order of the corners, each in [0, 1].
pub fn for_each_texel(corners_texel: &[[f32; 2]; 3], visit: impl FnMut(u32, u32, [f32; 3])) {
    for_each_texel_within(corners_texel, [MAX_PAGE_TEXEL; 2], visit);
}

/// [`for_each_texel`] for a page of the given width and height: what lies outside is left out.
pub fn for_each_texel_within(
    corners_texel: &[[f32; 2]; 3],
    page_size_texel: [u32; 2],
    visit: impl FnMut(u32, u32, [f32; 3]),
) {
    if let Some(corners) = subtexel_corners(corners_texel) {
        for_each_texel_of(&corners, page_size_texel, visit);
    }
}

/// The corners on the grid; nothing when one is not finite.
pub(crate) fn subtexel_corners(corners_texel: &[[f32; 2]; 3]) -> Option<[SubtexelPoint; 3]> {
    let all_finite = corners_texel.iter().flatten().all(|c| c.is_finite());
    all_finite.then(|| corners_texel.map(|corner| corner.map(|c| subtexel(f64::from(c)))))
}

/// The nearest grid point in subtexels, clamped; NaN becomes 0.
pub(crate) fn subtexel(coordinate_texel: f64) -> i64 {
    let rounded = (coordinate_texel * f64::from(SUBTEXELS)).round();
    #[expect(clippy::cast_possible_truncation, reason = "clamped to ±2²⁷")]
    let subtexel = rounded.clamp(-MAX_SUBTEXEL, MAX_SUBTEXEL) as i64;
    subtexel
}

/// Twice the signed area in square subtexels.
pub(crate) fn double_area(corners: &[SubtexelPoint; 3]) -> i64 {
    let [a, b, c] = corners;
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// `value(p) = slope_x·x + slope_y·y + offset`, positive inside, for one edge.
struct EdgeFunction {
    slope_x: i64,
    slope_y: i64,
    offset: i64,
    /// Smallest value that counts as inside: 0 when the edge owns the centres on it, else 1.
    threshold: i64,
}

impl EdgeFunction {
    fn new(from: SubtexelPoint, to: SubtexelPoint) -> Self {
        let slope_x = from[1] - to[1];
        let slope_y = to[0] - from[0];
        let owns_its_points = slope_x > 0 || (slope_x == 0 && slope_y > 0);
        Self {
            slope_x,
            slope_y,
            offset: -(slope_x * from[0] + slope_y * from[1]),
            threshold: i64::from(!owns_its_points),
        }
    }

    /// Value at the centre of texel (0, `y`).
    fn at_row(&self, y: i64) -> i64 {
        let half = SUBTEXELS_I64 / 2;
        self.slope_x * half + self.slope_y * (y * SUBTEXELS_I64 + half) + self.offset
    }

    /// Change of the value from one texel to the next one to the right.
    fn step(&self) -> i64 {
        self.slope_x * SUBTEXELS_I64
    }

    /// Narrows `first..=last` to the texels of the row that are inside.
    fn narrow(&self, value_at_row: i64, first: &mut i64, last: &mut i64) {
        let missing = self.threshold - value_at_row;
        let step = self.step();
        if step > 0 {
            *first = (*first).max(div_ceil(missing, step));
        } else if step < 0 {
            *last = (*last).min((-missing).div_euclid(-step));
        } else if missing > 0 {
            *last = *first - 1;
        }
    }
}

/// Quotient rounded up, for a positive divisor.
fn div_ceil(dividend: i64, divisor: i64) -> i64 {
    -(-dividend).div_euclid(divisor)
}

/// Texel rows or columns of `0..size` whose centres lie in the closed interval of subtexels.
fn centres_within(low: i64, high: i64, size: u32) -> (i64, i64) {
    let half = SUBTEXELS_I64 / 2;
    let first = div_ceil(low - half, SUBTEXELS_I64).max(0);
    let last = (high - half)
        .div_euclid(SUBTEXELS_I64)
        .min(i64::from(size) - 1);
    (first, last)
}

pub(crate) fn for_each_texel_of(
    corners: &[SubtexelPoint; 3],
    page_size_texel: [u32; 2],
    mut visit: impl FnMut(u32, u32, [f32; 3]),
) {
    let area = double_area(corners);
    if area == 0 {
        return;
    }
    let [a, b, c] = *corners;
    // Each edge faces the corner whose weight its value is.
    let edges = if area > 0 {
        [(b, c), (c, a), (a, b)]
    } else {
        [(c, b), (a, c), (b, a)]
    }
    .map(|(from, to)| EdgeFunction::new(from, to));
    let inverse_area = 1.0 / area.unsigned_abs() as f64;

    let extent = |axis: usize| {
        let coordinates = corners.map(|corner| corner[axis]);
        let [p, q, r] = coordinates;
        centres_within(p.min(q).min(r), p.max(q).max(r), page_size_texel[axis])
    };
    let (first_column, last_column) = extent(0);
    let (first_row, last_row) = extent(1);
    for y in first_row..=last_row {
        let (mut first, mut last) = (first_column, last_column);
        let at_row = edges.each_ref().map(|edge| edge.at_row(y));
        for (edge, value) in edges.iter().zip(at_row) {
            edge.narrow(value, &mut first, &mut last);
        }
        for x in first..=last {
            let weights: [f32; 3] = std::array::from_fn(|k| {
                let value = at_row[k] + edges[k].step() * x;
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
                let weight = (value as f64 * inverse_area) as f32;
                weight.min(1.0)
            });
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clipped to the page"
            )]
            visit(x as u32, y as u32, weights);
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(
        clippy::cast_possible_truncation,
        reason = "test coordinates are small"
    )]

    use proptest::prelude::*;

    use super::*;

    fn owned(corners: &[[f32; 2]; 3]) -> Vec<(u32, u32)> {
        let mut texels = Vec::new();
        for_each_texel(corners, |x, y, _| texels.push((x, y)));
        texels
    }

    /// Independent: the centre moved by (ε, ε²), in 128-bit integers of half a subtexel, with the
    /// sign of each orientation as a polynomial in ε.
    fn owns_by_perturbation(corners: &[[f32; 2]; 3], x: u32, y: u32) -> bool {
        let grid = corners.map(|c| c.map(|v| 2 * (f64::from(v) * 1024.0).round() as i128));
        let p = [i128::from(x) * 2048 + 1024, i128::from(y) * 2048 + 1024];
        let side = |a: [i128; 2], b: [i128; 2]| {
            let d = [b[0] - a[0], b[1] - a[1]];
            let constant = d[0] * (p[1] - a[1]) - d[1] * (p[0] - a[0]);
            // + ε·(−d.y) + ε²·d.x
            [constant, -d[1], d[0]]
                .into_iter()
                .map(i128::signum)
                .find(|s| *s != 0)
                .unwrap_or(0)
        };
        let [a, b, c] = grid;
        let sides = [side(a, b), side(b, c), side(c, a)];
        sides == [1; 3] || sides == [-1; 3]
    }

    #[test]
    fn square_split_in_two_covers_each_centre_once() {
        let lower = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]];
        let upper = [[0.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
        let mut all = owned(&lower);
        all.extend(owned(&upper));
        all.sort_unstable();
        let expected: Vec<_> = (0..4).flat_map(|x| (0..4).map(move |y| (x, y))).collect();
        assert_eq!(all, expected);
    }

    #[test]
    fn edges_through_centres_belong_to_the_top_left_side() {
        // Corners on centres: the top and left edges own their centres, the others do not.
        let corners = [[0.5, 0.5], [3.5, 0.5], [0.5, 3.5]];
        assert_eq!(
            owned(&corners),
            [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2)]
        );
        let turned = [[3.5, 3.5], [0.5, 3.5], [3.5, 0.5]];
        assert_eq!(
            owned(&turned),
            [(2, 1), (1, 2), (2, 2)].map(|(x, y)| (x, y))
        );
    }

    #[test]
    fn weights_interpolate_the_centre() {
        let corners = [[1.25f32, 0.5], [13.0, 4.75], [3.5, 17.0]];
        for corners in [corners, [corners[1], corners[0], corners[2]]] {
            let mut num_texels = 0;
            for_each_texel(&corners, |x, y, weights| {
                num_texels += 1;
                assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
                for (axis, centre) in [x as f32 + 0.5, y as f32 + 0.5].into_iter().enumerate() {
                    let point: f32 = (0..3).map(|k| weights[k] * corners[k][axis]).sum();
                    assert!((point - centre).abs() < 1e-5, "{point} is not {centre}");
                }
            });
            assert!((80..100).contains(&num_texels));
        }
    }

    #[test]
    fn wild_corners_own_what_is_on_the_page_or_nothing() {
        assert_eq!(owned(&[[0.0, f32::NAN], [9.0, 0.0], [9.0, 9.0]]), []);
        assert_eq!(owned(&[[f32::INFINITY, 0.0], [9.0, 0.0], [9.0, 9.0]]), []);
        assert_eq!(owned(&[[2.0, 2.0]; 3]), []);
        assert_eq!(owned(&[[-9.0, -9.0], [-1.0, -9.0], [-9.0, -1.0]]), []);
        let huge = [[-1e30, -1e30], [1e30, -1e30], [0.0, 1e30]];
        let mut num_texels = 0;
        for_each_texel_within(&huge, [7, 5], |x, y, _| {
            assert!(x < 7 && y < 5);
            num_texels += 1;
        });
        assert_eq!(num_texels, 35);
    }

    fn corner() -> impl Strategy<Value = [f32; 2]> {
        // Eighths of a texel, so that centres fall on edges and corners often.
        prop_oneof![
            [0i32..96, 0i32..96].prop_map(|c| c.map(|v| v as f32 / 8.0)),
            [0.0f32..12.0, 0.0f32..12.0],
        ]
    }

    /// Splits the triangles of a square at random points: a triangulation with corners and
    /// edges anywhere, where each centre must be owned once.
    fn triangulate(points: &[[f32; 2]]) -> Vec<[[f32; 2]; 3]> {
        let mut triangles = vec![
            [[0.0, 0.0], [12.0, 0.0], [12.0, 12.0]],
            [[0.0, 0.0], [12.0, 12.0], [0.0, 12.0]],
        ];
        let snap = |p: [f32; 2]| p.map(|c| snap_to_grid(f64::from(c)) as f32);
        let grid = |p: [f32; 2]| p.map(|c| subtexel(f64::from(c)));
        for point in points.iter().map(|p| snap(*p)) {
            let inside = triangles.iter().position(|[a, b, c]| {
                [(a, b), (b, c), (c, a)]
                    .iter()
                    .all(|(p, q)| double_area(&[grid(**p), grid(**q), grid(point)]) > 0)
            });
            if let Some([a, b, c]) = inside.map(|index| triangles.swap_remove(index)) {
                triangles.extend([[a, b, point], [b, c, point], [c, a, point]]);
            }
        }
        triangles
    }

    proptest! {
        #[test]
        fn agrees_with_exact_point_in_triangle(corners in [corner(), corner(), corner()]) {
            let mut expected = Vec::new();
            for y in 0..13 {
                for x in 0..13 {
                    if owns_by_perturbation(&corners, x, y) {
                        expected.push((x, y));
                    }
                }
            }
            prop_assert_eq!(owned(&corners), expected);
        }

        #[test]
        fn triangulations_partition_the_texels(
            points in proptest::collection::vec(corner(), 1..40),
        ) {
            let mut num_owners = [0; 144];
            for triangle in triangulate(&points) {
                for (x, y) in owned(&triangle) {
                    num_owners[(y * 12 + x) as usize] += 1;
                }
            }
            prop_assert_eq!(num_owners, [1; 144]);
        }
    }
}
