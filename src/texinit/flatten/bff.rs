//! Boundary first flattening of a disk (Sawhney and Crane 2018), from scale factors or exterior
//! angles of its boundary.
//!
//! With `A` the Laplacian of [`super::laplacian`] (positive, factor ½), Ω the angle defects 2π − Σθ
//! of interior vertices and k = π − Σθ the geodesic curvatures of boundary vertices, a conformal
//! scaling of lengths by e^u makes the surface flat when `(A u)_I = −Ω`, and then the boundary has
//! curvature `k̃ = k + (A u)_B`. So:
//! 1. Dirichlet to Neumann: u on the boundary (0 for the least area distortion) gives k̃; or Neumann
//!    to Dirichlet: k̃ gives u ([`Boundary`]);
//! 2. the boundary curve has exterior angles k̃ and the lengths of the surface scaled by e^u,
//!    corrected in the least-squares sense (weights 1/length) so that it closes;
//! 3. x is the harmonic extension of the curve's x, and y the conjugate of that: the Neumann
//!    problem with flux `−½ (x_next − x_previous)` (Hilbert transform).
//!
//! A disk without interior vertices is developable: its curve is the exact unfolding, step 3 is
//! left out. Angles in radians, lengths in metres; the result is counter-clockwise.

use std::f64::consts::{PI, TAU};

use super::cut::Disk;
use super::laplacian::{Metric, edge_weights};
use super::solver::{Solver, SolverError};

/// Why a disk was not flattened.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum BffError {
    /// Its lengths are zero or not finite.
    #[error("edge lengths are zero or not finite")]
    NoMetric,
    /// The Laplacian could not be factored.
    #[error(transparent)]
    Solver(#[from] SolverError),
    /// The boundary curve cannot be closed with positive lengths.
    #[error("boundary of {num_edges} edges cannot be closed")]
    NotClosed { num_edges: usize },
    /// A coordinate is not finite.
    #[error("a flattened coordinate is not finite")]
    NotFinite,
}

/// What the boundary of a disk is made to be; the rest follows (Sawhney and Crane 2018, section 4).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Boundary<'a> {
    /// Lengths as on the surface, u = 0: least area distortion.
    Isometric,
    /// Log scale factor u of each boundary vertex, in loop order.
    #[cfg_attr(not(test), expect(dead_code, reason = "an option of the method"))]
    LogScale(&'a [f64]),
    /// Exterior angle k̃ of each boundary vertex, in loop order, radians; made to sum to 2π by equal
    /// shares. Scale is free and chosen so that the boundary's mean u is 0.
    #[cfg_attr(not(test), expect(dead_code, reason = "an option of the method"))]
    ExteriorAngles(&'a [f64]),
    /// A circle, conformally: exterior angles in proportion to the lengths that they lead to.
    #[cfg_attr(not(test), expect(dead_code, reason = "an option of the method"))]
    Circle,
}

/// Rounds after which the exterior angles of a circle no longer change ("ten suffice").
const NUM_CIRCLE_ROUNDS: usize = 10;

/// A flattened disk.
pub(crate) struct FlatDisk {
    /// Per vertex its place in the plane, metres.
    pub(crate) points_m: Vec<[f64; 2]>,
    /// The interior vertex whose surroundings shrink most, if any shrink: the one of least u.
    pub(crate) most_shrunk_vertex: Option<usize>,
}

/// Flattens a disk.
pub(crate) fn flatten_disk(disk: &Disk, condition: Boundary<'_>) -> Result<FlatDisk, BffError> {
    let metric = Metric::new(&disk.corners_m).ok_or(BffError::NoMetric)?;
    let numbering = Numbering::new(disk);
    let curvature = Curvature::new(&disk.vertices, &metric, &numbering);
    let lengths = boundary_lengths(disk, &metric);
    let num_interior = numbering.num_interior;

    let mut most_shrunk = None;
    let flat = if num_interior == 0 && condition == Boundary::Isometric {
        closed_curve(&lengths, &curvature.boundary)?
    } else {
        let weights = numbering.renumber(edge_weights(&disk.mates, &disk.vertices, &metric));
        let solver = Solver::new(num_interior, disk.num_vertices, weights)?;
        let (target, scale) = boundary_data(&solver, &curvature, &lengths, condition);
        most_shrunk = place_of_least(&scale[..num_interior]);
        let curve = closed_curve(&scaled(&lengths, &scale[num_interior..]), &target)?;
        extend(&solver, num_interior, &curve)
    };
    if !flat.iter().flatten().all(|c| c.is_finite()) {
        return Err(BffError::NotFinite);
    }
    let point = |place: &u32| flat[*place as usize].map(|c| c * metric.unit_m);
    Ok(FlatDisk {
        points_m: numbering.place.iter().map(point).collect(),
        most_shrunk_vertex: most_shrunk
            .and_then(|place| numbering.place.iter().position(|p| *p as usize == place)),
    })
}

/// Exterior angles of the boundary, and u at every vertex.
fn boundary_data(
    solver: &Solver,
    curvature: &Curvature,
    lengths: &[f64],
    condition: Boundary<'_>,
) -> (Vec<f64>, Vec<f64>) {
    match condition {
        Boundary::Isometric => {
            dirichlet_to_neumann(solver, curvature, &vec![0.0; curvature.boundary.len()])
        }
        Boundary::LogScale(boundary) => dirichlet_to_neumann(solver, curvature, boundary),
        Boundary::ExteriorAngles(angles) => {
            let surplus = (TAU - angles.iter().sum::<f64>()) / angles.len() as f64;
            let target: Vec<f64> = angles.iter().map(|angle| angle + surplus).collect();
            let scale = neumann_to_dirichlet(solver, curvature, &target);
            (target, scale)
        }
        Boundary::Circle => {
            let mut target = turning_of_circle(lengths);
            let mut scale = neumann_to_dirichlet(solver, curvature, &target);
            for _ in 0..NUM_CIRCLE_ROUNDS {
                let scaled = scaled(lengths, &scale[curvature.interior.len()..]);
                target = turning_of_circle(&scaled);
                scale = neumann_to_dirichlet(solver, curvature, &target);
            }
            (target, scale)
        }
    }
}

/// Edge lengths after scaling by e^u, u taken half from each end.
fn scaled(lengths: &[f64], boundary_scale: &[f64]) -> Vec<f64> {
    let next = boundary_scale.iter().cycle().skip(1);
    lengths
        .iter()
        .zip(boundary_scale.iter().zip(next))
        .map(|(length, (u, v))| length * (0.5 * (u + v)).exp())
        .collect()
}

/// Exterior angles of a polygon of these sides inscribed, nearly, in a circle.
fn turning_of_circle(lengths: &[f64]) -> Vec<f64> {
    let perimeter: f64 = lengths.iter().sum();
    let num = lengths.len();
    (0..num)
        .map(|i| std::f64::consts::PI * (lengths[i] + lengths[(i + num - 1) % num]) / perimeter)
        .collect()
}

/// Where the least of the negative values is.
fn place_of_least(values: &[f64]) -> Option<usize> {
    let mut least = None;
    for (place, &value) in values.iter().enumerate() {
        if value < least.map_or(0.0, |(_, best)| best) {
            least = Some((place, value));
        }
    }
    least.map(|(place, _)| place)
}

/// Interior vertices first, then the pinned ones (a disk's boundary, in loop order).
pub(super) struct Numbering {
    num_interior: usize,
    place: Vec<u32>,
}

impl Numbering {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a disk has fewer vertices than 2^32"
    )]
    pub(super) fn pinning(num_vertices: usize, pinned: &[usize]) -> Self {
        let num_interior = num_vertices - pinned.len();
        let mut place = vec![u32::MAX; num_vertices];
        for (i, &vertex) in pinned.iter().enumerate() {
            place[vertex] = (num_interior + i) as u32;
        }
        let interior = place.iter_mut().filter(|slot| **slot == u32::MAX);
        for (slot, count) in interior.zip(0_u32..) {
            *slot = count;
        }
        Self {
            num_interior,
            place,
        }
    }

    pub(super) fn new(disk: &Disk) -> Self {
        let start = |&h: &u32| disk.vertices[h as usize / 3][h as usize % 3] as usize;
        let boundary: Vec<usize> = disk.boundary.iter().map(start).collect();
        Self::pinning(disk.num_vertices, &boundary)
    }

    pub(super) fn num_interior(&self) -> usize {
        self.num_interior
    }

    /// Per vertex its new number.
    pub(super) fn places(&self) -> &[u32] {
        &self.place
    }

    pub(super) fn renumber(&self, mut weights: Vec<(u32, u32, f64)>) -> Vec<(u32, u32, f64)> {
        for (a, b, _) in &mut weights {
            *a = self.place[*a as usize];
            *b = self.place[*b as usize];
        }
        weights
    }
}

/// Angle defects Ω of interior vertices and geodesic curvatures k of boundary vertices (π less for
/// a pinned vertex that is not on the boundary).
pub(super) struct Curvature {
    pub(super) interior: Vec<f64>,
    pub(super) boundary: Vec<f64>,
}

impl Curvature {
    pub(super) fn new(vertices: &[[u32; 3]], metric: &Metric, numbering: &Numbering) -> Self {
        let mut interior = vec![TAU; numbering.num_interior];
        let mut boundary = vec![PI; numbering.place.len() - numbering.num_interior];
        for (vertices, angles) in vertices.iter().zip(&metric.angles) {
            for (&vertex, angle) in vertices.iter().zip(angles) {
                let place = numbering.place[vertex as usize] as usize;
                match place.checked_sub(numbering.num_interior) {
                    Some(at_boundary) => boundary[at_boundary] -= angle,
                    None => interior[place] -= angle,
                }
            }
        }
        Self { interior, boundary }
    }
}

fn boundary_lengths(disk: &Disk, metric: &Metric) -> Vec<f64> {
    let length = |&h: &u32| metric.lengths[h as usize / 3][h as usize % 3];
    disk.boundary.iter().map(length).collect()
}

/// Curvatures k̃ of the boundary when its scale factors are given, and all scale factors.
fn dirichlet_to_neumann(
    solver: &Solver,
    curvature: &Curvature,
    boundary_scale: &[f64],
) -> (Vec<f64>, Vec<f64>) {
    let source: Vec<f64> = curvature.interior.iter().map(|defect| -defect).collect();
    let scale = solver.dirichlet(&source, boundary_scale);
    let flux = solver.apply(&scale);
    let target = curvature
        .boundary
        .iter()
        .zip(&flux[curvature.interior.len()..])
        .map(|(k, flux)| k + flux)
        .collect();
    (target, scale)
}

/// All scale factors when the boundary's curvatures k̃ are given; the boundary's mean is 0.
fn neumann_to_dirichlet(solver: &Solver, curvature: &Curvature, target: &[f64]) -> Vec<f64> {
    let mut flux: Vec<f64> = curvature.interior.iter().map(|defect| -defect).collect();
    let changes = target.iter().zip(&curvature.boundary);
    flux.extend(changes.map(|(target, k)| target - k));
    let mut scale = solver.neumann(&flux);
    let boundary = &scale[curvature.interior.len()..];
    let mean = boundary.iter().sum::<f64>() / boundary.len() as f64;
    scale.iter_mut().for_each(|u| *u -= mean);
    scale
}

/// Start points of the edges of a closed curve with the given exterior angles and, nearly, the
/// given edge lengths; angle `i` is at the start of edge `i`.
pub(super) fn closed_curve(
    lengths: &[f64],
    exterior_angles: &[f64],
) -> Result<Vec<[f64; 2]>, BffError> {
    let not_closed = BffError::NotClosed {
        num_edges: lengths.len(),
    };
    let mut heading = 0.0;
    let tangents: Vec<[f64; 2]> = exterior_angles
        .iter()
        .map(|angle| {
            heading += angle;
            [f64::cos(heading), f64::sin(heading)]
        })
        .collect();
    // Minimise Σ (l̃ - l)² / l with Σ l̃ T = 0: l̃ = l (1 - T·λ), (Σ l T Tᵀ) λ = Σ l T.
    let (mut gap, mut xx, mut xy, mut yy) = ([0.0; 2], 0.0, 0.0, 0.0);
    for (&length, [x, y]) in lengths.iter().zip(&tangents) {
        gap = [gap[0] + length * x, gap[1] + length * y];
        xx += length * x * x;
        xy += length * x * y;
        yy += length * y * y;
    }
    let determinant = xx * yy - xy * xy;
    if determinant.is_nan() || determinant <= 1e-12 * (xx + yy) * (xx + yy) {
        return Err(not_closed);
    }
    let multiplier = [
        (yy * gap[0] - xy * gap[1]) / determinant,
        (xx * gap[1] - xy * gap[0]) / determinant,
    ];
    let mut at = [0.0; 2];
    let mut curve = Vec::with_capacity(lengths.len());
    for (&length, [x, y]) in lengths.iter().zip(&tangents) {
        let factor = 1.0 - (x * multiplier[0] + y * multiplier[1]);
        if factor.is_nan() || factor <= 0.0 {
            return Err(not_closed);
        }
        curve.push(at);
        at = [at[0] + factor * length * x, at[1] + factor * length * y];
    }
    Ok(curve)
}

/// The harmonic extension of the curve's x and the conjugate harmonic y.
fn extend(solver: &Solver, num_interior: usize, curve: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let boundary_x: Vec<f64> = curve.iter().map(|point| point[0]).collect();
    let x = solver.dirichlet(&vec![0.0; num_interior], &boundary_x);
    let num_edges = curve.len();
    let mut flux = vec![0.0; num_interior];
    flux.extend((0..num_edges).map(|i| {
        let next = boundary_x[(i + 1) % num_edges];
        let previous = boundary_x[(i + num_edges - 1) % num_edges];
        -0.5 * (next - previous)
    }));
    let y = solver.neumann(&flux);
    x.into_iter().zip(y).map(|(x, y)| [x, y]).collect()
}
