//! What changed between two meshes of one surface.
//!
//! Vertices count as equal where their positions fall on the same point of a grid of
//! [`DiffParams::quantum_m`]; triangles where their corners are equal in the same turn. Each new
//! triangle is
//!
//! - *kept*: an old triangle is equal;
//! - *moved*: an old triangle becomes equal when vertices move by at most
//!   [`DiffParams::max_move_m`], as those of a truncated distance field do while it is refined. A
//!   vertex moves to the nearest new one, if it is also the nearest old one to that;
//! - *changed*: neither, and it touches a vertex of an old triangle that is gone: the surface was
//!   meshed anew there;
//! - *new*: neither, with no such vertex.
//!
//! Old triangles that are neither kept nor moved are *gone*. Of triangles that are there several
//! times, as many are kept as are on both sides. The classes depend on the geometry alone, not on
//! the order of vertices or triangles, nor on which corner a triangle starts with. O(n) for n triangles,
//! and O(k log k) for k that are not kept.

mod lookup;
mod nearest;
mod tracked;

use nalgebra::Point3;

use super::ids::TriangleId;
use super::tri_mesh::TriMesh;
use lookup::{Places, Pool, Turned};

pub use tracked::TrackedMesh;

/// When vertices are the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiffParams {
    /// Pitch of the grid on which positions are compared, metres (> 0).
    pub quantum_m: f64,
    /// How far a vertex may move and be the same, metres (≥ 0).
    pub max_move_m: f64,
}

impl Default for DiffParams {
    fn default() -> Self {
        Self {
            quantum_m: 1.0 / 32768.0,
            max_move_m: 0.01,
        }
    }
}

/// Why two meshes were not compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DiffError {
    /// The grid has no pitch, or the move is no length.
    #[error("a grid of {quantum_m} m and moves of {max_move_m} m are no lengths")]
    Params {
        /// [`DiffParams::quantum_m`].
        quantum_m: f64,
        /// [`DiffParams::max_move_m`].
        max_move_m: f64,
    },
    /// Positions too far from the origin for the grid.
    #[error("a coordinate of {coordinate_m} m is beyond what a grid of {quantum_m} m can number")]
    OffGrid {
        /// The coordinate.
        coordinate_m: f64,
        /// [`DiffParams::quantum_m`].
        quantum_m: f64,
    },
}

/// Where a new triangle comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// It is the old one.
    Kept(OldTriangle),
    /// It is the old one with other positions.
    Moved(OldTriangle),
    /// The surface was there and was meshed anew.
    Changed,
    /// No surface was there.
    New,
}

/// An old triangle, and how a new one lists its corners.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OldTriangle {
    /// Which one.
    pub triangle: TriangleId,
    /// Its corner k is the new triangle's corner (k + `first_corner`) % 3.
    pub first_corner: u8,
}

/// What [`diff`] found.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshDiff {
    /// Per new triangle.
    pub origins: Vec<Origin>,
    /// Old triangles that are neither kept nor moved, ascending.
    pub gone: Vec<TriangleId>,
    /// Per new vertex: whether a triangle at its place is gone, or one at it is not kept.
    pub is_touched: Vec<bool>,
}

/// How many triangles are what.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct DiffCounts {
    /// As they were.
    pub num_kept: usize,
    /// With other positions.
    pub num_moved: usize,
    /// Meshed anew.
    pub num_changed: usize,
    /// Where there was none.
    pub num_new: usize,
    /// Old ones without a successor.
    pub num_gone: usize,
}

impl DiffCounts {
    /// Whether all triangles are as they were.
    pub fn is_same(&self) -> bool {
        let others = [
            self.num_moved,
            self.num_changed,
            self.num_new,
            self.num_gone,
        ];
        others == [0; 4]
    }
}

impl MeshDiff {
    /// Leading new triangles that are kept under their number, listed from the same corner.
    pub fn num_in_place(&self) -> usize {
        let in_place = |(number, origin): &(u32, &Origin)| {
            let itself = OldTriangle {
                triangle: TriangleId(*number),
                first_corner: 0,
            };
            **origin == Origin::Kept(itself)
        };
        (0_u32..).zip(&self.origins).take_while(in_place).count()
    }

    /// How many triangles are what.
    pub fn counts(&self) -> DiffCounts {
        let mut counts = DiffCounts {
            num_gone: self.gone.len(),
            ..DiffCounts::default()
        };
        for origin in &self.origins {
            *match origin {
                Origin::Kept(_) => &mut counts.num_kept,
                Origin::Moved(_) => &mut counts.num_moved,
                Origin::Changed => &mut counts.num_changed,
                Origin::New => &mut counts.num_new,
            } += 1;
        }
        counts
    }
}

/// `mesh` with every position on the nearest point of a grid of `quantum_m`, and vertices at one
/// point made one, in the order in which triangles name them; vertices that no triangle names are left
/// out. Triangles keep their order and number.
///
/// # Errors
/// [`DiffError`] when the grid has no pitch or cannot number a coordinate.
pub fn on_grid(mesh: &TriMesh, quantum_m: f64) -> Result<TriMesh, DiffError> {
    check(&DiffParams {
        quantum_m,
        max_move_m: 0.0,
    })?;
    let mut places = Places::with_capacity(mesh.num_vertices());
    let mut place_of_vertex = vec![None; mesh.num_vertices()];
    let mut positions_m = Vec::new();
    let mut triangles = Vec::with_capacity(mesh.num_triangles());
    for corners in mesh.triangles() {
        let mut placed = [0; 3];
        for (place, &vertex) in placed.iter_mut().zip(corners) {
            let known = &mut place_of_vertex[vertex as usize];
            *place = match *known {
                Some(known) => known,
                None => {
                    let point = grid_point(&mesh.positions_m()[vertex as usize], quantum_m)?;
                    let new = places.insert(point);
                    if new as usize == positions_m.len() {
                        positions_m.push(Point3::from(point.map(|c| c as f64 * quantum_m)));
                    }
                    *known.insert(new)
                }
            };
        }
        triangles.push(placed);
    }
    // Indices and positions are of the mesh, so that nothing is refused or left out.
    Ok(TriMesh::from_soup(positions_m, triangles)
        .map(|(mesh, _)| mesh)
        .unwrap_or_default())
}

/// Compares two meshes. One that is followed as it changes is compared at less cost by
/// [`TrackedMesh`].
///
/// # Errors
/// [`DiffError`] when a parameter is no length or the grid cannot number a coordinate.
pub fn diff(old: &TriMesh, new: &TriMesh, params: &DiffParams) -> Result<MeshDiff, DiffError> {
    check(params)?;
    let mut places = Places::with_capacity(old.num_vertices() + new.num_vertices());
    let old_places = places_of(old, params, &mut places)?;
    let new_places = places_of(new, params, &mut places)?;
    let turned = |mesh: &TriMesh, places: &[u32]| {
        let corners = mesh.triangles().iter();
        let turned = corners.map(|corners| Turned::of(corners.map(|v| places[v as usize])));
        mesh.triangle_ids().zip(turned).collect()
    };
    let comparison = Comparison {
        old: turned(old, &old_places),
        new: turned(new, &new_places),
        is_old: &named(&places, &old_places, old),
        is_new: &named(&places, &new_places, new),
        places: &places,
        params,
    };
    let mut origins = vec![Origin::New; new.num_triangles()];
    let Compared { gone, is_gone_at } = comparison.find(&mut origins);
    let mut is_touched: Vec<bool> = new_places.iter().map(|&p| is_gone_at[p as usize]).collect();
    for (corners, origin) in new.triangles().iter().zip(&origins) {
        if !matches!(origin, Origin::Kept(_)) {
            for &vertex in corners {
                is_touched[vertex as usize] = true;
            }
        }
    }
    Ok(MeshDiff {
        origins,
        gone,
        is_touched,
    })
}

/// Per place, whether a triangle names a vertex there.
fn named(places: &Places, place_of_vertex: &[u32], mesh: &TriMesh) -> Vec<bool> {
    let mut is_named = vec![false; places.len()];
    for &vertex in mesh.triangles().as_flattened() {
        is_named[place_of_vertex[vertex as usize] as usize] = true;
    }
    is_named
}

fn check(params: &DiffParams) -> Result<(), DiffError> {
    let DiffParams {
        quantum_m,
        max_move_m,
    } = *params;
    let is_fine =
        quantum_m > 0.0 && quantum_m.is_finite() && (0.0..f64::INFINITY).contains(&max_move_m);
    if is_fine {
        Ok(())
    } else {
        Err(DiffError::Params {
            quantum_m,
            max_move_m,
        })
    }
}

/// Coordinates in steps of the grid.
type GridPoint = [i64; 3];

/// Grid numbers beyond this are not exact.
const MAX_STEPS: f64 = (1_u64 << 52) as f64;

#[expect(clippy::cast_possible_truncation, reason = "checked against MAX_STEPS")]
fn grid_point(position_m: &Point3<f64>, quantum_m: f64) -> Result<GridPoint, DiffError> {
    let steps = position_m.coords.map(|c| (c / quantum_m).round());
    match steps.iter().position(|s| s.abs() > MAX_STEPS) {
        Some(axis) => Err(DiffError::OffGrid {
            coordinate_m: position_m[axis],
            quantum_m,
        }),
        None => Ok([steps.x as i64, steps.y as i64, steps.z as i64]),
    }
}

/// Per vertex, the number of its place.
fn places_of(
    mesh: &TriMesh,
    params: &DiffParams,
    places: &mut Places,
) -> Result<Vec<u32>, DiffError> {
    mesh.positions_m()
        .iter()
        .map(|position| Ok(places.insert(grid_point(position, params.quantum_m)?)))
        .collect()
}

/// Triangles of two meshes that are to be compared.
struct Comparison<'a> {
    places: &'a Places,
    /// Triangles of the old mesh that may have a successor; ascending.
    old: Vec<(TriangleId, Turned)>,
    /// Triangles of the new mesh that may have a predecessor; ascending.
    new: Vec<(TriangleId, Turned)>,
    /// Per place: whether a triangle of the old mesh, to be compared or not, is there.
    is_old: &'a [bool],
    /// The same of the new mesh.
    is_new: &'a [bool],
    params: &'a DiffParams,
}

/// What came of a comparison.
struct Compared {
    /// Old triangles that are neither kept nor moved, ascending.
    gone: Vec<TriangleId>,
    /// Per place: whether an old triangle is gone there, before or after a move.
    is_gone_at: Vec<bool>,
}

impl Comparison<'_> {
    /// Finds where the new triangles come from; the origins of others are left alone.
    fn find(&self, origins: &mut [Origin]) -> Compared {
        let old: Vec<Turned> = self.old.iter().map(|(_, turned)| *turned).collect();
        let named = |found: OldTriangle, of: &[u32]| OldTriangle {
            triangle: self.old[of[found.triangle.index()] as usize].0,
            ..found
        };
        let all: Vec<u32> = (0_u32..).take(old.len()).collect();
        let mut pool = Pool::of(&old);
        for &(triangle, turned) in &self.new {
            origins[triangle.index()] = match pool.take(turned, &old) {
                Some(found) => Origin::Kept(named(found, &all)),
                None => Origin::New,
            };
        }

        let moves = self.moves(&pool.left(), origins);
        if !moves.is_empty() {
            let left: Vec<u32> = pool.left().into_iter().map(|index| index.0).collect();
            let moved = |&index: &u32| old[index as usize].with_places(|p| moves.after(p));
            let after: Vec<Turned> = left.iter().map(moved).collect();
            let mut moved = Pool::of(&after);
            for &(triangle, turned) in &self.new {
                let origin = &mut origins[triangle.index()];
                if *origin == Origin::New
                    && let Some(found) = moved.take(turned, &after)
                {
                    pool.remove(TriangleId(left[found.triangle.index()]));
                    *origin = Origin::Moved(named(found, &left));
                }
            }
        }

        let mut compared = Compared {
            gone: Vec::new(),
            is_gone_at: vec![false; self.places.len()],
        };
        for index in pool.left() {
            let (triangle, turned) = self.old[index.index()];
            compared.gone.push(triangle);
            for place in turned.places {
                compared.is_gone_at[place as usize] = true;
                compared.is_gone_at[moves.after(place) as usize] = true;
            }
        }
        for (triangle, turned) in &self.new {
            let origin = &mut origins[triangle.index()];
            let is_gone = |&place: &u32| compared.is_gone_at[place as usize];
            if *origin == Origin::New && turned.places.iter().any(is_gone) {
                *origin = Origin::Changed;
            }
        }
        compared
    }

    /// Where vertices went that are nowhere any more.
    fn moves(&self, left: &[TriangleId], origins: &[Origin]) -> nearest::Moves {
        let left = left.iter().map(|index| self.old[index.index()].1);
        let came = self.new.iter();
        let came = came.filter(|(triangle, _)| origins[triangle.index()] == Origin::New);
        let left = lone_places(left, self.is_new);
        let came = lone_places(came.map(|(_, turned)| *turned), self.is_old);
        nearest::Moves::mutual(self.places, &left, &came, self.params)
    }
}

/// Places of the triangles that are not there on the other side, ascending.
fn lone_places(triangles: impl Iterator<Item = Turned>, is_on_other_side: &[bool]) -> Vec<u32> {
    let places = triangles.flat_map(|triangle| triangle.places);
    let mut lone: Vec<u32> = places
        .filter(|&place| !is_on_other_side[place as usize])
        .collect();
    lone.sort_unstable();
    lone.dedup();
    lone
}

#[cfg(test)]
mod tests;
