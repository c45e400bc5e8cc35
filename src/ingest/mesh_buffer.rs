//! The mesh as it grows: whole, or in blocks that replace each other by key.
//!
//! All parts are in the world frame. The assembled mesh lists the blocks in the order of their
//! keys, so that the same blocks give the same mesh whatever the order in which they came.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::event::{MeshBlockKey, MeshUpdate};
use crate::geom::RigidTransform;
use crate::mesh::{MeshError, TriMesh};

/// The current parts of the mesh.
#[derive(Clone, Debug, Default)]
pub struct MeshBuffer {
    whole: Option<Arc<TriMesh>>,
    block_by_key: BTreeMap<MeshBlockKey, TriMesh>,
}

impl MeshBuffer {
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

    /// How many blocks there are.
    pub fn num_blocks(&self) -> usize {
        self.block_by_key.len()
    }

    /// The mesh, all blocks joined.
    ///
    /// # Errors
    /// [`MeshError::TooLarge`] when the blocks together have too many vertices or triangles.
    pub fn assembled(&self) -> Result<Arc<TriMesh>, MeshError> {
        if let Some(whole) = &self.whole {
            return Ok(whole.clone());
        }
        let blocks = || self.block_by_key.values();
        let num_vertices = blocks().map(TriMesh::num_vertices).sum();
        let num_triangles = blocks().map(TriMesh::num_triangles).sum();
        if u32::try_from(num_vertices).is_err() || u32::try_from(num_triangles).is_err() {
            return Err(MeshError::TooLarge {
                num_vertices,
                num_triangles,
            });
        }
        let mut positions_m = Vec::with_capacity(num_vertices);
        let mut triangles = Vec::with_capacity(num_triangles);
        for block in blocks() {
            #[expect(clippy::cast_possible_truncation, reason = "the sum was checked")]
            let first = positions_m.len() as u32;
            positions_m.extend_from_slice(block.positions_m());
            triangles.extend(block.triangles().iter().map(|t| t.map(|v| v + first)));
        }
        TriMesh::from_soup(positions_m, triangles).map(|(mesh, _)| Arc::new(mesh))
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
        let mesh = buffer.assembled().unwrap();
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
    fn updates_are_moved_to_the_world() {
        let mut buffer = MeshBuffer::default();
        let there =
            RigidTransform::try_from_quaternion([0.0, 0.0, 0.0, 1.0], [10.0, 0.0, 0.0]).unwrap();
        buffer.apply(blocks(false, vec![(0, triangle(1.0))]), &there);
        assert_eq!(xs(&buffer), [11.0]);
    }
}
