//! Small charts that join their neighbours: what must hold after it, and that they do.

use super::*;
use crate::texinit::overlap::detect::{PlaneTriangles, overlapping_pairs};
use crate::texinit::overlap::{OverlapParams, separate};

/// Each triangle as the chart that `label` says, each chart flattened by itself.
fn charts_by_label(mesh: &TriMesh, manifold: &Manifold, label: &[u32]) -> Vec<FlatChart> {
    let num_charts = label.iter().max().map_or(0, |max| *max as usize + 1);
    let pieces = Piece::from_labels(manifold.mates(), label, num_charts);
    let params = FlattenParams::default();
    let flat = pieces
        .into_iter()
        .map(|piece| flatten_piece(piece, mesh, manifold, &params).0);
    flat.flatten().collect()
}

#[test]
fn a_scrap_of_a_plane_joins_the_rest() {
    let plane = noisy_plane(20);
    let manifold = Manifold::new(&plane).unwrap();
    // Two scraps inside, one at the rim, and the rest.
    let label: Vec<u32> = (0..plane.num_triangles())
        .map(|t| match t {
            300..304 => 1,
            410 => 2,
            0..4 => 3,
            _ => 0,
        })
        .collect();
    let charts = charts_by_label(&plane, &manifold, &label);
    assert_eq!(charts.len(), 4);
    let params = FlattenParams::default();
    let (joined, report) = absorb(&plane, &manifold, charts.clone(), &params);
    assert_eq!(joined.len(), 1);
    check_each_triangle_once(&plane, &joined);
    assert!(worst_length_error(&plane, &joined) < 1e-9);
    assert_eq!(report.num_absorbed, 3);
    assert_eq!(report.num_tried, 1, "all at once");
    assert_eq!(report.seam_length_m, 0.0);
    for off in [
        FlattenParams {
            absorb_below_triangles: 0,
            ..params.clone()
        },
        FlattenParams {
            mode: ChartMode::Paper,
            ..params.clone()
        },
        FlattenParams {
            max_chart_triangles: 100,
            ..params
        },
    ] {
        assert_eq!(absorb(&plane, &manifold, charts.clone(), &off).0, charts);
    }
}

/// A corner of a box does not flatten together with a scrap that closes it.
#[test]
fn what_does_not_flatten_together_stays_apart() {
    let surface = cap(10, 2.8, 0.0);
    let manifold = Manifold::new(&surface).unwrap();
    // The top of a nearly closed sphere, and all the rest.
    let label: Vec<u32> = surface
        .triangle_ids()
        .map(|t| u32::from(surface.corners_m(t).iter().all(|p| p.z > 0.8)))
        .collect();
    let params = FlattenParams {
        max_chart_triangles: 10_000,
        absorb_below_triangles: 200,
        ..Default::default()
    };
    let charts = charts_by_label(&surface, &manifold, &label);
    let (joined, report) = absorb(&surface, &manifold, charts, &params);
    check_each_triangle_once(&surface, &joined);
    assert!(report.num_tried > 0);
    for chart in joined.iter().filter(|chart| chart.triangles.len() > 1) {
        let distortion = chart.distortion;
        assert!(distortion.quasi_conformal_mean <= params.max_quasi_conformal_mean);
        assert!(distortion.area_ratio_min > 0.0);
    }
}

fn check_no_overlap(charts: &[FlatChart]) {
    for chart in charts {
        let pairs = overlapping_pairs(&PlaneTriangles::new(&chart.corners_m), 1);
        assert_eq!(pairs, Some(Vec::new()));
    }
}

fn whole_way(mesh: &TriMesh, params: &FlattenParams) -> (Vec<FlatChart>, AbsorbReport) {
    let flat = flatten(mesh, params).unwrap();
    let (apart, _) = separate(mesh, flat.charts, &OverlapParams::default());
    absorb(mesh, &flat.manifold, apart, params)
}

#[test]
fn a_rough_surface_gets_fewer_charts_and_shorter_seams() {
    let rough = cap(40, 2.5, 0.03);
    let params = FlattenParams::default();
    let (joined, report) = whole_way(&rough, &params);
    check_each_triangle_once(&rough, &joined);
    check_no_overlap(&joined);
    assert!(report.num_absorbed > 0, "{report:?}");
    assert_eq!(
        report.num_charts + report.num_absorbed,
        report.num_charts_before
    );
    let off = FlattenParams {
        absorb_below_triangles: 0,
        ..params.clone()
    };
    let (_, without) = whole_way(&rough, &off);
    assert!(report.seam_length_m < without.seam_length_m);

    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| whole_way(&rough, &params))
    };
    let one = run(1);
    assert_eq!(one.0, joined);
    assert_eq!(one, run(2));
    assert_eq!(one, run(4));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn any_soup_keeps_every_triangle_and_gets_no_overlap(
        positions in proptest::collection::vec(proptest::array::uniform3(coordinate()), 12),
        triangles in proptest::collection::vec(proptest::array::uniform3(0_u32..12), 0..60),
    ) {
        let soup = mesh(positions, triangles);
        let (joined, _) = whole_way(&soup, &FlattenParams::default());
        check_each_triangle_once(&soup, &joined);
        check_no_overlap(&joined);
    }
}
