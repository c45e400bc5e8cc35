//! Mesh to flat charts: the first stage of TexInit.
//!
//! [`flatten`] cuts the mesh into disk-like charts and flattens each by boundary first flattening
//! (Sawhney and Crane 2018; [`bff`]). Every triangle is in exactly one chart, whatever the soup.
//!
//! - Vertices of equal position count as one; [`crate::mesh::Manifold`] makes the soup manifold.
//! - [`ChartMode::Streaming`]: charts of bounded normal deviation, size and roughness
//!   ([`charts`]); a flattening that is flipped or distorted past the bounds is slit to where it
//!   shrinks most, and where that does not help split, and tried again. Single triangles that are
//!   flipped or crushed in a good flattening become charts of their own.
//! - [`ChartMode::Paper`]: one chart per connected component. Closed surfaces and handles are cut
//!   through generators and [`cones`]; only what cannot be solved is split; flipped triangles become
//!   charts of their own.
//! - Holes inside a chart are filled for the solve only ([`cut`]).
//! - What is split off is often small: once overlaps are separated, [`absorb()`] joins it to
//!   neighbours where both flatten together.
//! - A piece whose Laplacian has no factor or whose boundary curve does not close is split, counted
//!   ([`SolveCounts::num_split_for_solver`]) and logged.
//! - Triangles that name a position twice join the chart of a neighbour along their one edge, with
//!   that edge's flat ends, else they are charts of their own.
//!
//! Flat coordinates are metres, y up: each chart is scaled so that its flat area is its area on
//! the surface. Triangles are counter-clockwise, except those that the mesh has reversed against
//! their neighbours ([`crate::mesh::ManifoldReport::num_reversed_triangles`]): these are mirrored
//! in their chart. Charts may still overlap themselves; that is the next stage's.
//!
//! [`DiskSurface`] gives the map of one surface to a boundary of choice by itself.
//!
//! Charts are solved in parallel, each sequentially; the result does not depend on the thread
//! count.

pub(crate) mod absorb;
pub(crate) mod bff;
pub(crate) mod chart_solve;
pub(crate) mod charts;
pub(crate) mod cones;
pub(crate) mod cut;
pub(crate) mod disk_surface;
pub(crate) mod distortion;
pub(crate) mod faces;
pub(crate) mod judge;
pub(crate) mod laplacian;
pub(crate) mod merge;
pub(crate) mod piece;
pub(crate) mod solver;
pub(crate) mod split;

#[cfg(test)]
mod tests;

use std::time::{Duration, Instant};

use rayon::prelude::*;

pub use absorb::{AbsorbReport, absorb};
pub use bff::{BffError, Boundary, Closure};
pub use chart_solve::SolveCounts;
pub use disk_surface::{DiskError, DiskMap, DiskSurface};
pub use distortion::ChartDistortion;
pub use solver::SolverError;

use chart_solve::{flatten_piece, in_mesh_order, single};
use distortion::{DistortionSums, stretch};
use faces::Faces;
use piece::Piece;

use crate::mesh::adjacency::NO_HALF_EDGE;
use crate::mesh::{Manifold, ManifoldReport, MeshError, TriMesh, TriangleId};

/// How the mesh is cut into charts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChartMode {
    /// Many charts of bounded distortion.
    #[default]
    Streaming,
    /// One chart per connected component.
    Paper,
}

/// What the boundary of each chart is made to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChartBoundary {
    /// Lengths as on the surface: least area distortion.
    #[default]
    Isometric,
    /// A circle, conformally. Charts that this distorts past the bounds are split.
    Disk,
}

/// How to cut and flatten.
#[derive(Debug, Clone, PartialEq)]
pub struct FlattenParams {
    /// How the mesh is cut into charts.
    pub mode: ChartMode,
    /// What the boundary of each chart is made to be. With a disk, whole components are cut without
    /// cones.
    pub boundary: ChartBoundary,
    /// Largest angle between a triangle's smoothed normal and its chart's, radians, (0, π/2].
    pub max_normal_deviation_rad: f64,
    /// Most triangles in a chart, ≥ 1.
    pub max_chart_triangles: usize,
    /// Charts of fewer triangles are merged into neighbours where normals and size allow.
    pub min_chart_triangles: usize,
    /// Largest perimeter² / (4π area) that merging charts may make, ≥ 1 (a disk).
    pub max_boundary_roughness: f64,
    /// How often a normal is averaged with its neighbours'.
    pub num_smoothing_rounds: u32,
    /// How often charts are grown again from their centres.
    pub num_relaxation_rounds: u32,
    /// Largest area-weighted mean of the quasi-conformal error of a chart, ≥ 1.
    pub max_quasi_conformal_mean: f64,
    /// Largest factor by which lengths may grow or shrink in a chart (its extreme hundredths of
    /// area apart), ≥ 1.
    pub max_stretch: f64,
    /// Largest share of a chart's area that may be flipped triangles, [0, 1]; up to it they leave
    /// the chart, beyond it the chart is slit or split.
    pub max_flipped_share: f64,
    /// Most cones in a whole component ([`ChartMode::Paper`]); 0 places none.
    pub max_cones: usize,
    /// Charts of fewer triangles are joined to neighbours after flattening, where the two flatten
    /// together within the bounds ([`absorb()`]); 0 joins none.
    pub absorb_below_triangles: usize,
}

impl Default for FlattenParams {
    fn default() -> Self {
        Self {
            mode: ChartMode::Streaming,
            boundary: ChartBoundary::Isometric,
            max_normal_deviation_rad: 55_f64.to_radians(),
            max_chart_triangles: 1500,
            min_chart_triangles: 12,
            max_boundary_roughness: 4.0,
            num_smoothing_rounds: 5,
            num_relaxation_rounds: 3,
            max_quasi_conformal_mean: 1.5,
            max_stretch: 2.0,
            max_flipped_share: 0.005,
            max_cones: 100,
            absorb_below_triangles: 30,
        }
    }
}

/// Why nothing was flattened.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FlattenError {
    /// A parameter is out of its range.
    #[error("flatten parameter {name} = {value} is not in {range}")]
    InvalidParam {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// The mesh cannot be indexed.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

impl FlattenParams {
    fn check(&self) -> Result<(), FlattenError> {
        let half_turn = std::f64::consts::FRAC_PI_2;
        let deviation = self.max_normal_deviation_rad;
        let checks = [
            (
                "max_normal_deviation_rad",
                deviation,
                "(0, π/2]",
                deviation > 0.0 && deviation <= half_turn,
            ),
            (
                "max_chart_triangles",
                self.max_chart_triangles as f64,
                "[1, ∞)",
                self.max_chart_triangles >= 1,
            ),
            (
                "max_boundary_roughness",
                self.max_boundary_roughness,
                "[1, ∞)",
                self.max_boundary_roughness >= 1.0,
            ),
            (
                "max_quasi_conformal_mean",
                self.max_quasi_conformal_mean,
                "[1, ∞)",
                self.max_quasi_conformal_mean >= 1.0,
            ),
            (
                "max_stretch",
                self.max_stretch,
                "[1, ∞)",
                self.max_stretch >= 1.0,
            ),
            (
                "max_flipped_share",
                self.max_flipped_share,
                "[0, 1]",
                (0.0..=1.0).contains(&self.max_flipped_share),
            ),
        ];
        match checks.into_iter().find(|(_, _, _, is_valid)| !is_valid) {
            Some((name, value, range, _)) => Err(FlattenError::InvalidParam { name, value, range }),
            None => Ok(()),
        }
    }
}

/// A connected set of triangles and where they lie in the plane.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatChart {
    /// Its triangles, ascending, collapsed ones last.
    pub triangles: Vec<TriangleId>,
    /// Per triangle of `triangles`, its corners in the mesh's corner order, metres, y up.
    pub corners_m: Vec<[[f64; 2]; 3]>,
    /// How far it is from the surface.
    pub distortion: ChartDistortion,
}

/// What [`flatten`] did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FlattenReport {
    /// What was not manifold.
    pub manifold: ManifoldReport,
    /// Failures and remedies of the solves.
    pub solve: SolveCounts,
    /// Charts grown, before any was split.
    pub num_grown_charts: usize,
    /// Charts in the result.
    pub num_charts: usize,
    /// Of these, with a single triangle.
    pub num_single_triangle_charts: usize,
    /// Length of edges whose two faces lie apart in the plane, metres.
    pub seam_length_m: f64,
    /// Over the area of all charts.
    pub distortion: ChartDistortion,
    /// Time to join the triangles.
    pub manifold_time: Duration,
    /// Time to grow the charts.
    pub charts_time: Duration,
    /// Time to flatten them.
    pub solve_time: Duration,
}

/// Charts and report.
#[derive(Debug, Clone, PartialEq)]
pub struct FlattenResult {
    /// All charts; each triangle of the mesh is in exactly one.
    pub charts: Vec<FlatChart>,
    /// How the triangles are joined.
    pub manifold: Manifold,
    /// What was done.
    pub report: FlattenReport,
}

/// Cuts `mesh` into charts and flattens each.
///
/// # Errors
/// [`FlattenError`] for a parameter out of range or a mesh that 32 bits cannot index.
pub fn flatten(mesh: &TriMesh, params: &FlattenParams) -> Result<FlattenResult, FlattenError> {
    params.check()?;
    let start = Instant::now();
    let manifold = Manifold::new(mesh)?;
    let manifold_time = start.elapsed();

    let start = Instant::now();
    let (label, num_grown_charts) = match params.mode {
        ChartMode::Streaming => {
            let faces = Faces::new(mesh, &manifold, params.num_smoothing_rounds);
            charts::grow_charts(&manifold, &faces, params)
        }
        ChartMode::Paper => charts::whole_components(&manifold, mesh.num_triangles()),
    };
    let pieces = Piece::from_labels(manifold.mates(), &label, num_grown_charts);
    let charts_time = start.elapsed();

    let start = Instant::now();
    let solved: Vec<(Vec<FlatChart>, SolveCounts)> = pieces
        .into_par_iter()
        .map(|piece| flatten_piece(piece, mesh, &manifold, params))
        .collect();
    let mut solve = SolveCounts::default();
    let mut charts = Vec::new();
    for (flat, counts) in solved {
        charts.extend(flat);
        solve.add(&counts);
    }
    attach_collapsed(mesh, &manifold, &mut charts);
    if solve.num_split_for_solver + solve.num_without_cones > 0 {
        tracing::warn!(
            num_split = solve.num_split_for_solver,
            num_without_cones = solve.num_without_cones,
            "pieces could not be flattened as they were; they were split, or cut without cones"
        );
    }
    let report = FlattenReport {
        manifold: *manifold.report(),
        solve,
        num_grown_charts,
        num_charts: charts.len(),
        num_single_triangle_charts: charts.iter().filter(|c| c.triangles.len() == 1).count(),
        seam_length_m: seam_length_m(mesh, &manifold, &charts),
        distortion: overall_distortion(mesh, &manifold, &charts),
        manifold_time,
        charts_time,
        solve_time: start.elapsed(),
    };
    Ok(FlattenResult {
        charts,
        manifold,
        report,
    })
}

/// Puts each collapsed triangle beside a triangle that has its one edge, else on its own.
fn attach_collapsed(mesh: &TriMesh, manifold: &Manifold, charts: &mut Vec<FlatChart>) {
    let collapsed: Vec<TriangleId> = mesh
        .triangle_ids()
        .filter(|&t| manifold.is_collapsed(t))
        .collect();
    if collapsed.is_empty() {
        return;
    }
    let welded = manifold.welded_triangles();
    let mut sides: Vec<([u32; 2], usize, usize, usize)> = Vec::new();
    for (c, chart) in charts.iter().enumerate() {
        for (i, triangle) in chart.triangles.iter().enumerate() {
            let corners = welded[triangle.index()];
            for k in 0..3 {
                let ends = [corners[k], corners[(k + 1) % 3]];
                sides.push(([ends[0].min(ends[1]), ends[0].max(ends[1])], c, i, k));
            }
        }
    }
    sides.sort_unstable();
    for triangle in collapsed {
        let corners = welded[triangle.index()];
        let low = corners.into_iter().min().unwrap_or_default();
        let high = corners.into_iter().max().unwrap_or_default();
        let found = sides.partition_point(|side| side.0 < [low, high]);
        match sides.get(found) {
            Some(&(ends, c, i, k)) if ends == [low, high] => {
                let beside = welded[charts[c].triangles[i].index()];
                let flat = charts[c].corners_m[i];
                let place = |v: u32| {
                    if beside[k] == v {
                        flat[k]
                    } else {
                        flat[(k + 1) % 3]
                    }
                };
                charts[c].triangles.push(triangle);
                charts[c].corners_m.push(corners.map(place));
            }
            _ => charts.push(single(triangle, &mesh.corners_m(triangle), manifold)),
        }
    }
}

/// Sum over mates whose flat sides do not coincide.
fn seam_length_m(mesh: &TriMesh, manifold: &Manifold, charts: &[FlatChart]) -> f64 {
    let mut place = vec![(u32::MAX, [[0.0; 2]; 3]); mesh.num_triangles()];
    for (c, chart) in (0_u32..).zip(charts) {
        for (triangle, corners) in chart.triangles.iter().zip(&chart.corners_m) {
            place[triangle.index()] = (c, in_mesh_order(*corners, *triangle, manifold));
        }
    }
    let mut length = 0.0;
    for (h, &mate) in (0_u32..).zip(manifold.mates()) {
        if mate == NO_HALF_EDGE || mate < h {
            continue;
        }
        let side = |h: u32| {
            let (chart, corners) = place[h as usize / 3];
            let k = h as usize % 3;
            (chart, corners[k], corners[(k + 1) % 3])
        };
        let (chart, start, end) = side(h);
        if side(mate) != (chart, end, start) {
            let corners = manifold.oriented_corners_m(mesh, TriangleId(h / 3));
            let k = h as usize % 3;
            length += (corners[(k + 1) % 3] - corners[k]).norm();
        }
    }
    length
}

/// Of all triangles together, at one scale.
fn overall_distortion(
    mesh: &TriMesh,
    manifold: &Manifold,
    charts: &[FlatChart],
) -> ChartDistortion {
    let sums: Vec<DistortionSums> = charts
        .par_iter()
        .map(|chart| {
            let placed = chart.triangles.iter().zip(&chart.corners_m);
            DistortionSums::of(placed.filter_map(|(&triangle, corners)| {
                let surface = manifold.oriented_corners_m(mesh, triangle);
                stretch(&surface, &in_mesh_order(*corners, triangle, manifold))
            }))
        })
        .collect();
    let mut overall = DistortionSums::default();
    for chart in &sums {
        overall.add(chart);
    }
    overall.distortion()
}
