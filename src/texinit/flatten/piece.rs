//! A connected set of triangles on its way to a flat chart.

use nalgebra::Point3;

use crate::mesh::adjacency::NO_HALF_EDGE;
use crate::mesh::components::components_within;
use crate::mesh::{Manifold, TriMesh, TriangleId};

/// Triangles of one chart with their own mates: half-edge `3 i + k` is the oriented side `k` of
/// `triangles[i]`, and no mate leads out of the piece.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Piece {
    pub(crate) triangles: Vec<TriangleId>,
    pub(crate) mates: Vec<u32>,
}

impl Piece {
    /// One piece per label below `num_labels`; triangles of other labels are in none.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "an index of a triangle of the mesh"
    )]
    pub(crate) fn from_labels(mates: &[u32], label: &[u32], num_labels: usize) -> Vec<Self> {
        let ids = (0..label.len() as u32).map(TriangleId);
        Self::gather(mates, &ids.collect::<Vec<_>>(), label, num_labels)
    }

    /// One piece of these triangles, which are in ascending order.
    pub(crate) fn of_triangles(mates: &[u32], triangles: Vec<TriangleId>) -> Self {
        let local = |h: u32| {
            let found = triangles.binary_search(&TriangleId(h / 3));
            #[expect(clippy::cast_possible_truncation, reason = "fewer than the mesh has")]
            found.map_or(NO_HALF_EDGE, |place| 3 * place as u32 + h % 3)
        };
        let mates = triangles
            .iter()
            .flat_map(|t| &mates[3 * t.index()..3 * t.index() + 3])
            .map(|&mate| match mate {
                NO_HALF_EDGE => NO_HALF_EDGE,
                mate => local(mate),
            })
            .collect();
        Self { triangles, mates }
    }

    /// This piece cut along its labels' borders, each part further into connected ones.
    pub(crate) fn split(&self, label: &[u32]) -> Vec<Self> {
        let (label, num_parts) = components_within(&self.mates, |a, b| label[a] == label[b]);
        Self::gather(&self.mates, &self.triangles, &label, num_parts as usize)
    }

    fn gather(mates: &[u32], ids: &[TriangleId], label: &[u32], num_labels: usize) -> Vec<Self> {
        let mut pieces = vec![
            Self {
                triangles: Vec::new(),
                mates: Vec::new(),
            };
            num_labels
        ];
        let mut place = vec![u32::MAX; label.len()];
        for (triangle, &piece) in label.iter().enumerate() {
            if let Some(piece) = pieces.get_mut(piece as usize) {
                #[expect(clippy::cast_possible_truncation, reason = "fewer than the mesh has")]
                {
                    place[triangle] = piece.triangles.len() as u32;
                }
                piece.triangles.push(ids[triangle]);
            }
        }
        for (triangle, &owner) in label.iter().enumerate() {
            let Some(piece) = pieces.get_mut(owner as usize) else {
                continue;
            };
            for &mate in &mates[3 * triangle..3 * triangle + 3] {
                let neighbor = mate as usize / 3;
                piece
                    .mates
                    .push(if mate != NO_HALF_EDGE && label[neighbor] == owner {
                        3 * place[neighbor] + mate % 3
                    } else {
                        NO_HALF_EDGE
                    });
            }
        }
        pieces
    }

    /// How many triangles.
    pub(crate) fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Positions of the oriented corners of each triangle, metres.
    pub(crate) fn corners_m(&self, mesh: &TriMesh, manifold: &Manifold) -> Vec<[Point3<f64>; 3]> {
        self.triangles
            .iter()
            .map(|&t| manifold.oriented_corners_m(mesh, t))
            .collect()
    }
}
