//! From overlapping pairs to connected pieces without overlap: the field of Eq. MRFPlane and its
//! guarantee, region growing beside it, and pieces put together again.

use std::collections::BTreeSet;

use super::OverlapParams;
use super::detect::PlaneTriangles;
use super::field::{Preferred, field, num_messages, smallest_free, solve};
use super::graph::{Neighbours, SharedEdges, join, root};
use super::grow::grow;
use super::mplp::PottsField;

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
    /// Whether the field chose among fewer planes than its form asks for.
    pub(super) is_capped: bool,
    /// Planes that the field chose among.
    pub(super) num_planes: usize,
    /// Triangles that the guarantee moved to another plane.
    pub(super) num_moved_triangles: usize,
}

/// A chart in which triangles overlap.
pub(super) struct FoldedChart<'a> {
    pub(super) layer: &'a PlaneTriangles,
    /// Edges in the plane: what a piece may hang together by.
    pub(super) plane_edges: &'a SharedEdges,
    /// Edges that the field's adjacency comes from.
    pub(super) field_edges: &'a SharedEdges,
    /// The overlapping pairs in order; nothing where they are too many to know.
    pub(super) pairs: Option<&'a [[u32; 2]]>,
}

/// Separates a chart.
pub(super) fn pieces(chart: &FoldedChart<'_>, params: &OverlapParams) -> Pieces {
    let layer = chart.layer;
    let adjacent = chart.plane_edges.adjacent_pairs(layer);
    let adjacency = Neighbours::new(layer.len(), &adjacent);
    let order = adjacency.breadth_first();
    let grown = |overlaps: Option<&Neighbours>| grow(&order, &adjacency, overlaps, layer);
    let mut pieces = Pieces {
        members: Vec::new(),
        method: PieceMethod::Growing,
        is_crowded: true,
        is_capped: false,
        num_planes: 0,
        num_moved_triangles: 0,
    };
    let Some(pairs) = chart.pairs else {
        pieces.members = members_by_piece(&grown(None));
        return pieces;
    };
    let overlaps = Neighbours::new(layer.len(), pairs);
    let preferred = Preferred::new(params.form, layer, &order, &overlaps, pairs);
    let num_wanted = preferred.num_planes;
    let Some(field) = field_of(chart, pairs, preferred, params) else {
        pieces.members = members_by_piece(&grown(Some(&overlaps)));
        return pieces;
    };
    pieces.is_crowded = false;
    pieces.is_capped = field.num_labels < num_wanted;
    pieces.num_planes = field.num_labels;
    let mut planes = solve(&field, params);
    pieces.num_moved_triangles = move_to_free_planes(&mut planes, &adjacency, &overlaps, pairs);
    let mut by_field = chart.plane_edges.connected(&planes);
    if params.merge_pieces {
        merge(&mut by_field, &adjacent, pairs);
    }
    pieces.members = members_by_piece(&by_field);
    pieces.method = PieceMethod::Field;
    if params.try_growing {
        let grown = members_by_piece(&grown(Some(&overlaps)));
        if grown.len() < pieces.members.len() {
            pieces.members = grown;
            pieces.method = PieceMethod::Growing;
        }
    }
    pieces
}

/// The chart's field over no more planes than allowed; nothing when it passes too many messages.
fn field_of(
    chart: &FoldedChart<'_>,
    pairs: &[[u32; 2]],
    preferred: Preferred,
    params: &OverlapParams,
) -> Option<PottsField> {
    let preferred = preferred.capped(params.max_planes.max(2));
    let adjacent = chart.field_edges.adjacent_pairs(chart.layer);
    let num_messages = num_messages(preferred.num_planes, adjacent.len() + pairs.len());
    (num_messages <= params.max_messages).then(|| field(params.form, &preferred, &adjacent, pairs))
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

/// Puts pieces together that are adjacent and do not overlap, those of the most common edges
/// first: planes are labels, and pieces on different ones need not overlap.
fn merge(piece_of: &mut [usize], adjacent: &[[u32; 2]], overlapping: &[[u32; 2]]) {
    let between = |pairs: &[[u32; 2]]| {
        let mut found: Vec<[usize; 2]> = pairs
            .iter()
            .map(|pair| pair.map(|t| piece_of[t as usize]))
            .filter(|[a, b]| a != b)
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        found.sort_unstable();
        found
    };
    let mut conflicts = vec![BTreeSet::new(); piece_of.len()];
    for [a, b] in between(overlapping) {
        conflicts[a].insert(b);
        conflicts[b].insert(a);
    }
    let borders = between(adjacent);
    let mut by_length: Vec<(usize, [usize; 2])> = borders
        .chunk_by(|x, y| x == y)
        .map(|group| (group.len(), group[0]))
        .collect();
    by_length.sort_by_key(|(num_edges, _)| std::cmp::Reverse(*num_edges));
    let mut parents: Vec<usize> = (0..piece_of.len()).collect();
    for (_, [a, b]) in by_length {
        let [a, b] = [root(&mut parents, a), root(&mut parents, b)];
        if a == b || conflicts[a].contains(&b) {
            continue;
        }
        join(&mut parents, a, b);
        let kept = root(&mut parents, a);
        let gone = std::mem::take(&mut conflicts[a + b - kept]);
        for other in gone {
            conflicts[other].remove(&(a + b - kept));
            conflicts[other].insert(kept);
            conflicts[kept].insert(other);
        }
    }
    for piece in piece_of {
        *piece = root(&mut parents, *piece);
    }
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

#[cfg(test)]
mod tests;
