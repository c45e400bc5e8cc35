//! Harmonic colours on a mesh: each free vertex becomes the mean of its neighbours, weighted by
//! the inverse length of the edge between them, while vertices with a colour keep it.
//!
//! The weights are positive, so no colour leaves the range of those given (the maximum principle);
//! on a surface flat and regular it is linear interpolation. Started ring by ring from the given
//! colours, then over-relaxed in that order and back, each connected region by itself until it has
//! converged; enough for a smooth blend, near convergence for regions of some dozens of rings. What lies
//! further in is smoothed a little and no more: nobody knows what is there.
//! Each region in a fixed order that goes by position: it comes out alike whatever else there is.

use rayon::prelude::*;

use super::{FillParams, Surface};
use crate::mesh::{TriMesh, TriangleId};

/// Change of a linear colour in one sweep below which sweeping stops: under a tenth of a byte.
const CONVERGED: f32 = 2e-4;

/// Rings from the given colours on that are swept until they have converged.
const NEAR_RINGS: usize = 12;
/// Sweeps of all rings before that.
const FAR_SWEEPS: usize = 12;

/// Edges shorter than this count as this long.
const MIN_EDGE_M: f64 = 1e-6;

const ABSENT: u32 = u32::MAX;

/// Numbers of vertices of a mesh in a part of it; those of all others are [`ABSENT`].
#[derive(Debug, Default)]
pub(super) struct VertexNumbers(Vec<u32>);

/// Vertices of a part of the surface; those of equal position are one.
pub(super) struct SurfaceVertices<'a> {
    surface: &'a Surface<'a>,
    numbers: VertexNumbers,
    /// Triangles of the part.
    triangles: Vec<TriangleId>,
    /// Per vertex: the one of the mesh that stands for it.
    of_mesh: Vec<u32>,
}

impl<'a> SurfaceVertices<'a> {
    /// Those of some triangles. They are numbered by position, so that neither the order of the mesh nor
    /// what else there is shows in the result. `numbers` are of no vertex.
    pub(super) fn of(
        surface: &'a Surface<'a>,
        triangles: Vec<TriangleId>,
        mut numbers: VertexNumbers,
    ) -> Self {
        let mut members: Vec<u32> = triangles
            .iter()
            .flat_map(|triangle| surface.corners(*triangle))
            .collect();
        members.sort_unstable();
        members.dedup();
        let positions_m = surface.mesh.positions_m();
        let mut by_position: Vec<([u64; 3], u32)> = members
            .iter()
            .map(|&vertex| {
                let position = positions_m[vertex as usize];
                ([0, 1, 2].map(|axis| in_order(position[axis])), vertex)
            })
            .collect();
        by_position.sort_unstable();
        numbers.0.resize(positions_m.len(), ABSENT);
        for (number, &(_, vertex)) in (0_u32..).zip(&by_position) {
            numbers.0[vertex as usize] = number;
        }
        Self {
            surface,
            numbers,
            triangles,
            of_mesh: by_position.into_iter().map(|(_, vertex)| vertex).collect(),
        }
    }

    /// The numbers, again of no vertex.
    pub(super) fn into_numbers(mut self) -> VertexNumbers {
        for &vertex in &self.of_mesh {
            self.numbers.0[vertex as usize] = ABSENT;
        }
        self.numbers
    }

    pub(super) fn len(&self) -> usize {
        self.of_mesh.len()
    }

    /// Per vertex: the one of the mesh that stands for it.
    pub(super) fn of_mesh(&self) -> &[u32] {
        &self.of_mesh
    }

    pub(super) fn of_triangle(&self, triangle: TriangleId) -> [Option<usize>; 3] {
        self.at_corners(triangle)
            .map(|vertex| (vertex != ABSENT).then_some(vertex as usize))
    }

    /// The vertices of a triangle, or [`ABSENT`].
    fn at_corners(&self, triangle: TriangleId) -> [u32; 3] {
        let corners = self.surface.corners(triangle);
        corners.map(|vertex| self.numbers.0[vertex as usize])
    }
}

/// A number that goes up with the value; −0 is 0.
fn in_order(value: f64) -> u64 {
    const SIGN: u64 = 1 << 63;
    let bits = (value + 0.0).to_bits();
    if bits & SIGN == 0 { bits | SIGN } else { !bits }
}

/// Rings from the given colours on that are not far.
const EXACT_RINGS: usize = 8;

/// Colours of all vertices.
pub(super) struct Diffused {
    /// Per vertex; none where no given colour is connected.
    pub(super) linear: Vec<Option<[f64; 3]>>,
    /// Per vertex: whether so many rings lie between it and the given colours that its own is a guess.
    pub(super) is_far: Vec<bool>,
    pub(super) num_diffused: usize,
    pub(super) num_sweeps: usize,
}

pub(super) fn diffuse(
    surface: &Surface<'_>,
    vertices: &SurfaceVertices<'_>,
    given: Vec<Option<[f64; 3]>>,
    params: &FillParams,
) -> Diffused {
    let graph = Graph::new(surface.mesh, vertices, &given);
    let mut linear = given;
    let rings = spread(&graph, &mut linear);
    let num_sweeps = relax(&graph, &rings, &mut linear, params);
    let mut is_far = vec![false; linear.len()];
    for &vertex in rings.iter().skip(EXACT_RINGS).flatten() {
        is_far[vertex] = true;
    }
    Diffused {
        linear,
        is_far,
        num_diffused: rings.iter().map(Vec::len).sum(),
        num_sweeps,
    }
}

/// Per free vertex: its neighbours with the weights of the edges to them.
struct Graph {
    start: Vec<usize>,
    neighbours: Vec<(u32, f64)>,
}

impl Graph {
    fn new(mesh: &TriMesh, vertices: &SurfaceVertices<'_>, given: &[Option<[f64; 3]>]) -> Self {
        // An edge is met once from each of its triangles; of equal ones the first weight counts.
        let is_free = |vertex: u32| given[vertex as usize].is_none();
        let sides = || {
            vertices.triangles.iter().flat_map(|&triangle| {
                let ids = vertices.at_corners(triangle);
                (0..3).map(move |k| (triangle, k, ids[k], ids[(k + 1) % 3]))
            })
        };
        let mut next = vec![0; vertices.len() + 1];
        for (_, _, from, to) in sides().filter(|(_, _, from, to)| from != to) {
            for vertex in [from, to].into_iter().filter(|&vertex| is_free(vertex)) {
                next[vertex as usize + 1] += 1;
            }
        }
        for k in 1..next.len() {
            next[k] += next[k - 1];
        }
        let met_from = next.clone();
        let mut met = vec![(ABSENT, 0.0); next[vertices.len()]];
        for (triangle, k, from, to) in sides().filter(|(_, _, from, to)| from != to) {
            let corners = mesh.corners_m(triangle);
            let length_m = (corners[(k + 1) % 3] - corners[k]).norm();
            let weight = 1.0 / length_m.max(MIN_EDGE_M);
            for (from, to) in [(from, to), (to, from)] {
                if is_free(from) {
                    let place = &mut next[from as usize];
                    met[*place] = (to, weight);
                    *place += 1;
                }
            }
        }
        let mut graph = Self {
            start: Vec::with_capacity(met_from.len()),
            neighbours: Vec::with_capacity(met.len()),
        };
        for ends in met_from.windows(2) {
            let of_vertex = &mut met[ends[0]..ends[1]];
            of_vertex.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
            graph.start.push(graph.neighbours.len());
            let chunks = of_vertex.chunk_by(|a, b| a.0 == b.0);
            graph.neighbours.extend(chunks.map(|same| same[0]));
        }
        graph.start.push(graph.neighbours.len());
        graph
    }

    fn of(&self, vertex: usize) -> &[(u32, f64)] {
        &self.neighbours[self.start[vertex]..self.start[vertex + 1]]
    }

    /// Weighted mean of the neighbours that have a colour.
    fn mean(&self, vertex: usize, linear: &[Option<[f64; 3]>]) -> Option<[f64; 3]> {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for &(neighbour, weight) in self.of(vertex) {
            if let Some(colour) = linear[neighbour as usize] {
                for (sum, channel) in sum.iter_mut().zip(colour) {
                    *sum += weight * channel;
                }
                total += weight;
            }
        }
        (total > 0.0).then(|| sum.map(|channel| channel / total))
    }
}

/// Colours free vertices from the given ones outwards, each ring from the rings before it; returns
/// the rings.
fn spread(graph: &Graph, linear: &mut [Option<[f64; 3]>]) -> Vec<Vec<usize>> {
    let is_free: Vec<bool> = linear.iter().map(Option::is_none).collect();
    let mut is_reached: Vec<bool> = is_free.iter().map(|free| !free).collect();
    let mut ring: Vec<usize> = (0..linear.len())
        .filter(|&v| is_free[v] && graph.of(v).iter().any(|(n, _)| !is_free[*n as usize]))
        .collect();
    for &vertex in &ring {
        is_reached[vertex] = true;
    }
    let mut rings = Vec::new();
    while !ring.is_empty() {
        let means: Vec<_> = ring.iter().map(|&v| graph.mean(v, linear)).collect();
        let mut next = Vec::new();
        for (&vertex, mean) in ring.iter().zip(means) {
            linear[vertex] = mean;
            for &(neighbour, _) in graph.of(vertex) {
                if !std::mem::replace(&mut is_reached[neighbour as usize], true) {
                    next.push(neighbour as usize);
                }
            }
        }
        rings.push(std::mem::replace(&mut ring, next));
    }
    rings
}

/// Successive over-relaxation, forth and back in turn, of each region of connected free vertices
/// until it has converged; returns the largest number of sweeps.
fn relax(
    graph: &Graph,
    rings: &[Vec<usize>],
    linear: &mut [Option<[f64; 3]>],
    params: &FillParams,
) -> usize {
    let order: Vec<usize> = rings.iter().flatten().copied().collect();
    let mut ring_of = vec![0; linear.len()];
    for (number, ring) in rings.iter().enumerate() {
        for &vertex in ring {
            ring_of[vertex] = number;
        }
    }
    let mut place_of = vec![ABSENT; linear.len()];
    let regions = regions(graph, &order, linear.len());
    let mut systems: Vec<System> = regions
        .iter()
        .map(|region| System::new(graph, region, linear, &mut place_of, params.over_relaxation))
        .collect();
    let regions_and_systems = regions.par_iter().zip(&mut systems);
    let num_sweeps: Vec<usize> = regions_and_systems
        .map(|(region, system)| {
            // The region goes by rings, as its vertices do in all.
            let num_near = region.partition_point(|&vertex| ring_of[vertex] < NEAR_RINGS);
            system.solve(num_near, params.max_sweeps)
        })
        .collect();
    for (region, system) in regions.iter().zip(&systems) {
        for (&vertex, [r, g, b, _]) in region.iter().zip(&system.values) {
            linear[vertex] = Some([*r, *g, *b].map(f64::from));
        }
    }
    num_sweeps.into_iter().max().unwrap_or(0)
}

/// The free vertices that are connected by edges between them, each region in the given order.
fn regions(graph: &Graph, order: &[usize], num_vertices: usize) -> Vec<Vec<usize>> {
    const GIVEN: usize = usize::MAX;
    const UNREACHED: usize = usize::MAX - 1;
    let mut region_of = vec![GIVEN; num_vertices];
    for &vertex in order {
        region_of[vertex] = UNREACHED;
    }
    let mut num_regions = 0;
    for &seed in order {
        if region_of[seed] != UNREACHED {
            continue;
        }
        region_of[seed] = num_regions;
        let mut front = vec![seed];
        while let Some(vertex) = front.pop() {
            for &(neighbour, _) in graph.of(vertex) {
                let region = &mut region_of[neighbour as usize];
                if *region == UNREACHED {
                    *region = num_regions;
                    front.push(neighbour as usize);
                }
            }
        }
        num_regions += 1;
    }
    let mut regions = vec![Vec::new(); num_regions];
    for &vertex in order {
        regions[region_of[vertex]].push(vertex);
    }
    regions
}

/// A linear colour, padded so that all of it is worked on at once.
type Colour = [f32; 4];

/// The free vertices in their order, then the given ones, close together for sweeping. In `f32`, whose
/// rounding is far below [`CONVERGED`].
struct System {
    values: Vec<Colour>,
    start: Vec<u32>,
    /// Place of the neighbour and its share of the mean.
    shares: Vec<(u32, f32)>,
    low: Colour,
    high: Colour,
    over_relaxation: f32,
}

impl System {
    /// `place_of` is [`ABSENT`] for all vertices, and is so again afterwards.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "rounding to f32 is meant; a mesh has 32 bits of sides"
    )]
    fn new(
        graph: &Graph,
        order: &[usize],
        linear: &[Option<[f64; 3]>],
        place_of: &mut [u32],
        over_relaxation: f64,
    ) -> Self {
        let mut values = Vec::with_capacity(order.len());
        let mut placed = Vec::with_capacity(order.len());
        let mut place = |vertex: usize| {
            let slot = &mut place_of[vertex];
            if *slot == ABSENT {
                *slot = values.len() as u32;
                let [r, g, b] = linear[vertex].unwrap_or_default().map(|value| value as f32);
                values.push([r, g, b, 0.0]);
                placed.push(vertex);
            }
            *slot
        };
        for &vertex in order {
            place(vertex);
        }
        let mut start = Vec::with_capacity(order.len() + 1);
        start.push(0);
        let mut shares = Vec::new();
        for &vertex in order {
            let neighbours = graph.of(vertex);
            let total: f64 = neighbours.iter().map(|(_, weight)| weight).sum();
            let share = |&(to, weight): &(u32, f64)| (place(to as usize), (weight / total) as f32);
            shares.extend(neighbours.iter().map(share));
            start.push(shares.len() as u32);
        }
        for vertex in placed {
            place_of[vertex] = ABSENT;
        }
        let (mut low, mut high) = ([f32::INFINITY; 4], [f32::NEG_INFINITY; 4]);
        for value in &values {
            for k in 0..4 {
                low[k] = low[k].min(value[k]);
                high[k] = high[k].max(value[k]);
            }
        }
        Self {
            values,
            start,
            shares,
            low,
            high,
            over_relaxation: over_relaxation as f32,
        }
    }

    /// Sweeps until the first `num_near` vertices have converged, [`FAR_SWEEPS`] times over the others at most;
    /// returns the number of sweeps.
    fn solve(&mut self, num_near: usize, max_sweeps: usize) -> usize {
        let num_free = self.start.len() - 1;
        for number in 0..max_sweeps {
            let num_swept = match number < FAR_SWEEPS {
                true => num_free,
                false => num_near,
            };
            if self.sweep(num_swept, number % 2 == 1) < CONVERGED {
                return number + 1;
            }
        }
        max_sweeps
    }

    /// Relaxes the first of the free vertices once; returns the largest change.
    fn sweep(&mut self, num_free: usize, is_backward: bool) -> f32 {
        let mut largest_change = [0.0_f32; 4];
        for step in 0..num_free {
            let vertex = if is_backward {
                num_free - 1 - step
            } else {
                step
            };
            let mut mean = [0.0_f32; 4];
            let of_vertex = self.start[vertex] as usize..self.start[vertex + 1] as usize;
            for &(neighbour, share) in &self.shares[of_vertex] {
                let value = self.values[neighbour as usize];
                for k in 0..4 {
                    mean[k] += share * value[k];
                }
            }
            let value = &mut self.values[vertex];
            for k in 0..4 {
                // Over-relaxing may overshoot the range, which the solution never leaves.
                let relaxed = value[k] + self.over_relaxation * (mean[k] - value[k]);
                let relaxed = relaxed.max(self.low[k]).min(self.high[k]);
                largest_change[k] = largest_change[k].max((relaxed - value[k]).abs());
                value[k] = relaxed;
            }
        }
        largest_change.into_iter().fold(0.0, f32::max)
    }
}
