//! Which triangles meet at which edge.
//!
//! A *half-edge* `3 t + k` is the side of triangle `t` from its corner `k` to its corner
//! `(k + 1) % 3`. [`EdgeTable`] groups the half-edges of each undirected edge, in any soup. What a
//! manifold mesh has beyond that are *mates*: per half-edge the one across it, or
//! [`NO_HALF_EDGE`]; mates run in opposite directions. The functions here walk mates.

use super::tri_mesh::MeshError;

/// No half-edge: the other side of a boundary.
pub const NO_HALF_EDGE: u32 = u32::MAX;

/// The next half-edge in the same triangle.
pub const fn next(half_edge: u32) -> u32 {
    if half_edge % 3 == 2 {
        half_edge - 2
    } else {
        half_edge + 1
    }
}

/// The previous half-edge in the same triangle.
pub const fn previous(half_edge: u32) -> u32 {
    if half_edge.is_multiple_of(3) {
        half_edge + 2
    } else {
        half_edge - 1
    }
}

/// The half-edges of each undirected edge, edges sorted by (smaller, larger) vertex and the
/// half-edges of one edge ascending. Sides that join a vertex to itself are left out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EdgeTable {
    half_edges: Vec<u32>,
    edge_starts: Vec<u32>,
}

impl EdgeTable {
    /// The edges of `triangles`, whose indices are all below `num_vertices`. O(n).
    ///
    /// # Errors
    /// [`MeshError`] when 32 bits cannot number the half-edges or an index is out of range.
    pub fn new(triangles: &[[u32; 3]], num_vertices: usize) -> Result<Self, MeshError> {
        check_sizes(triangles, num_vertices)?;
        // A counting sort by the smaller vertex, then short sorts within its bucket.
        let mut bucket_starts = vec![0_u32; num_vertices + 1];
        for (_, low, _) in sides(triangles) {
            bucket_starts[low as usize + 1] += 1;
        }
        for v in 0..num_vertices {
            bucket_starts[v + 1] += bucket_starts[v];
        }
        let num_sides = bucket_starts[num_vertices] as usize;
        let mut cursor = bucket_starts.clone();
        let mut sorted = vec![(0_u32, 0_u32); num_sides];
        for (half_edge, low, high) in sides(triangles) {
            let slot = &mut cursor[low as usize];
            sorted[*slot as usize] = (high, half_edge);
            *slot += 1;
        }
        let mut edge_starts = Vec::with_capacity(num_sides / 2 + 1);
        for range in bucket_starts.windows(2) {
            let bucket = &mut sorted[range[0] as usize..range[1] as usize];
            bucket.sort_unstable();
            let mut start = range[0];
            for edge in bucket.chunk_by(|a, b| a.0 == b.0) {
                edge_starts.push(start);
                #[expect(clippy::cast_possible_truncation, reason = "at most num_sides")]
                {
                    start += edge.len() as u32;
                }
            }
        }
        edge_starts.push(bucket_starts[num_vertices]);
        Ok(Self {
            half_edges: sorted.into_iter().map(|(_, h)| h).collect(),
            edge_starts,
        })
    }

    /// How many undirected edges there are.
    pub fn num_edges(&self) -> usize {
        self.edge_starts.len() - 1
    }

    /// The half-edges of each edge.
    pub fn edges(&self) -> impl Iterator<Item = &[u32]> {
        self.edge_starts
            .windows(2)
            .map(|range| &self.half_edges[range[0] as usize..range[1] as usize])
    }
}

fn check_sizes(triangles: &[[u32; 3]], num_vertices: usize) -> Result<(), MeshError> {
    if triangles.len() >= (u32::MAX / 3) as usize || num_vertices >= u32::MAX as usize {
        return Err(MeshError::TooLarge {
            num_vertices,
            num_triangles: triangles.len(),
        });
    }
    for (triangle, corners) in triangles.iter().enumerate() {
        if let Some(&index) = corners.iter().find(|&&v| v as usize >= num_vertices) {
            return Err(MeshError::IndexOutOfRange {
                triangle,
                index: i64::from(index),
                num_vertices,
            });
        }
    }
    Ok(())
}

/// (half-edge, smaller vertex, larger vertex) of each side with two different ends.
fn sides(triangles: &[[u32; 3]]) -> impl Iterator<Item = (u32, u32, u32)> {
    (0..)
        .step_by(3)
        .zip(triangles)
        .flat_map(|(first, &[a, b, c])| {
            [(first, a, b), (first + 1, b, c), (first + 2, c, a)]
                .into_iter()
                .filter(|(_, start, end)| start != end)
                .map(|(h, start, end)| (h, start.min(end), start.max(end)))
        })
}

/// Numbers the vertices that mates make: corners belong to one vertex where they meet across
/// shared edges, so that each vertex has one fan or one cycle of triangles. Returns the vertex of
/// each corner and the number of vertices; numbered by first corner.
pub fn vertices_of_corners(mates: &[u32]) -> (Vec<[u32; 3]>, u32) {
    let mut vertex_of_corner = vec![[u32::MAX; 3]; mates.len() / 3];
    let mut num_vertices = 0;
    let slot = |h: u32| (h as usize / 3, h as usize % 3);
    for corner in (0_u32..).take(mates.len()) {
        let (t, k) = slot(corner);
        if vertex_of_corner[t][k] != u32::MAX {
            continue;
        }
        let mut at = corner;
        let closes = loop {
            let (t, k) = slot(at);
            vertex_of_corner[t][k] = num_vertices;
            at = mates[previous(at) as usize];
            if at == NO_HALF_EDGE || at == corner {
                break at == corner;
            }
        };
        let mut across = if closes {
            NO_HALF_EDGE
        } else {
            mates[corner as usize]
        };
        while across != NO_HALF_EDGE {
            let (t, k) = slot(next(across));
            vertex_of_corner[t][k] = num_vertices;
            across = mates[next(across) as usize];
        }
        num_vertices += 1;
    }
    (vertex_of_corner, num_vertices)
}

/// The boundary loops that mates leave, each as consecutive half-edges with the surface on their
/// left, in the order of their smallest half-edge.
pub fn boundary_loops(mates: &[u32]) -> Vec<Vec<u32>> {
    let mut is_visited = vec![false; mates.len()];
    let mut loops = Vec::new();
    for first in (0_u32..).take(mates.len()) {
        if mates[first as usize] != NO_HALF_EDGE || is_visited[first as usize] {
            continue;
        }
        let mut boundary = Vec::new();
        let mut at = first;
        while !is_visited[at as usize] {
            is_visited[at as usize] = true;
            boundary.push(at);
            at = next(at);
            while mates[at as usize] != NO_HALF_EDGE {
                at = next(mates[at as usize]);
            }
        }
        loops.push(boundary);
    }
    loops
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fan_of_three_faces_on_one_edge_is_one_group() {
        let triangles = [[0, 1, 2], [1, 0, 3], [0, 1, 4], [5, 5, 0]];
        let table = EdgeTable::new(&triangles, 6).unwrap();
        let groups: Vec<&[u32]> = table.edges().collect();
        assert_eq!(groups[0], &[0, 3, 6]);
        // Seven edges of the three faces, and 0–5 twice by the collapsed one.
        assert_eq!(table.num_edges(), 8);
        assert_eq!(groups.iter().map(|g| g.len()).sum::<usize>(), 11);
    }

    #[test]
    fn an_index_out_of_range_is_refused() {
        assert!(EdgeTable::new(&[[0, 1, 7]], 3).is_err());
    }

    #[test]
    fn a_square_has_four_vertices_and_one_loop() {
        let mates = [NO_HALF_EDGE, NO_HALF_EDGE, 3, 2, NO_HALF_EDGE, NO_HALF_EDGE];
        let (vertices, num_vertices) = vertices_of_corners(&mates);
        assert_eq!(num_vertices, 4);
        assert_eq!(vertices[0][0], vertices[1][0]);
        assert_eq!(vertices[0][2], vertices[1][1]);
        assert_eq!(boundary_loops(&mates), vec![vec![0, 1, 4, 5]]);
    }
}
