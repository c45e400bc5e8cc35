//! Charts never mix in what a renderer reads: bilinear lookups anywhere in a triangle, in the pages
//! and in their box-filtered mipmaps up to the level that the gutter is for, return colours of the
//! triangle's chart alone. Each chart has one colour, so that anything else shows.

#![expect(
    clippy::cast_possible_truncation,
    reason = "texel coordinates are small"
)]

use veneer::atlas::{
    AtlasLayout, AtlasTexture, PackParams, PlaneChart, TexelSource, TexturePage, dilate_gutters,
    for_each_texel, pack,
};
use veneer::mesh::TriangleId;

struct Chart {
    triangles: Vec<TriangleId>,
    corners_m: Vec<[[f64; 2]; 3]>,
}

impl PlaneChart for Chart {
    fn triangles(&self) -> &[TriangleId] {
        &self.triangles
    }

    fn corners_m(&self) -> &[[[f64; 2]; 3]] {
        &self.corners_m
    }
}

struct Random(u64);

impl Random {
    /// A number in 0..1 (Knuth's linear congruential generator).
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / f64::from(1 << 24)
    }
}

/// Jagged stars, rings and needles, from a tenth of a texel to a hundred.
fn charts(num_charts: usize) -> (Vec<Chart>, usize) {
    let mut random = Random(7);
    let mut next_id = 0;
    let mut charts = Vec::new();
    for k in 0..num_charts {
        let radius_m = 0.6 * 0.98_f64.powi(k as i32);
        let num_spokes = 5 + k % 17;
        // Every third is a ring around a hole.
        let inner_share = if k % 3 == 0 { 0.7 } else { 0.0 };
        let radii: Vec<f64> = (0..num_spokes)
            .map(|_| radius_m * (0.8 + 0.2 * random.next()))
            .collect();
        let at = |spoke: usize, share: f64| {
            let angle = spoke as f64 / num_spokes as f64 * std::f64::consts::TAU;
            let radius = radii[spoke % num_spokes] * share;
            [
                radius * angle.cos(),
                radius * angle.sin() * if k % 5 == 0 { 0.03 } else { 1.0 },
            ]
        };
        let mut corners_m = Vec::new();
        for spoke in 0..num_spokes {
            let (outer, next_outer) = (at(spoke, 1.0), at(spoke + 1, 1.0));
            let (inner, next_inner) = (at(spoke, inner_share), at(spoke + 1, inner_share));
            corners_m.push([inner, outer, next_outer]);
            if inner_share > 0.0 {
                corners_m.push([inner, next_outer, next_inner]);
            }
        }
        let first: u32 = next_id;
        next_id += corners_m.len() as u32;
        charts.push(Chart {
            triangles: (first..next_id).map(TriangleId).collect(),
            corners_m,
        });
    }
    (charts, next_id as usize)
}

fn color_of(chart: usize) -> [u8; 3] {
    [1 + (chart % 250) as u8, 1 + (chart / 250) as u8, 255]
}

/// Each chart in its own colour, nothing where no chart is.
fn painted(layout: &AtlasLayout) -> AtlasTexture {
    let [width, height] = layout.page_size_texel;
    let mut pages = vec![TexturePage::blank(width, height); layout.num_pages as usize];
    for (corners, chart) in layout.corners_texel.iter().zip(&layout.chart_of_triangle) {
        let page = &mut pages[layout.charts[chart.index()].page as usize];
        for_each_texel(corners, |x, y, _| {
            let index = (y * width + x) as usize;
            page.srgb[index] = color_of(chart.index());
            page.source[index] = TexelSource::keyframe(0);
        });
    }
    let mut texture = AtlasTexture::from_iter(pages);
    dilate_gutters(layout, &mut texture).unwrap();
    texture
}

/// An image of a page or of one of its mipmaps.
struct Level {
    size: [usize; 2],
    color: Vec<[f64; 3]>,
}

impl Level {
    fn of(page: &TexturePage) -> Self {
        Self {
            size: [page.width as usize, page.height as usize],
            color: page.srgb.iter().map(|c| c.map(f64::from)).collect(),
        }
    }

    fn halved(&self) -> Self {
        let size = self.size.map(|side| side / 2);
        let mut color = Vec::new();
        for y in 0..size[1] {
            for x in 0..size[0] {
                let texel =
                    |dx: usize, dy: usize| self.color[(2 * y + dy) * self.size[0] + 2 * x + dx];
                let four = [texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)];
                color.push(std::array::from_fn(|k| {
                    four.iter().map(|c| c[k]).sum::<f64>() / 4.0
                }));
            }
        }
        Self { size, color }
    }

    /// Texel centres at halves, clamped to the edge. `uv` in 0..1.
    fn bilinear(&self, uv: [f64; 2]) -> [f64; 3] {
        let [x, y] = [0, 1].map(|axis| uv[axis] * self.size[axis] as f64 - 0.5);
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let texel = |dx: f64, dy: f64| {
            let column = (x.floor() + dx).clamp(0.0, self.size[0] as f64 - 1.0) as usize;
            let row = (y.floor() + dy).clamp(0.0, self.size[1] as f64 - 1.0) as usize;
            self.color[row * self.size[0] + column]
        };
        let corners = [
            ((1.0 - fx) * (1.0 - fy), texel(0.0, 0.0)),
            (fx * (1.0 - fy), texel(1.0, 0.0)),
            ((1.0 - fx) * fy, texel(0.0, 1.0)),
            (fx * fy, texel(1.0, 1.0)),
        ];
        std::array::from_fn(|k| corners.iter().map(|(weight, c)| weight * c[k]).sum())
    }
}

/// Per mipmap level: the share of lookups that saw another colour than their chart's.
fn mixed_shares(gutter_texel: u32, num_levels: usize) -> Vec<f64> {
    let (charts, num_triangles) = charts(300);
    let params = PackParams {
        gutter_texel,
        ..PackParams::default()
    };
    let (layout, report) = pack(&charts, num_triangles, 120.0, &params).unwrap();
    assert!(
        report.footprint_share > 0.75,
        "tight enough to see mixing: {report:?}"
    );
    let texture = painted(&layout);
    let mut levels: Vec<Vec<Level>> =
        vec![texture.pages.iter().map(|page| Level::of(page)).collect()];
    for level in 1..num_levels {
        levels.push(levels[level - 1].iter().map(Level::halved).collect());
    }
    let mut random = Random(3);
    let mut num_lookups = 0.0;
    let mut num_mixed = vec![0.0; num_levels];
    for (corners, chart) in layout.corners_texel.iter().zip(&layout.chart_of_triangle) {
        // Those with a texel of their own are held to no level but the first ones.
        let [a, b, c] = corners.map(|corner| corner.map(f64::from));
        let extent =
            |axis: usize| a[axis].max(b[axis]).max(c[axis]) - a[axis].min(b[axis]).min(c[axis]);
        if extent(0) <= 0.5 && extent(1) <= 0.5 {
            continue;
        }
        let page = layout.charts[chart.index()].page as usize;
        let expected = color_of(chart.index()).map(f64::from);
        for lookup in 0..40 {
            let (mut s, mut t) = (random.next(), random.next());
            if s + t > 1.0 {
                (s, t) = (1.0 - s, 1.0 - t);
            }
            let [s, t] = match lookup {
                0 => [0.0, 0.0],
                1 => [1.0, 0.0],
                2 => [0.0, 1.0],
                3..10 => [s, 0.0],
                10..17 => [0.0, t],
                17..24 => [s, 1.0 - s],
                _ => [s, t],
            };
            let uv = [0, 1].map(|axis| {
                let point = a[axis] + s * (b[axis] - a[axis]) + t * (c[axis] - a[axis]);
                point / f64::from(layout.page_size_texel[axis])
            });
            num_lookups += 1.0;
            for (pages, num_mixed) in levels.iter().zip(&mut num_mixed) {
                let seen = pages[page].bilinear(uv);
                if (0..3).any(|k| (seen[k] - expected[k]).abs() > 1e-6) {
                    *num_mixed += 1.0;
                }
            }
        }
    }
    assert!(num_lookups > 1e5, "{num_lookups}");
    num_mixed.iter().map(|num| num / num_lookups).collect()
}

#[test]
fn charts_mix_in_no_mipmap_up_to_the_second_and_in_the_third() {
    let shares = mixed_shares(PackParams::default().gutter_texel, 4);
    assert_eq!(shares[..3], [0.0; 3]);
    assert!(shares[3] > 0.01, "{shares:?}");
}

#[test]
fn each_doubling_of_the_gutter_keeps_one_more_mipmap_apart() {
    let shares = mixed_shares(1, 3);
    assert_eq!(shares[..2], [0.0; 2]);
    assert!(shares[2] > 0.01, "{shares:?}");
    let shares = mixed_shares(4, 5);
    assert_eq!(shares[..4], [0.0; 4]);
    assert!(shares[4] > 0.01, "{shares:?}");
}
