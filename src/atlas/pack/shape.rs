//! From a chart in metres to pieces in subtexels: turned, scaled, put on the grid, and free of
//! shared texels by construction.

use super::PlaneChart;
use super::bounding_rect;
use crate::atlas::proof::TexelSet;
use crate::atlas::texels::{self, MAX_PAGE_TEXEL, SUBTEXELS, SubtexelPoint};
use crate::mesh::TriangleId;

/// Where charts start within their first texel, tried in order until no texel is shared: rounding
/// to the grid can turn a needle over, and then it may claim the centre that it lies next to.
const STARTS_SUBTEXEL: [[i64; 2]; 4] = [[0, 0], [337, 211], [149, 683], [701, 467]];

/// Corners of a triangle that owns just the texel (0, 0), counter-clockwise seen with y up.
const OWN_TEXEL: [SubtexelPoint; 3] = [[256, 768], [768, 768], [512, 256]];

/// Corners beyond this are no layout: their extent would overflow.
const MAX_COORDINATE_M: f64 = 1e100;

/// The best rectangle of a chart, which does not depend on the density.
pub(super) struct ChartFrame {
    along: [f64; 2],
    /// Smallest coordinates along the sides.
    min: [f64; 2],
    /// Length of the sides, the longer one first.
    pub(super) extent_m: [f64; 2],
    /// Of all triangles together.
    pub(super) area_m2: f64,
    is_laid_out: Vec<bool>,
}

impl ChartFrame {
    pub(super) fn of(chart: &impl PlaneChart) -> Self {
        let is_laid_out: Vec<bool> = chart
            .corners_m()
            .iter()
            .map(|corners| {
                corners
                    .iter()
                    .flatten()
                    .all(|c| c.abs() <= MAX_COORDINATE_M)
            })
            .collect();
        let points = || {
            let corners = chart.corners_m().iter().zip(&is_laid_out);
            corners.filter(|(_, ok)| **ok).flat_map(|(c, _)| *c)
        };
        let along = bounding_rect::longer_side(points().collect());
        let (mut min, mut max) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points().map(|p| turned(along, p)) {
            for axis in 0..2 {
                min[axis] = min[axis].min(point[axis]);
                max[axis] = max[axis].max(point[axis]);
            }
        }
        if min[0] > max[0] {
            (min, max) = ([0.0; 2], [0.0; 2]);
        }
        Self {
            along,
            min,
            extent_m: [max[0] - min[0], max[1] - min[1]],
            area_m2: chart
                .corners_m()
                .iter()
                .zip(&is_laid_out)
                .filter(|(_, ok)| **ok)
                .map(|([a, b, c], _)| {
                    0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs()
                })
                .sum(),
            is_laid_out,
        }
    }

    /// How much smaller than asked the chart is drawn to be at most `room_texel` long.
    pub(super) fn scale(&self, texels_per_m: f64, room_texel: u32) -> f64 {
        let longest_texel = self.extent_m[0].max(self.extent_m[1]) * texels_per_m;
        if longest_texel > f64::from(room_texel) {
            f64::from(room_texel) / longest_texel
        } else {
            1.0
        }
    }

    /// Place in subtexels from the top left of the chart, v down.
    fn place(&self, point_m: [f64; 2], subtexels_per_m: f64) -> SubtexelPoint {
        let point = turned(self.along, point_m);
        let right = (point[0] - self.min[0]) * subtexels_per_m;
        let up = (point[1] - self.min[1]) * subtexels_per_m;
        let height = self.extent_m[1] * subtexels_per_m;
        [right, height - up].map(|v| texels::subtexel(v / f64::from(SUBTEXELS)).max(0))
    }
}

fn turned(along: [f64; 2], p: [f64; 2]) -> [f64; 2] {
    [
        along[0] * p[0] + along[1] * p[1],
        along[0] * p[1] - along[1] * p[0],
    ]
}

/// What becomes one chart of the atlas.
pub(super) struct Piece {
    pub(super) triangles: Vec<TriangleId>,
    /// From the top left of the piece.
    pub(super) corners: Vec<[SubtexelPoint; 3]>,
    /// Whole texels that hold the corners.
    pub(super) size_texel: [u32; 2],
    /// Texels per metre of the chart that it is of.
    pub(super) texels_per_m: f64,
    /// What its triangles own where it is not turned.
    pub(super) claims: Claims,
    /// A triangle around the centre of the only texel.
    pub(super) is_own_texel: bool,
}

impl Piece {
    fn own_texel(triangle: TriangleId, texels_per_m: f64) -> Self {
        Self {
            triangles: vec![triangle],
            corners: vec![OWN_TEXEL],
            size_texel: [1, 1],
            texels_per_m,
            claims: Claims {
                num_owned_texels: 1,
                num_subtexel_triangles: 0,
            },
            is_own_texel: true,
        }
    }

    /// Moves corners to start in the first texel and finds the size.
    fn fitted(
        triangles: Vec<TriangleId>,
        mut corners: Vec<[SubtexelPoint; 3]>,
        texels_per_m: f64,
    ) -> Self {
        let side = i64::from(SUBTEXELS);
        let mut size_texel = [1; 2];
        for (axis, size) in size_texel.iter_mut().enumerate() {
            let along_axis = || corners.iter().flatten().map(|c| c[axis]);
            let low = along_axis().min().unwrap_or(0).div_euclid(side) * side;
            let high = along_axis().max().unwrap_or(0) - low;
            let texels = (high + side - 1).div_euclid(side);
            *size = u32::try_from(texels).unwrap_or(MAX_PAGE_TEXEL).max(1);
            for corner in corners.iter_mut().flatten() {
                corner[axis] -= low;
            }
        }
        Self {
            triangles,
            corners,
            size_texel,
            texels_per_m,
            claims: Claims::default(),
            is_own_texel: false,
        }
    }
}

/// The pieces of a chart, and how many of its triangles needed what.
pub(super) struct ShapedChart {
    /// The chart, then the triangles that could not stay in it.
    pub(super) pieces: Vec<Piece>,
    texels_per_m: f64,
    pub(super) num_moved_triangles: usize,
}

pub(super) fn shape(
    chart: &impl PlaneChart,
    frame: &ChartFrame,
    texels_per_m: f64,
    room_texel: u32,
) -> ShapedChart {
    let texels_per_m = texels_per_m * frame.scale(texels_per_m, room_texel);
    let subtexels_per_m = texels_per_m * f64::from(SUBTEXELS);
    let mut triangles = Vec::with_capacity(chart.triangles().len());
    let mut corners = Vec::with_capacity(chart.triangles().len());
    let mut shaped = ShapedChart {
        pieces: Vec::new(),
        texels_per_m,
        num_moved_triangles: 0,
    };
    let mut degenerate = Vec::new();
    let in_plane = chart.corners_m().iter().zip(&frame.is_laid_out);
    for (&triangle, (corners_m, is_laid_out)) in chart.triangles().iter().zip(in_plane) {
        let placed = corners_m.map(|p| frame.place(p, subtexels_per_m));
        if *is_laid_out && texels::double_area(&placed) != 0 {
            triangles.push(triangle);
            corners.push(placed);
        } else {
            degenerate.push(triangle);
        }
    }
    if !triangles.is_empty() {
        shaped.add_chart(triangles, corners);
    }
    shaped.push_own_texels(degenerate);
    shaped
}

impl ShapedChart {
    fn add_chart(&mut self, triangles: Vec<TriangleId>, corners: Vec<[SubtexelPoint; 3]>) {
        let texels_per_m = self.texels_per_m;
        let at_start = |start: [i64; 2]| {
            let moved = |corner: SubtexelPoint| [corner[0] + start[0], corner[1] + start[1]];
            let corners = corners.iter().map(|c| c.map(moved)).collect();
            Piece::fitted(triangles.clone(), corners, texels_per_m)
        };
        let mut is_shared = false;
        for piece in STARTS_SUBTEXEL.map(at_start) {
            match claim_all(&piece.corners, piece.size_texel) {
                None => is_shared = true,
                Some(claims) if claims.num_owned_texels > 0 => {
                    self.pieces.push(Piece { claims, ..piece });
                    return;
                }
                Some(_) => {}
            }
        }
        if !is_shared {
            self.push_own_texels(triangles);
            return;
        }
        let (kept, moved) = split_by_owner(&at_start(STARTS_SUBTEXEL[0]));
        self.num_moved_triangles += moved.triangles.len();
        let apart = moved.triangles.into_iter().zip(moved.corners);
        let apart = apart.map(|(triangle, corners)| (vec![triangle], vec![corners]));
        for (triangles, corners) in std::iter::once((kept.triangles, kept.corners)).chain(apart) {
            let piece = Piece::fitted(triangles, corners, texels_per_m);
            match claim_all(&piece.corners, piece.size_texel) {
                Some(claims) if claims.num_owned_texels > 0 => {
                    self.pieces.push(Piece { claims, ..piece });
                }
                _ => self.push_own_texels(piece.triangles),
            }
        }
    }

    fn push_own_texels(&mut self, triangles: Vec<TriangleId>) {
        let texels_per_m = self.texels_per_m;
        let own = triangles
            .into_iter()
            .map(|triangle| Piece::own_texel(triangle, texels_per_m));
        self.pieces.extend(own);
    }
}

/// What the triangles of a piece own.
#[derive(Clone, Copy, Default)]
pub(super) struct Claims {
    pub(super) num_owned_texels: usize,
    pub(super) num_subtexel_triangles: usize,
}

/// Lets each triangle claim its texels among the first `size_texel`; nothing when two claim the
/// same.
pub(super) fn claim_all(corners: &[[SubtexelPoint; 3]], size_texel: [u32; 2]) -> Option<Claims> {
    let [width, height] = size_texel;
    let mut owned = TexelSet::new(width as usize, height as usize);
    let mut claims = Claims::default();
    for corners in corners {
        let (mut num_texels, mut is_alone) = (0, true);
        texels::for_each_texel_of(corners, size_texel, |x, y, _| {
            num_texels += 1;
            is_alone &= owned.insert(x, y);
        });
        if !is_alone {
            return None;
        }
        claims.num_owned_texels += num_texels;
        claims.num_subtexel_triangles += usize::from(num_texels == 0);
    }
    Some(claims)
}

#[derive(Default)]
struct TriangleList {
    triangles: Vec<TriangleId>,
    corners: Vec<[SubtexelPoint; 3]>,
}

/// First come, first served: triangles that would claim a texel of an earlier one go apart.
fn split_by_owner(piece: &Piece) -> (TriangleList, TriangleList) {
    let [width, height] = piece.size_texel.map(|side| side as usize);
    let mut is_owned = vec![false; width * height];
    let (mut kept, mut moved) = (TriangleList::default(), TriangleList::default());
    let mut claimed = Vec::new();
    for (&triangle, corners) in piece.triangles.iter().zip(&piece.corners) {
        claimed.clear();
        texels::for_each_texel_of(corners, piece.size_texel, |x, y, _| {
            claimed.push(y as usize * width + x as usize);
        });
        let list = if claimed.iter().any(|&texel| is_owned[texel]) {
            &mut moved
        } else {
            for &texel in &claimed {
                is_owned[texel] = true;
            }
            &mut kept
        };
        list.triangles.push(triangle);
        list.corners.push(*corners);
    }
    (kept, moved)
}
