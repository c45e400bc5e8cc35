//! From overlapping pairs to connected pieces without overlap: the field of Eq. MRFPlane, its
//! guarantee, and region growing beside it.
//!
//! Adjacency is that of the plane: triangles that have both ends of an edge in common, bit for
//! bit. A cut of the surface is therefore a boundary, and a piece can be moved as it lies.

use std::collections::VecDeque;

use super::OverlapParams;
use super::detect::PlaneTriangles;
use super::mplp::{self, PottsEdge, PottsField, Preference};

type Point = [f64; 2];

/// What gave the pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PieceMethod {
    /// Planes of the Markov random field.
    Field,
    /// Region growing.
    Growing,
}

/// A chart's triangles in pieces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Pieces {
    /// Per piece, ordered by its first triangle: its triangles, ascending.
    pub(super) members: Vec<Vec<usize>>,
    /// What gave them.
    pub(super) method: PieceMethod,
    /// Whether the field was too large to be set up.
    pub(super) is_crowded: bool,
    /// Triangles that the guarantee moved to another plane.
    pub(super) num_moved_triangles: usize,
}

/// Separates a chart whose overlapping pairs are known, or are too many to know (`None`).
pub(super) fn pieces(
    corners_m: &[[Point; 3]],
    layer: &PlaneTriangles,
    pairs: Option<&[[u32; 2]]>,
    params: &OverlapParams,
) -> Pieces {
    let shared = SharedEdges::new(corners_m);
    let adjacency = Neighbours::new(corners_m.len(), &shared.adjacent_pairs(layer));
    let order = breadth_first(&adjacency);
    let grown = |is_crowded, num_moved_triangles| Pieces {
        members: grow(&order, &adjacency, layer),
        method: PieceMethod::Growing,
        is_crowded,
        num_moved_triangles,
    };
    let Some(pairs) = pairs else {
        return grown(true, 0);
    };
    let overlaps = Neighbours::new(corners_m.len(), pairs);
    let Some(mut planes) = planes_by_field(&order, &adjacency, &overlaps, pairs, params) else {
        return grown(true, 0);
    };
    let num_moved_triangles = move_to_free_planes(&mut planes, &adjacency, &overlaps, pairs);
    let by_field = Pieces {
        members: shared.connected(&planes),
        method: PieceMethod::Field,
        is_crowded: false,
        num_moved_triangles,
    };
    if params.try_growing {
        let grown = grown(false, num_moved_triangles);
        if grown.members.len() < by_field.members.len() {
            return grown;
        }
    }
    by_field
}

/// Triangles grouped by the edge that they share.
struct SharedEdges {
    triangles: Vec<u32>,
    start: Vec<usize>,
}

/// All pairs of a group are adjacent up to this size, then only consecutive ones.
const MAX_FULL_GROUP: usize = 4;

impl SharedEdges {
    fn new(corners_m: &[[Point; 3]]) -> Self {
        // Adding zero makes −0 and 0 the same.
        let bits = |p: Point| p.map(|v| (v + 0.0).to_bits());
        let mut edges: Vec<([[u64; 2]; 2], u32)> = Vec::with_capacity(corners_m.len() * 3);
        for (corners, id) in corners_m.iter().zip(0u32..) {
            let [a, b, c] = corners.map(bits);
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

    /// Pairs on either side of an edge; a pair that also overlaps is not adjacent.
    fn adjacent_pairs(&self, layer: &PlaneTriangles) -> Vec<[u32; 2]> {
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

    /// Triangles of one plane that hang together by edges.
    fn connected(&self, planes: &[u32]) -> Vec<Vec<usize>> {
        let mut parents: Vec<usize> = (0..planes.len()).collect();
        let mut group_by_plane = Vec::new();
        for group in self.groups().filter(|group| group.len() > 1) {
            group_by_plane.clear();
            group_by_plane.extend(group.iter().map(|&t| (planes[t as usize], t as usize)));
            group_by_plane.sort_unstable();
            for pair in group_by_plane.windows(2) {
                if pair[0].0 == pair[1].0 {
                    let roots = [root(&mut parents, pair[0].1), root(&mut parents, pair[1].1)];
                    parents[roots[0].max(roots[1])] = roots[0].min(roots[1]);
                }
            }
        }
        let piece_of: Vec<usize> = (0..planes.len()).map(|t| root(&mut parents, t)).collect();
        members_by_piece(&piece_of)
    }
}

fn root(parents: &mut [usize], mut node: usize) -> usize {
    while parents[node] != node {
        parents[node] = parents[parents[node]];
        node = parents[node];
    }
    node
}

/// Pieces ordered by their first triangle, from a piece number < triangle count per triangle.
fn members_by_piece(piece_of: &[usize]) -> Vec<Vec<usize>> {
    let mut rank_of = vec![usize::MAX; piece_of.len()];
    let mut members: Vec<Vec<usize>> = Vec::new();
    for (triangle, &piece) in piece_of.iter().enumerate() {
        if rank_of[piece] == usize::MAX {
            rank_of[piece] = members.len();
            members.push(Vec::new());
        }
        members[rank_of[piece]].push(triangle);
    }
    members
}

/// Per triangle: the other ends of its pairs.
struct Neighbours {
    start: Vec<usize>,
    others: Vec<u32>,
}

impl Neighbours {
    fn new(num_triangles: usize, pairs: &[[u32; 2]]) -> Self {
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

    fn len(&self) -> usize {
        self.start.len() - 1
    }

    fn of(&self, triangle: usize) -> impl Iterator<Item = usize> {
        let range = self.start[triangle]..self.start[triangle + 1];
        self.others[range].iter().map(|&t| t as usize)
    }
}

/// All triangles, each component from its first one outwards.
fn breadth_first(adjacency: &Neighbours) -> Vec<usize> {
    let mut is_reached = vec![false; adjacency.len()];
    let mut order = Vec::with_capacity(adjacency.len());
    for seed in 0..adjacency.len() {
        if std::mem::replace(&mut is_reached[seed], true) {
            continue;
        }
        let mut next = order.len();
        order.push(seed);
        while let Some(&triangle) = order.get(next) {
            next += 1;
            for other in adjacency.of(triangle) {
                if !std::mem::replace(&mut is_reached[other], true) {
                    order.push(other);
                }
            }
        }
    }
    order
}

/// The smallest plane that is not among those taken.
fn smallest_free(taken: &mut Vec<u32>) -> u32 {
    taken.sort_unstable();
    taken.dedup();
    (0u32..)
        .zip(taken.iter())
        .find(|(plane, used)| plane != *used)
        .map_or_else(
            || u32::try_from(taken.len()).unwrap_or(u32::MAX),
            |(p, _)| p,
        )
}

/// Each triangle's first plane where it overlaps none of those before it in the order.
fn first_fit(order: &[usize], overlaps: &Neighbours) -> Vec<u32> {
    let mut planes = vec![u32::MAX; overlaps.len()];
    let mut taken = Vec::new();
    for &triangle in order {
        taken.clear();
        let assigned = overlaps.of(triangle).map(|t| planes[t]);
        taken.extend(assigned.filter(|&plane| plane != u32::MAX));
        planes[triangle] = smallest_free(&mut taken);
    }
    planes
}

/// The field's planes; nothing when it would take too many messages.
fn planes_by_field(
    order: &[usize],
    adjacency: &Neighbours,
    overlaps: &Neighbours,
    overlapping_pairs: &[[u32; 2]],
    params: &OverlapParams,
) -> Option<Vec<u32>> {
    let preferred = first_fit(order, overlaps);
    let num_planes = preferred.iter().max().map_or(1, |&p| p as usize + 1);
    let num_labels = num_planes.min(params.max_planes.max(2));
    let num_edges = adjacency.others.len() / 2 + overlapping_pairs.len();
    if num_edges.saturating_mul(2 * num_labels) > params.max_messages {
        return None;
    }
    let mut unary = vec![0.0; preferred.len() * num_labels];
    for (triangle, &plane) in preferred.iter().enumerate() {
        let label = (plane as usize).min(num_labels - 1);
        unary[triangle * num_labels + label] = params.unary_reward;
    }
    let mut edges = Vec::with_capacity(num_edges);
    // In walking order, so that one sweep carries a plane along a whole strip.
    for &triangle in order {
        let forward = adjacency.of(triangle).filter(|&other| triangle < other);
        edges.extend(forward.map(|other| PottsEdge {
            nodes: [triangle, other],
            preference: Preference::Equal,
            reward: params.adjacent_reward,
        }));
    }
    edges.extend(overlapping_pairs.iter().map(|pair| PottsEdge {
        nodes: pair.map(|t| t as usize),
        preference: Preference::Different,
        reward: params.overlap_reward,
    }));
    let field = PottsField {
        num_labels,
        unary,
        edges,
    };
    let labels = mplp::solve(&field, params.max_sweeps).into_iter();
    Some(
        labels
            .map(|label| u32::try_from(label).unwrap_or(u32::MAX))
            .collect(),
    )
}

/// Moves one triangle of each pair that overlaps on one plane to the smallest plane free of all
/// that it overlaps; returns how many. A triangle on such a plane is in no such pair again.
fn move_to_free_planes(
    planes: &mut [u32],
    adjacency: &Neighbours,
    overlaps: &Neighbours,
    pairs: &[[u32; 2]],
) -> usize {
    let mut num_moved = 0;
    let mut taken = Vec::new();
    for pair in pairs {
        let [first, second] = pair.map(|t| t as usize);
        if planes[first] != planes[second] {
            continue;
        }
        let num_ties = |triangle: usize| {
            let same = |other: &usize| planes[*other] == planes[triangle];
            adjacency.of(triangle).filter(same).count()
        };
        let moved = if num_ties(first) < num_ties(second) {
            first
        } else {
            second
        };
        taken.clear();
        taken.extend(overlaps.of(moved).map(|t| planes[t]));
        planes[moved] = smallest_free(&mut taken);
        num_moved += 1;
    }
    num_moved
}

/// Grows pieces from the first free triangle in the order, neighbour by neighbour, leaving out
/// those that overlap the piece. Each triangle is tried once per piece that it borders.
fn grow(order: &[usize], adjacency: &Neighbours, layer: &PlaneTriangles) -> Vec<Vec<usize>> {
    const FREE: usize = usize::MAX;
    let mut piece_of = vec![FREE; layer.len()];
    let mut tried_by = vec![FREE; layer.len()];
    let mut cells: Vec<Vec<usize>> = vec![Vec::new(); layer.num_cells()];
    let mut used_cells: Vec<usize> = Vec::new();
    let mut front = VecDeque::new();
    for (piece, &seed) in order.iter().enumerate() {
        if piece_of[seed] != FREE {
            continue;
        }
        for cell in used_cells.drain(..) {
            cells[cell].clear();
        }
        front.push_back(seed);
        tried_by[seed] = piece;
        while let Some(triangle) = front.pop_front() {
            let mut is_free = true;
            layer.for_each_cell(triangle, |cell| {
                is_free = is_free && cells[cell].iter().all(|&t| !layer.overlap(t, triangle));
            });
            if !is_free {
                continue;
            }
            piece_of[triangle] = piece;
            layer.for_each_cell(triangle, |cell| {
                cells[cell].push(triangle);
                used_cells.push(cell);
            });
            for other in adjacency.of(triangle) {
                if piece_of[other] == FREE && tried_by[other] != piece {
                    tried_by[other] = piece;
                    front.push_back(other);
                }
            }
        }
    }
    members_by_piece(&piece_of)
}
