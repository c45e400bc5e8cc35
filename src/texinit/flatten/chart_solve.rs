//! From one piece to flat charts: disk, flatten, judge, and split where the result is not good.

use super::bff::{BffError, Boundary, FlatDisk, flatten_disk};
use super::cones::place_cones;
use super::cut::{Disk, Surface, make_disk, slit};
use super::distortion::{Stretch, stretch, summarize};
use super::judge::{Rejected, judge, must_leave, scale_to_area};
use super::piece::Piece;
use super::split::{around_blamed, halves};
use super::{ChartBoundary, ChartMode, FlatChart, FlattenParams};
use crate::mesh::components::components_within;
use crate::mesh::{Manifold, TriMesh, TriangleId};
use nalgebra::Point3;

/// How many times a piece may be halved before its triangles are laid out one by one.
const MAX_SPLIT_DEPTH: u32 = 16;

/// A piece gets one slit, and one more for each so many triangles.
const TRIANGLES_PER_SLIT: usize = 60;

/// But not more than this: each slit is another factorisation.
const MAX_SLITS: usize = 20;

/// What happened on the way, summed over charts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SolveCounts {
    /// Holes filled for the solve.
    pub num_filled_holes: usize,
    /// Edges cut to make disks.
    pub num_cut_edges: usize,
    /// Cones placed in whole components.
    pub num_cones: usize,
    /// Whole components that could not be flattened through cones and were cut without any.
    pub num_without_cones: usize,
    /// Slits to where charts shrank too much.
    pub num_slits: usize,
    /// Pieces split because no disk could be made of them.
    pub num_split_for_topology: usize,
    /// Pieces split because the Laplacian could not be factored or the boundary not closed.
    pub num_split_for_solver: usize,
    /// Pieces split because too much of their area was flipped.
    pub num_split_for_flips: usize,
    /// Pieces split because a distortion bound was passed.
    pub num_split_for_distortion: usize,
    /// Flipped or crushed triangles that became charts of their own.
    pub num_ejected_triangles: usize,
}

impl SolveCounts {
    pub(crate) fn add(&mut self, other: &Self) {
        self.num_filled_holes += other.num_filled_holes;
        self.num_cut_edges += other.num_cut_edges;
        self.num_cones += other.num_cones;
        self.num_without_cones += other.num_without_cones;
        self.num_slits += other.num_slits;
        self.num_split_for_topology += other.num_split_for_topology;
        self.num_split_for_solver += other.num_split_for_solver;
        self.num_split_for_flips += other.num_split_for_flips;
        self.num_split_for_distortion += other.num_split_for_distortion;
        self.num_ejected_triangles += other.num_ejected_triangles;
    }
}

/// A judged flattening of a piece, corners in oriented order.
pub(crate) struct Flat {
    pub(crate) corners_m: Vec<[[f64; 2]; 3]>,
    pub(crate) stretches: Vec<Option<Stretch>>,
    num_filled_holes: usize,
    num_cut_edges: usize,
    num_cones: usize,
    num_slits: usize,
}

/// Flattens a piece into one chart or, where that fails, several.
pub(crate) fn flatten_piece(
    piece: Piece,
    mesh: &TriMesh,
    manifold: &Manifold,
    params: &FlattenParams,
) -> (Vec<FlatChart>, SolveCounts) {
    let mut charts = Vec::new();
    let mut counts = SolveCounts::default();
    let mut stack = vec![(piece, 0)];
    while let Some((piece, depth)) = stack.pop() {
        let surface = piece.corners_m(mesh, manifold);
        let max_slits = (1 + piece.len() / TRIANGLES_PER_SLIT).min(MAX_SLITS);
        let rejected = match try_flatten(&piece, &surface, params, max_slits, &mut counts) {
            Ok(flat) => {
                counts.num_filled_holes += flat.num_filled_holes;
                counts.num_cut_edges += flat.num_cut_edges;
                counts.num_cones += flat.num_cones;
                counts.num_slits += flat.num_slits;
                emit(
                    &piece,
                    &surface,
                    flat,
                    manifold,
                    params,
                    &mut charts,
                    &mut counts,
                );
                continue;
            }
            Err(rejected) => rejected,
        };
        let blamed = match rejected {
            Rejected::NotADisk => {
                counts.num_split_for_topology += 1;
                None
            }
            Rejected::Solver => {
                counts.num_split_for_solver += 1;
                None
            }
            Rejected::Flipped(blamed) => {
                counts.num_split_for_flips += 1;
                Some(blamed)
            }
            Rejected::Distorted(blamed) => {
                counts.num_split_for_distortion += 1;
                Some(blamed)
            }
        };
        if depth < MAX_SPLIT_DEPTH && piece.len() > 1 {
            let label = blamed
                .and_then(|blamed| around_blamed(&piece, blamed))
                .unwrap_or_else(|| halves(&piece, &surface));
            let parts = piece.split(&label);
            stack.extend(parts.into_iter().rev().map(|part| (part, depth + 1)));
        } else {
            let singles = piece.triangles.iter().zip(&surface);
            charts.extend(singles.map(|(&t, corners)| single(t, corners, manifold)));
        }
    }
    (charts, counts)
}

/// Makes the piece a disk, flattens it, and slits it to where it shrinks too much.
pub(crate) fn try_flatten(
    piece: &Piece,
    surface: &[[Point3<f64>; 3]],
    params: &FlattenParams,
    max_slits: usize,
    counts: &mut SolveCounts,
) -> Result<Flat, Rejected> {
    if let [corners] = surface {
        let corners_m = vec![isometric(corners)];
        return Ok(Flat {
            stretches: vec![stretch(corners, &corners_m[0])],
            corners_m,
            num_filled_holes: 0,
            num_cut_edges: 0,
            num_cones: 0,
            num_slits: 0,
        });
    }
    let is_isometric = params.boundary == ChartBoundary::Isometric;
    if params.mode == ChartMode::Paper && is_isometric && params.max_cones > 0 {
        match flatten_with_cones(piece, surface, params) {
            Some(flat) => return Ok(flat),
            None => counts.num_without_cones += 1,
        }
    }
    let mut disk = make_disk(surface.to_vec(), piece.mates.clone()).ok_or(Rejected::NotADisk)?;
    let (condition, max_slits) = if is_isometric {
        (Boundary::Isometric, max_slits)
    } else {
        // A slit would only be opened to a part of the circle.
        (Boundary::Circle, 0)
    };
    let mut num_slits = 0;
    loop {
        let flat = flatten_disk(&disk, condition).map_err(|error| {
            log_failure(piece, &error);
            Rejected::Solver
        })?;
        let rejected = match accept(&disk, &flat, surface, params) {
            Ok(flat) => return Ok(Flat { num_slits, ..flat }),
            Err(rejected) => rejected,
        };
        let slit_disk = flat
            .most_shrunk_vertex
            .filter(|_| num_slits < max_slits)
            .and_then(|vertex| slit(&disk, vertex));
        disk = slit_disk.ok_or(rejected)?;
        num_slits += 1;
    }
}

/// A whole component, cut through generators and cones, lengths along the cut kept; none where
/// that cannot be done, which a cut without cones or a split then mends.
fn flatten_with_cones(
    piece: &Piece,
    surface_m: &[[Point3<f64>; 3]],
    params: &FlattenParams,
) -> Option<Flat> {
    let surface = Surface::filled(surface_m.to_vec(), piece.mates.clone());
    let (surface, num_handle_edges) = surface.without_handles();
    let cones = place_cones(&surface, params.max_cones)?;
    let mut disk = surface.cut_open(&cones.vertices)?;
    disk.num_cut_edges += num_handle_edges;
    let flat = flatten_disk(&disk, Boundary::Isometric)
        .inspect_err(|error| log_failure(piece, error))
        .ok()?;
    let flat = accept(&disk, &flat, surface_m, params).ok()?;
    Some(Flat {
        num_cones: cones.vertices.len(),
        ..flat
    })
}

/// The piece's triangles in the plane, if good enough.
fn accept(
    disk: &Disk,
    flat: &FlatDisk,
    surface: &[[Point3<f64>; 3]],
    params: &FlattenParams,
) -> Result<Flat, Rejected> {
    let mut corners_m: Vec<[[f64; 2]; 3]> = disk.vertices[..disk.num_real]
        .iter()
        .map(|corners| corners.map(|v| flat.points_m[v as usize]))
        .collect();
    scale_to_area(surface, &mut corners_m).ok_or(Rejected::Solver)?;
    let stretches: Vec<Option<Stretch>> = surface
        .iter()
        .zip(&corners_m)
        .map(|(surface, flat)| stretch(surface, flat))
        .collect();
    judge(&stretches, params)?;
    Ok(Flat {
        corners_m,
        stretches,
        num_filled_holes: disk.num_filled_holes,
        num_cut_edges: disk.num_cut_edges,
        num_cones: 0,
        num_slits: 0,
    })
}

fn log_failure(piece: &Piece, error: &BffError) {
    tracing::debug!(num_triangles = piece.len(), %error, "chart not flattened");
}

/// Appends the flattened piece as charts; flipped or crushed triangles leave it for charts of their
/// own, and what they held together falls into connected charts.
fn emit(
    piece: &Piece,
    surface: &[[Point3<f64>; 3]],
    flat: Flat,
    manifold: &Manifold,
    params: &FlattenParams,
    charts: &mut Vec<FlatChart>,
    counts: &mut SolveCounts,
) {
    let is_ejected: Vec<bool> = flat
        .corners_m
        .iter()
        .zip(&flat.stretches)
        .map(|(corners, stretch)| must_leave(corners, stretch.as_ref(), params.mode))
        .collect();
    let (part, num_parts) =
        components_within(&piece.mates, |a, b| !is_ejected[a] && !is_ejected[b]);
    let mut members = vec![Vec::new(); num_parts as usize];
    for (i, &part) in part.iter().enumerate() {
        members[part as usize].push(i);
    }
    for indices in members {
        if let [i] = indices[..] {
            counts.num_ejected_triangles += usize::from(is_ejected[i]);
            charts.push(single(piece.triangles[i], &surface[i], manifold));
            continue;
        }
        let stretches: Vec<Stretch> = indices.iter().filter_map(|&i| flat.stretches[i]).collect();
        charts.push(FlatChart {
            triangles: indices.iter().map(|&i| piece.triangles[i]).collect(),
            corners_m: indices
                .iter()
                .map(|&i| in_mesh_order(flat.corners_m[i], piece.triangles[i], manifold))
                .collect(),
            distortion: summarize(&stretches),
        });
    }
}

/// Oriented corners in the mesh's corner order, and the other way round.
pub(crate) fn in_mesh_order<T>(
    [a, b, c]: [T; 3],
    triangle: TriangleId,
    manifold: &Manifold,
) -> [T; 3] {
    if manifold.is_reversed(triangle) {
        [a, c, b]
    } else {
        [a, b, c]
    }
}

/// A triangle as a chart of its own, from its oriented corners; counter-clockwise as the mesh has
/// it.
pub(crate) fn single(
    triangle: TriangleId,
    corners: &[Point3<f64>; 3],
    manifold: &Manifold,
) -> FlatChart {
    FlatChart {
        triangles: vec![triangle],
        corners_m: vec![isometric(&in_mesh_order(*corners, triangle, manifold))],
        distortion: Default::default(),
    }
}

/// The triangle laid flat, its first side along x; zero where lengths are not finite.
fn isometric([a, b, c]: &[Point3<f64>; 3]) -> [[f64; 2]; 3] {
    let (along, other) = (b - a, c - a);
    let length = along.norm();
    let flat = if length > 0.0 {
        let direction = along / length;
        [
            [0.0, 0.0],
            [length, 0.0],
            [other.dot(&direction), other.cross(&direction).norm()],
        ]
    } else {
        [[0.0, 0.0], [0.0, 0.0], [other.norm(), 0.0]]
    };
    if flat.iter().flatten().all(|c| c.is_finite()) {
        flat
    } else {
        [[0.0; 2]; 3]
    }
}
