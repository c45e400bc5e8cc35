//! Which part of a mesh is which block, so that a mesh that was put together can be taken apart.

use super::event::MeshBlockKey;
use crate::mesh::{MeshError, TriMesh, TriangleId};

/// A block of a mesh: its vertices and triangles follow those of the block before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshBlockSpan {
    /// Which block.
    pub key: MeshBlockKey,
    /// How many vertices are its own.
    pub num_vertices: u32,
    /// How many triangles are its own, > 0.
    pub num_triangles: u32,
}

/// Why a mesh has no such blocks.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeshBlocksError {
    /// Keys must ascend.
    #[error("block {index} of a mesh is not after the one before it")]
    Order {
        /// Which, from 0.
        index: usize,
    },
    /// A block without triangles is none.
    #[error("block {index} of a mesh has no triangle")]
    Empty {
        /// Which, from 0.
        index: usize,
    },
    /// Blocks together are the whole mesh.
    #[error("the blocks of a mesh have {in_blocks} {what}, the mesh has {in_mesh}")]
    Sum {
        /// `vertices` or `triangles`.
        what: &'static str,
        /// All blocks together.
        in_blocks: u64,
        /// The mesh.
        in_mesh: usize,
    },
    /// A triangle of a block uses another one's vertex.
    #[error("triangle {triangle} of a mesh uses a vertex of another block")]
    Shared {
        /// Which, of the mesh.
        triangle: usize,
    },
    /// A block is no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// The blocks of a mesh in the order of their keys; none for a mesh that came whole.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MeshBlocks {
    spans: Vec<MeshBlockSpan>,
}

impl MeshBlocks {
    /// The blocks of `mesh`; no span at all says that it came whole.
    ///
    /// # Errors
    /// [`MeshBlocksError`] unless the spans are in order, cover the mesh, and share nothing.
    pub fn new(spans: Vec<MeshBlockSpan>, mesh: &TriMesh) -> Result<Self, MeshBlocksError> {
        if spans.is_empty() {
            return Ok(Self::default());
        }
        if let Some(at) = spans.windows(2).position(|two| two[0].key >= two[1].key) {
            return Err(MeshBlocksError::Order { index: at + 1 });
        }
        if let Some(index) = spans.iter().position(|span| span.num_triangles == 0) {
            return Err(MeshBlocksError::Empty { index });
        }
        let sum = |num: fn(&MeshBlockSpan) -> u32| spans.iter().map(|s| u64::from(num(s))).sum();
        for (what, in_blocks, in_mesh) in [
            ("vertices", sum(|s| s.num_vertices), mesh.num_vertices()),
            ("triangles", sum(|s| s.num_triangles), mesh.num_triangles()),
        ] {
            if in_blocks != in_mesh as u64 {
                return Err(MeshBlocksError::Sum {
                    what,
                    in_blocks,
                    in_mesh,
                });
            }
        }
        let blocks = Self { spans };
        for place in blocks.places() {
            let is_own = |vertex: &u32| place.vertices.contains(&(*vertex as usize));
            let mut triangles = mesh.triangles()[place.triangles.clone()].iter();
            if let Some(at) = triangles.position(|corners| !corners.iter().all(is_own)) {
                let triangle = place.triangles.start + at;
                return Err(MeshBlocksError::Shared { triangle });
            }
        }
        Ok(blocks)
    }

    /// The blocks.
    pub fn spans(&self) -> &[MeshBlockSpan] {
        &self.spans
    }

    /// Whether the mesh came whole.
    pub fn is_whole(&self) -> bool {
        self.spans.is_empty()
    }

    fn places(&self) -> impl Iterator<Item = Place> {
        let mut first = [0; 2];
        self.spans.iter().map(move |span| {
            let next = [
                first[0] + span.num_vertices as usize,
                first[1] + span.num_triangles as usize,
            ];
            let place = Place {
                key: span.key,
                vertices: first[0]..next[0],
                triangles: first[1]..next[1],
            };
            first = next;
            place
        })
    }

    /// The blocks of `mesh`, which these are of, each with indices of its own.
    ///
    /// # Errors
    /// [`MeshBlocksError`] where these are the blocks of another mesh.
    pub fn split(&self, mesh: &TriMesh) -> Result<Vec<(MeshBlockKey, TriMesh)>, MeshBlocksError> {
        Self::new(self.spans.clone(), mesh)?;
        let block = |place: Place| {
            let positions_m = mesh.positions_m()[place.vertices.clone()].to_vec();
            let triangles = mesh.triangles()[place.triangles].iter();
            #[expect(
                clippy::cast_possible_truncation,
                reason = "a mesh has fewer than 2³² vertices"
            )]
            let first = place.vertices.start as u32;
            let triangles = triangles.map(|corners| corners.map(|v| v - first));
            let (block, _) = TriMesh::from_soup(positions_m, triangles.collect())?;
            Ok((place.key, block))
        };
        self.places().map(block).collect()
    }

    /// The blocks of [`TriMesh::filtered`] of `mesh`, which these are of: those that keep a triangle.
    #[must_use]
    pub fn filtered(&self, mesh: &TriMesh, keep: impl Fn(TriangleId) -> bool) -> Self {
        let mut is_used = vec![false; mesh.num_vertices()];
        let kept = mesh.triangle_ids().map(|triangle| {
            let is_kept = keep(triangle);
            for vertex in mesh.triangles()[triangle.index()] {
                is_used[vertex as usize] |= is_kept;
            }
            is_kept
        });
        let is_kept: Vec<bool> = kept.collect();
        let num_in = |flags: &[bool], range: std::ops::Range<usize>| {
            let flags = flags.get(range).unwrap_or_default();
            u32::try_from(flags.iter().filter(|flag| **flag).count()).unwrap_or(u32::MAX)
        };
        let left = self.places().map(|place| MeshBlockSpan {
            key: place.key,
            num_vertices: num_in(&is_used, place.vertices),
            num_triangles: num_in(&is_kept, place.triangles),
        });
        Self {
            spans: left.filter(|span| span.num_triangles > 0).collect(),
        }
    }
}

/// Where a block is in its mesh.
struct Place {
    key: MeshBlockKey,
    vertices: std::ops::Range<usize>,
    triangles: std::ops::Range<usize>,
}

/// Blocks one behind the other; keys must ascend, and no block be empty.
///
/// # Errors
/// [`MeshError::TooLarge`] when they together have too many vertices or triangles.
pub(super) fn joined<'a>(
    blocks: impl Iterator<Item = (MeshBlockKey, &'a TriMesh)> + Clone,
) -> Result<(TriMesh, MeshBlocks), MeshError> {
    let num_vertices = blocks.clone().map(|(_, b)| b.num_vertices()).sum();
    let num_triangles = blocks.clone().map(|(_, b)| b.num_triangles()).sum();
    if u32::try_from(num_vertices).is_err() || u32::try_from(num_triangles).is_err() {
        return Err(MeshError::TooLarge {
            num_vertices,
            num_triangles,
        });
    }
    let mut positions_m = Vec::with_capacity(num_vertices);
    let mut triangles = Vec::with_capacity(num_triangles);
    let mut spans = Vec::new();
    for (key, block) in blocks {
        #[expect(clippy::cast_possible_truncation, reason = "the sum was checked")]
        let [first, num_vertices, num_triangles] = [
            positions_m.len(),
            block.num_vertices(),
            block.num_triangles(),
        ]
        .map(|n| n as u32);
        positions_m.extend_from_slice(block.positions_m());
        triangles.extend(block.triangles().iter().map(|t| t.map(|v| v + first)));
        spans.push(MeshBlockSpan {
            key,
            num_vertices,
            num_triangles,
        });
    }
    let (mesh, _) = TriMesh::from_soup(positions_m, triangles)?;
    Ok((mesh, MeshBlocks { spans }))
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    fn key(i: i64) -> MeshBlockKey {
        MeshBlockKey([i, -i, 0])
    }

    /// A strip of squares along x.
    fn strip(first_m: f64, num_squares: u32) -> TriMesh {
        let corners = (0..=num_squares).flat_map(|i| {
            let x = first_m + f64::from(i);
            [Point3::new(x, 0.0, 0.0), Point3::new(x, 1.0, 0.0)]
        });
        let squares = (0..num_squares).flat_map(|i| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| 2 * i + k);
            [[a, b, c], [b, d, c]]
        });
        let (mesh, _) = TriMesh::from_soup(corners.collect(), squares.collect()).unwrap();
        mesh
    }

    fn made() -> (Vec<(MeshBlockKey, TriMesh)>, TriMesh, MeshBlocks) {
        let parts = vec![
            (key(-4), strip(0.0, 3)),
            (key(0), strip(10.0, 1)),
            (key(7), strip(20.0, 2)),
        ];
        let (mesh, blocks) = joined(parts.iter().map(|(key, block)| (*key, block))).unwrap();
        (parts, mesh, blocks)
    }

    #[test]
    fn what_was_joined_comes_apart_as_it_was() {
        let (parts, mesh, blocks) = made();
        assert_eq!(mesh.num_triangles(), 12);
        assert_eq!(blocks.split(&mesh).unwrap(), parts);
        assert_eq!(MeshBlocks::new(blocks.spans().to_vec(), &mesh), Ok(blocks));
    }

    #[test]
    fn cutting_the_mesh_cuts_the_blocks() {
        let (parts, mesh, blocks) = made();
        let near = |mesh: &TriMesh, t| {
            (2.0..11.5).contains(
                &mesh
                    .corners_m(t)
                    .map(|c| c.x)
                    .into_iter()
                    .fold(0.0, f64::max),
            )
        };
        let cut = mesh.filtered(|t| near(&mesh, t));
        let left = blocks.filtered(&mesh, |t| near(&mesh, t));
        assert_eq!(
            MeshBlocks::new(left.spans().to_vec(), &cut),
            Ok(left.clone())
        );
        let each = parts
            .iter()
            .map(|(key, b)| (*key, b.filtered(|t| near(b, t))));
        let each: Vec<_> = each.filter(|(_, b)| b.num_triangles() > 0).collect();
        assert_eq!(left.split(&cut).unwrap(), each);
        assert_eq!(each.len(), 2);
        assert!(MeshBlocks::default().filtered(&mesh, |_| true).is_whole());
    }

    #[test]
    fn blocks_of_another_mesh_are_refused() {
        let (_, mesh, blocks) = made();
        let refused = |change: fn(&mut Vec<MeshBlockSpan>)| {
            let mut spans = blocks.spans().to_vec();
            change(&mut spans);
            MeshBlocks::new(spans, &mesh).unwrap_err()
        };
        assert_eq!(
            refused(|s| s.swap(0, 1)),
            MeshBlocksError::Order { index: 1 }
        );
        assert_eq!(
            refused(|s| s[1].num_triangles = 0),
            MeshBlocksError::Empty { index: 1 }
        );
        let vertices = refused(|s| s[1].num_vertices += 1);
        assert!(matches!(
            vertices,
            MeshBlocksError::Sum {
                what: "vertices",
                in_blocks: 19,
                in_mesh: 18
            }
        ));
        let triangles = refused(|s| s.truncate(2));
        assert!(matches!(triangles, MeshBlocksError::Sum { .. }));
        let shared = refused(|s| {
            s[0].num_triangles -= 1;
            s[1].num_triangles += 1;
        });
        assert_eq!(shared, MeshBlocksError::Shared { triangle: 5 });
        assert!(blocks.split(&strip(0.0, 6)).is_err());
    }
}
