//! Overlap detection and its cure: after [`separate()`], no two triangles of a chart share area in
//! the plane.
//!
//! Method: Zhao, Zhao, Schwing, ECCV 2022, section 3.1, Eq. MRFPlane. Triangles of a chart that
//! overlap ([`detect`], exact) are assigned to different planes by a Markov random field, in the
//! paper's form or in that of the authors' program ([`OverlapForm`]). It is solved by MPLP
//! ([`mplp`]); what still overlaps is moved to the first plane free of all its neighbours.
//! Triangles of one plane that hang together by edges in the plane are a piece, and each piece is
//! a chart of its own.
//!
//! Two additions, each switchable. Pieces of different planes that are adjacent and do not overlap
//! are put together. Region growing ([`grow`]) is tried beside the field, and the result with fewer
//! pieces is kept. A chart too folded for the field ([`OverlapParams::max_pairs_per_triangle`],
//! [`OverlapParams::max_messages`]) is grown only.
//!
//! Charts without overlap, nearly all of them, come back as they were.

pub mod detect;
mod field;
mod graph;
mod grid;
mod grow;
pub mod mplp;
mod outline;
pub mod separate;
mod stack;

use rayon::prelude::*;

pub use field::OverlapForm;
pub use separate::PieceMethod;

use super::flatten::FlatChart;
use crate::atlas::PlaneChart;
use crate::mesh::weld::equal_representatives;
use crate::mesh::{TriMesh, TriangleId};
use graph::SharedEdges;
use separate::FoldedChart;

impl PlaneChart for FlatChart {
    fn triangles(&self) -> &[TriangleId] {
        &self.triangles
    }

    fn corners_m(&self) -> &[[[f64; 2]; 3]] {
        &self.corners_m
    }
}

/// How overlaps are resolved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverlapParams {
    /// The field's planes, rewards and adjacency.
    pub form: OverlapForm,
    /// Sweeps of dual coordinate descent over all pairs, at most.
    pub max_sweeps: usize,
    /// Planes that the field chooses among, at most, ≥ 2; the guarantee may use more.
    pub max_planes: usize,
    /// More overlapping pairs than this times the chart's triangles: the chart is grown only.
    pub max_pairs_per_triangle: usize,
    /// More messages (two per pair and plane, 8 bytes each) than this: the chart is grown only.
    pub max_messages: usize,
    /// Put pieces together that are adjacent and do not overlap.
    pub merge_pieces: bool,
    /// Keep the grown pieces where they are fewer than the field's.
    pub try_growing: bool,
}

impl Default for OverlapParams {
    fn default() -> Self {
        Self {
            form: OverlapForm::Printed,
            max_sweeps: 10,
            max_planes: 16,
            max_pairs_per_triangle: 64,
            max_messages: 1 << 23,
            merge_pieces: true,
            try_growing: true,
        }
    }
}

impl OverlapParams {
    /// The authors' program: its form of the field, and nothing beside it.
    pub fn paper() -> Self {
        Self {
            form: OverlapForm::Reference,
            max_planes: 64,
            max_messages: 1 << 25,
            merge_pieces: false,
            try_growing: false,
            ..Self::default()
        }
    }
}

/// What [`separate()`] found and did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct OverlapReport {
    /// Charts that came in.
    pub num_charts: usize,
    /// Of these: charts in which triangles overlap.
    pub num_overlapping_charts: usize,
    /// Pairs of overlapping triangles, where they were counted to the end.
    pub num_overlapping_pairs: usize,
    /// Charts too folded for the field.
    pub num_crowded_charts: usize,
    /// Charts whose field chose among fewer planes than its form asks for.
    pub num_capped_charts: usize,
    /// The most planes that a field chose among.
    pub max_field_planes: usize,
    /// Overlapping charts whose pieces are the grown ones.
    pub num_grown_charts: usize,
    /// Triangles that the field left on the plane of one they overlap.
    pub num_moved_triangles: usize,
    /// Charts that overlapping charts were separated into.
    pub num_pieces: usize,
}

impl OverlapReport {
    fn add(&mut self, other: &Self) {
        self.num_charts += other.num_charts;
        self.num_overlapping_charts += other.num_overlapping_charts;
        self.num_overlapping_pairs += other.num_overlapping_pairs;
        self.num_crowded_charts += other.num_crowded_charts;
        self.num_capped_charts += other.num_capped_charts;
        self.max_field_planes = self.max_field_planes.max(other.max_field_planes);
        self.num_grown_charts += other.num_grown_charts;
        self.num_moved_triangles += other.num_moved_triangles;
        self.num_pieces += other.num_pieces;
    }
}

/// The same triangles in charts without overlap, in the order of the charts they came from. A
/// piece keeps the corners and, as a bound, the distortion of its chart; triangles of no area in
/// the plane overlap nothing. The charts are of `mesh`.
pub fn separate(
    mesh: &TriMesh,
    charts: Vec<FlatChart>,
    params: &OverlapParams,
) -> (Vec<FlatChart>, OverlapReport) {
    // As in flattening, vertices of equal position are one.
    let vertex_of = match params.form {
        OverlapForm::Printed => Vec::new(),
        OverlapForm::Reference => equal_representatives(mesh.positions_m()),
    };
    let surface_edges = |chart: &FlatChart| {
        let triangles = chart.triangles.iter().map(|t| mesh.triangles()[t.index()]);
        SharedEdges::of(triangles.map(|t| t.map(|v| vertex_of[v as usize])))
    };
    let separated: Vec<(Vec<FlatChart>, OverlapReport)> = charts
        .into_par_iter()
        .map(|chart| separate_chart(chart, &surface_edges, params))
        .collect();
    let mut report = OverlapReport::default();
    for (_, chart_report) in &separated {
        report.add(chart_report);
    }
    let pieces = separated.into_iter().flat_map(|(pieces, _)| pieces);
    (pieces.collect(), report)
}

fn separate_chart(
    chart: FlatChart,
    surface_edges: &impl Fn(&FlatChart) -> SharedEdges,
    params: &OverlapParams,
) -> (Vec<FlatChart>, OverlapReport) {
    let max_pairs = params
        .max_pairs_per_triangle
        .saturating_mul(chart.corners_m.len());
    let mut report = OverlapReport {
        num_charts: 1,
        ..OverlapReport::default()
    };
    let layer = detect::PlaneTriangles::new(&chart.corners_m);
    let pairs = detect::overlapping_pairs(&layer, max_pairs);
    if pairs.as_ref().is_some_and(Vec::is_empty) {
        return (vec![chart], report);
    }
    let plane_edges = SharedEdges::in_plane(&chart.corners_m);
    let on_surface;
    let field_edges = match params.form {
        OverlapForm::Printed => &plane_edges,
        OverlapForm::Reference => {
            on_surface = surface_edges(&chart);
            &on_surface
        }
    };
    let folded = FoldedChart {
        layer: &layer,
        plane_edges: &plane_edges,
        field_edges,
        pairs: pairs.as_deref(),
    };
    let pieces = separate::pieces(&folded, params);
    report.num_overlapping_charts = 1;
    report.num_overlapping_pairs = pairs.as_ref().map_or(0, Vec::len);
    report.num_crowded_charts = usize::from(pieces.is_crowded);
    report.num_capped_charts = usize::from(pieces.is_capped);
    report.max_field_planes = pieces.num_planes;
    report.num_grown_charts = usize::from(pieces.method == PieceMethod::Growing);
    report.num_moved_triangles = pieces.num_moved_triangles;
    report.num_pieces = pieces.members.len();
    let charts = pieces.members.iter().map(|members| FlatChart {
        triangles: members.iter().map(|&t| chart.triangles[t]).collect(),
        corners_m: members.iter().map(|&t| chart.corners_m[t]).collect(),
        distortion: chart.distortion,
    });
    (charts.collect(), report)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use proptest::prelude::*;

    use super::super::flatten::ChartDistortion;
    use super::detect::tests::pairs_by_brute_force;
    use super::*;

    type Point = [f64; 2];

    fn chart(corners_m: Vec<[Point; 3]>) -> FlatChart {
        FlatChart {
            triangles: (0u32..).map(TriangleId).take(corners_m.len()).collect(),
            corners_m,
            distortion: ChartDistortion::default(),
        }
    }

    /// Two triangles per step of a strip between two polylines.
    fn strip(left: &[Point], right: &[Point]) -> FlatChart {
        let quads = left.windows(2).zip(right.windows(2));
        chart(
            quads
                .flat_map(|(l, r)| [[l[0], r[0], r[1]], [l[0], r[1], l[1]]])
                .collect(),
        )
    }

    /// A strip that turns on itself: an annulus walked around more than once, no wider outwards.
    fn wound_strip(num_turns: f64) -> FlatChart {
        let at = |k: usize, radius: f64| {
            let angle = k as f64 / 40.0 * std::f64::consts::TAU;
            [radius * angle.cos(), radius * angle.sin()]
        };
        let num_steps = (0..)
            .take_while(|k| f64::from(*k) <= num_turns * 40.0)
            .count();
        let edge = |radius: f64| -> Vec<Point> { (0..num_steps).map(|k| at(k, radius)).collect() };
        strip(&edge(1.0), &edge(1.4))
    }

    /// A straight strip that folds back over itself every `length` steps, a little higher.
    fn folded_strip(length: usize, num_folds: usize) -> FlatChart {
        let x_at = |k: usize| {
            let phase = k % (2 * length);
            phase.min(2 * length - phase) as f64
        };
        let num_steps = length * (num_folds + 1) + 1;
        let edge = |y: f64| -> Vec<Point> {
            let rise = |k: usize| 1e-3 * k as f64;
            (0..num_steps).map(|k| [x_at(k), y + rise(k)]).collect()
        };
        strip(&edge(0.0), &edge(1.0))
    }

    fn random_fan_mesh(points: &[(usize, [i32; 2])]) -> FlatChart {
        // Each new triangle stands on an edge of an earlier one, its tip anywhere.
        let mut triangles: Vec<[Point; 3]> = vec![[[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]];
        for (k, tip) in points {
            let base = triangles[k / 3 % triangles.len()];
            let (a, b) = (base[k % 3], base[(k + 1) % 3]);
            triangles.push([b, a, tip.map(f64::from)]);
        }
        chart(triangles)
    }

    fn share_an_edge(a: &[Point; 3], b: &[Point; 3]) -> bool {
        a.iter().filter(|p| b.contains(p)).count() >= 2
    }

    /// No overlap by brute force, connected, and each triangle once with its own corners.
    fn check(original: &FlatChart, pieces: &[FlatChart]) {
        let mut seen: Vec<(TriangleId, [Point; 3])> = Vec::new();
        for piece in pieces {
            assert_eq!(piece.triangles.len(), piece.corners_m.len());
            assert_eq!(
                pairs_by_brute_force(&piece.corners_m),
                Vec::<[u32; 2]>::new()
            );
            let mut is_reached = vec![false; piece.corners_m.len()];
            is_reached[0] = true;
            let mut front = vec![0];
            while let Some(t) = front.pop() {
                for (other, is_reached) in is_reached.iter_mut().enumerate() {
                    if !*is_reached && share_an_edge(&piece.corners_m[t], &piece.corners_m[other]) {
                        *is_reached = true;
                        front.push(other);
                    }
                }
            }
            assert!(is_reached.iter().all(|r| *r), "a piece of several parts");
            seen.extend(
                piece
                    .triangles
                    .iter()
                    .copied()
                    .zip(piece.corners_m.iter().copied()),
            );
        }
        seen.sort_by_key(|(id, _)| *id);
        let expected: Vec<_> = original
            .triangles
            .iter()
            .copied()
            .zip(original.corners_m.iter().copied())
            .collect();
        assert_eq!(seen, expected);
    }

    /// The plane itself as the surface: vertices are those of the plane.
    fn surface(chart: &FlatChart) -> TriMesh {
        let corners = chart.corners_m.iter().flatten();
        let positions: Vec<Point3<f64>> = corners.map(|p| Point3::new(p[0], p[1], 0.0)).collect();
        let triangles = (0u32..).step_by(3).take(chart.corners_m.len());
        let triangles = triangles.map(|first| [first, first + 1, first + 2]);
        TriMesh::from_soup(positions, triangles.collect())
            .unwrap()
            .0
    }

    fn separated(chart: &FlatChart, params: &OverlapParams) -> (Vec<FlatChart>, OverlapReport) {
        separate(&surface(chart), vec![chart.clone()], params)
    }

    fn variants() -> [OverlapParams; 4] {
        let default = OverlapParams::default();
        let field_only = OverlapParams {
            merge_pieces: false,
            try_growing: false,
            ..default
        };
        let grown_only = OverlapParams {
            max_pairs_per_triangle: 0,
            ..default
        };
        [default, field_only, grown_only, OverlapParams::paper()]
    }

    #[test]
    fn a_chart_without_overlap_comes_back_as_it_was() {
        let ring = wound_strip(0.9);
        let (pieces, report) = separated(&ring, &OverlapParams::default());
        assert_eq!(pieces, [ring]);
        assert_eq!(report.num_overlapping_charts, 0);
    }

    #[test]
    fn a_strip_wound_twice_becomes_two_or_three_pieces() {
        let spiral = wound_strip(2.0);
        for params in variants() {
            let (pieces, report) = separated(&spiral, &params);
            check(&spiral, &pieces);
            assert_eq!(report.num_overlapping_charts, 1);
            assert_eq!(report.num_pieces, pieces.len());
            assert!((2..=3).contains(&pieces.len()), "{} pieces", pieces.len());
        }
    }

    #[test]
    fn a_folded_strip_becomes_one_piece_per_layer() {
        let folded = folded_strip(12, 3);
        for params in variants() {
            let (pieces, report) = separated(&folded, &params);
            check(&folded, &pieces);
            assert!((4..=8).contains(&pieces.len()), "{} pieces", pieces.len());
            assert!(report.num_pieces == pieces.len());
        }
    }

    #[test]
    fn a_chart_too_folded_for_the_field_is_grown() {
        let spiral = wound_strip(3.0);
        let params = OverlapParams {
            max_messages: 1000,
            ..OverlapParams::default()
        };
        let (pieces, report) = separated(&spiral, &params);
        check(&spiral, &pieces);
        assert_eq!((report.num_crowded_charts, report.num_grown_charts), (1, 1));
    }

    #[test]
    fn a_deep_stack_is_grown() {
        let stack = chart(vec![[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]; 300]);
        let (pieces, report) = separated(&stack, &OverlapParams::default());
        check(&stack, &pieces);
        assert_eq!(pieces.len(), 300);
        assert_eq!((report.num_crowded_charts, report.num_grown_charts), (1, 1));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn any_chart_becomes_connected_pieces_without_overlap(
            tips in proptest::collection::vec((any::<usize>(), [0i32..9, 0i32..9]), 0..60),
        ) {
            let chart = random_fan_mesh(&tips);
            for params in variants() {
                let (pieces, report) = separated(&chart, &params);
                if report.num_overlapping_charts > 0 {
                    check(&chart, &pieces);
                } else {
                    prop_assert_eq!(pairs_by_brute_force(&chart.corners_m).len(), 0);
                    prop_assert_eq!(&pieces, std::slice::from_ref(&chart));
                }
            }
        }
    }
}
