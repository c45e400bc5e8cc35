//! Small charts back into their neighbours, after flattening and separation.
//!
//! What is split off for distortion, ejected, or moved to another plane is often a few triangles:
//! a chart of its own with a border all round. Such a chart is tried with the neighbour it shares
//! the longest border with, then with the next: the two are flattened together, and stay together
//! if that passes the same bounds as any chart, no triangle has to leave, and no two overlap. So
//! whatever held of the charts before (bounds, no overlap) holds after.
//!
//! Rounds of pairs that do not touch each other's charts are solved in parallel; who is tried with
//! whom does not depend on the thread count. Only [`ChartMode::Streaming`] with isometric
//! boundaries absorbs; whole components stay as they are.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::chart_solve::{SolveCounts, in_mesh_order, try_flatten};
use super::distortion::summarize;
use super::judge::must_leave;
use super::piece::Piece;
use super::{
    ChartBoundary, ChartDistortion, ChartMode, FlatChart, FlattenParams, attach_collapsed,
    overall_distortion, seam_length_m,
};
use crate::mesh::adjacency::NO_HALF_EDGE;
use crate::mesh::{Manifold, TriMesh, TriangleId};
use crate::texinit::overlap::detect::{PlaneTriangles, overlapping_pairs};

/// Neighbours that a small chart is tried with, at most: a third joins few more charts.
const MAX_TRIES: usize = 2;

/// A chart that has turned away so many takes no more: where it lies among dust, trying each grain
/// would cost a factorisation apiece.
const MAX_REJECTIONS: usize = 8;

/// Slits that two charts get to lie flat together, at most; each is another factorisation.
const MAX_SLITS_TOGETHER: usize = 2;

/// What [`absorb()`] did.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AbsorbReport {
    /// How often charts were flattened together.
    pub num_tried: usize,
    /// Charts that became part of another.
    pub num_absorbed: usize,
    /// Charts that came in.
    pub num_charts_before: usize,
    /// Charts in the result.
    pub num_charts: usize,
    /// Of these, with a single triangle.
    pub num_single_triangle_charts: usize,
    /// Length of edges whose two faces lie apart in the plane, metres.
    pub seam_length_m: f64,
    /// Over the area of all charts of the result.
    pub distortion: ChartDistortion,
}

/// Joins charts of fewer than [`FlattenParams::absorb_below_triangles`] triangles to neighbours
/// where the two flatten together. `charts` hold each triangle of the mesh once, without overlap;
/// so does the result.
pub fn absorb(
    mesh: &TriMesh,
    manifold: &Manifold,
    charts: Vec<FlatChart>,
    params: &FlattenParams,
) -> (Vec<FlatChart>, AbsorbReport) {
    let mut report = AbsorbReport {
        num_charts_before: charts.len(),
        ..AbsorbReport::default()
    };
    let is_on = params.mode == ChartMode::Streaming && params.boundary == ChartBoundary::Isometric;
    let charts = if is_on && params.absorb_below_triangles > 1 {
        let mut absorber = Absorber::new(mesh, manifold, charts, params);
        while absorber.round(&mut report) {}
        absorber.finish()
    } else {
        charts
    };
    report.num_charts = charts.len();
    report.num_single_triangle_charts = charts.iter().filter(|c| c.triangles.len() == 1).count();
    report.seam_length_m = seam_length_m(mesh, manifold, &charts);
    report.distortion = overall_distortion(mesh, manifold, &charts);
    (charts, report)
}

/// What a chart does in a round.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Free,
    /// Is tried with another.
    Guest,
    /// Others are tried with it.
    Host,
}

struct Absorber<'a> {
    mesh: &'a TriMesh,
    manifold: &'a Manifold,
    params: &'a FlattenParams,
    /// None where it became part of another.
    charts: Vec<Option<FlatChart>>,
    /// Chart of each triangle; none for collapsed ones.
    label: Vec<u32>,
    /// Neighbours that each chart was tried with.
    tried: Vec<Vec<u32>>,
    /// How many each chart has turned away.
    num_rejected: Vec<usize>,
}

impl<'a> Absorber<'a> {
    fn new(
        mesh: &'a TriMesh,
        manifold: &'a Manifold,
        charts: Vec<FlatChart>,
        params: &'a FlattenParams,
    ) -> Self {
        let mut label = vec![u32::MAX; mesh.num_triangles()];
        let mut open = Vec::with_capacity(charts.len());
        for chart in charts {
            // Collapsed triangles are put beside their edge again in the end.
            let chart = without_collapsed(chart, manifold);
            if !chart.triangles.is_empty() {
                #[expect(clippy::cast_possible_truncation, reason = "fewer than triangles")]
                for triangle in &chart.triangles {
                    label[triangle.index()] = open.len() as u32;
                }
                open.push(Some(chart));
            }
        }
        Self {
            mesh,
            manifold,
            params,
            tried: vec![Vec::new(); open.len()],
            num_rejected: vec![0; open.len()],
            charts: open,
            label,
        }
    }

    fn num_triangles(&self, chart: u32) -> usize {
        let chart = self.charts[chart as usize].as_ref();
        chart.map_or(0, |chart| chart.triangles.len())
    }

    /// Pairs guests with hosts, flattens each host with its guests, and keeps what came out well;
    /// false when nobody was left to try.
    fn round(&mut self, report: &mut AbsorbReport) -> bool {
        let parties = self.parties();
        let joined: Vec<Joined> = parties
            .into_par_iter()
            .map(|(host, guests)| self.join(host, guests))
            .collect();
        let was_tried = !joined.is_empty();
        for outcome in joined {
            report.num_tried += outcome.num_tried;
            report.num_absorbed += outcome.absorbed.len();
            self.num_rejected[outcome.host as usize] += outcome.rejected.len();
            for guest in outcome.rejected {
                self.tried[guest as usize].push(outcome.host);
            }
            for guest in outcome.absorbed {
                self.charts[guest as usize] = None;
            }
            if let Some(chart) = outcome.chart {
                for triangle in &chart.triangles {
                    self.label[triangle.index()] = outcome.host;
                }
                self.charts[outcome.host as usize] = Some(chart);
            }
        }
        was_tried
    }

    /// Hosts and their guests: small charts, the smallest first, each go to the neighbour of the
    /// longest common border that is itself no guest.
    fn parties(&self) -> Vec<(u32, Vec<u32>)> {
        let mut small: Vec<(usize, u32)> = (0_u32..)
            .take(self.charts.len())
            .map(|chart| (self.num_triangles(chart), chart))
            .filter(|&(size, chart)| {
                size > 0
                    && size < self.params.absorb_below_triangles
                    && self.tried[chart as usize].len() < MAX_TRIES
            })
            .collect();
        small.sort_unstable();
        let mut role = vec![Role::Free; self.charts.len()];
        let mut guests_of: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for (size, chart) in small {
            if role[chart as usize] != Role::Free {
                continue;
            }
            let host = self
                .borders_m(chart)
                .into_iter()
                .filter(|&(other, _)| {
                    role[other as usize] != Role::Guest
                        && self.num_rejected[other as usize] < MAX_REJECTIONS
                        && !self.tried[chart as usize].contains(&other)
                        && self.num_triangles(other) + size <= self.params.max_chart_triangles
                })
                // The first of equals.
                .fold(
                    None,
                    |best: Option<(u32, f64)>, (other, length)| match best {
                        Some((_, longest)) if length <= longest => best,
                        _ => Some((other, length)),
                    },
                );
            if let Some((host, _)) = host {
                role[chart as usize] = Role::Guest;
                role[host as usize] = Role::Host;
                guests_of.entry(host).or_default().push(chart);
            }
        }
        guests_of.into_iter().collect()
    }

    /// Length of the border that a chart has with each neighbour.
    fn borders_m(&self, chart: u32) -> BTreeMap<u32, f64> {
        let mut borders: BTreeMap<u32, f64> = BTreeMap::new();
        let triangles = self.charts[chart as usize]
            .iter()
            .flat_map(|c| &c.triangles);
        for &triangle in triangles {
            let corners = self.manifold.oriented_corners_m(self.mesh, triangle);
            for k in 0..3 {
                let mate = self.manifold.mates()[3 * triangle.index() + k];
                if mate == NO_HALF_EDGE || self.label[mate as usize / 3] == chart {
                    continue;
                }
                let length = (corners[(k + 1) % 3] - corners[k]).norm();
                *borders.entry(self.label[mate as usize / 3]).or_default() += length;
            }
        }
        borders
    }

    /// Flattens a host with all its guests or, where that does not come out well, with one half of
    /// them and then the other, down to single ones.
    fn join(&self, host: u32, guests: Vec<u32>) -> Joined {
        let mut joined = Joined {
            host,
            chart: None,
            absorbed: Vec::new(),
            rejected: Vec::new(),
            num_tried: 0,
        };
        let own = self.triangles_of(host);
        let mut groups = vec![guests];
        while let Some(mut group) = groups.pop() {
            if self.num_rejected[host as usize] + joined.rejected.len() >= MAX_REJECTIONS {
                joined.rejected.append(&mut group);
                continue;
            }
            let current = joined.chart.as_ref().map_or(&own, |chart| &chart.triangles);
            let mut together = current.clone();
            for &guest in &group {
                together.extend(self.triangles_of(guest));
            }
            let mut chart = None;
            if together.len() <= self.params.max_chart_triangles {
                joined.num_tried += 1;
                chart = self.flatten_together(together);
            }
            if chart.is_some() {
                joined.chart = chart;
                joined.absorbed.append(&mut group);
            } else if group.len() > 1 {
                let rest = group.split_off(group.len() / 2);
                groups.extend([rest, group]);
            } else {
                joined.rejected.append(&mut group);
            }
        }
        joined
    }

    fn triangles_of(&self, chart: u32) -> Vec<TriangleId> {
        let chart = self.charts[chart as usize].as_ref();
        chart.map_or_else(Vec::new, |chart| chart.triangles.clone())
    }

    /// The triangles as one chart, if it passes.
    fn flatten_together(&self, mut triangles: Vec<TriangleId>) -> Option<FlatChart> {
        triangles.sort_unstable();
        let piece = Piece::of_triangles(self.manifold.mates(), triangles);
        let surface = piece.corners_m(self.mesh, self.manifold);
        let mut counts = SolveCounts::default();
        let flat = try_flatten(
            &piece,
            &surface,
            self.params,
            MAX_SLITS_TOGETHER,
            &mut counts,
        )
        .ok()?;
        let mut placed = flat.corners_m.iter().zip(&flat.stretches);
        if placed.any(|(corners, stretch)| must_leave(corners, stretch.as_ref(), self.params.mode))
        {
            return None;
        }
        let layer = PlaneTriangles::new(&flat.corners_m);
        if !overlapping_pairs(&layer, 0).is_some_and(|pairs| pairs.is_empty()) {
            return None;
        }
        let stretches: Vec<_> = flat.stretches.into_iter().flatten().collect();
        let in_mesh = piece.triangles.iter().zip(&flat.corners_m);
        Some(FlatChart {
            corners_m: in_mesh
                .map(|(&triangle, corners)| in_mesh_order(*corners, triangle, self.manifold))
                .collect(),
            triangles: piece.triangles,
            distortion: summarize(&stretches),
        })
    }

    fn finish(self) -> Vec<FlatChart> {
        let mut charts = self.charts.into_iter().flatten().collect();
        attach_collapsed(self.mesh, self.manifold, &mut charts);
        charts
    }
}

/// What became of a host and its guests.
struct Joined {
    host: u32,
    /// The host with what it absorbed.
    chart: Option<FlatChart>,
    absorbed: Vec<u32>,
    rejected: Vec<u32>,
    num_tried: usize,
}

fn without_collapsed(mut chart: FlatChart, manifold: &Manifold) -> FlatChart {
    if chart.triangles.iter().any(|&t| manifold.is_collapsed(t)) {
        let kept = |i: &usize| !manifold.is_collapsed(chart.triangles[*i]);
        let kept: Vec<usize> = (0..chart.triangles.len()).filter(kept).collect();
        chart.corners_m = kept.iter().map(|&i| chart.corners_m[i]).collect();
        chart.triangles = kept.iter().map(|&i| chart.triangles[i]).collect();
    }
    chart
}
