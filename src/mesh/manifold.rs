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

use super::adjacency::{EdgeTable, NO_HALF_EDGE, next, previous, vertices_of_corners};
use super::components::components;
use super::ids::TriangleId;
use super::tri_mesh::{MeshError, TriMesh};
use super::weld::equal_representatives;

/// Faces on one edge beyond which it is cut without looking for pairs (pairing is quadratic).
const MAX_PAIRED_FACES: usize = 64;

/// What was found and done. Vertices of equal position count as one throughout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ManifoldReport {
    /// Undirected edges of the soup, after welding.
    pub num_edges: usize,
    /// Edges of a single face.
    pub num_boundary_edges: usize,
    /// Edges of more than two faces.
    pub num_non_manifold_edges: usize,
    /// The most faces on one edge.
    pub max_faces_on_edge: usize,
    /// Faces on edges of more than two that have no partner there: the edge is boundary to them.
    pub num_unpaired_faces: usize,
    /// Two-face edges cut because no orientation fits.
    pub num_orientation_cuts: usize,
    /// Vertices of equal position with an earlier one.
    pub num_merged_vertices: usize,
    /// Vertices whose faces do not form one fan or cycle.
    pub num_split_vertices: usize,
    /// Extra vertices made of these, so that each fan has its own.
    pub num_duplicated_vertices: usize,
    /// Vertices that no triangle names.
    pub num_isolated_vertices: usize,
    /// Triangles turned round to agree with their neighbours.
    pub num_reversed_triangles: usize,
    /// Triangles with the same three vertices as an earlier one, in the same turn.
    pub num_duplicate_triangles: usize,
    /// Triangles with the same three vertices as earlier ones, but in the other turn.
    pub num_opposite_triangles: usize,
    /// Triangles that name a position twice.
    pub num_collapsed_triangles: usize,
    /// Other triangles of no area.
    pub num_zero_area_triangles: usize,
    /// Connected pieces after the repair, collapsed triangles apart.
    pub num_components: usize,
    /// Of these, with a single triangle.
    pub num_single_triangle_components: usize,
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
        count_copies(&welded, &table, &mut report);
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
        manifold.count(mesh, &representative);
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

    /// Counts what the joined triangles tell; the edges were counted while they were joined.
    fn count(&mut self, mesh: &TriMesh, representative: &[u32]) {
        let report = &mut self.report;
        let mut is_used = vec![false; mesh.num_vertices()];
        // One vertex of the manifold per fan, at one welded vertex.
        let mut welded_of = vec![u32::MAX; self.num_vertices as usize];
        for (t, welded) in self.welded.iter().enumerate() {
            welded.iter().for_each(|&v| is_used[v as usize] = true);
            if is_collapsed(*welded) {
                report.num_collapsed_triangles += 1;
                continue;
            }
            let [a, b, c] = *welded;
            let oriented = if self.is_reversed[t] {
                [a, c, b]
            } else {
                *welded
            };
            for (&vertex, &welded) in self.vertex_of_corner[t].iter().zip(&oriented) {
                welded_of[vertex as usize] = welded;
            }
            report.num_reversed_triangles += usize::from(self.is_reversed[t]);
        }
        let mut num_fans = vec![0_usize; mesh.num_vertices()];
        for &welded in welded_of.iter().filter(|welded| **welded != u32::MAX) {
            num_fans[welded as usize] += 1;
        }
        for &num_fans in num_fans.iter().filter(|num_fans| **num_fans > 1) {
            report.num_split_vertices += 1;
            report.num_duplicated_vertices += num_fans - 1;
        }
        for (vertex, &first) in representative.iter().enumerate() {
            report.num_merged_vertices += usize::from(first as usize != vertex);
            report.num_isolated_vertices += usize::from(!is_used[first as usize]);
        }
        report.num_zero_area_triangles = mesh
            .triangle_ids()
            .filter(|&t| !is_collapsed(self.welded[t.index()]))
            .filter(|&t| mesh.scaled_normal(t).amax() <= 0.0)
            .count();
        let (label, num_pieces) = components(&self.mates);
        let mut size = vec![0_usize; num_pieces as usize];
        label.iter().for_each(|&piece| size[piece as usize] += 1);
        // A collapsed triangle joins nothing, so it is a piece of its own.
        report.num_components = size.len() - report.num_collapsed_triangles;
        report.num_single_triangle_components =
            size.iter().filter(|size| **size == 1).count() - report.num_collapsed_triangles;
    }
}

fn is_collapsed([a, b, c]: [u32; 3]) -> bool {
    a == b || b == c || c == a
}

fn start_of(triangles: &[[u32; 3]], half_edge: u32) -> u32 {
    triangles[half_edge as usize / 3][half_edge as usize % 3]
}

/// Counts triangles that share all three vertices with an earlier one.
///
/// Such triangles meet at all their edges; they are looked for at the one of their two smaller
/// vertices.
fn count_copies(welded: &[[u32; 3]], table: &EdgeTable, report: &mut ManifoldReport) {
    // (largest vertex, half-edge, whether the side runs from the smallest vertex)
    let mut copies: Vec<(u32, u32, bool)> = Vec::new();
    for edge in table.edges().filter(|edge| edge.len() > 1) {
        copies.clear();
        for &h in edge {
            let opposite = start_of(welded, previous(h));
            let [start, end] = [start_of(welded, h), start_of(welded, next(h))];
            if opposite > start.max(end) {
                copies.push((opposite, h, start < end));
            }
        }
        copies.sort_unstable();
        for same in copies.chunk_by(|a, b| a.0 == b.0) {
            let mut has_turn = [false; 2];
            for (earlier, &(_, _, turn)) in same.iter().enumerate() {
                if std::mem::replace(&mut has_turn[usize::from(turn)], true) {
                    report.num_duplicate_triangles += 1;
                } else if earlier > 0 {
                    report.num_opposite_triangles += 1;
                }
            }
        }
    }
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
        report.max_faces_on_edge = report.max_faces_on_edge.max(edge.len());
        match *edge {
            [_] => report.num_boundary_edges += 1,
            [a, b] => {
                mates[a as usize] = b;
                mates[b as usize] = a;
            }
            _ => {
                report.num_non_manifold_edges += 1;
                pair_flattest(mesh, welded, edge, &mut mates);
                let is_alone = |h: &&u32| mates[**h as usize] == NO_HALF_EDGE;
                report.num_unpaired_faces += edge.iter().filter(is_alone).count();
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
    use crate::mesh::adjacency::boundary_loops;
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

    /// Points in general position.
    fn points(num: u32) -> Vec<[f64; 3]> {
        let place = |i: u32| {
            let i = f64::from(i);
            [(1.7 * i).sin(), (2.3 * i).cos(), (0.9 * i).sin()]
        };
        (0..num).map(place).collect()
    }

    fn report_of(positions: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> ManifoldReport {
        let mesh = mesh(positions, triangles);
        let manifold = Manifold::new(&mesh).unwrap();
        check_invariants(&mesh, &manifold);
        *manifold.report()
    }

    /// Five pages of a book, alternately turned: two pairs and one that is left over.
    #[test]
    fn a_book_of_five_faces_is_two_pairs_and_one() {
        let pages = vec![[0, 1, 2], [1, 0, 3], [0, 1, 4], [1, 0, 5], [0, 1, 6]];
        let expected = ManifoldReport {
            num_edges: 11,
            num_boundary_edges: 10,
            num_non_manifold_edges: 1,
            max_faces_on_edge: 5,
            num_unpaired_faces: 1,
            num_split_vertices: 2,
            num_duplicated_vertices: 4,
            num_components: 3,
            num_single_triangle_components: 1,
            ..Default::default()
        };
        assert_eq!(report_of(points(7), pages), expected);
        // All in one turn: an orientable pair needs two directions, so none join.
        let alike = (2..7).map(|tip| [0, 1, tip]).collect();
        let expected = ManifoldReport {
            num_unpaired_faces: 5,
            num_duplicated_vertices: 8,
            num_components: 5,
            num_single_triangle_components: 5,
            ..expected
        };
        assert_eq!(report_of(points(7), alike), expected);
    }

    #[test]
    fn a_vertex_of_three_fans_is_split_once_into_three() {
        let fans = vec![[0, 1, 2], [0, 3, 4], [0, 4, 5], [0, 6, 7]];
        let expected = ManifoldReport {
            num_edges: 11,
            num_boundary_edges: 10,
            max_faces_on_edge: 2,
            num_split_vertices: 1,
            num_duplicated_vertices: 2,
            num_components: 3,
            num_single_triangle_components: 2,
            ..Default::default()
        };
        assert_eq!(report_of(points(8), fans), expected);
    }

    #[test]
    fn copies_in_the_same_turn_and_in_the_other_are_counted_apart() {
        // The second is the first begun elsewhere, the third is turned round, the last copies that.
        let copies = vec![[0, 1, 2], [1, 2, 0], [2, 1, 0], [0, 2, 1]];
        let report = report_of(points(3), copies);
        assert_eq!(report.num_duplicate_triangles, 2);
        assert_eq!(report.num_opposite_triangles, 1);
        assert_eq!([report.num_edges, report.num_non_manifold_edges], [3, 3]);
        assert_eq!(report.max_faces_on_edge, 4);
        // Back to back: a closed surface of two faces.
        let pair = report_of(points(3), vec![[0, 1, 2], [0, 2, 1]]);
        let expected = ManifoldReport {
            num_edges: 3,
            max_faces_on_edge: 2,
            num_opposite_triangles: 1,
            num_components: 1,
            ..Default::default()
        };
        assert_eq!(pair, expected);
    }

    #[test]
    fn faces_without_area_and_vertices_without_faces_are_counted() {
        let mut positions = points(3);
        positions.extend([[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [7.0, 0.0, 0.0]]);
        // A copy of vertex 3 (used through it), one of vertex 0, and two that nothing names.
        positions.extend([[5.0, 0.0, 0.0], positions[0], [8.0, 8.0, 8.0], [9.0; 3]]);
        let triangles = vec![
            [0, 1, 2],
            // Three points on a line.
            [3, 4, 5],
            // Twice the same vertex, by index, by position, and thrice.
            [1, 1, 2],
            [0, 7, 1],
            [6, 3, 3],
        ];
        let expected = ManifoldReport {
            num_edges: 6,
            num_boundary_edges: 6,
            max_faces_on_edge: 1,
            num_merged_vertices: 2,
            num_isolated_vertices: 2,
            num_collapsed_triangles: 3,
            num_zero_area_triangles: 1,
            num_components: 2,
            num_single_triangle_components: 2,
            ..Default::default()
        };
        assert_eq!(report_of(positions, triangles), expected);
    }

    #[test]
    fn one_turned_face_of_a_patch_is_turned_back() {
        let patch = vec![[0, 1, 2], [0, 2, 3], [0, 4, 3], [0, 4, 5]];
        let report = report_of(points(6), patch);
        assert_eq!(report.num_reversed_triangles, 1);
        assert_eq!(report.num_components, 1);
        assert_eq!(report.num_orientation_cuts, 0);
    }

    #[test]
    fn an_edge_of_a_thousand_faces_keeps_them_all() {
        let fan: Vec<[u32; 3]> = (2..1002).map(|tip| [0, 1, tip]).collect();
        let positions = (0..1002).map(|i| {
            let turn = f64::from(i);
            [turn.cos(), turn.sin(), f64::from(i % 2)]
        });
        let report = report_of(positions.collect(), fan);
        assert_eq!(report.max_faces_on_edge, 1000);
        assert_eq!(report.num_unpaired_faces, 1000);
        assert_eq!(report.num_single_triangle_components, 1000);
    }

    /// The counts again, by comparing every triangle with every other.
    fn check_counts(mesh: &TriMesh, report: &ManifoldReport) {
        let triangles = mesh.triangles();
        let turned_alike =
            |a: [u32; 3], b: [u32; 3]| (0..3).any(|k| [a[k], a[(k + 1) % 3], a[(k + 2) % 3]] == b);
        let (mut duplicate, mut opposite, mut collapsed) = (0, 0, 0);
        for (i, &[a, b, c]) in triangles.iter().enumerate() {
            if is_collapsed([a, b, c]) {
                collapsed += 1;
            } else if triangles[..i].iter().any(|&t| turned_alike(t, [a, b, c])) {
                duplicate += 1;
            } else if triangles[..i].iter().any(|&t| turned_alike(t, [a, c, b])) {
                opposite += 1;
            }
        }
        assert_eq!(report.num_duplicate_triangles, duplicate);
        assert_eq!(report.num_opposite_triangles, opposite);
        assert_eq!(report.num_collapsed_triangles, collapsed);
        let is_named = |v: u32| triangles.iter().flatten().any(|named| *named == v);
        let num_vertices = u32::try_from(mesh.num_vertices()).unwrap();
        let isolated = (0..num_vertices).filter(|v| !is_named(*v)).count();
        assert_eq!(report.num_isolated_vertices, isolated);
    }

    proptest! {
        #[test]
        fn any_soup_becomes_manifold(
            triangles in proptest::collection::vec(proptest::array::uniform3(0_u32..7), 0..40)
        ) {
            let mesh = mesh(points(7), triangles);
            let manifold = Manifold::new(&mesh).unwrap();
            check_invariants(&mesh, &manifold);
            check_counts(&mesh, manifold.report());
        }
    }
}
