//! A mesh that is followed as it changes: what is as it was is found in passing.

use std::sync::Arc;

use nalgebra::Point3;

use super::lookup::{Places, Turned};
use super::{
    Compared, Comparison, DiffError, DiffParams, MAX_STEPS, MeshDiff, OldTriangle, Origin, check,
    each_once, grid_point, ids_from, nearest_point,
};
use crate::mesh::{TriMesh, TriangleId};

const NONE: u32 = u32::MAX;
/// Triangles of one first corner that are looked through; those beyond are found by all corners.
const MAX_FAN: usize = 16;

/// The last state of a mesh, on the grid of [`DiffParams::quantum_m`].
///
/// Those who publish meshes keep the order of what did not change, or that of large parts of it. So
/// leading triangles that are the old ones, vertex numbers and all, are passed over, as where a mesh grows
/// at its end. Each new triangle after these is first held against the old one behind the last that was
/// found, then against those that begin at the same point; what is left on either side is compared as
/// [`super::diff()`] does, with the same classes. But for comparing and copying memory the cost is that of
/// the triangles, old and new, that are not passed over.
///
/// Each point of the grid is one vertex, and keeps its number as long as a triangle names it. Numbers
/// that are free lie in the mesh as vertices that no triangle names.
#[derive(Debug)]
pub struct TrackedMesh {
    params: DiffParams,
    given: Arc<TriMesh>,
    /// Per vertex given: its number on the grid; [`NONE`] where no triangle names it.
    place_of_vertex: Vec<u32>,
    /// Per vertex given: the first triangle that names it, or [`NONE`].
    first_of_vertex: Vec<u32>,
    places: Places,
    /// Per place: how many vertices given that triangles name are there; 0 where it is free.
    num_at_place: Vec<u32>,
    mesh: Arc<TriMesh>,
    fans: Fans,
    /// How often vertices got other numbers.
    num_renumberings: usize,
}

/// What is known of a new mesh while it is held against the old one, beyond the triangles in place.
struct Matching<'a> {
    num_in_place: usize,
    new: &'a TriMesh,
    /// Per vertex of the new mesh, as far as it is known.
    place_of_vertex: &'a mut [u32],
    old: &'a TriMesh,
    /// The old mesh, its vertices on the grid.
    old_on_grid: &'a TriMesh,
    places: &'a Places,
    quantum_m: f64,
    matched: Matched,
}

/// What came of it.
struct Matched {
    /// Per old triangle after those in place.
    is_matched: Vec<bool>,
    /// Per new triangle after those in place.
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
            first_of_vertex: Vec::new(),
            places: Places::with_capacity(0),
            num_at_place: Vec::new(),
            mesh: Arc::default(),
            fans: Fans::default(),
            num_renumberings: 0,
        })
    }

    /// Forgets the mesh.
    pub fn clear(&mut self) {
        self.given = Arc::default();
        self.place_of_vertex.clear();
        self.first_of_vertex.clear();
        self.places = Places::with_capacity(0);
        self.num_at_place.clear();
        self.mesh = Arc::default();
        self.fans = Fans::default();
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
    /// [`MeshDiff::touched`] are vertices of [`Self::mesh`].
    ///
    /// # Errors
    /// [`DiffError`] when the grid cannot number a coordinate; the mesh stays what it was.
    pub fn follow(&mut self, given: &Arc<TriMesh>) -> Result<Option<MeshDiff>, DiffError> {
        if Arc::ptr_eq(&self.given, given) {
            return Ok(None);
        }
        let num_in_place = num_in_place(given, &self.given);
        self.check_points(&given.triangles()[num_in_place..], given)?;
        // From here on nothing is refused, so that all that is kept may change.
        let emptied = self.take_off(num_in_place, given.num_vertices());
        let Matched {
            is_matched,
            mut origins,
            left,
        } = self.matched(given, num_in_place);
        let came = self.number(given, &left);
        let triangles = self.put_on(given, num_in_place);
        let is_empty = |&place: &u32| self.num_at_place[place as usize] == 0;
        let mut went: Vec<u32> = emptied.into_iter().filter(is_empty).collect();
        went.sort_unstable();

        let old_corners = self.mesh.triangles()[num_in_place..].iter();
        let old = ids_from(num_in_place).zip(old_corners.map(|&corners| Turned::of(corners)));
        let is_left = old.zip(is_matched).filter(|(_, is_matched)| !is_matched);
        let new_corners = |triangle: &TriangleId| triangles[triangle.index()];
        let comparison = Comparison {
            places: &self.places,
            old: is_left.map(|(triangle, _)| triangle).collect(),
            new: left.iter().map(|t| Turned::of(new_corners(t))).collect(),
            went: &went,
            came: &came,
            params: &self.params,
        };
        let Compared {
            origins: found,
            gone,
            gone_at: mut touched,
        } = comparison.find();
        for (triangle, origin) in left.iter().zip(found) {
            if !matches!(origin, Origin::Kept(_)) {
                touched.extend(new_corners(triangle));
            }
            origins[triangle.index() - num_in_place] = origin;
        }
        let mut touched = each_once(touched, self.places.len());
        self.given = Arc::clone(given);
        self.settle(triangles, &came, &went, &mut touched);
        Ok(Some(MeshDiff::of(num_in_place, origins, gone, touched)))
    }

    /// Whether the grid can number the corners of some triangles of a mesh.
    fn check_points(&self, triangles: &[[u32; 3]], mesh: &TriMesh) -> Result<(), DiffError> {
        let quantum_m = self.params.quantum_m;
        // Far from the limit rounding makes no difference, and nothing need be divided.
        let surely_m = 0.5 * MAX_STEPS * quantum_m;
        let is_sure = |position_m: &Point3<f64>| position_m.iter().all(|c| c.abs() <= surely_m);
        let corners = triangles.as_flattened();
        let positions_m = mesh.positions_m();
        // Many corners are sooner looked at by vertex.
        if corners.len() > 2 * positions_m.len() && positions_m.iter().all(is_sure) {
            return Ok(());
        }
        for &vertex in corners {
            let position_m = &positions_m[vertex as usize];
            if !is_sure(position_m) {
                grid_point(position_m, quantum_m)?;
            }
        }
        Ok(())
    }

    /// Takes the old triangles after those in place off their vertices, and makes room for those of a new
    /// mesh. Returns the places where no triangle is any more, each once.
    fn take_off(&mut self, num_in_place: usize, num_vertices: usize) -> Vec<u32> {
        let mut emptied = Vec::new();
        for &vertex in self.given.triangles()[num_in_place..].as_flattened() {
            let first = &mut self.first_of_vertex[vertex as usize];
            if *first == NONE || (*first as usize) < num_in_place {
                continue;
            }
            *first = NONE;
            let place = std::mem::replace(&mut self.place_of_vertex[vertex as usize], NONE);
            let num_there = &mut self.num_at_place[place as usize];
            *num_there -= 1;
            if *num_there == 0 {
                emptied.push(place);
            }
        }
        // Triangles in place name none of those that are cut off.
        self.place_of_vertex.resize(num_vertices, NONE);
        self.first_of_vertex.resize(num_vertices, NONE);
        emptied
    }

    /// Finds equal triangles where the order is the old one.
    fn matched(&mut self, given: &TriMesh, num_in_place: usize) -> Matched {
        let num_after = |mesh: &TriMesh| mesh.num_triangles() - num_in_place;
        let matching = Matching {
            num_in_place,
            new: given,
            place_of_vertex: &mut self.place_of_vertex,
            old: &self.given,
            old_on_grid: &self.mesh,
            places: &self.places,
            quantum_m: self.params.quantum_m,
            matched: Matched {
                is_matched: vec![false; num_after(&self.given)],
                origins: vec![Origin::New; num_after(given)],
                left: Vec::new(),
            },
        };
        matching.in_order(&mut self.fans)
    }

    /// Numbers the points of triangles that have no equal in the old order. Returns the places that no
    /// old triangle names, ascending.
    fn number(&mut self, given: &TriMesh, left: &[TriangleId]) -> Vec<u32> {
        let mut came = Vec::new();
        for vertex in left.iter().flat_map(|t| given.triangles()[t.index()]) {
            let place = &mut self.place_of_vertex[vertex as usize];
            if *place == NONE {
                let position_m = &given.positions_m()[vertex as usize];
                let point = nearest_point(position_m, self.params.quantum_m);
                let (number, is_new) = self.places.enter(point);
                *place = number;
                came.extend(is_new.then_some(number));
            }
        }
        came.sort_unstable();
        came
    }

    /// Puts the new triangles after those in place on their vertices; returns all, by place.
    fn put_on(&mut self, given: &TriMesh, num_in_place: usize) -> Vec<[u32; 3]> {
        self.num_at_place.resize(self.places.len(), 0);
        let mut triangles = Vec::with_capacity(given.num_triangles());
        triangles.extend_from_slice(&self.mesh.triangles()[..num_in_place]);
        let others = given.triangles()[num_in_place..].iter();
        let others = ids_from(num_in_place).zip(others);
        triangles.extend(others.map(|(triangle, corners)| {
            corners.map(|vertex| {
                let place = self.place_of_vertex[vertex as usize];
                let first = &mut self.first_of_vertex[vertex as usize];
                if *first == NONE {
                    *first = triangle.0;
                    self.num_at_place[place as usize] += 1;
                }
                place
            })
        }));
        triangles
    }

    /// Makes the mesh of the places that came, and frees those that went.
    fn settle(
        &mut self,
        mut triangles: Vec<[u32; 3]>,
        came: &[u32],
        went: &[u32],
        touched: &mut Vec<u32>,
    ) {
        let quantum_m = self.params.quantum_m;
        let mut positions_m = Vec::with_capacity(self.places.len());
        positions_m.extend_from_slice(self.mesh.positions_m());
        positions_m.resize(self.places.len(), Point3::origin());
        for &place in came {
            let point = self.places.point(place);
            positions_m[place as usize] = Point3::from(point.map(|c| c as f64 * quantum_m));
        }
        for &place in went {
            self.places.remove(place);
        }
        if 2 * self.places.num_free() > self.places.len() {
            self.renumber(&mut triangles, &mut positions_m, touched);
        }
        self.mesh = Arc::new(TriMesh::of_parts(positions_m, triangles));
    }

    /// Numbers anew what triangles name, in their order.
    fn renumber(
        &mut self,
        triangles: &mut [[u32; 3]],
        positions_m: &mut Vec<Point3<f64>>,
        touched: &mut Vec<u32>,
    ) {
        let num_named = self.places.len() - self.places.num_free();
        let mut places = Places::with_capacity(num_named);
        let mut number_of = vec![NONE; self.places.len()];
        let (mut kept_m, mut kept_num) = (Vec::new(), Vec::new());
        for vertex in triangles.as_flattened_mut() {
            let before = *vertex as usize;
            if number_of[before] == NONE {
                number_of[before] = places.insert(self.places.point(*vertex));
                kept_m.push(positions_m[before]);
                kept_num.push(self.num_at_place[before]);
            }
            *vertex = number_of[before];
        }
        let named = self.place_of_vertex.iter_mut();
        for place in named.filter(|place| **place != NONE) {
            *place = number_of[*place as usize];
        }
        let kept_touched = touched.iter().map(|&place| number_of[place as usize]);
        *touched = kept_touched.filter(|&place| place != NONE).collect();
        touched.sort_unstable();
        self.num_renumberings += 1;
        self.num_at_place = kept_num;
        self.places = places;
        self.fans = Fans::default();
        *positions_m = kept_m;
    }
}

/// How many leading triangles are the old ones, vertex numbers and positions and all.
fn num_in_place(new: &TriMesh, old: &TriMesh) -> usize {
    let num_vertices = match new.shares_vertices(old) {
        true => new.num_vertices(),
        false => num_common(new.positions_m(), old.positions_m(), |new, old| {
            // Without a decision per entry, so that several are compared at a time.
            new.iter().zip(old).fold(true, |is_same, (new, old)| {
                is_same & (new.x == old.x) & (new.y == old.y) & (new.z == old.z)
            })
        }),
    };
    let are_all_common = num_vertices == old.num_vertices();
    let is_common = |&vertex: &u32| (vertex as usize) < num_vertices;
    num_common(new.triangles(), old.triangles(), |new, old| {
        let (new, old) = (new.as_flattened(), old.as_flattened());
        new == old && (are_all_common || new.iter().all(is_common))
    })
}

/// How many leading entries are the same; `are_same` is asked of equally many of either side.
fn num_common<T>(new: &[T], old: &[T], are_same: impl Fn(&[T], &[T]) -> bool) -> usize {
    const CHUNK: usize = 256;
    let num_both = new.len().min(old.len());
    let num_same = |first: usize, size: usize| {
        let [new, old] = [new, old].map(|side| side[first..num_both].chunks(size));
        let chunks = new.zip(old).take_while(|(new, old)| are_same(new, old));
        chunks.map(|(new, _)| new.len()).sum::<usize>()
    };
    let in_chunks = num_same(0, CHUNK);
    in_chunks + num_same(in_chunks, 1)
}

impl Matching<'_> {
    /// Finds equal triangles where the order is the old one.
    fn in_order(mut self, fans: &mut Fans) -> Matched {
        let mut next_old = self.num_in_place;
        let triangles = ids_from(self.num_in_place).take(self.matched.origins.len());
        for triangle in triangles {
            let mut found = ids_from(next_old).next();
            found = found.filter(|&old| self.is_equal(triangle, old));
            if found.is_none() {
                found = self.find(triangle, fans);
            }
            match found {
                Some(old) => {
                    let (before, now) = (old.index(), triangle.index());
                    self.matched.is_matched[before - self.num_in_place] = true;
                    self.matched.origins[now - self.num_in_place] = Origin::Kept(OldTriangle {
                        triangle: old,
                        first_corner: 0,
                    });
                    next_old = old.index() + 1;
                }
                None => self.matched.left.push(triangle),
            }
        }
        fans.fold(self.old_on_grid);
        self.matched
    }

    /// Whether a triangle equals an old one that is there and not matched yet, corner by corner.
    fn is_equal(&mut self, triangle: TriangleId, old: TriangleId) -> bool {
        let number = old.index() - self.num_in_place;
        if self.matched.is_matched.get(number) != Some(&false) {
            return false;
        }
        let old_corners = self.old.triangles()[old.index()];
        let old_places = self.old_on_grid.triangles()[old.index()];
        let corners = self.new.triangles()[triangle.index()];
        (0..3).all(|k| {
            let place = &mut self.place_of_vertex[corners[k] as usize];
            if *place == NONE {
                let position_m = self.new.positions_m()[corners[k] as usize];
                if position_m == self.old.positions_m()[old_corners[k] as usize] {
                    *place = old_places[k];
                }
            }
            *place == old_places[k]
        })
    }

    /// Looks for an equal triangle by its first corner.
    fn find(&mut self, triangle: TriangleId, fans: &mut Fans) -> Option<TriangleId> {
        let [vertex, _, _] = self.new.triangles()[triangle.index()];
        let place = &mut self.place_of_vertex[vertex as usize];
        if *place == NONE {
            let position_m = &self.new.positions_m()[vertex as usize];
            *place = self.places.get(nearest_point(position_m, self.quantum_m))?;
        }
        if !fans.is_spread {
            fans.spread(self.old_on_grid, self.num_in_place);
        }
        let mut fan = fans.at(*place).take(MAX_FAN);
        fan.find(|&old| self.is_equal(triangle, old))
    }
}

/// Old triangles after the first ones, by their first corner.
#[derive(Debug, Default)]
struct Fans {
    is_spread: bool,
    first_triangle: usize,
    /// Per place: its first triangle; [`NONE`] for all while nothing is spread.
    first: Vec<u32>,
    /// Per triangle from `first_triangle` on: the next one of the place.
    next: Vec<u32>,
}

impl Fans {
    fn spread(&mut self, mesh: &TriMesh, first_triangle: usize) {
        let triangles = &mesh.triangles()[first_triangle..];
        self.is_spread = true;
        self.first_triangle = first_triangle;
        self.first.resize(mesh.num_vertices(), NONE);
        self.next.resize(triangles.len(), NONE);
        // From the last, so that the first is found first.
        for (number, &[place, _, _]) in triangles.iter().enumerate().rev() {
            #[expect(clippy::cast_possible_truncation, reason = "checked at construction")]
            let triangle = (first_triangle + number) as u32;
            self.next[number] = std::mem::replace(&mut self.first[place as usize], triangle);
        }
    }

    /// Undoes [`Self::spread`], if it was done, of the same mesh.
    fn fold(&mut self, mesh: &TriMesh) {
        if !std::mem::take(&mut self.is_spread) {
            return;
        }
        for &[place, _, _] in &mesh.triangles()[self.first_triangle..] {
            self.first[place as usize] = NONE;
        }
        self.next.clear();
    }

    fn at(&self, place: u32) -> impl Iterator<Item = TriangleId> {
        let first = self.first.get(place as usize).copied();
        let is_there = |number: &u32| *number != NONE;
        std::iter::successors(first.filter(is_there), move |&number| {
            Some(self.next[number as usize - self.first_triangle]).filter(is_there)
        })
        .map(TriangleId)
    }
}
