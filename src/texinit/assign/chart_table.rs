//! Labels chart by chart: those of a chart depend on its own triangles and the frames, and on
//! nothing else of the mesh but what hides them.
//!
//! Differs from labels of the whole mesh in that adjacent triangles of different charts earn no
//! reward for equal frames, and in that sharpness and exposure are held against the typical frame of
//! those that see the chart, in steps ([`TypicalQuality::in_steps`]). Then a change of the mesh or of the
//! frames changes the labels of charts that it touches, and of no others.
//!
//! [`TypicalQuality::in_steps`]: super::quality::TypicalQuality::in_steps

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::atlas::AtlasLayout;
use crate::keyframe::FrameQuality;
use crate::mesh::{TriMesh, TriangleId};

use super::adjacency::adjacent_pairs;
use super::cues::FrameCandidates;
use super::label::{CandidateTable, count_seams};
use super::{AssignParams, AssignReport, Assignment, FailedFrame, ScoredFrames};

/// A chart of the mesh as a mesh of its own, triangles in the chart's order.
pub(crate) fn chart_mesh(mesh: &TriMesh, triangles: &[TriangleId]) -> TriMesh {
    let corners = triangles.iter().map(|t| mesh.triangles()[t.index()]);
    let mut vertices: Vec<u32> = corners.clone().flatten().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let positions_m = vertices.iter().map(|&v| mesh.positions_m()[v as usize]);
    #[expect(clippy::cast_possible_truncation, reason = "fewer than the mesh has")]
    let local = |vertex: u32| vertices.partition_point(|&v| v < vertex) as u32;
    let corners = corners.map(|corners| corners.map(local));
    // Part of a mesh is a mesh: nothing is refused or left out.
    TriMesh::from_soup(positions_m.collect(), corners.collect())
        .map(|(mesh, _)| mesh)
        .unwrap_or_default()
}

/// Chart of each triangle, and its number in the chart.
fn places<'a>(
    num_triangles: usize,
    charts: impl Iterator<Item = &'a [TriangleId]>,
) -> Vec<[u32; 2]> {
    let mut places = vec![[u32::MAX; 2]; num_triangles];
    for (chart, triangles) in (0_u32..).zip(charts) {
        for (number, triangle) in (0_u32..).zip(triangles) {
            places[triangle.index()] = [chart, number];
        }
    }
    places
}

/// A frame's column in parts, by chart; triangles are named by their number in it. `place_of` gives the
/// chart of a triangle, and that number.
pub(crate) fn split_by_chart(
    scored: FrameCandidates,
    place_of: impl Fn(u32) -> [u32; 2],
) -> BTreeMap<u32, FrameCandidates> {
    let mut by_chart: BTreeMap<u32, FrameCandidates> = BTreeMap::new();
    for mut candidate in scored.candidates {
        let [chart, number] = place_of(candidate.triangle);
        candidate.triangle = number;
        by_chart
            .entry(chart)
            .or_default()
            .candidates
            .push(candidate);
    }
    for (triangle, colors) in scored.valid_colors {
        let [chart, number] = place_of(triangle);
        let part = by_chart.entry(chart).or_default();
        part.valid_colors.push((number, colors));
    }
    for part in by_chart.values_mut() {
        part.candidates.sort_unstable_by_key(|c| c.triangle);
        part.candidates.shrink_to_fit();
    }
    by_chart
}

impl ScoredFrames {
    /// The labels that the triangles of each chart get together.
    pub(crate) fn assign_in_charts(
        self,
        mesh: &TriMesh,
        layout: &AtlasLayout,
        params: &AssignParams,
    ) -> Assignment {
        let triangles = || layout.charts.iter().map(|chart| &*chart.triangles);
        let places = places(mesh.num_triangles(), triangles());
        let num_frames = self.columns.len();
        let mut columns_by_chart: Vec<Vec<(u32, FrameQuality, FrameCandidates)>> =
            layout.charts.iter().map(|_| Vec::new()).collect();
        for (frame, quality, scored) in self.columns {
            for (chart, part) in split_by_chart(scored, |triangle| places[triangle as usize]) {
                columns_by_chart[chart as usize].push((frame, quality, part));
            }
        }
        let by_chart: Vec<Assignment> = columns_by_chart
            .into_par_iter()
            .zip(&layout.charts)
            .map(|(columns, chart)| {
                let own = chart_mesh(mesh, &chart.triangles);
                let mut table = CandidateTable::new(own.num_triangles(), own.num_vertices());
                table.add_all(columns);
                let typical = table.typical_quality().in_steps();
                table.assign(&own, params, typical)
            })
            .collect();
        let mut all = joined(mesh, triangles().zip(&by_chart), self.failed);
        all.report.num_frames = num_frames;
        all
    }
}

/// The assignment of a mesh from those of its charts.
pub(crate) fn joined<'a>(
    mesh: &TriMesh,
    charts: impl Iterator<Item = (&'a [TriangleId], &'a Assignment)>,
    failed_frames: Vec<FailedFrame>,
) -> Assignment {
    let num_triangles = mesh.num_triangles();
    let mut all = Assignment {
        label: vec![None; num_triangles],
        best_texels_per_m: vec![0.0; num_triangles],
        mean_srgb: vec![[0; 3]; num_triangles],
        num_views: vec![0; num_triangles],
        is_partly_hidden: vec![false; num_triangles],
        report: AssignReport {
            failed_frames,
            ..AssignReport::default()
        },
    };
    for (triangles, part) in charts {
        for (number, triangle) in triangles.iter().enumerate() {
            let index = triangle.index();
            all.label[index] = part.label[number];
            all.best_texels_per_m[index] = part.best_texels_per_m[number];
            all.mean_srgb[index] = part.mean_srgb[number];
            all.num_views[index] = part.num_views[number];
            all.is_partly_hidden[index] = part.is_partly_hidden[number];
        }
        all.report.num_candidates += part.report.num_candidates;
        all.report.num_labelled += part.report.num_labelled;
        all.report.num_unlabelled += part.report.num_unlabelled;
        all.report.num_seams_unary += part.report.num_seams_unary;
    }
    let mut used: Vec<u32> = all.label.iter().copied().flatten().collect();
    used.sort_unstable();
    used.dedup();
    all.report.num_frames_used = used.len();
    let seams = count_seams(&all.label, &adjacent_pairs(mesh.triangles()));
    (all.report.num_seams, all.report.num_inner_edges) = seams;
    all
}
