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
//!    problem with flux `−½ (x_next − x_previous)` (Hilbert transform). Where the shape of the
//!    boundary is what was asked for (angles, circle), y is harmonic as well, so that the boundary
//!    is the curve exactly; the conjugate would be off by what the mesh is too coarse for.
//!
//! A disk without interior vertices is developable: its curve is the exact unfolding, step 3 is
//! left out. Angles in radians, lengths in metres; the result is counter-clockwise.

use std::f64::consts::{PI, TAU};

use super::cut::Disk;
use super::laplacian::{Metric, edge_weights};
use super::solver::{Solver, SolverError};

/// Why a disk was not flattened.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BffError {
    /// Its lengths are zero or not finite.
    #[error("edge lengths are zero or not finite")]
    NoMetric,
    /// The Laplacian could not be factored.
    #[error(transparent)]
    Solver(#[from] SolverError),
    /// The boundary curve cannot be closed with positive lengths.
    #[error("boundary of {num_edges} edges cannot be closed")]
    NotClosed {
        /// How many edges it has.
        num_edges: usize,
    },
    /// A coordinate is not finite.
    #[error("a flattened coordinate is not finite")]
    NotFinite,
}

/// What the boundary of a disk is made to be; the rest follows (Sawhney and Crane 2018, section 4).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Boundary<'a> {
    /// Lengths as on the surface, u = 0: least area distortion.
    Isometric,
    /// Log scale factor u of each boundary vertex, in loop order: lengths there become e^u times
    /// those on the surface. The exterior angles follow.
    LogScale(&'a [f64]),
    /// Exterior angle k̃ of each boundary vertex, in loop order, radians; made to sum to 2π by equal
    /// shares. Scale is free and chosen so that the boundary's mean u is 0.
    ExteriorAngles(&'a [f64]),
    /// A circle, conformally: exterior angles in proportion to the lengths that they lead to.
    Circle,
}

/// The exterior angles of a circle follow from lengths that follow from them: at most so many rounds
/// (ten suffice unless the surface is much longer than wide).
const MAX_CIRCLE_ROUNDS: usize = 60;

/// Halvings of an interval of diameters, to the last bit of a double.
const NUM_BISECTIONS: usize = 60;

/// Largest change of an exterior angle, radians, with which they have settled.
const SETTLED_RAD: f64 = 1e-7;

/// How well a boundary curve closed, as shares of its perimeter. On a smooth surface it closes by
/// itself; on a mesh the gap shrinks as triangles do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closure {
    /// The gap of the curve of the angles and lengths asked for.
    pub gap: f64,
    /// The gap that is left once lengths are corrected: rounding.
    pub corrected_gap: f64,
    /// The largest change of a length, as a share of it.
    pub max_correction: f64,
}

/// A flattened disk.
pub(crate) struct FlatDisk {
    /// Per vertex its place in the plane, metres.
    pub(crate) points_m: Vec<[f64; 2]>,
    /// The interior vertex whose surroundings shrink most, if any shrink: the one of least u.
    pub(crate) most_shrunk_vertex: Option<usize>,
    /// Per vertex the log scale factor u.
    pub(crate) log_scale: Vec<f64>,
    /// How well the boundary closed.
    pub(crate) closure: Closure,
}

/// Flattens a disk.
pub(crate) fn flatten_disk(disk: &Disk, condition: Boundary<'_>) -> Result<FlatDisk, BffError> {
    let metric = Metric::new(&disk.corners_m).ok_or(BffError::NoMetric)?;
    let numbering = Numbering::new(disk);
    let curvature = Curvature::new(&disk.vertices, &metric, &numbering);
    let lengths = boundary_lengths(disk, &metric);
    let num_interior = numbering.num_interior;

    let mut most_shrunk = None;
    let (flat, scale, closure) = if num_interior == 0 && condition == Boundary::Isometric {
        let (curve, closure) = closed_curve(&lengths, &curvature.boundary)?;
        (curve, vec![0.0; lengths.len()], closure)
    } else {
        let weights = numbering.renumber(edge_weights(&disk.mates, &disk.vertices, &metric));
        let solver = Solver::new(num_interior, disk.num_vertices, weights)?;
        let (target, scale) = boundary_data(&solver, &curvature, &lengths, condition);
        most_shrunk = place_of_least(&scale[..num_interior]);
        let lengths = scaled(&lengths, &scale[num_interior..]);
        let (curve, closure) = closed_curve(&lengths, &target)?;
        let is_exact = matches!(condition, Boundary::ExteriorAngles(_) | Boundary::Circle);
        let flat = extend(&solver, num_interior, &curve, is_exact);
        (flat, scale, closure)
    };
    if !flat.iter().flatten().all(|c| c.is_finite()) {
        return Err(BffError::NotFinite);
    }
    let point = |place: &u32| flat[*place as usize].map(|c| c * metric.unit_m);
    Ok(FlatDisk {
        points_m: numbering.place.iter().map(point).collect(),
        most_shrunk_vertex: most_shrunk
            .and_then(|place| numbering.place.iter().position(|p| *p as usize == place)),
        log_scale: numbering
            .place
            .iter()
            .map(|&place| scale[place as usize])
            .collect(),
        closure,
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
            for _ in 0..MAX_CIRCLE_ROUNDS {
                let scaled = scaled(lengths, &scale[curvature.interior.len()..]);
                let previous = std::mem::replace(&mut target, turning_of_circle(&scaled));
                let changes = target.iter().zip(&previous).map(|(a, b)| (a - b).abs());
                // The angles are those of the lengths, so that the curve is a circle in any case.
                if changes.fold(0.0, f64::max) <= SETTLED_RAD {
                    break;
                }
                scale = neumann_to_dirichlet(solver, curvature, &target);
            }
            let scaled = scaled(lengths, &scale[curvature.interior.len()..]);
            (turning_of_circle(&scaled), scale)
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

/// Exterior angles of the polygon of these sides that is inscribed in a circle: at each corner half
/// the arcs beside it, an arc being 2 asin(side / diameter). Where one side is too long for a circle
/// around the middle, it becomes the diameter and the rest is shared out.
fn turning_of_circle(lengths: &[f64]) -> Vec<f64> {
    let arcs = |inverse_diameter: f64| -> Vec<f64> {
        let arc = |length: &f64| 2.0 * (length * inverse_diameter).min(1.0).asin();
        lengths.iter().map(arc).collect()
    };
    let longest = lengths.iter().copied().fold(0.0, f64::max);
    // Arcs grow with the inverse diameter; those of the perimeter as one circle are too short.
    let (mut low, mut high) = (PI / lengths.iter().sum::<f64>(), 1.0 / longest);
    for _ in 0..NUM_BISECTIONS {
        let middle = 0.5 * (low + high);
        if arcs(middle).iter().sum::<f64>() < TAU {
            low = middle;
        } else {
            high = middle;
        }
    }
    let arcs = arcs(low);
    let excess = TAU / arcs.iter().sum::<f64>();
    let num = arcs.len();
    (0..num)
        .map(|i| 0.5 * excess * (arcs[i] + arcs[(i + num - 1) % num]))
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
) -> Result<(Vec<[f64; 2]>, Closure), BffError> {
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
    let perimeter: f64 = lengths.iter().sum();
    let mut closure = Closure {
        gap: gap[0].hypot(gap[1]) / perimeter,
        corrected_gap: 0.0,
        max_correction: 0.0,
    };
    let mut at = [0.0; 2];
    let mut curve = Vec::with_capacity(lengths.len());
    for (&length, [x, y]) in lengths.iter().zip(&tangents) {
        let factor = 1.0 - (x * multiplier[0] + y * multiplier[1]);
        if factor.is_nan() || factor <= 0.0 {
            return Err(not_closed);
        }
        closure.max_correction = closure.max_correction.max((factor - 1.0).abs());
        curve.push(at);
        at = [at[0] + factor * length * x, at[1] + factor * length * y];
    }
    closure.corrected_gap = at[0].hypot(at[1]) / perimeter;
    Ok((curve, closure))
}

/// The harmonic extension of the curve's x, and that of its y or the conjugate harmonic y.
fn extend(
    solver: &Solver,
    num_interior: usize,
    curve: &[[f64; 2]],
    is_exact: bool,
) -> Vec<[f64; 2]> {
    let boundary_x: Vec<f64> = curve.iter().map(|point| point[0]).collect();
    let still = vec![0.0; num_interior];
    let x = solver.dirichlet(&still, &boundary_x);
    let y = if is_exact {
        let boundary_y: Vec<f64> = curve.iter().map(|point| point[1]).collect();
        solver.dirichlet(&still, &boundary_y)
    } else {
        let num_edges = curve.len();
        let mut flux = still;
        flux.extend((0..num_edges).map(|i| {
            let next = boundary_x[(i + 1) % num_edges];
            let previous = boundary_x[(i + num_edges - 1) % num_edges];
            -0.5 * (next - previous)
        }));
        solver.neumann(&flux)
    };
    x.into_iter().zip(y).map(|(x, y)| [x, y]).collect()
}
