//! Which triangles share an edge, in the order in which labels are solved for ([`super::pairwise`]).

/// Pairs of triangles that share an edge, sorted, the lower number first. Where more than two meet, each
/// is paired with the next.
pub(crate) fn adjacent_pairs(triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(3 * triangles.len());
    for (triangle, &[a, b, c]) in (0u32..).zip(triangles) {
        for [p, q] in [[a, b], [b, c], [c, a]] {
            if p != q {
                sides.push(([p.min(q), p.max(q)], triangle));
            }
        }
    }
    sides.sort_unstable();
    let mut pairs: Vec<[u32; 2]> = sides
        .windows(2)
        .filter(|pair| pair[0].0 == pair[1].0 && pair[0].1 != pair[1].1)
        .map(|pair| [pair[0].1, pair[1].1])
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Triangles of a block: pairs within one do not meet those within another.
pub(super) const BLOCK_SIZE: usize = 4096;

/// Which triangles share an edge, in the order in which messages are sent.
#[derive(Clone, Debug)]
pub(crate) struct Adjacency {
    /// Those within a block, by block, then those between blocks; sorted in each part.
    pairs: Vec<[u32; 2]>,
    /// Behind the last pair of each block.
    block_ends: Vec<usize>,
    neighbours: Neighbours,
}

impl Adjacency {
    pub(crate) fn of(triangles: &[[u32; 3]]) -> Self {
        Self::new(triangles.len(), adjacent_pairs(triangles))
    }

    /// From sorted pairs, the lower number first.
    pub(super) fn new(num_triangles: usize, pairs: Vec<[u32; 2]>) -> Self {
        let neighbours = Neighbours::new(num_triangles, &pairs);
        let block_of = |triangle: u32| triangle as usize / BLOCK_SIZE;
        let (mut within, between): (Vec<_>, Vec<_>) = pairs
            .into_iter()
            .partition(|&[i, j]| block_of(i) == block_of(j));
        let num_blocks = num_triangles.div_ceil(BLOCK_SIZE);
        let end_of = |block: usize| within.partition_point(|&[i, _]| block_of(i) <= block);
        let block_ends = (0..num_blocks).map(end_of).collect();
        within.extend(between);
        Self {
            pairs: within,
            block_ends,
            neighbours,
        }
    }

    /// All pairs, each once.
    pub(crate) fn pairs(&self) -> &[[u32; 2]] {
        &self.pairs
    }

    /// Behind the last pair within each block; those between blocks follow.
    pub(super) fn block_ends(&self) -> &[usize] {
        &self.block_ends
    }

    /// What is adjacent to a triangle.
    pub(super) fn of_triangle(&self, triangle: usize) -> &[u32] {
        self.neighbours.of(triangle)
    }
}

/// Adjacent triangles of each triangle.
#[derive(Clone, Debug)]
struct Neighbours {
    first: Vec<u32>,
    others: Vec<u32>,
}

impl Neighbours {
    fn new(num_triangles: usize, pairs: &[[u32; 2]]) -> Self {
        let mut first = vec![0_u32; num_triangles + 1];
        for &triangle in pairs.iter().flatten() {
            first[triangle as usize + 1] += 1;
        }
        for triangle in 0..num_triangles {
            first[triangle + 1] += first[triangle];
        }
        let mut next = first.clone();
        let mut others = vec![0; 2 * pairs.len()];
        for &[i, j] in pairs {
            for [triangle, other] in [[i, j], [j, i]] {
                let place = &mut next[triangle as usize];
                others[*place as usize] = other;
                *place += 1;
            }
        }
        Self { first, others }
    }

    fn of(&self, triangle: usize) -> &[u32] {
        &self.others[self.first[triangle] as usize..self.first[triangle + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_share_an_edge() {
        let triangles = [[0, 1, 2], [0, 2, 3], [2, 4, 3], [2, 0, 4], [1, 1, 2]];
        let pairs = adjacent_pairs(&triangles);
        // Edge 0–2 has three triangles, edge 1–2 two, edges 2–3 and 2–4 two each.
        assert_eq!(pairs, [[0, 1], [0, 4], [1, 2], [1, 3], [2, 3]]);
    }
}
