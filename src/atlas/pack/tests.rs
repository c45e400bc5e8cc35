use proptest::prelude::*;

use super::super::num_shared_texels;
use super::super::texels::for_each_texel_within;
use super::*;

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

/// Charts of consecutive triangles.
fn charts(corners_m: Vec<Vec<[[f64; 2]; 3]>>) -> (Vec<Chart>, usize) {
    let mut ids = (0u32..).map(TriangleId);
    let charts: Vec<Chart> = corners_m
        .into_iter()
        .map(|corners_m| Chart {
            triangles: ids.by_ref().take(corners_m.len()).collect(),
            corners_m,
        })
        .collect();
    let num_triangles = charts.iter().map(|c| c.triangles.len()).sum();
    (charts, num_triangles)
}

/// A round chart of rings of triangles about `radius_m` wide, turned and out of round.
fn round_chart(radius_m: f64, num_rings: usize, phase: f64) -> Vec<[[f64; 2]; 3]> {
    let num_spokes = 12;
    let at = |ring: usize, spoke: usize| {
        let angle = phase + (spoke % num_spokes) as f64 / 12.0 * std::f64::consts::TAU;
        let wobble = 1.0 + 0.3 * (3.0 * angle + phase).sin();
        let radius = radius_m * ring as f64 / num_rings as f64 * wobble;
        [1.7 * radius * angle.cos(), radius * angle.sin()]
    };
    let mut corners = Vec::new();
    for ring in 0..num_rings {
        for spoke in 0..num_spokes {
            let (inner, outer) = (at(ring, spoke), at(ring + 1, spoke));
            let (inner_next, outer_next) = (at(ring, spoke + 1), at(ring + 1, spoke + 1));
            corners.push([inner, outer, outer_next]);
            if ring > 0 {
                corners.push([inner, outer_next, inner_next]);
            }
        }
    }
    corners
}

/// Sizes as streaming charts have them: many small, some large.
fn many_charts(num_charts: usize) -> (Vec<Chart>, usize) {
    charts(
        (0..num_charts)
            .map(|k| {
                let radius_m = 0.03 + 0.5 / (1.0 + (k * 7919 % 97) as f64);
                round_chart(radius_m, 1 + k % 5, k as f64)
            })
            .collect(),
    )
}

/// What every layout promises.
fn check(charts: &[Chart], num_triangles: usize, layout: &AtlasLayout, params: &PackParams) {
    assert_eq!(num_shared_texels(layout), 0);
    let [width, height] = layout.page_size_texel;
    let mut owners = vec![vec![None; (width * height) as usize]; layout.num_pages as usize];
    for (id, chart) in (0u32..).zip(&layout.charts) {
        let cell_size = [params.cell_texel(); 2];
        assert_eq!(chart.cell_size_texel(), cell_size);
        assert_eq!(
            [chart.rect.x, chart.rect.y].map(|c| c % cell_size[0]),
            [0, 0]
        );
        for (y, first, len) in chart.own_spans() {
            for x in first..first + len {
                let owner = &mut owners[chart.page as usize][(y * width + x) as usize];
                assert_eq!(owner.replace(id), None, "texel {x}, {y} is owned twice");
            }
        }
    }
    check_borders(layout, &owners, params);
    let num_texels = u64::from(layout.page_size_texel[0])
        * u64::from(layout.page_size_texel[1])
        * u64::from(layout.num_pages);
    assert!(num_texels <= params.max_texels);
    let mut seen: Vec<TriangleId> = Vec::new();
    for (id, chart) in (0u32..).zip(&layout.charts) {
        let mut num_texels = 0;
        for triangle in &chart.triangles {
            let corners = &layout.corners_texel[triangle.index()];
            for_each_texel_within(corners, layout.page_size_texel, |_, _, _| num_texels += 1);
        }
        assert!(num_texels > 0, "a rectangle that owns no texel");
        for &triangle in &chart.triangles {
            assert_eq!(layout.chart_of_triangle[triangle.index()], ChartId(id));
        }
        seen.extend(&chart.triangles);
    }
    seen.sort_unstable();
    assert!(
        seen.into_iter()
            .eq((0u32..).map(TriangleId).take(num_triangles))
    );
    assert_eq!(
        charts.iter().map(|c| c.triangles.len()).sum::<usize>(),
        num_triangles
    );
}

/// Around points of each triangle, everything within the gutter is its chart's.
fn check_borders(layout: &AtlasLayout, owners: &[Vec<Option<u32>>], params: &PackParams) {
    let gutter = params.gutter_texel as f32;
    for (corners, chart) in layout.corners_texel.iter().zip(&layout.chart_of_triangle) {
        let page = &owners[layout.charts[chart.index()].page as usize];
        let is_own_texel = corners
            .iter()
            .all(|c| (0..2).all(|axis| (c[axis] - corners[0][axis]).abs() <= 0.5));
        // Those have a cell to themselves and no more.
        let reach = if is_own_texel { 0.0 } else { gutter - 1e-3 };
        for weights in [
            [1.0, 0.0],
            [0.0, 1.0],
            [0.0, 0.0],
            [0.5, 0.5],
            [0.3, 0.3],
            [0.1, 0.6],
        ] {
            let [s, t] = weights;
            let point: [f32; 2] = std::array::from_fn(|axis| {
                let [a, b, c] = corners.map(|c| c[axis]);
                a * s + b * t + c * (1.0 - s - t)
            });
            for [dx, dy] in [
                [-1.0, -1.0],
                [1.0, -1.0],
                [-1.0, 1.0],
                [1.0, 1.0],
                [0.0, 0.0],
            ] {
                let [x, y] = [point[0] + dx * reach, point[1] + dy * reach];
                assert!(x >= 0.0 && y >= 0.0, "{point:?} has no border");
                let index = y as usize * layout.page_size_texel[0] as usize + x as usize;
                assert_eq!(
                    page[index],
                    Some(chart.0),
                    "beside {point:?} of {corners:?}"
                );
            }
        }
    }
}

#[test]
fn charts_keep_their_lengths_and_are_not_mirrored() {
    let (charts, num_triangles) = many_charts(40);
    let params = PackParams::default();
    let (layout, report) = pack(&charts, num_triangles, 200.0, &params).unwrap();
    check(&charts, num_triangles, &layout, &params);
    assert_eq!(report.num_own_texel_triangles, 0);
    for chart in &charts {
        for (triangle, corners_m) in chart.triangles.iter().zip(&chart.corners_m) {
            let texel = layout.corners_texel[triangle.index()].map(|c| c.map(f64::from));
            for k in 0..3 {
                let length = |p: [f64; 2], q: [f64; 2]| (q[0] - p[0]).hypot(q[1] - p[1]);
                let l = (k + 1) % 3;
                let expected = 200.0 * length(corners_m[k], corners_m[l]);
                assert!((length(texel[k], texel[l]) - expected).abs() < 2e-3);
            }
            let [a, b, c] = texel;
            let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            assert!(area < 0.0, "counter-clockwise is clockwise with v down");
        }
    }
}

#[test]
fn pages_are_well_filled_and_the_same_on_any_thread_count() {
    let (charts, num_triangles) = many_charts(1500);
    let params = PackParams {
        page_size_texel: 1024,
        ..PackParams::default()
    };
    let run = |num_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build();
        pool.unwrap()
            .install(|| pack(&charts, num_triangles, 300.0, &params).unwrap())
    };
    let (layout, report) = run(1);
    check(&charts, num_triangles, &layout, &params);
    assert!(layout.num_pages > 3);
    assert!(report.footprint_share > 0.85, "{report:?}");
    assert!((layout, report) == run(4));
}

#[test]
fn one_small_chart_gets_a_small_page() {
    let (charts, num_triangles) = charts(vec![vec![[[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]]]);
    let (layout, _) = pack(&charts, num_triangles, 100.0, &PackParams::default()).unwrap();
    assert_eq!((layout.page_size_texel, layout.num_pages), ([64, 64], 1));
    let (layout, _) = pack::<Chart>(&[], 0, 100.0, &PackParams::default()).unwrap();
    assert_eq!((layout.page_size_texel, layout.num_pages), ([64, 64], 1));
}

#[test]
fn a_triangle_without_area_owns_one_texel() {
    let good = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    let needle = [[0.0, 0.0], [1.0, 0.0], [0.5, 1e-9]];
    let wild = [[f64::NAN, 0.0], [1.0, 0.0], [0.0, f64::INFINITY]];
    let (charts, num_triangles) = charts(vec![
        vec![good, [[0.5; 2]; 3], needle],
        vec![wild],
        vec![[[3.0, 3.0], [4.0, 4.0], [5.0, 5.0]]],
    ]);
    let params = PackParams::default();
    let (layout, report) = pack(&charts, num_triangles, 50.0, &params).unwrap();
    check(&charts, num_triangles, &layout, &params);
    assert_eq!(report.num_own_texel_triangles, 4);
    for corners in &layout.corners_texel[1..] {
        let mut num_texels = 0;
        for_each_texel_within(corners, layout.page_size_texel, |_, _, _| num_texels += 1);
        assert_eq!(num_texels, 1);
    }
}

#[test]
fn triangles_that_share_texels_are_placed_apart() {
    let (left, right) = (
        [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
        [[0.5, 0.0], [1.5, 0.0], [0.5, 1.0]],
    );
    let (charts, num_triangles) = charts(vec![vec![left, right, left]]);
    let params = PackParams::default();
    let (layout, report) = pack(&charts, num_triangles, 50.0, &params).unwrap();
    check(&charts, num_triangles, &layout, &params);
    assert_eq!((report.num_moved_triangles, layout.charts.len()), (2, 3));
}

#[test]
fn a_chart_larger_than_a_page_is_drawn_smaller() {
    let (charts, num_triangles) = charts(vec![
        round_chart(10.0, 3, 0.0),
        round_chart(1e9, 2, 0.5),
        round_chart(0.5, 2, 1.0),
    ]);
    let params = PackParams {
        page_size_texel: 256,
        ..PackParams::default()
    };
    let (layout, report) = pack(&charts, num_triangles, 100.0, &params).unwrap();
    check(&charts, num_triangles, &layout, &params);
    assert_eq!(report.num_scaled_charts, 2);
    assert!(report.smallest_scale < 1e-6);
    let TexelRect { width, height, .. } = layout.charts[0].rect;
    assert!(width.max(height) > 240);
}

#[test]
fn density_is_lowered_until_the_budget_holds() {
    let (charts, num_triangles) = many_charts(400);
    for max_texels in [1 << 14, 1 << 16, 1 << 18, 3 << 18] {
        let params = PackParams {
            page_size_texel: 512,
            max_texels,
            ..PackParams::default()
        };
        let too_much = pack(&charts, num_triangles, 2000.0, &params);
        assert!(matches!(too_much, Err(PackError::OverBudget { .. })));
        let packed = pack_to_budget(&charts, num_triangles, 2000.0, &params);
        if max_texels == 1 << 14 {
            // 400 gutters alone take more.
            assert!(matches!(packed, Err(PackError::OverBudget { .. })));
        } else {
            let (layout, report) = packed.unwrap();
            check(&charts, num_triangles, &layout, &params);
            let num_texels = report.footprint_share
                * f64::from(layout.page_size_texel[0] * layout.page_size_texel[1])
                * f64::from(layout.num_pages);
            let budget_share = num_texels / max_texels as f64;
            assert!(
                budget_share > 0.75,
                "{max_texels}: {budget_share} {report:?}"
            );
            let more = pack(&charts, num_triangles, 1.1 * layout.texels_per_m, &params);
            assert!(more.is_err(), "{max_texels}: room for a tenth more");
        }
    }
    let (roomy, _) = pack_to_budget(&charts, num_triangles, 10.0, &PackParams::default()).unwrap();
    assert_eq!(roomy.texels_per_m, 10.0);
}

#[test]
fn a_mesh_of_absurd_size_still_finds_its_density() {
    let (mut charts, num_triangles) = many_charts(100);
    for corner in charts.iter_mut().flat_map(|c| &mut c.corners_m).flatten() {
        *corner = corner.map(|m| m * 1e30);
    }
    let params = PackParams {
        page_size_texel: 512,
        max_texels: 1 << 18,
        ..PackParams::default()
    };
    let (layout, report) = pack_to_budget(&charts, num_triangles, 2000.0, &params).unwrap();
    assert!(layout.texels_per_m < 1e-25, "{}", layout.texels_per_m);
    check(&charts, num_triangles, &layout, &params);
    assert!(report.footprint_share > 0.8, "{report:?}");
}

#[test]
fn plates_are_filled_each_by_itself() {
    let (charts, num_triangles) = many_charts(1100);
    let params = PackParams::default();
    let (layout, report) = pack_plates(&charts, num_triangles, 512, &params).unwrap();
    assert_eq!((layout.page_size_texel, layout.num_pages), ([512, 512], 3));
    assert_eq!(num_shared_texels(&layout), 0);
    assert!(report.footprint_share > 0.8, "{report:?}");
    // From the smallest to the largest, 500 to a plate; small ones are drawn larger.
    let size_m2 = |chart: &Chart| {
        let doubled = |[a, b, c]: &[[f64; 2]; 3]| {
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        chart.corners_m.iter().map(doubled).sum::<f64>()
    };
    let mut by_size: Vec<usize> = (0..charts.len()).collect();
    by_size.sort_by(|&a, &b| size_m2(&charts[a]).total_cmp(&size_m2(&charts[b])));
    let mut density_of_page = [0.0; 3];
    for (rank, &k) in by_size.iter().enumerate() {
        let id = layout.chart_of_triangle[charts[k].triangles[0].index()];
        let placed = &layout.charts[id.index()];
        assert_eq!(placed.page as usize, rank / 500);
        let known = &mut density_of_page[placed.page as usize];
        assert!(*known == 0.0 || *known == placed.texels_per_m);
        *known = placed.texels_per_m;
    }
    assert!(
        density_of_page[0] > 2.0 * density_of_page[2],
        "{density_of_page:?}"
    );
    for (index, a) in layout.charts.iter().enumerate() {
        let (r, size) = (&a.rect, layout.page_size_texel);
        assert!(r.x + r.width <= size[0] && r.y + r.height <= size[1]);
        for b in &layout.charts[..index] {
            let s = &b.rect;
            let is_beside = r.x + r.width <= s.x || s.x + s.width <= r.x;
            let is_below = r.y + r.height <= s.y || s.y + s.height <= r.y;
            assert!(a.page != b.page || is_beside || is_below);
        }
    }
}

#[test]
fn plates_are_halved_to_the_budget() {
    let (charts, num_triangles) = many_charts(600);
    let budget = |max_texels| PackParams {
        max_texels,
        ..PackParams::default()
    };
    let (layout, _) = pack_plates(&charts, num_triangles, 1024, &budget(1 << 20)).unwrap();
    assert_eq!((layout.page_size_texel, layout.num_pages), ([512, 512], 2));
    let error = pack_plates(&charts, num_triangles, 1024, &budget(1 << 12)).unwrap_err();
    assert_eq!(error.to_string(), "2 plates do not fit into 4096 texels");
    let (layout, _) = pack_plates::<Chart>(&[], 0, 512, &budget(1 << 20)).unwrap();
    assert_eq!((layout.num_pages, layout.charts.len()), (1, 0));
}

#[test]
fn wrong_input_is_named() {
    let (mut charts, num_triangles) = many_charts(2);
    let params = PackParams::default();
    let error = |charts: &[Chart], n, density, params: &PackParams| {
        pack(charts, n, density, params).unwrap_err().to_string()
    };
    let odd_page = PackParams {
        page_size_texel: 1000,
        ..params
    };
    let thin_gutter = PackParams {
        gutter_texel: 0,
        ..params
    };
    for (message, part) in [
        (error(&charts, num_triangles, f64::NAN, &params), "NaN"),
        (error(&charts, num_triangles, 1.0, &odd_page), "1000"),
        (
            error(&charts, num_triangles, 1.0, &thin_gutter),
            "gutter of 0",
        ),
        (
            error(&charts, num_triangles - 1, 1.0, &params),
            "in 1 charts",
        ),
        (
            error(&charts, num_triangles + 1, 1.0, &params),
            "in 0 charts",
        ),
    ] {
        assert!(message.contains(part), "{message}");
    }
    charts[1].triangles[0] = TriangleId(0);
    assert!(error(&charts, num_triangles, 1.0, &params).contains("in 2 charts"));
    charts[1].triangles.pop();
    assert!(error(&charts, num_triangles, 1.0, &params).contains("corners for"));
}

/// Fans of triangles around a point, with spokes down to nothing and angles down to needles:
/// no overlap before rounding, all sorts of it after.
fn fan() -> impl Strategy<Value = Vec<[[f64; 2]; 3]>> {
    let spoke = (
        0.0..1.0f64,
        prop_oneof![0.0..0.05f64, 0.0..1.0f64, 0.0..0.002f64],
    );
    proptest::collection::vec(spoke, 3..40).prop_map(|mut spokes| {
        spokes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at = |(turn, radius): (f64, f64)| {
            let angle = turn * std::f64::consts::TAU;
            [radius * angle.cos(), radius * angle.sin()]
        };
        let pairs = spokes
            .windows(2)
            .filter(|pair| pair[1].0 - pair[0].0 < 0.49);
        pairs
            .map(|pair| [[0.0, 0.0], at(pair[0]), at(pair[1])])
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]
    #[test]
    fn no_texel_is_shared_whatever_the_charts(
        fans in proptest::collection::vec(fan(), 0..8),
        texels_per_m in prop_oneof![0.01..5.0f64, 5.0..500.0f64],
        gutter_texel in 1u32..9,
    ) {
        let (charts, num_triangles) = charts(fans);
        let params = PackParams { page_size_texel: 512, gutter_texel, max_texels: 1 << 26 };
        let (layout, report) = pack(&charts, num_triangles, texels_per_m, &params).unwrap();
        check(&charts, num_triangles, &layout, &params);
        let mut num_owned_texels = 0;
        let mut num_without = 0;
        for corners in &layout.corners_texel {
            let before = num_owned_texels;
            for_each_texel_within(corners, layout.page_size_texel, |_, _, _| num_owned_texels += 1);
            num_without += usize::from(num_owned_texels == before);
        }
        prop_assert_eq!(report.num_owned_texels, num_owned_texels);
        prop_assert_eq!(report.num_subtexel_triangles, num_without);
    }
}
