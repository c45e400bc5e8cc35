//! Who claims which texel, by point-in-triangle tests in f64: independent of the product's exact
//! ones.

#![expect(
    clippy::cast_possible_truncation,
    reason = "grids of at most a few thousand points to a side, clamped"
)]

use veneer::atlas::AtlasLayout;
use veneer::texinit::flatten::FlatChart;

/// Barycentric weight from which a centre counts as strictly inside: far above the rounding of
/// f64, far below a texel.
const INSIDE: f64 = 1e-6;

type Triangle = [[f64; 2]; 3];

/// Who is strictly inside what, point by point of a grid whose points are at halves.
pub(crate) struct Claims {
    pub(crate) size: [usize; 2],
    /// 0 nobody, 1 one triangle, 2 several.
    pub(crate) num_owners: Vec<u8>,
}

impl Claims {
    pub(crate) fn new(size: [usize; 2]) -> Self {
        Self {
            size,
            num_owners: vec![0; size[0] * size[1]],
        }
    }

    pub(crate) fn add(&mut self, [a, b, c]: &Triangle) {
        let range = |axis: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]) - 1.0;
            let high = a[axis].max(b[axis]).max(c[axis]) + 1.0;
            (low.max(0.0) as usize)..(high.max(0.0) as usize + 1).min(self.size[axis])
        };
        let doubled_area = cross(a, b, c);
        for y in range(1) {
            for x in range(0) {
                let point = [x as f64 + 0.5, y as f64 + 0.5];
                let weights = [
                    cross(b, c, &point) / doubled_area,
                    cross(c, a, &point) / doubled_area,
                    cross(a, b, &point) / doubled_area,
                ];
                // Not a number where the triangle has no area: never inside.
                if weights.iter().all(|weight| *weight > INSIDE) {
                    let num = &mut self.num_owners[y * self.size[0] + x];
                    *num = (*num + 1).min(2);
                }
            }
        }
    }

    pub(crate) fn count(&self, num_owners: u8) -> usize {
        self.num_owners.iter().filter(|n| **n == num_owners).count()
    }
}

pub(crate) fn cross(a: &[f64; 2], b: &[f64; 2], c: &[f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Per page, who claims its texels.
pub(crate) fn claims_by_page(layout: &AtlasLayout) -> Vec<Claims> {
    let size = layout.page_size_texel.map(|side| side as usize);
    let mut pages: Vec<Claims> = (0..layout.num_pages).map(|_| Claims::new(size)).collect();
    for (chart, corners) in layout.chart_of_triangle.iter().zip(&layout.corners_texel) {
        let page = layout.charts[chart.index()].page as usize;
        pages[page].add(&corners.map(|corner| corner.map(f64::from)));
    }
    pages
}

/// Texel centres that one triangle claims, and those that several claim.
pub(crate) fn claimed_texels(layout: &AtlasLayout) -> [usize; 2] {
    let pages = claims_by_page(layout);
    [1, 2].map(|num_owners| pages.iter().map(|page| page.count(num_owners)).sum())
}

/// Points of the charts' own planes that several triangles of one chart claim: what `separate`
/// alone must prevent, before packing rounds anything.
pub(crate) fn claimed_twice_in_plane(charts: &[FlatChart]) -> usize {
    charts.iter().map(claimed_twice_in_chart).sum()
}

fn claimed_twice_in_chart(chart: &FlatChart) -> usize {
    let points = || chart.corners_m.iter().flatten();
    let low = |axis: usize| points().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
    let high = |axis: usize| points().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
    let origin = [low(0), low(1)];
    let extent_m = (high(0) - origin[0]).max(high(1) - origin[1]);
    // Some twenty points to a triangle.
    let side = (20.0 * chart.triangles.len() as f64)
        .sqrt()
        .clamp(8.0, 2000.0);
    let mut claims = Claims::new([side as usize + 1; 2]);
    for corners in &chart.corners_m {
        claims.add(
            &corners.map(|[x, y]| [x - origin[0], y - origin[1]].map(|v| v / extent_m * side)),
        );
    }
    claims.count(2)
}
