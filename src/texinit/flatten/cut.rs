//! Making a connected piece a topological disk: small holes are filled by extra triangles, what
//! remains is cut.
//!
//! Filling: a hole that is short beside the longest boundary gets a fan about its centroid, which
//! only takes part in the solve. The cut graph is the greedy tree–cotree one (Erickson and
//! Whittlesey 2005, "Greedy optimal homotopy and homology generators"), with the whole boundary as
//! its root: a shortest-path forest from the boundary, a spanning tree of the triangles that
//! crosses the longest detours first, and cuts along what neither holds. A closed piece is rooted
//! at one vertex; a sphere is slit along the shortest path between two far vertices.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Point3;

use crate::mesh::adjacency::{NO_HALF_EDGE, boundary_loops, next, vertices_of_corners};

/// A hole is filled when its boundary is at most this share of the longest one.
const MAX_FILLED_SHARE: f64 = 0.5;

/// A disk of triangles; the first `num_real` are the piece's, the others fill holes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Disk {
    pub(crate) num_real: usize,
    pub(crate) corners_m: Vec<[Point3<f64>; 3]>,
    pub(crate) mates: Vec<u32>,
    pub(crate) vertices: Vec<[u32; 3]>,
    pub(crate) num_vertices: usize,
    /// The one boundary loop, surface on the left.
    pub(crate) boundary: Vec<u32>,
    pub(crate) num_filled_holes: usize,
    pub(crate) num_cut_edges: usize,
}

/// The piece as a disk; none when it is still not one after cutting.
pub(crate) fn make_disk(mut corners_m: Vec<[Point3<f64>; 3]>, mut mates: Vec<u32>) -> Option<Disk> {
    let num_real = corners_m.len();
    let num_filled_holes = fill_holes(&mut corners_m, &mut mates);
    let mut num_cut_edges = 0;
    let (mut vertices, mut num_vertices) = vertices_of_corners(&mates);
    let mut loops = boundary_loops(&mates);
    if loops.len() != 1 || euler_characteristic(num_vertices, &mates) != 1 {
        num_cut_edges = cut(&corners_m, &mut mates, &vertices, num_vertices as usize);
        (vertices, num_vertices) = vertices_of_corners(&mates);
        loops = boundary_loops(&mates);
    }
    if loops.len() != 1 || euler_characteristic(num_vertices, &mates) != 1 {
        return None;
    }
    Some(Disk {
        num_real,
        corners_m,
        mates,
        vertices,
        num_vertices: num_vertices as usize,
        boundary: loops.pop()?,
        num_filled_holes,
        num_cut_edges,
    })
}

/// A connected piece before it is cut: any number of boundary loops and handles. The first
/// `num_real` triangles are the piece's, the others fill holes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Surface {
    pub(crate) num_real: usize,
    pub(crate) corners_m: Vec<[Point3<f64>; 3]>,
    pub(crate) mates: Vec<u32>,
    pub(crate) vertices: Vec<[u32; 3]>,
    pub(crate) num_vertices: usize,
    pub(crate) num_filled_holes: usize,
}

impl Surface {
    /// Fills holes as the authors' program does: of a surface without handles all loops but the
    /// longest, and that too when it is shorter than half the diameter; of one with handles all.
    pub(crate) fn filled(mut corners_m: Vec<[Point3<f64>; 3]>, mut mates: Vec<u32>) -> Self {
        let num_real = corners_m.len();
        let (_, num_vertices) = vertices_of_corners(&mates);
        let loops = boundary_loops(&mates);
        let num_loops = i64::try_from(loops.len()).unwrap_or(i64::MAX);
        // χ = 2 − 2 · handles − loops.
        let has_handles = euler_characteristic(num_vertices, &mates) + num_loops < 2;
        let length =
            |hole: &Vec<u32>| -> f64 { hole.iter().map(|&h| edge_length(&corners_m, h)).sum() };
        let lengths: Vec<f64> = loops.iter().map(length).collect();
        let mut longest = 0;
        for (i, length) in lengths.iter().enumerate() {
            if *length > lengths[longest] {
                longest = i;
            }
        }
        let short = 0.5 * diameter_m(&corners_m);
        let mut num_filled_holes = 0;
        for (i, hole) in loops.iter().enumerate() {
            if has_handles || i != longest || lengths[i] < short {
                fill(&mut corners_m, &mut mates, hole);
                num_filled_holes += 1;
            }
        }
        let (vertices, num_vertices) = vertices_of_corners(&mates);
        Self {
            num_real,
            corners_m,
            mates,
            vertices,
            num_vertices: num_vertices as usize,
            num_filled_holes,
        }
    }

    /// Vertices on the boundary, loop by loop.
    pub(crate) fn boundary_vertices(&self) -> Vec<usize> {
        let start = |h: u32| self.vertices[h as usize / 3][h as usize % 3] as usize;
        boundary_loops(&self.mates)
            .into_iter()
            .flatten()
            .map(start)
            .collect()
    }

    /// Cut along the generators of its handles; nothing changes on a disk or a sphere.
    pub(crate) fn without_handles(mut self) -> (Self, usize) {
        let graph = VertexGraph::new(
            &self.corners_m,
            &self.mates,
            &self.vertices,
            self.num_vertices,
        );
        let is_cut = mark_cut(&self.corners_m, &self.mates, &graph);
        let num_cut_edges = separate(&mut self.mates, &is_cut);
        let (vertices, num_vertices) = vertices_of_corners(&self.mates);
        self.vertices = vertices;
        self.num_vertices = num_vertices as usize;
        (self, num_cut_edges)
    }

    /// The disk that remains when handles are cut and the cut is led through the `terminals`: each
    /// in turn, the nearest first, is joined to what is cut already by a shortest path (Takahashi
    /// and Matsuyama 1980; at most twice the shortest such tree). None when it is no disk.
    pub(crate) fn cut_open(&self, terminals: &[usize]) -> Option<Disk> {
        let graph = VertexGraph::new(
            &self.corners_m,
            &self.mates,
            &self.vertices,
            self.num_vertices,
        );
        let mut is_cut = mark_cut(&self.corners_m, &self.mates, &graph);
        let mut tree = self.boundary_vertices();
        for (h, _) in (0_u32..).zip(&is_cut).filter(|(_, is_cut)| **is_cut) {
            tree.extend(graph.ends(h));
        }
        if tree.is_empty() {
            tree.extend(terminals.first());
        }
        graph.join_terminals(&tree, terminals, &mut is_cut);
        if tree.len() == 1 && is_cut.iter().all(|is_cut| !is_cut) {
            mark_slit(&graph, tree[0], &mut is_cut);
        }
        let mut mates = self.mates.clone();
        let num_cut_edges = separate(&mut mates, &is_cut);
        let (vertices, num_vertices) = vertices_of_corners(&mates);
        let mut loops = boundary_loops(&mates);
        if loops.len() != 1 || euler_characteristic(num_vertices, &mates) != 1 {
            return None;
        }
        Some(Disk {
            num_real: self.num_real,
            corners_m: self.corners_m.clone(),
            mates,
            vertices,
            num_vertices: num_vertices as usize,
            boundary: loops.pop()?,
            num_filled_holes: self.num_filled_holes,
            num_cut_edges,
        })
    }
}

/// Diagonal of the box around the triangles.
fn diameter_m(corners_m: &[[Point3<f64>; 3]]) -> f64 {
    let (mut low, mut high) = ([f64::MAX; 3], [f64::MIN; 3]);
    for point in corners_m.iter().flatten() {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    let squares = (0..3).map(|axis| (high[axis] - low[axis]).powi(2));
    squares.sum::<f64>().sqrt()
}

/// The disk slit open along the shortest path from an interior vertex to its boundary.
pub(crate) fn slit(disk: &Disk, vertex: usize) -> Option<Disk> {
    let graph = VertexGraph::new(
        &disk.corners_m,
        &disk.mates,
        &disk.vertices,
        disk.num_vertices,
    );
    let roots: Vec<usize> = disk
        .boundary
        .iter()
        .map(|&h| disk.vertices[h as usize / 3][h as usize % 3] as usize)
        .collect();
    let mut is_cut = vec![false; disk.mates.len()];
    graph
        .shortest_paths(&roots)
        .mark_path(&graph, vertex, &mut is_cut);
    let mut mates = disk.mates.clone();
    let num_cut_edges = disk.num_cut_edges + separate(&mut mates, &is_cut);
    let (vertices, num_vertices) = vertices_of_corners(&mates);
    let mut loops = boundary_loops(&mates);
    if loops.len() != 1 || num_cut_edges == disk.num_cut_edges {
        return None;
    }
    Some(Disk {
        num_real: disk.num_real,
        corners_m: disk.corners_m.clone(),
        mates,
        vertices,
        num_vertices: num_vertices as usize,
        boundary: loops.pop()?,
        num_filled_holes: disk.num_filled_holes,
        num_cut_edges,
    })
}

/// V − E + F.
pub(crate) fn euler_characteristic(num_vertices: u32, mates: &[u32]) -> i64 {
    let count = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
    let num_open = mates.iter().filter(|m| **m == NO_HALF_EDGE).count();
    let num_edges = (mates.len() + num_open) / 2;
    i64::from(num_vertices) - count(num_edges) + count(mates.len() / 3)
}

fn edge_length(corners_m: &[[Point3<f64>; 3]], half_edge: u32) -> f64 {
    let corners = &corners_m[half_edge as usize / 3];
    let k = half_edge as usize % 3;
    (corners[(k + 1) % 3] - corners[k]).norm()
}

fn fill_holes(corners_m: &mut Vec<[Point3<f64>; 3]>, mates: &mut Vec<u32>) -> usize {
    let loops = boundary_loops(mates);
    if loops.len() < 2 {
        return 0;
    }
    let lengths: Vec<f64> = loops
        .iter()
        .map(|hole| hole.iter().map(|&h| edge_length(corners_m, h)).sum())
        .collect();
    let mut longest = 0;
    for (i, length) in lengths.iter().enumerate() {
        if *length > lengths[longest] {
            longest = i;
        }
    }
    let mut num_filled = 0;
    for (i, hole) in loops.iter().enumerate() {
        if i != longest && lengths[i] <= MAX_FILLED_SHARE * lengths[longest] {
            fill(corners_m, mates, hole);
            num_filled += 1;
        }
    }
    num_filled
}

/// Adds a fan about the centroid of a hole; a hole of two or three sides needs no new vertex.
#[expect(
    clippy::cast_possible_truncation,
    reason = "at most one new triangle per half-edge of a mesh"
)]
fn fill(corners_m: &mut Vec<[Point3<f64>; 3]>, mates: &mut Vec<u32>, hole: &[u32]) {
    let join = |mates: &mut Vec<u32>, a: u32, b: u32| {
        mates[a as usize] = b;
        mates[b as usize] = a;
    };
    let first = mates.len() as u32;
    let start = |h: u32| corners_m[h as usize / 3][h as usize % 3];
    let starts: Vec<Point3<f64>> = hole.iter().map(|&h| start(h)).collect();
    match *hole {
        [a, b] => join(mates, a, b),
        [a, b, c] => {
            mates.extend([NO_HALF_EDGE; 3]);
            for (side, half_edge) in [(0, a), (1, c), (2, b)] {
                join(mates, first + side, half_edge);
            }
            corners_m.push([starts[1], starts[0], starts[2]]);
        }
        _ => {
            let share = 1.0 / hole.len() as f64;
            let center = starts
                .iter()
                .fold(Point3::origin(), |sum, p| sum + p.coords * share);
            let num_sides = hole.len() as u32;
            mates.resize(mates.len() + 3 * hole.len(), NO_HALF_EDGE);
            for (i, &half_edge) in (0..num_sides).zip(hole) {
                let triangle = first + 3 * i;
                let before = first + 3 * ((i + num_sides - 1) % num_sides);
                join(mates, triangle, half_edge);
                join(mates, triangle + 1, before + 2);
                let end = starts[(i as usize + 1) % starts.len()];
                corners_m.push([end, starts[i as usize], center]);
            }
        }
    }
}

/// Cuts mates along the tree–cotree graph, or slits a sphere; returns how many edges were cut.
fn cut(
    corners_m: &[[Point3<f64>; 3]],
    mates: &mut [u32],
    vertices: &[[u32; 3]],
    num_vertices: usize,
) -> usize {
    let graph = VertexGraph::new(corners_m, mates, vertices, num_vertices);
    let mut is_cut = mark_cut(corners_m, mates, &graph);
    let is_closed = mates.iter().all(|mate| *mate != NO_HALF_EDGE);
    if is_closed && num_vertices > 0 && is_cut.iter().all(|c| !c) {
        mark_slit(&graph, 0, &mut is_cut);
    }
    separate(mates, &is_cut)
}

/// Marks the tree–cotree graph: nothing on a disk or a sphere.
fn mark_cut(corners_m: &[[Point3<f64>; 3]], mates: &[u32], graph: &VertexGraph) -> Vec<bool> {
    let mut roots: Vec<usize> = (0_u32..)
        .zip(mates.iter())
        .filter(|(_, mate)| **mate == NO_HALF_EDGE)
        .map(|(h, _)| graph.ends(h)[0])
        .collect();
    if roots.is_empty() && !mates.is_empty() {
        roots.push(0);
    }
    let forest = graph.shortest_paths(&roots);
    let crossed = cotree(corners_m, mates, graph, &forest);
    let mut is_cut = vec![false; mates.len()];
    for (h, &mate) in (0_u32..).zip(mates.iter()) {
        if mate == NO_HALF_EDGE || mate < h || forest.holds(graph, h, mate) {
            continue;
        }
        if !crossed[h as usize] {
            is_cut[h as usize] = true;
            for end in graph.ends(h) {
                forest.mark_path(graph, end, &mut is_cut);
            }
        }
    }
    is_cut
}

/// Marks the path from the vertex farthest from `from` to the one farthest from that.
fn mark_slit(graph: &VertexGraph, from: usize, is_cut: &mut [bool]) {
    let far = graph.shortest_paths(&[from]).farthest();
    let slit = graph.shortest_paths(&[far]);
    slit.mark_path(graph, slit.farthest(), is_cut);
}

/// Parts the marked half-edges from their mates; returns how many edges that were.
fn separate(mates: &mut [u32], is_cut: &[bool]) -> usize {
    let mut num_cut = 0;
    for h in 0..mates.len() {
        if is_cut[h] && mates[h] != NO_HALF_EDGE {
            let mate = mates[h] as usize;
            mates[mate] = NO_HALF_EDGE;
            mates[h] = NO_HALF_EDGE;
            num_cut += 1;
        }
    }
    num_cut
}

/// Per half-edge, whether a spanning tree of the triangles crosses it; edges of the forest are
/// never crossed, those whose loop through the forest is longest come first.
fn cotree(
    corners_m: &[[Point3<f64>; 3]],
    mates: &[u32],
    graph: &VertexGraph,
    forest: &Forest,
) -> Vec<bool> {
    let mut order: Vec<(Reverse<u64>, u32)> = (0_u32..)
        .zip(mates)
        .filter(|&(h, &mate)| mate != NO_HALF_EDGE && h < mate && !forest.holds(graph, h, mate))
        .map(|(h, _)| {
            let ends = graph.ends(h).map(|v| forest.distance[v]);
            let detour = ends[0] + ends[1] + edge_length(corners_m, h);
            (Reverse(detour.to_bits()), h)
        })
        .collect();
    order.sort_unstable();
    let mut set: Vec<u32> = (0_u32..).take(mates.len() / 3).collect();
    let mut crossed = vec![false; mates.len()];
    for (_, h) in order {
        let mate = mates[h as usize];
        let (a, b) = (find(&mut set, h / 3), find(&mut set, mate / 3));
        if a != b {
            set[a.max(b) as usize] = a.min(b);
            crossed[h as usize] = true;
            crossed[mate as usize] = true;
        }
    }
    crossed
}

/// Representative of an element, with path halving.
pub(crate) fn find(set: &mut [u32], mut element: u32) -> u32 {
    while set[element as usize] != element {
        let parent = set[element as usize];
        set[element as usize] = set[parent as usize];
        element = set[element as usize];
    }
    element
}

/// Vertices joined by edges, as compressed rows of (neighbour, half-edge, length).
struct VertexGraph<'a> {
    vertices: &'a [[u32; 3]],
    row_starts: Vec<usize>,
    entries: Vec<(usize, u32, f64)>,
}

impl<'a> VertexGraph<'a> {
    fn new(
        corners_m: &[[Point3<f64>; 3]],
        mates: &[u32],
        vertices: &'a [[u32; 3]],
        num_vertices: usize,
    ) -> Self {
        let mut graph = Self {
            vertices,
            row_starts: vec![0; num_vertices + 1],
            entries: Vec::new(),
        };
        let mut triples = Vec::with_capacity(2 * mates.len());
        for (h, &mate) in (0_u32..).zip(mates) {
            if mate == NO_HALF_EDGE || h < mate {
                let [a, b] = graph.ends(h);
                let length = edge_length(corners_m, h);
                triples.push((a, (b, h, length)));
                triples.push((b, (a, h, length)));
            }
        }
        triples.sort_by_key(|(row, (_, h, _))| (*row, *h));
        for (row, _) in &triples {
            graph.row_starts[row + 1] += 1;
        }
        for row in 0..num_vertices {
            graph.row_starts[row + 1] += graph.row_starts[row];
        }
        graph.entries = triples.into_iter().map(|(_, entry)| entry).collect();
        graph
    }

    fn ends(&self, h: u32) -> [usize; 2] {
        [h, next(h)].map(|h| self.vertices[h as usize / 3][h as usize % 3] as usize)
    }

    fn shortest_paths(&self, roots: &[usize]) -> Forest {
        let num_vertices = self.row_starts.len() - 1;
        let mut forest = Forest {
            distance: vec![f64::MAX; num_vertices],
            parent_edge: vec![NO_HALF_EDGE; num_vertices],
        };
        let mut heap = BinaryHeap::new();
        for &root in roots {
            forest.distance[root] = 0.0;
            heap.push(Reverse((0_u64, root)));
        }
        while let Some(Reverse((bits, vertex))) = heap.pop() {
            let distance = f64::from_bits(bits);
            if distance > forest.distance[vertex] {
                continue;
            }
            let row = self.row_starts[vertex]..self.row_starts[vertex + 1];
            for &(neighbor, h, length) in &self.entries[row] {
                let through = distance + length;
                if through < forest.distance[neighbor] {
                    forest.distance[neighbor] = through;
                    forest.parent_edge[neighbor] = h;
                    heap.push(Reverse((through.to_bits(), neighbor)));
                }
            }
        }
        forest
    }

    /// Marks, for each terminal, the shortest path to `tree` and the paths marked before. A found
    /// path becomes part of the tree at distance 0, and distances only shrink from there.
    fn join_terminals(&self, tree: &[usize], terminals: &[usize], is_cut: &mut [bool]) {
        let num_vertices = self.row_starts.len() - 1;
        let mut is_terminal = vec![false; num_vertices];
        for &terminal in terminals {
            is_terminal[terminal] = true;
        }
        let mut forest = Forest {
            distance: vec![f64::MAX; num_vertices],
            parent_edge: vec![NO_HALF_EDGE; num_vertices],
        };
        let mut heap = BinaryHeap::new();
        for &root in tree {
            forest.distance[root] = 0.0;
            is_terminal[root] = false;
            heap.push(Reverse((0_u64, root)));
        }
        while let Some(Reverse((bits, vertex))) = heap.pop() {
            if f64::from_bits(bits) > forest.distance[vertex] {
                continue;
            }
            if std::mem::replace(&mut is_terminal[vertex], false) {
                let mut at = vertex;
                while forest.parent_edge[at] != NO_HALF_EDGE {
                    let h = std::mem::replace(&mut forest.parent_edge[at], NO_HALF_EDGE);
                    is_cut[h as usize] = true;
                    forest.distance[at] = 0.0;
                    is_terminal[at] = false;
                    heap.push(Reverse((0_u64, at)));
                    let [a, b] = self.ends(h);
                    at = if a == at { b } else { a };
                }
            }
            let distance = forest.distance[vertex];
            let row = self.row_starts[vertex]..self.row_starts[vertex + 1];
            for &(neighbor, h, length) in &self.entries[row] {
                let through = distance + length;
                if through < forest.distance[neighbor] {
                    forest.distance[neighbor] = through;
                    forest.parent_edge[neighbor] = h;
                    heap.push(Reverse((through.to_bits(), neighbor)));
                }
            }
        }
    }
}

/// Shortest paths to the roots: per vertex its distance and the edge towards the root.
struct Forest {
    distance: Vec<f64>,
    parent_edge: Vec<u32>,
}

impl Forest {
    fn holds(&self, graph: &VertexGraph, h: u32, mate: u32) -> bool {
        graph
            .ends(h)
            .iter()
            .any(|&v| self.parent_edge[v] == h || self.parent_edge[v] == mate)
    }

    fn farthest(&self) -> usize {
        let mut farthest = 0;
        for (vertex, distance) in self.distance.iter().enumerate() {
            if *distance > self.distance[farthest] && *distance < f64::MAX {
                farthest = vertex;
            }
        }
        farthest
    }

    fn mark_path(&self, graph: &VertexGraph, mut vertex: usize, is_cut: &mut [bool]) {
        while self.parent_edge[vertex] != NO_HALF_EDGE {
            let h = self.parent_edge[vertex];
            if std::mem::replace(&mut is_cut[h as usize], true) {
                break;
            }
            let [a, b] = graph.ends(h);
            vertex = if a == vertex { b } else { a };
        }
    }
}
