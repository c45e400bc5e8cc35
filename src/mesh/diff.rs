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
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshDiff {
    /// Leading new triangles that are kept under their number, listed from the same corner; as many as
    /// there are.
    pub num_in_place: usize,
    /// Per new triangle after these.
    pub origins: Vec<Origin>,
    /// Old triangles that are neither kept nor moved, ascending.
    pub gone: Vec<TriangleId>,
    /// New vertices, ascending, each once, whether a triangle names them or not: those at whose place a
    /// triangle is gone, or at which one is not kept.
    pub touched: Vec<u32>,
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
    /// The first `num_in_place` triangles are in place; of those after them, whose `origins` these are, the
    /// first may be as well.
    fn of(
        mut num_in_place: usize,
        mut origins: Vec<Origin>,
        gone: Vec<TriangleId>,
        touched: Vec<u32>,
    ) -> Self {
        let is_in_place = |(triangle, origin): &(TriangleId, &Origin)| {
            let itself = OldTriangle {
                triangle: *triangle,
                first_corner: 0,
            };
            **origin == Origin::Kept(itself)
        };
        let others = ids_from(num_in_place).zip(&origins);
        let num_more = others.take_while(is_in_place).count();
        origins.drain(..num_more);
        num_in_place += num_more;
        Self {
            num_in_place,
            origins,
            gone,
            touched,
        }
    }

    /// New triangles after those in place, and where they come from.
    pub fn others(&self) -> impl Iterator<Item = (TriangleId, Origin)> {
        ids_from(self.num_in_place).zip(self.origins.iter().copied())
    }

    /// How many triangles are what.
    pub fn counts(&self) -> DiffCounts {
        let mut counts = DiffCounts {
            num_kept: self.num_in_place,
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

/// Triangles from the `first` on.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a mesh has 32 bits of triangles"
)]
fn ids_from(first: usize) -> impl Iterator<Item = TriangleId> {
    (first as u32..).map(TriangleId)
}

/// Numbers below `end`, ascending, each once.
fn each_once(mut numbers: Vec<u32>, end: usize) -> Vec<u32> {
    // Many are sooner marked than sorted.
    if numbers.len() < end / 16 {
        numbers.sort_unstable();
        numbers.dedup();
        return numbers;
    }
    let mut is_there = vec![false; end];
    for number in numbers {
        is_there[number as usize] = true;
    }
    marked(is_there)
}

/// The numbers of those that are marked, ascending.
fn marked(is_marked: impl IntoIterator<Item = bool>) -> Vec<u32> {
    let numbers = (0_u32..).zip(is_marked).filter(|(_, is_it)| *is_it);
    numbers.map(|(number, _)| number).collect()
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
    let turned = |mesh: &TriMesh, places: &[u32]| -> Vec<Turned> {
        let corners = mesh.triangles().iter();
        let turned = corners.map(|corners| Turned::of(corners.map(|v| places[v as usize])));
        turned.collect()
    };
    let is_old = named(&places, &old_places, old);
    let is_new = named(&places, &new_places, new);
    let comparison = Comparison {
        places: &places,
        old: old.triangle_ids().zip(turned(old, &old_places)).collect(),
        new: turned(new, &new_places),
        went: &marked(is_old.iter().zip(&is_new).map(|(old, new)| *old && !*new)),
        came: &marked(is_new.iter().zip(&is_old).map(|(new, old)| *new && !*old)),
        params,
    };
    let Compared {
        origins,
        gone,
        gone_at,
    } = comparison.find();
    let mut is_gone_at = vec![false; places.len()];
    for place in gone_at {
        is_gone_at[place as usize] = true;
    }
    let mut is_touched: Vec<bool> = new_places.iter().map(|&p| is_gone_at[p as usize]).collect();
    for (corners, origin) in new.triangles().iter().zip(&origins) {
        if !matches!(origin, Origin::Kept(_)) {
            for &vertex in corners {
                is_touched[vertex as usize] = true;
            }
        }
    }
    Ok(MeshDiff::of(0, origins, gone, marked(is_touched)))
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

fn grid_point(position_m: &Point3<f64>, quantum_m: f64) -> Result<GridPoint, DiffError> {
    let is_off = |c: &f64| (c / quantum_m).round().abs() > MAX_STEPS;
    match position_m.iter().find(|c| is_off(c)) {
        Some(&coordinate_m) => Err(DiffError::OffGrid {
            coordinate_m,
            quantum_m,
        }),
        None => Ok(nearest_point(position_m, quantum_m)),
    }
}

/// The point of a position that is known to be on the grid.
#[expect(
    clippy::cast_possible_truncation,
    reason = "below MAX_STEPS, as was checked"
)]
fn nearest_point(position_m: &Point3<f64>, quantum_m: f64) -> GridPoint {
    let [x, y, z] = position_m.coords.into();
    [x, y, z].map(|c: f64| (c / quantum_m).round() as i64)
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
    /// Triangles of the new mesh that may have a predecessor.
    new: Vec<Turned>,
    /// Places that triangles of the old mesh name, and none of the new one; ascending.
    went: &'a [u32],
    /// Places that triangles of the new mesh name, and none of the old one; ascending.
    came: &'a [u32],
    params: &'a DiffParams,
}

/// What came of a comparison.
struct Compared {
    /// Per triangle of the new mesh that was compared.
    origins: Vec<Origin>,
    /// Old triangles that are neither kept nor moved, ascending.
    gone: Vec<TriangleId>,
    /// Places at which an old triangle is gone, before or after a move; ascending, each once.
    gone_at: Vec<u32>,
}

impl Comparison<'_> {
    /// Finds where the new triangles come from.
    fn find(&self) -> Compared {
        let old: Vec<Turned> = self.old.iter().map(|(_, turned)| *turned).collect();
        let named = |found: OldTriangle, index: TriangleId| OldTriangle {
            triangle: self.old[index.index()].0,
            ..found
        };
        let mut pool = Pool::of(&old);
        let kept = |turned| match pool.take(turned, &old) {
            Some(found) => Origin::Kept(named(found, found.triangle)),
            None => Origin::New,
        };
        let mut origins: Vec<Origin> = self.new.iter().copied().map(kept).collect();

        // A triangle at a place that the other mesh does not name has no equal there.
        let moves = nearest::Moves::mutual(self.places, self.went, self.came, self.params);
        if !moves.is_empty() {
            let left = pool.left();
            let moved = |index: &TriangleId| old[index.index()].with_places(|p| moves.after(p));
            let after: Vec<Turned> = left.iter().map(moved).collect();
            let mut moved = Pool::of(&after);
            for (&turned, origin) in self.new.iter().zip(&mut origins) {
                if *origin == Origin::New
                    && let Some(found) = moved.take(turned, &after)
                {
                    let index = left[found.triangle.index()];
                    pool.remove(index);
                    *origin = Origin::Moved(named(found, index));
                }
            }
        }

        let mut gone = Vec::new();
        let mut gone_at = Vec::new();
        for index in pool.left() {
            let (triangle, turned) = self.old[index.index()];
            gone.push(triangle);
            gone_at.extend(turned.places);
            gone_at.extend(turned.places.map(|place| moves.after(place)));
        }
        let gone_at = each_once(gone_at, self.places.len());
        for (turned, origin) in self.new.iter().zip(&mut origins) {
            let is_gone = |place: &u32| gone_at.binary_search(place).is_ok();
            if *origin == Origin::New && turned.places.iter().any(is_gone) {
                *origin = Origin::Changed;
            }
        }
        Compared {
            origins,
            gone,
            gone_at,
        }
    }
}

#[cfg(test)]
mod tests;
