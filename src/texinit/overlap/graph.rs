//! Which triangles of a chart meet: by the edges that they share, and as lists of neighbours.

use super::detect::PlaneTriangles;

/// Triangles grouped by the edge that they share.
pub(super) struct SharedEdges {
    triangles: Vec<u32>,
    start: Vec<usize>,
}

/// All pairs of a group are adjacent up to this size, then only consecutive ones.
const MAX_FULL_GROUP: usize = 4;

impl SharedEdges {
    /// Edges of the plane: both ends in common, bit for bit. A cut of the surface is a boundary.
    pub(super) fn in_plane(corners_m: &[[[f64; 2]; 3]]) -> Self {
        // Adding zero makes −0 and 0 the same.
        let bits = |p: [f64; 2]| p.map(|v| (v + 0.0).to_bits());
        Self::of(corners_m.iter().map(|corners| corners.map(bits)))
    }

    /// Edges between vertices, three per triangle. A vertex named twice makes no edge of its own.
    pub(super) fn of<V: Ord + Copy>(triangles: impl ExactSizeIterator<Item = [V; 3]>) -> Self {
        let mut edges: Vec<([V; 2], u32)> = Vec::with_capacity(triangles.len() * 3);
        for ([a, b, c], id) in triangles.zip(0u32..) {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                edges.push(([p.min(q), p.max(q)], id));
            }
        }
        edges.sort_unstable();
        edges.dedup();
        let mut start = vec![0];
        for (k, pair) in (1..).zip(edges.windows(2)) {
            if pair[0].0 != pair[1].0 {
                start.push(k);
            }
        }
        start.push(edges.len());
        Self {
            triangles: edges.into_iter().map(|(_, id)| id).collect(),
            start,
        }
    }

    fn groups(&self) -> impl Iterator<Item = &[u32]> {
        self.start
            .windows(2)
            .map(|range| &self.triangles[range[0]..range[1]])
    }

    /// Pairs on either side of an edge, lower index first, in order; a pair that also overlaps is
    /// not adjacent.
    pub(super) fn adjacent_pairs(&self, layer: &PlaneTriangles) -> Vec<[u32; 2]> {
        let mut pairs = Vec::new();
        for group in self.groups() {
            let reach = if group.len() <= MAX_FULL_GROUP {
                group.len()
            } else {
                2
            };
            for (k, &first) in group.iter().enumerate() {
                let others = group.iter().skip(k + 1).take(reach - 1);
                pairs.extend(others.map(|&second| [first, second]));
            }
        }
        pairs.retain(|&[a, b]| !layer.overlap(a as usize, b as usize));
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }

    /// A number per triangle, the same for those of one plane that hang together by edges: the
    /// first triangle among them.
    pub(super) fn connected(&self, planes: &[u32]) -> Vec<usize> {
        let mut parents: Vec<usize> = (0..planes.len()).collect();
        let mut group_by_plane = Vec::new();
        for group in self.groups().filter(|group| group.len() > 1) {
            group_by_plane.clear();
            group_by_plane.extend(group.iter().map(|&t| (planes[t as usize], t as usize)));
            group_by_plane.sort_unstable();
            for pair in group_by_plane.windows(2) {
                if pair[0].0 == pair[1].0 {
                    join(&mut parents, pair[0].1, pair[1].1);
                }
            }
        }
        (0..planes.len()).map(|t| root(&mut parents, t)).collect()
    }
}

/// The representative of a node's set, paths halved on the way.
pub(super) fn root(parents: &mut [usize], mut node: usize) -> usize {
    while parents[node] != node {
        parents[node] = parents[parents[node]];
        node = parents[node];
    }
    node
}

/// Joins two sets under the smaller representative.
pub(super) fn join(parents: &mut [usize], first: usize, second: usize) {
    let roots = [root(parents, first), root(parents, second)];
    parents[roots[0].max(roots[1])] = roots[0].min(roots[1]);
}

/// Per triangle: the other ends of its pairs.
pub(super) struct Neighbours {
    start: Vec<usize>,
    others: Vec<u32>,
}

impl Neighbours {
    pub(super) fn new(num_triangles: usize, pairs: &[[u32; 2]]) -> Self {
        let mut start = vec![0; num_triangles + 1];
        for &triangle in pairs.iter().flatten() {
            start[triangle as usize + 1] += 1;
        }
        for k in 1..start.len() {
            start[k] += start[k - 1];
        }
        let mut next = start.clone();
        let mut others = vec![0; pairs.len() * 2];
        for &[a, b] in pairs {
            for (from, to) in [(a, b), (b, a)] {
                others[next[from as usize]] = to;
                next[from as usize] += 1;
            }
        }
        Self { start, others }
    }

    /// How many triangles there are.
    pub(super) fn len(&self) -> usize {
        self.start.len() - 1
    }

    pub(super) fn of(&self, triangle: usize) -> impl Iterator<Item = usize> {
        let range = self.start[triangle]..self.start[triangle + 1];
        self.others[range].iter().map(|&t| t as usize)
    }

    /// All triangles, each component from its first one outwards.
    pub(super) fn breadth_first(&self) -> Vec<usize> {
        let mut is_reached = vec![false; self.len()];
        let mut order = Vec::with_capacity(self.len());
        for seed in 0..self.len() {
            if std::mem::replace(&mut is_reached[seed], true) {
                continue;
            }
            let mut next = order.len();
            order.push(seed);
            while let Some(&triangle) = order.get(next) {
                next += 1;
                for other in self.of(triangle) {
                    if !std::mem::replace(&mut is_reached[other], true) {
                        order.push(other);
                    }
                }
            }
        }
        order
    }
}
