//! A mesh that is followed as it changes: what is as it was is found in passing.

use std::sync::Arc;

use nalgebra::Point3;

use super::lookup::{Places, Turned};
use super::{
    Compared, Comparison, DiffError, DiffParams, MeshDiff, OldTriangle, Origin, check, grid_point,
};
use crate::mesh::{TriMesh, TriangleId};

const NONE: u32 = u32::MAX;
/// Triangles of one first corner that are looked through; those beyond are found by all corners.
const MAX_FAN: usize = 16;

/// The last state of a mesh, on the grid of [`DiffParams::quantum_m`].
///
/// Those who publish meshes keep the order of what did not change, or that of large parts of it. So each
/// new triangle is first held against the old one behind the last that was found, then against
/// those that begin at the same point; what is left on either side is compared as [`super::diff()`] does,
/// with the same classes.
///
/// Each point of the grid is one vertex, and keeps its number as long as a triangle names it. Numbers
/// that are free lie in the mesh as vertices that no triangle names.
#[derive(Debug)]
pub struct TrackedMesh {
    params: DiffParams,
    given: Arc<TriMesh>,
    /// Per vertex given: its number on the grid; [`NONE`] where no triangle names it.
    place_of_vertex: Vec<u32>,
    places: Places,
    /// Per place: whether a triangle names it.
    is_named: Vec<bool>,
    mesh: Arc<TriMesh>,
    /// How often vertices got other numbers.
    num_renumberings: usize,
}

/// What is known of a new mesh while it is held against the old one.
struct Matching<'a> {
    old: &'a TrackedMesh,
    new: &'a TriMesh,
    place_of_vertex: Vec<u32>,
    is_matched: Vec<bool>,
    origins: Vec<Origin>,
    /// Triangles of the new mesh without an equal one so far.
    left: Vec<TriangleId>,
}

impl TrackedMesh {
    /// An empty mesh.
    ///
    /// # Errors
    /// [`DiffError`] when a parameter is no length.
    pub fn new(params: &DiffParams) -> Result<Self, DiffError> {
        check(params)?;
        Ok(Self {
            params: *params,
            given: Arc::default(),
            place_of_vertex: Vec::new(),
            places: Places::with_capacity(0),
            is_named: Vec::new(),
            mesh: Arc::default(),
            num_renumberings: 0,
        })
    }

    /// Forgets the mesh.
    pub fn clear(&mut self) {
        self.given = Arc::default();
        self.place_of_vertex.clear();
        self.places = Places::with_capacity(0);
        self.is_named.clear();
        self.mesh = Arc::default();
        self.num_renumberings += 1;
    }

    /// How often vertices got other numbers: while it is the same, triangles that are kept name the same
    /// ones.
    pub fn num_renumberings(&self) -> usize {
        self.num_renumberings
    }

    /// The mesh as it was given last, its vertices on the grid; triangles have their order and number.
    pub fn mesh(&self) -> &Arc<TriMesh> {
        &self.mesh
    }

    /// Takes a new mesh, and says what changed; nothing where it is the very one that was given before.
    /// [`MeshDiff::is_touched`] is by vertex of [`Self::mesh`].
    ///
    /// # Errors
    /// [`DiffError`] when the grid cannot number a coordinate; the mesh stays what it was.
    pub fn follow(&mut self, given: &Arc<TriMesh>) -> Result<Option<MeshDiff>, DiffError> {
        if Arc::ptr_eq(&self.given, given) {
            return Ok(None);
        }
        let mut matching = Matching::new(self, given);
        let num_in_place = matching.match_in_place();
        matching.match_in_order(num_in_place)?;
        let Matching {
            mut place_of_vertex,
            is_matched,
            mut origins,
            left,
            ..
        } = matching;
        self.number(given, &left, &mut place_of_vertex)?;

        let mut is_named = vec![false; self.places.len()];
        let placed = place_of_vertex.iter().filter(|&&place| place != NONE);
        for &place in placed {
            is_named[place as usize] = true;
        }
        self.is_named.resize(self.places.len(), false);
        let corners = given.triangles()[num_in_place..].iter();
        let others = corners.map(|corners| corners.map(|v| place_of_vertex[v as usize]));
        let mut triangles = Vec::with_capacity(given.num_triangles());
        triangles.extend_from_slice(&self.mesh.triangles()[..num_in_place]);
        triangles.extend(others);
        let unmatched = self.mesh.triangle_ids().zip(self.mesh.triangles());
        let unmatched = unmatched.filter(|(triangle, _)| !is_matched[triangle.index()]);
        let new_corners =
            |triangle: TriangleId| (triangle, Turned::of(triangles[triangle.index()]));
        let comparison = Comparison {
            places: &self.places,
            old: unmatched
                .map(|(triangle, corners)| (triangle, Turned::of(*corners)))
                .collect(),
            new: left.iter().copied().map(new_corners).collect(),
            is_old: &self.is_named,
            is_new: &is_named,
            params: &self.params,
        };
        let Compared {
            gone,
            is_gone_at: mut is_touched,
        } = comparison.find(&mut origins);
        for triangle in left {
            if !matches!(origins[triangle.index()], Origin::Kept(_)) {
                for vertex in triangles[triangle.index()] {
                    is_touched[vertex as usize] = true;
                }
            }
        }
        self.given = Arc::clone(given);
        self.place_of_vertex = place_of_vertex;
        self.settle(is_named, triangles, &mut is_touched);
        Ok(Some(MeshDiff {
            origins,
            gone,
            is_touched,
        }))
    }

    /// Numbers the points of triangles that have no equal in the old order.
    fn number(
        &mut self,
        given: &TriMesh,
        left: &[TriangleId],
        place_of_vertex: &mut [u32],
    ) -> Result<(), DiffError> {
        let quantum_m = self.params.quantum_m;
        let vertices = || left.iter().flat_map(|t| given.triangles()[t.index()]);
        let point_of = |vertex: u32| grid_point(&given.positions_m()[vertex as usize], quantum_m);
        // First all are asked for, so that an error leaves all as it was.
        for vertex in vertices() {
            point_of(vertex)?;
        }
        for vertex in vertices() {
            let place = &mut place_of_vertex[vertex as usize];
            if *place == NONE {
                *place = self.places.insert(point_of(vertex)?);
            }
        }
        Ok(())
    }

    /// Makes the mesh of what is named, and frees what is no more.
    fn settle(
        &mut self,
        is_named: Vec<bool>,
        mut triangles: Vec<[u32; 3]>,
        is_touched: &mut Vec<bool>,
    ) {
        let quantum_m = self.params.quantum_m;
        let mut positions_m = self.mesh.positions_m().to_vec();
        positions_m.resize(self.places.len(), Point3::origin());
        let was_and_is = self.is_named.iter().zip(&is_named);
        for ((place, position_m), named) in (0_u32..).zip(&mut positions_m).zip(was_and_is) {
            match named {
                (true, false) => self.places.remove(place),
                (false, true) => {
                    let point = self.places.point(place);
                    *position_m = Point3::from(point.map(|c| c as f64 * quantum_m));
                }
                _ => {}
            }
        }
        self.is_named = is_named;
        if 2 * self.places.num_free() > self.places.len() {
            self.renumber(&mut triangles, &mut positions_m, is_touched);
        }
        self.mesh = Arc::new(TriMesh::of_parts(positions_m, triangles));
    }

    /// Numbers anew what triangles name, in their order.
    fn renumber(
        &mut self,
        triangles: &mut [[u32; 3]],
        positions_m: &mut Vec<Point3<f64>>,
        is_touched: &mut Vec<bool>,
    ) {
        let num_named = self.places.len() - self.places.num_free();
        let mut places = Places::with_capacity(num_named);
        let mut number_of = vec![NONE; self.places.len()];
        let (mut kept_m, mut kept_touched) = (Vec::new(), Vec::new());
        for vertex in triangles.as_flattened_mut() {
            let before = *vertex as usize;
            if number_of[before] == NONE {
                number_of[before] = places.insert(self.places.point(*vertex));
                kept_m.push(positions_m[before]);
                kept_touched.push(is_touched[before]);
            }
            *vertex = number_of[before];
        }
        for place in self
            .place_of_vertex
            .iter_mut()
            .filter(|place| **place != NONE)
        {
            *place = number_of[*place as usize];
        }
        self.num_renumberings += 1;
        self.is_named = vec![true; places.len()];
        self.places = places;
        (*positions_m, *is_touched) = (kept_m, kept_touched);
    }
}

impl<'a> Matching<'a> {
    fn new(old: &'a TrackedMesh, new: &'a TriMesh) -> Self {
        Self {
            old,
            new,
            place_of_vertex: vec![NONE; new.num_vertices()],
            is_matched: vec![false; old.given.num_triangles()],
            origins: vec![Origin::New; new.num_triangles()],
            left: Vec::new(),
        }
    }

    /// Finds leading triangles that are the old ones, vertex numbers and all, as where a mesh grows at
    /// its end; returns how many.
    fn match_in_place(&mut self) -> usize {
        let (new, old) = (self.new, &self.old.given);
        let positions_m = new.positions_m().iter().zip(old.positions_m());
        let num_vertices = positions_m.take_while(|(new, old)| new == old).count();
        let is_same = |(new, old): &(&[u32; 3], &[u32; 3])| {
            new == old && new.iter().all(|&vertex| (vertex as usize) < num_vertices)
        };
        let triangles = new.triangles().iter().zip(old.triangles());
        let num_in_place = triangles.take_while(is_same).count();
        for &vertex in new.triangles()[..num_in_place].as_flattened() {
            self.place_of_vertex[vertex as usize] = self.old.place_of_vertex[vertex as usize];
        }
        self.is_matched[..num_in_place].fill(true);
        let origins = self.origins[..num_in_place].iter_mut();
        for (triangle, origin) in (0_u32..).map(TriangleId).zip(origins) {
            *origin = Origin::Kept(OldTriangle {
                triangle,
                first_corner: 0,
            });
        }
        num_in_place
    }

    /// Finds equal triangles where the order is the old one, from triangle `first` on.
    fn match_in_order(&mut self, first: usize) -> Result<(), DiffError> {
        let mut fans: Option<Fans> = None;
        #[expect(clippy::cast_possible_truncation, reason = "checked at construction")]
        let mut next_old = TriangleId(first as u32);
        for triangle in self.new.triangle_ids().skip(first) {
            let mut found = Some(next_old).filter(|&old| self.is_equal(triangle, old));
            if found.is_none() {
                let fans = fans.get_or_insert_with(|| Fans::of(&self.old.mesh));
                found = self.find(triangle, fans)?;
            }
            match found {
                Some(old) => {
                    self.is_matched[old.index()] = true;
                    self.origins[triangle.index()] = Origin::Kept(OldTriangle {
                        triangle: old,
                        first_corner: 0,
                    });
                    next_old = TriangleId(old.0 + 1);
                }
                None => self.left.push(triangle),
            }
        }
        Ok(())
    }

    /// Whether a triangle equals an old one that is there and not matched yet, corner by corner.
    fn is_equal(&mut self, triangle: TriangleId, old: TriangleId) -> bool {
        if self.is_matched.get(old.index()) != Some(&false) {
            return false;
        }
        let old_corners = self.old.given.triangles()[old.index()];
        let corners = self.new.triangles()[triangle.index()];
        corners.into_iter().zip(old_corners).all(|(vertex, old)| {
            let old_place = self.old.place_of_vertex[old as usize];
            let place = &mut self.place_of_vertex[vertex as usize];
            if *place == NONE {
                let position_m = self.new.positions_m()[vertex as usize];
                if position_m == self.old.given.positions_m()[old as usize] {
                    *place = old_place;
                }
            }
            *place == old_place
        })
    }

    /// Looks for an equal triangle by its first corner.
    fn find(&mut self, triangle: TriangleId, fans: &Fans) -> Result<Option<TriangleId>, DiffError> {
        let [vertex, _, _] = self.new.triangles()[triangle.index()];
        let place = &mut self.place_of_vertex[vertex as usize];
        if *place == NONE {
            let position_m = &self.new.positions_m()[vertex as usize];
            let point = grid_point(position_m, self.old.params.quantum_m)?;
            match self.old.places.get(point) {
                Some(known) => *place = known,
                None => return Ok(None),
            }
        }
        let fan = fans.at(*place);
        Ok(fan.take(MAX_FAN).find(|&old| self.is_equal(triangle, old)))
    }
}

/// Old triangles by their first corner.
struct Fans {
    /// Per place: its first triangle.
    first: Vec<u32>,
    /// Per triangle: the next one of the place.
    next: Vec<u32>,
}

impl Fans {
    fn of(mesh: &TriMesh) -> Self {
        let mut first = vec![NONE; mesh.num_vertices()];
        let mut next = vec![NONE; mesh.num_triangles()];
        // From the last, so that the first is found first.
        for (index, &[place, _, _]) in mesh.triangles().iter().enumerate().rev() {
            #[expect(clippy::cast_possible_truncation, reason = "checked at construction")]
            let triangle = index as u32;
            next[index] = std::mem::replace(&mut first[place as usize], triangle);
        }
        Self { first, next }
    }

    fn at(&self, place: u32) -> impl Iterator<Item = TriangleId> {
        let first = self.first.get(place as usize).copied();
        let is_there = |number: &u32| *number != NONE;
        std::iter::successors(first.filter(is_there), move |&number| {
            Some(self.next[number as usize]).filter(is_there)
        })
        .map(TriangleId)
    }
}
