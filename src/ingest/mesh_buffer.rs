//! The mesh as it grows: whole, or in blocks that replace each other by key.
//!
//! All parts are in the world frame. The assembled mesh lists the blocks in the order of their
//! keys, so that the same blocks give the same mesh whatever the order in which they came.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::event::{MeshBlockKey, MeshUpdate};
use super::mesh_blocks::{MeshBlocks, MeshBlocksError, joined};
use super::params::IngestLimits;
use crate::geom::RigidTransform;
use crate::mesh::{MeshError, TriMesh};

/// An update that would make the mesh larger than it may be; the mesh stays as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the mesh would have {actual} {what}, limits.mesh_{what} is {limit}")]
pub struct MeshTooLarge {
    /// `blocks`, `vertices` or `triangles`.
    pub what: &'static str,
    /// How many there would be.
    pub actual: usize,
    /// How many there may be.
    pub limit: usize,
}

/// The current parts of the mesh.
#[derive(Clone, Debug, Default)]
pub struct MeshBuffer {
    whole: Option<Arc<TriMesh>>,
    block_by_key: BTreeMap<MeshBlockKey, TriMesh>,
}

impl MeshBuffer {
    /// A mesh that was assembled before, in the world frame.
    ///
    /// # Errors
    /// [`MeshBlocksError`] where `blocks` are those of another mesh.
    pub fn resumed(mesh: Arc<TriMesh>, blocks: &MeshBlocks) -> Result<Self, MeshBlocksError> {
        Ok(Self {
            block_by_key: blocks.split(&mesh)?.into_iter().collect(),
            whole: blocks.is_whole().then_some(mesh),
        })
    }

    /// Applies an update that is in a frame of its own. A whole mesh removes all blocks, blocks
    /// remove a whole mesh.
    pub fn apply(&mut self, update: MeshUpdate, world_from_mesh: &RigidTransform) {
        match update {
            MeshUpdate::Whole(mesh) => {
                self.block_by_key.clear();
                self.whole = Some(Arc::new(in_world(mesh, world_from_mesh)));
            }
            MeshUpdate::Blocks { clear, blocks } => {
                self.whole = None;
                if clear {
                    self.block_by_key.clear();
                }
                for (key, block) in blocks {
                    if block.num_triangles() == 0 {
                        self.block_by_key.remove(&key);
                    } else {
                        let block = in_world(block, world_from_mesh);
                        self.block_by_key.insert(key, block);
                    }
                }
            }
        }
    }

    /// Whether the mesh stays within its limits with an update.
    ///
    /// # Errors
    /// [`MeshTooLarge`] when it does not.
    pub fn check(&self, update: &MeshUpdate, limits: &IngestLimits) -> Result<(), MeshTooLarge> {
        let [num_blocks, num_vertices, num_triangles] = match update {
            MeshUpdate::Whole(mesh) => [1, mesh.num_vertices(), mesh.num_triangles()],
            MeshUpdate::Blocks { clear, blocks } => self.size_with(*clear, blocks),
        };
        for (what, actual, limit) in [
            ("blocks", num_blocks, limits.mesh_blocks),
            ("vertices", num_vertices, limits.mesh_vertices),
            ("triangles", num_triangles, limits.mesh_triangles),
        ] {
            if actual > limit {
                return Err(MeshTooLarge {
                    what,
                    actual,
                    limit,
                });
            }
        }
        Ok(())
    }

    /// Blocks, vertices and triangles once `blocks` are in; of blocks of one key the last counts.
    fn size_with(&self, clear: bool, blocks: &[(MeshBlockKey, TriMesh)]) -> [usize; 3] {
        let new: BTreeMap<MeshBlockKey, &TriMesh> =
            blocks.iter().map(|(key, block)| (*key, block)).collect();
        let kept = self.block_by_key.iter();
        let kept = kept.filter(|(key, _)| !clear && !new.contains_key(key));
        let mut size = [0; 3];
        let new_blocks = new.values().copied().filter(|b| b.num_triangles() > 0);
        for block in kept.map(|(_, block)| block).chain(new_blocks) {
            size[0] += 1;
            size[1] += block.num_vertices();
            size[2] += block.num_triangles();
        }
        size
    }

    /// How many blocks there are.
    pub fn num_blocks(&self) -> usize {
        self.block_by_key.len()
    }

    /// The mesh, all blocks joined, and which part of it is which.
    ///
    /// # Errors
    /// [`MeshError::TooLarge`] when the blocks together have too many vertices or triangles.
    pub fn assembled(&self) -> Result<(Arc<TriMesh>, MeshBlocks), MeshError> {
        if let Some(whole) = &self.whole {
            return Ok((whole.clone(), MeshBlocks::default()));
        }
        let blocks = self.block_by_key.iter();
        let (mesh, blocks) = joined(blocks.map(|(key, block)| (*key, block)))?;
        Ok((Arc::new(mesh), blocks))
    }
}

fn in_world(mesh: TriMesh, world_from_mesh: &RigidTransform) -> TriMesh {
    if *world_from_mesh == RigidTransform::identity() {
        mesh
    } else {
        mesh.transformed(world_from_mesh)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    fn triangle(x: f64) -> TriMesh {
        let positions = [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0]];
        TriMesh::from_soup(positions.map(Point3::from).to_vec(), vec![[0, 1, 2]])
            .unwrap()
            .0
    }

    fn blocks(clear: bool, blocks: Vec<(i64, TriMesh)>) -> MeshUpdate {
        MeshUpdate::Blocks {
            clear,
            blocks: blocks
                .into_iter()
                .map(|(key, mesh)| (MeshBlockKey([key, 0, 0]), mesh))
                .collect(),
        }
    }

    fn xs(buffer: &MeshBuffer) -> Vec<f64> {
        let (mesh, _) = buffer.assembled().unwrap();
        mesh.triangles()
            .iter()
            .map(|t| mesh.positions_m()[t[0] as usize].x)
            .collect()
    }

    #[test]
    fn blocks_replace_remove_and_clear_by_key() {
        let mut buffer = MeshBuffer::default();
        let here = RigidTransform::identity();
        buffer.apply(
            blocks(false, vec![(7, triangle(7.0)), (2, triangle(2.0))]),
            &here,
        );
        assert_eq!(xs(&buffer), [2.0, 7.0]);
        buffer.apply(
            blocks(false, vec![(2, triangle(20.0)), (7, TriMesh::default())]),
            &here,
        );
        assert_eq!(xs(&buffer), [20.0]);
        buffer.apply(blocks(true, vec![(1, triangle(1.0))]), &here);
        assert_eq!(xs(&buffer), [1.0]);
        buffer.apply(MeshUpdate::Whole(triangle(5.0)), &here);
        assert_eq!((xs(&buffer), buffer.num_blocks()), (vec![5.0], 0));
        buffer.apply(blocks(true, vec![]), &here);
        assert_eq!(xs(&buffer), [0.0; 0]);
    }

    #[test]
    fn a_mesh_goes_on_as_if_it_had_not_been_put_away() {
        let here = RigidTransform::identity();
        let mut whole = MeshBuffer::default();
        whole.apply(MeshUpdate::Whole(triangle(5.0)), &here);
        let mut in_blocks = MeshBuffer::default();
        in_blocks.apply(
            blocks(false, vec![(7, triangle(7.0)), (2, triangle(2.0))]),
            &here,
        );
        for buffer in [whole, in_blocks] {
            let (mesh, parts) = buffer.assembled().unwrap();
            for update in [
                blocks(false, vec![(2, triangle(20.0)), (9, triangle(9.0))]),
                blocks(false, vec![(7, TriMesh::default())]),
                blocks(true, vec![(1, triangle(1.0))]),
                MeshUpdate::Whole(triangle(3.0)),
            ] {
                let mut goes_on = MeshBuffer::resumed(mesh.clone(), &parts).unwrap();
                let mut stayed = buffer.clone();
                assert_eq!(goes_on.assembled(), stayed.assembled());
                goes_on.apply(update.clone(), &here);
                stayed.apply(update, &here);
                assert_eq!(goes_on.assembled(), stayed.assembled());
            }
        }
    }

    #[test]
    fn updates_are_moved_to_the_world() {
        let mut buffer = MeshBuffer::default();
        let there =
            RigidTransform::try_from_quaternion([0.0, 0.0, 0.0, 1.0], [10.0, 0.0, 0.0]).unwrap();
        buffer.apply(blocks(false, vec![(0, triangle(1.0))]), &there);
        assert_eq!(xs(&buffer), [11.0]);
    }

    #[test]
    fn what_would_grow_too_large_is_refused_by_what_there_would_be() {
        let mut buffer = MeshBuffer::default();
        let limits = IngestLimits {
            mesh_blocks: 2,
            mesh_triangles: 3,
            mesh_vertices: 100,
            ..IngestLimits::default()
        };
        let two = blocks(false, vec![(1, triangle(1.0)), (2, triangle(2.0))]);
        assert_eq!(buffer.check(&two, &limits), Ok(()));
        buffer.apply(two.clone(), &RigidTransform::identity());
        // The same again replaces; another key would be a third block.
        assert_eq!(buffer.check(&two, &limits), Ok(()));
        let third = |clear| blocks(clear, vec![(3, triangle(3.0))]);
        let refused = buffer.check(&third(false), &limits).unwrap_err();
        assert_eq!(
            ("blocks", 3, 2),
            (refused.what, refused.actual, refused.limit)
        );
        assert_eq!(buffer.check(&third(true), &limits), Ok(()));
        let instead = vec![(1, TriMesh::default()), (3, triangle(3.0))];
        assert_eq!(buffer.check(&blocks(false, instead), &limits), Ok(()));
        let whole = MeshUpdate::Whole(triangle(0.0));
        let vertices = IngestLimits {
            mesh_vertices: 2,
            ..limits
        };
        let refused = buffer.check(&whole, &vertices).unwrap_err();
        assert_eq!(
            refused.to_string(),
            "the mesh would have 3 vertices, limits.mesh_vertices is 2"
        );
    }
}
