//! The unknowns: one per vertex and label of a triangle at it.

use crate::mesh::TriMesh;

/// Stands for no node.
pub(super) const NO_NODE: u32 = u32::MAX;

/// Numbers pairs of vertex and label.
pub(super) struct Nodes {
    num_nodes: usize,
    /// Per triangle: the nodes of its corners; [`NO_NODE`] without a label.
    of_triangle: Vec<[u32; 3]>,
}

impl Nodes {
    pub(super) fn new(mesh: &TriMesh, labels: &[Option<u32>]) -> Self {
        let labelled = || mesh.triangles().iter().zip(labels);
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

    pub(super) fn all(&self) -> &[[u32; 3]] {
        &self.of_triangle
    }
}
