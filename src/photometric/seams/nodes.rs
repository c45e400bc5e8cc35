//! The unknowns: one per vertex and label of a triangle at it.

use super::surface::Surface;

/// Stands for no node.
pub(super) const NO_NODE: u32 = u32::MAX;

/// Numbers pairs of vertex and label.
pub(super) struct Nodes {
    num_nodes: usize,
    /// Per triangle: the nodes of its corners; [`NO_NODE`] without a label.
    of_triangle: Vec<[u32; 3]>,
}

impl Nodes {
    pub(super) fn new(surface: &Surface<'_>) -> Self {
        let labelled = || surface.mesh.triangles().iter().zip(surface.labels);
        let mut pairs: Vec<(u32, u32)> = labelled()
            .flat_map(|(corners, label)| corners.map(|v| label.map(|l| (v, l))))
            .flatten()
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        #[expect(clippy::cast_possible_truncation, reason = "at most three a triangle")]
        let number = |pair: (u32, u32)| pairs.binary_search(&pair).map_or(NO_NODE, |n| n as u32);
        let of_triangle = labelled()
            .map(|(corners, label)| match label {
                Some(label) => corners.map(|v| number((v, *label))),
                None => [NO_NODE; 3],
            })
            .collect();
        Self {
            num_nodes: pairs.len(),
            of_triangle,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.num_nodes
    }

    pub(super) fn of(&self, triangle: u32) -> [u32; 3] {
        self.of_triangle[triangle as usize]
    }

    /// Per node: what was added there before and stays, where a triangle at it keeps its texels.
    /// Empty where nothing does.
    pub(super) fn standing(&self, surface: &Surface<'_>) -> Vec<Option<[f32; 3]>> {
        let mut standing = Vec::new();
        for (triangle, corners) in (0_u32..).zip(&self.of_triangle) {
            let Some(added) = surface.standing(triangle) else {
                continue;
            };
            standing.resize(self.num_nodes, None);
            for (corner, node) in corners.iter().enumerate() {
                if *node != NO_NODE {
                    let added = added.map_or([0.0; 3], |added| added.corners[corner]);
                    // Of two the first counts: where they differ, one was levelled without the other.
                    standing[*node as usize].get_or_insert(added);
                }
            }
        }
        standing
    }

    pub(super) fn all(&self) -> &[[u32; 3]] {
        &self.of_triangle
    }
}
