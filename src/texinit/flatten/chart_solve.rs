//! From one piece to flat charts: disk, flatten, judge, and split where the result is not good.

use super::bff::{BffError, flatten_disk};
use super::cut::make_disk;
use super::distortion::{Stretch, doubled_area, stretch, summarize};
use super::piece::Piece;
use super::{ChartMode, FlatChart, FlattenParams};
use crate::mesh::adjacency::NO_HALF_EDGE;
use crate::mesh::components::components_within;
use crate::mesh::{Manifold, TriMesh, TriangleId};
use nalgebra::Point3;

/// How many times a piece may be halved before its triangles are laid out one by one.
const MAX_SPLIT_DEPTH: u32 = 16;

/// Area-weighted share of a chart at each end that the stretch bound ignores.
const STRETCH_TAIL: f64 = 0.01;

/// What happened on the way, summed over charts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SolveCounts {
    /// Holes filled for the solve.
    pub num_filled_holes: usize,
    /// Edges cut to make disks.
    pub num_cut_edges: usize,
    /// Pieces halved because no disk could be made of them.
    pub num_split_for_topology: usize,
    /// Pieces halved because the Laplacian could not be factored or the boundary not closed.
    pub num_split_for_solver: usize,
    /// Pieces halved because too much of their area was flipped.
    pub num_split_for_flips: usize,
    /// Pieces halved because a distortion bound was passed.
    pub num_split_for_distortion: usize,
    /// Flipped triangles that became charts of their own.
    pub num_flipped_triangles: usize,
}

impl SolveCounts {
    pub(crate) fn add(&mut self, other: &Self) {
        self.num_filled_holes += other.num_filled_holes;
        self.num_cut_edges += other.num_cut_edges;
        self.num_split_for_topology += other.num_split_for_topology;
        self.num_split_for_solver += other.num_split_for_solver;
        self.num_split_for_flips += other.num_split_for_flips;
        self.num_split_for_distortion += other.num_split_for_distortion;
        self.num_flipped_triangles += other.num_flipped_triangles;
    }
}

enum Rejected {
    NotADisk,
    Solver,
    Flipped,
    Distorted,
}

/// A judged flattening of a piece, corners in oriented order.
struct Flat {
    corners_m: Vec<[[f64; 2]; 3]>,
    stretches: Vec<Option<Stretch>>,
    num_filled_holes: usize,
    num_cut_edges: usize,
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
        let rejected = match try_flatten(&piece, &surface, params) {
            Ok(flat) => {
                counts.num_filled_holes += flat.num_filled_holes;
                counts.num_cut_edges += flat.num_cut_edges;
                emit(&piece, &surface, flat, manifold, &mut charts, &mut counts);
                continue;
            }
            Err(rejected) => rejected,
        };
        match rejected {
            Rejected::NotADisk => counts.num_split_for_topology += 1,
            Rejected::Solver => counts.num_split_for_solver += 1,
            Rejected::Flipped => counts.num_split_for_flips += 1,
            Rejected::Distorted => counts.num_split_for_distortion += 1,
        }
        if depth < MAX_SPLIT_DEPTH && piece.len() > 1 {
            let parts = piece.split(&halves(&piece, &surface));
            stack.extend(parts.into_iter().rev().map(|part| (part, depth + 1)));
        } else {
            let singles = piece.triangles.iter().zip(&surface);
            charts.extend(singles.map(|(&t, corners)| single(t, corners, manifold)));
        }
    }
    (charts, counts)
}

fn try_flatten(
    piece: &Piece,
    surface: &[[Point3<f64>; 3]],
    params: &FlattenParams,
) -> Result<Flat, Rejected> {
    if let [corners] = surface {
        let corners_m = vec![isometric(corners)];
        return Ok(Flat {
            stretches: vec![stretch(corners, &corners_m[0])],
            corners_m,
            num_filled_holes: 0,
            num_cut_edges: 0,
        });
    }
    let disk = make_disk(surface.to_vec(), piece.mates.clone()).ok_or(Rejected::NotADisk)?;
    let points = flatten_disk(&disk).map_err(|error| {
        log_failure(piece, &error);
        Rejected::Solver
    })?;
    let mut corners_m: Vec<[[f64; 2]; 3]> = disk.vertices[..disk.num_real]
        .iter()
        .map(|corners| corners.map(|v| points[v as usize]))
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
    })
}

fn log_failure(piece: &Piece, error: &BffError) {
    tracing::debug!(num_triangles = piece.len(), %error, "chart not flattened");
}

/// Scales the chart so that its flat area is its area on the surface.
fn scale_to_area(surface: &[[Point3<f64>; 3]], corners_m: &mut [[[f64; 2]; 3]]) -> Option<()> {
    let area: f64 = surface
        .iter()
        .map(|[a, b, c]| (b - a).cross(&(c - a)).norm())
        .sum();
    let flat: f64 = corners_m.iter().map(doubled_area).sum();
    // A chart of no area keeps its lengths.
    let scale = if area > 0.0 {
        (area / flat).sqrt()
    } else {
        1.0
    };
    if !scale.is_finite() {
        return None;
    }
    for coordinate in corners_m.iter_mut().flatten().flatten() {
        *coordinate *= scale;
    }
    Some(())
}

/// Whether the flattening is good enough. Whole components are taken as they come.
fn judge(stretches: &[Option<Stretch>], params: &FlattenParams) -> Result<(), Rejected> {
    if params.mode == ChartMode::Paper {
        return Ok(());
    }
    let mut known: Vec<&Stretch> = stretches.iter().flatten().collect();
    let area: f64 = known.iter().map(|s| s.area_m2).sum();
    let flipped: f64 = known
        .iter()
        .filter(|s| s.area_ratio <= 0.0)
        .map(|s| s.area_m2)
        .sum();
    if flipped > params.max_flipped_share * area {
        return Err(Rejected::Flipped);
    }
    let dilatation: f64 = known
        .iter()
        .map(|s| s.area_m2 * s.quasi_conformal.min(10.0))
        .sum();
    if dilatation > params.max_quasi_conformal_mean * area {
        return Err(Rejected::Distorted);
    }
    known.sort_by(|a, b| a.area_ratio.total_cmp(&b.area_ratio));
    let limit2 = params.max_stretch * params.max_stretch;
    let ratios: Vec<(f64, f64)> = known.iter().map(|s| (s.area_ratio, s.area_m2)).collect();
    let low = past_tail(ratios.iter(), area);
    let high = past_tail(ratios.iter().rev(), area);
    if low * limit2 < 1.0 || high > limit2 {
        return Err(Rejected::Distorted);
    }
    Ok(())
}

/// The first ratio beyond the tail of the area, in the order given as (ratio, area).
fn past_tail<'a>(ratios: impl Iterator<Item = &'a (f64, f64)>, area: f64) -> f64 {
    let mut passed = 0.0;
    for (ratio, own) in ratios {
        passed += own;
        if passed > STRETCH_TAIL * area {
            return *ratio;
        }
    }
    1.0
}

/// Two labels: triangles nearer (along the piece) to one or the other of two far triangles.
fn halves(piece: &Piece, surface: &[[Point3<f64>; 3]]) -> Vec<u32> {
    let centroids: Vec<Point3<f64>> = surface
        .iter()
        .map(|[a, b, c]| Point3::from((a.coords + b.coords + c.coords) / 3.0))
        .collect();
    let farthest = |from: Point3<f64>| {
        let mut best = 0;
        for (i, centroid) in centroids.iter().enumerate() {
            if (centroid - from).norm_squared() > (centroids[best] - from).norm_squared() {
                best = i;
            }
        }
        best
    };
    let first = farthest(centroids[0]);
    let mut second = farthest(centroids[first]);
    if second == first {
        second = usize::from(first == 0);
    }
    let mut label = vec![u32::MAX; piece.len()];
    let mut heap = std::collections::BinaryHeap::new();
    heap.push(std::cmp::Reverse((0_u64, first, 0)));
    heap.push(std::cmp::Reverse((0_u64, second, 1)));
    while let Some(std::cmp::Reverse((bits, triangle, side))) = heap.pop() {
        if label[triangle] != u32::MAX {
            continue;
        }
        label[triangle] = side;
        for &mate in &piece.mates[3 * triangle..3 * triangle + 3] {
            let neighbor = mate as usize / 3;
            if mate != NO_HALF_EDGE && label[neighbor] == u32::MAX {
                let step = (centroids[neighbor] - centroids[triangle]).norm();
                let distance = f64::from_bits(bits) + step.max(0.0);
                heap.push(std::cmp::Reverse((distance.to_bits(), neighbor, side)));
            }
        }
    }
    label
}

/// Appends the flattened piece as charts; flipped triangles leave it for charts of their own, and
/// what they held together falls into connected charts.
fn emit(
    piece: &Piece,
    surface: &[[Point3<f64>; 3]],
    flat: Flat,
    manifold: &Manifold,
    charts: &mut Vec<FlatChart>,
    counts: &mut SolveCounts,
) {
    let is_flipped: Vec<bool> = flat
        .corners_m
        .iter()
        .zip(&flat.stretches)
        .map(|(corners, stretch)| {
            doubled_area(corners) < 0.0 || (stretch.is_some() && doubled_area(corners) <= 0.0)
        })
        .collect();
    let (part, num_parts) =
        components_within(&piece.mates, |a, b| !is_flipped[a] && !is_flipped[b]);
    let mut members = vec![Vec::new(); num_parts as usize];
    for (i, &part) in part.iter().enumerate() {
        members[part as usize].push(i);
    }
    for indices in members {
        if let [i] = indices[..] {
            counts.num_flipped_triangles += usize::from(is_flipped[i]);
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

fn in_mesh_order(
    [a, b, c]: [[f64; 2]; 3],
    triangle: TriangleId,
    manifold: &Manifold,
) -> [[f64; 2]; 3] {
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
    let [a, b, c] = *corners;
    let in_mesh = if manifold.is_reversed(triangle) {
        [a, c, b]
    } else {
        [a, b, c]
    };
    FlatChart {
        triangles: vec![triangle],
        corners_m: vec![isometric(&in_mesh)],
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
