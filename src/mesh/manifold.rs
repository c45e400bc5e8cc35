//! Any soup as an oriented manifold, without dropping a triangle.
//!
//! - An edge of more than two faces is split into pairs that run in opposite directions, the
//!   flattest pair first; what is left over becomes boundary.
//! - An edge of two faces joins them. Within each connected piece the faces are oriented alike
//!   (the majority stays as it is); where no orientation fits (Möbius strip) the edge is cut.
//! - A vertex whose faces do not form one fan or cycle becomes one vertex per fan: vertices follow
//!   from the edges that are joined ([`super::adjacency::vertices_of_corners`]).
//! - A triangle that names a vertex twice is *collapsed*: it keeps its place but joins nothing.
//!
//! Half-edges here are *oriented*: those of a reversed triangle run over its corners 0, 2, 1.

use nalgebra::Point3;

use super::adjacency::{EdgeTable, NO_HALF_EDGE, vertices_of_corners};
use super::ids::TriangleId;
use super::tri_mesh::{MeshError, TriMesh};
use super::weld::equal_representatives;

/// Faces on one edge beyond which it is cut without looking for pairs (pairing is quadratic).
const MAX_PAIRED_FACES: usize = 64;

/// What was found and done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ManifoldReport {
    /// Undirected edges of the soup, after welding.
    pub num_edges: usize,
    /// Edges of a single face.
    pub num_boundary_edges: usize,
    /// Edges of more than two faces.
    pub num_non_manifold_edges: usize,
    /// Two-face edges cut because no orientation fits.
    pub num_orientation_cuts: usize,
    /// Extra vertices made where faces do not form one fan.
    pub num_duplicated_vertices: usize,
    /// Triangles turned round to agree with their neighbours.
    pub num_reversed_triangles: usize,
    /// Triangles with the same three vertices as an earlier one.
    pub num_duplicate_triangles: usize,
    /// Triangles that name a position twice.
    pub num_collapsed_triangles: usize,
    /// Other triangles of no area.
    pub num_zero_area_triangles: usize,
}

/// The joined, oriented triangles of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Manifold {
    mates: Vec<u32>,
    vertex_of_corner: Vec<[u32; 3]>,
    num_vertices: u32,
    welded: Vec<[u32; 3]>,
    is_reversed: Vec<bool>,
    report: ManifoldReport,
}

impl Manifold {
    /// Joins the triangles of `mesh`, whose vertices count as one where their positions are equal.
    ///
    /// # Errors
    /// [`MeshError::TooLarge`] when 32 bits cannot number the half-edges.
    pub fn new(mesh: &TriMesh) -> Result<Self, MeshError> {
        let representative = equal_representatives(mesh.positions_m());
        let welded: Vec<[u32; 3]> = mesh
            .triangles()
            .iter()
            .map(|corners| corners.map(|v| representative[v as usize]))
            .collect();
        // A collapsed triangle is listed by one vertex thrice, so that it has no sides.
        let joinable: Vec<[u32; 3]> = welded
            .iter()
            .map(|&c| if is_collapsed(c) { [c[0]; 3] } else { c })
            .collect();
        let table = EdgeTable::new(&joinable, mesh.num_vertices())?;
        let mut report = ManifoldReport::default();
        let mut mates = join(mesh, &welded, &table, &mut report);
        let is_reversed = orient(&welded, &mut mates, &mut report);
        let mates = oriented(&mates, &is_reversed);
        let (vertex_of_corner, num_vertices) = vertices_of_corners(&mates);
        let mut manifold = Self {
            mates,
            vertex_of_corner,
            num_vertices,
            welded,
            is_reversed,
            report,
        };
        manifold.count(mesh);
        Ok(manifold)
    }

    /// Per oriented half-edge the one across it, or [`NO_HALF_EDGE`].
    pub fn mates(&self) -> &[u32] {
        &self.mates
    }

    /// Whether a triangle's oriented corners are its corners 0, 2, 1.
    pub fn is_reversed(&self, triangle: TriangleId) -> bool {
        self.is_reversed[triangle.index()]
    }

    /// Whether a triangle names a position twice; it then joins nothing.
    pub fn is_collapsed(&self, triangle: TriangleId) -> bool {
        is_collapsed(self.welded[triangle.index()])
    }

    /// Per triangle, in the mesh's corner order, its vertices with equal positions merged: each is
    /// the index of the first mesh vertex there.
    pub fn welded_triangles(&self) -> &[[u32; 3]] {
        &self.welded
    }

    /// Positions of a triangle's oriented corners.
    pub fn oriented_corners_m(&self, mesh: &TriMesh, triangle: TriangleId) -> [Point3<f64>; 3] {
        let [a, b, c] = mesh.corners_m(triangle);
        if self.is_reversed(triangle) {
            [a, c, b]
        } else {
            [a, b, c]
        }
    }

    /// Vertex of each oriented corner, one per fan, below [`Self::num_vertices`].
    pub fn vertex_of_corner(&self) -> &[[u32; 3]] {
        &self.vertex_of_corner
    }

    /// How many vertices the manifold has.
    pub fn num_vertices(&self) -> u32 {
        self.num_vertices
    }

    /// What was found and done.
    pub fn report(&self) -> &ManifoldReport {
        &self.report
    }

    fn count(&mut self, mesh: &TriMesh) {
        let mut keys = self.welded.clone();
        for key in &mut keys {
            key.sort_unstable();
        }
        keys.sort_unstable();
        let mut used: Vec<u32> = keys.iter().flatten().copied().collect();
        keys.dedup();
        used.sort_unstable();
        used.dedup();
        self.report.num_duplicate_triangles = self.welded.len() - keys.len();
        let mut num_loose_corners = 0;
        for triangle in mesh.triangle_ids() {
            if self.is_collapsed(triangle) {
                self.report.num_collapsed_triangles += 1;
                num_loose_corners += 3;
            } else if mesh.scaled_normal(triangle).norm_squared() <= 0.0 {
                self.report.num_zero_area_triangles += 1;
            }
        }
        self.report.num_duplicated_vertices =
            (self.num_vertices as usize).saturating_sub(used.len() + num_loose_corners);
        self.report.num_reversed_triangles = self.is_reversed.iter().filter(|r| **r).count();
    }
}

fn is_collapsed([a, b, c]: [u32; 3]) -> bool {
    a == b || b == c || c == a
}

fn start_of(triangles: &[[u32; 3]], half_edge: u32) -> u32 {
    triangles[half_edge as usize / 3][half_edge as usize % 3]
}

/// Mates in the mesh's own half-edges; two-face edges may still run in one direction.
fn join(
    mesh: &TriMesh,
    welded: &[[u32; 3]],
    table: &EdgeTable,
    report: &mut ManifoldReport,
) -> Vec<u32> {
    let mut mates = vec![NO_HALF_EDGE; 3 * welded.len()];
    report.num_edges = table.num_edges();
    for edge in table.edges() {
        match *edge {
            [_] => report.num_boundary_edges += 1,
            [a, b] => {
                mates[a as usize] = b;
                mates[b as usize] = a;
            }
            _ => {
                report.num_non_manifold_edges += 1;
                pair_flattest(mesh, welded, edge, &mut mates);
            }
        }
    }
    mates
}

/// Joins faces of one edge that run in opposite directions, those with the most similar normals
/// first; ties go to the smaller indices.
fn pair_flattest(mesh: &TriMesh, welded: &[[u32; 3]], edge: &[u32], mates: &mut [u32]) {
    if edge.len() > MAX_PAIRED_FACES {
        return;
    }
    let normal = |h: u32| {
        mesh.scaled_normal(TriangleId(h / 3))
            .try_normalize(0.0)
            .unwrap_or_default()
    };
    let mut pairs = Vec::new();
    for (i, &a) in edge.iter().enumerate() {
        for &b in &edge[i + 1..] {
            if start_of(welded, a) != start_of(welded, b) {
                pairs.push((-normal(a).dot(&normal(b)), a, b));
            }
        }
    }
    pairs.sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    for (_, a, b) in pairs {
        if mates[a as usize] == NO_HALF_EDGE && mates[b as usize] == NO_HALF_EDGE {
            mates[a as usize] = b;
            mates[b as usize] = a;
        }
    }
}

/// Which triangles must be turned round; cuts the edges across which that cannot agree.
fn orient(welded: &[[u32; 3]], mates: &mut [u32], report: &mut ManifoldReport) -> Vec<bool> {
    let mut is_reversed = vec![false; welded.len()];
    let mut is_visited = vec![false; welded.len()];
    let mut piece = Vec::new();
    for seed in 0..welded.len() {
        if is_visited[seed] {
            continue;
        }
        piece.clear();
        piece.push(seed);
        is_visited[seed] = true;
        let mut head = 0;
        while let Some(&triangle) = piece.get(head) {
            head += 1;
            for h in 3 * triangle..3 * triangle + 3 {
                let mate = mates[h];
                if mate == NO_HALF_EDGE {
                    continue;
                }
                let neighbor = mate as usize / 3;
                let same_direction = welded[triangle][h % 3] == start_of(welded, mate);
                let expected = is_reversed[triangle] != same_direction;
                if !is_visited[neighbor] {
                    is_visited[neighbor] = true;
                    is_reversed[neighbor] = expected;
                    piece.push(neighbor);
                } else if is_reversed[neighbor] != expected {
                    mates[h] = NO_HALF_EDGE;
                    mates[mate as usize] = NO_HALF_EDGE;
                    report.num_orientation_cuts += 1;
                }
            }
        }
        if 2 * piece.iter().filter(|&&t| is_reversed[t]).count() > piece.len() {
            for &triangle in &piece {
                is_reversed[triangle] = !is_reversed[triangle];
            }
        }
    }
    is_reversed
}

/// The same mates, numbered by oriented half-edges: side `k` of a reversed triangle is `2 - k`.
fn oriented(mates: &[u32], is_reversed: &[bool]) -> Vec<u32> {
    let turn = |h: usize| {
        if is_reversed[h / 3] {
            h - h % 3 + 2 - h % 3
        } else {
            h
        }
    };
    let mut turned = vec![NO_HALF_EDGE; mates.len()];
    for (h, &mate) in mates.iter().enumerate() {
        if mate != NO_HALF_EDGE {
            #[expect(clippy::cast_possible_truncation, reason = "in the same triangle")]
            {
                turned[turn(h)] = turn(mate as usize) as u32;
            }
        }
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::adjacency::{boundary_loops, next};
    use crate::mesh::components::components;
    use proptest::prelude::*;

    fn mesh(positions: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> TriMesh {
        let positions = positions.into_iter().map(Point3::from).collect();
        TriMesh::from_soup(positions, triangles).unwrap().0
    }

    fn check_invariants(mesh: &TriMesh, manifold: &Manifold) {
        let mates = manifold.mates();
        let corner = |h: u32| manifold.oriented_corners_m(mesh, TriangleId(h / 3))[h as usize % 3];
        for (h, &mate) in (0_u32..).zip(mates) {
            if mate != NO_HALF_EDGE {
                assert_eq!(mates[mate as usize], h, "mates are mutual");
                assert_ne!(h / 3, mate / 3, "no triangle is joined to itself");
                assert_eq!(corner(h), corner(next(mate)), "opposite directions");
                assert_eq!(corner(next(h)), corner(mate), "opposite directions");
            }
        }
        for (t, corners) in manifold.vertex_of_corner().iter().enumerate() {
            assert!(corners.iter().all(|&v| v < manifold.num_vertices()), "{t}");
        }
    }

    fn strip(num_quads: u32, is_twisted: bool) -> TriMesh {
        let mut positions = Vec::new();
        for i in 0..num_quads {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(num_quads);
            let tilt = if is_twisted { 0.5 * angle } else { 0.0 };
            for side in [-0.2, 0.2] {
                let radius = 1.0 + side * tilt.sin();
                positions.push([
                    radius * angle.cos(),
                    radius * angle.sin(),
                    side * tilt.cos(),
                ]);
            }
        }
        let mut triangles = Vec::new();
        for i in 0..num_quads {
            let [a, b] = [2 * i, 2 * i + 1];
            let j = (i + 1) % num_quads;
            let [c, d] = if is_twisted && j == 0 {
                [1, 0]
            } else {
                [2 * j, 2 * j + 1]
            };
            triangles.push([a, c, b]);
            triangles.push([b, c, d]);
        }
        mesh(positions, triangles)
    }

    #[test]
    fn an_annulus_stays_whole_and_a_moebius_strip_is_cut_once() {
        let ring = Manifold::new(&strip(12, false)).unwrap();
        assert_eq!(ring.report().num_orientation_cuts, 0);
        assert_eq!(boundary_loops(ring.mates()).len(), 2);
        let moebius = strip(12, true);
        let cut = Manifold::new(&moebius).unwrap();
        check_invariants(&moebius, &cut);
        assert_eq!(cut.report().num_orientation_cuts, 1);
        assert_eq!(components(cut.mates()).1, 1);
        assert_eq!(boundary_loops(cut.mates()).len(), 1);
    }

    #[test]
    fn an_hourglass_vertex_is_duplicated() {
        let mesh = mesh(
            vec![
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1.0, 1.0, 0.0],
                [-1.0, 0.0, 0.0],
                [-1.0, -1.0, 0.0],
            ],
            vec![[0, 1, 2], [0, 3, 4]],
        );
        let manifold = Manifold::new(&mesh).unwrap();
        check_invariants(&mesh, &manifold);
        assert_eq!(manifold.num_vertices(), 6);
        assert_eq!(manifold.report().num_duplicated_vertices, 1);
    }

    #[test]
    fn of_four_faces_on_an_edge_the_coplanar_ones_pair() {
        let mesh = mesh(
            vec![
                [0.0, 0.0, 0.0],
                [0.0, 0.0, 1.0],
                [1.0, 0.0, 0.0],
                [-1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [0.0, -1.0, 0.0],
            ],
            vec![[0, 1, 2], [0, 1, 4], [1, 0, 3], [1, 0, 5]],
        );
        let manifold = Manifold::new(&mesh).unwrap();
        check_invariants(&mesh, &manifold);
        assert_eq!(manifold.report().num_non_manifold_edges, 1);
        assert_eq!(manifold.mates()[0], 6);
        assert_eq!(manifold.mates()[3], 9);
    }

    #[test]
    fn reversed_duplicate_and_collapsed_faces_are_counted() {
        let mesh = mesh(
            vec![
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1.0, 1.0, 0.0],
                [0.0, 1.0, 0.0],
                [2.0, 0.0, 0.0],
                [2.0, 1.0, 0.0],
                [0.0, 9.0, 0.0],
                [1.0, 9.0, 0.0],
                [2.0, 9.0, 0.0],
            ],
            vec![
                [0, 1, 2],
                [0, 2, 3],
                [1, 5, 4],
                [1, 5, 2],
                [0, 2, 3],
                [3, 3, 0],
                [6, 7, 8],
            ],
        );
        let manifold = Manifold::new(&mesh).unwrap();
        check_invariants(&mesh, &manifold);
        let report = manifold.report();
        assert!(manifold.is_reversed(TriangleId(2)) && !manifold.is_reversed(TriangleId(0)));
        assert_eq!(report.num_duplicate_triangles, 1);
        assert_eq!(report.num_collapsed_triangles, 1);
        assert_eq!(report.num_zero_area_triangles, 1);
    }

    proptest! {
        #[test]
        fn any_soup_becomes_manifold(
            triangles in proptest::collection::vec(proptest::array::uniform3(0_u32..7), 0..40)
        ) {
            let positions = (0..7)
                .map(|i| {
                    let i = f64::from(i);
                    [(1.7 * i).sin(), (2.3 * i).cos(), (0.9 * i).sin()]
                })
                .collect();
            let mesh = mesh(positions, triangles);
            let manifold = Manifold::new(&mesh).unwrap();
            check_invariants(&mesh, &manifold);
        }
    }
}
