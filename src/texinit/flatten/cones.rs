//! Cone singularities (Sawhney and Crane 2018, section 5.2): a few vertices take all the curvature,
//! so that a whole component flattens with little change of scale once it is cut through them.
//!
//! The log scale factors u solve `(A u)_i = −Ω_i` at every interior vertex that is no cone, with
//! u = 0 at the boundary and at the cones; a cone's angle is what then remains. Cones are placed
//! one after the other where |u| is largest (the authors' program; "Boundary first flattening" and
//! Ben-Chen, Gotsman, Bunin 2008), until lengths change nowhere by more than [`MAX_LOG_SCALE`].
//! A closed surface has its first cone where the angle defect is largest.
//!
//! One sparse factor serves all cones: fixing u at a further vertex c subtracts a multiple of the
//! response to a unit load at c, made to vanish at the earlier cones. So a cone costs one solve
//! and one pass over the responses so far: n·m for m cones.

use super::bff::{Curvature, Numbering};
use super::cut::Surface;
use super::laplacian::{Metric, edge_weights};
use super::solver::InteriorSolver;

/// Natural logarithm of the largest change of lengths that no further cone is placed for.
const MAX_LOG_SCALE: f64 = 0.2;

/// Responses of this many numbers are held at most (8 bytes each); a larger component gets fewer
/// cones.
const MAX_RESPONSE_LEN: usize = 1 << 25;

/// Where the curvature goes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cones {
    /// Vertices of the surface, in the order they were placed.
    pub(crate) vertices: Vec<usize>,
    /// Log scale factor u of every vertex; 0 at cones and at the boundary.
    pub(crate) log_scale: Vec<f64>,
}

/// Places at most `max_cones` cones; nothing where the surface has no metric or its Laplacian no
/// factor.
pub(crate) fn place_cones(surface: &Surface, max_cones: usize) -> Option<Cones> {
    let metric = Metric::new(&surface.corners_m)?;
    let mut pinned = surface.boundary_vertices();
    let mut vertices = Vec::new();
    if pinned.is_empty() {
        let defects = angle_defects(surface, &metric);
        let first = place_of_largest(&defects)?;
        vertices.push(first);
        pinned.push(first);
    }
    let numbering = Numbering::pinning(surface.num_vertices, &pinned);
    let curvature = Curvature::new(&surface.vertices, &metric, &numbering);
    let weights = numbering.renumber(edge_weights(&surface.mates, &surface.vertices, &metric));
    let num_interior = numbering.num_interior();
    let solver = InteriorSolver::new(num_interior, surface.num_vertices, &weights).ok()?;
    let mut log_scale: Vec<f64> = curvature.interior.iter().map(|defect| -defect).collect();
    solver.solve(&mut log_scale);

    let max_cones = max_cones.min(MAX_RESPONSE_LEN / num_interior.max(1));
    let mut cones: Vec<(usize, Vec<f64>)> = Vec::new();
    while vertices.len() + cones.len() < max_cones {
        let Some(place) = place_of_largest(&log_scale) else {
            break;
        };
        if log_scale[place].abs() <= MAX_LOG_SCALE {
            break;
        }
        let mut response = vec![0.0; num_interior];
        response[place] = 1.0;
        solver.solve(&mut response);
        for (earlier, other) in &cones {
            subtract(
                &mut response,
                response_share(other, *earlier),
                other,
                *earlier,
            );
        }
        if response[place] <= 0.0 || !response[place].is_finite() {
            break;
        }
        subtract(&mut log_scale, 1.0 / response[place], &response, place);
        // Exactly, so that no rounding finds it again.
        log_scale[place] = 0.0;
        cones.push((place, response));
    }

    let all: Vec<f64> = numbering
        .places()
        .iter()
        .map(|&place| log_scale.get(place as usize).copied().unwrap_or(0.0))
        .collect();
    if !all.iter().all(|u| u.is_finite()) {
        return None;
    }
    let mut vertex_at = vec![0; num_interior];
    for (vertex, &place) in numbering.places().iter().enumerate() {
        if let Some(slot) = vertex_at.get_mut(place as usize) {
            *slot = vertex;
        }
    }
    vertices.extend(cones.iter().map(|(place, _)| vertex_at[*place]));
    Some(Cones {
        vertices,
        log_scale: all,
    })
}

/// One over a response's value at its own cone.
fn response_share(response: &[f64], place: usize) -> f64 {
    1.0 / response[place]
}

/// Makes `values` vanish at `place` by a multiple of a response whose value there is `1 / share`.
fn subtract(values: &mut [f64], share: f64, response: &[f64], place: usize) {
    let factor = values[place] * share;
    for (value, response) in values.iter_mut().zip(response) {
        *value -= factor * response;
    }
}

/// 2π − Σθ at every vertex; used on closed surfaces only.
fn angle_defects(surface: &Surface, metric: &Metric) -> Vec<f64> {
    let numbering = Numbering::pinning(surface.num_vertices, &[]);
    Curvature::new(&surface.vertices, metric, &numbering).interior
}

/// Where the magnitude is largest, the first of equals.
fn place_of_largest(values: &[f64]) -> Option<usize> {
    let mut largest: Option<(usize, f64)> = None;
    for (place, value) in values.iter().enumerate() {
        if largest.is_none_or(|(_, best)| value.abs() > best) {
            largest = Some((place, value.abs()));
        }
    }
    largest.map(|(place, _)| place)
}
