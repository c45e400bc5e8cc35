//! Going on with a scan of an earlier run.

use std::sync::Arc;

use super::LiveScan;
use crate::ingest::{MeshBlocks, MeshBlocksError};
use crate::keyframe::{Keyframe, KeyframeId};
use crate::mesh::TriMesh;

/// What there was of a scan when an earlier run ended.
#[derive(Clone, Debug, Default)]
pub struct EarlierScan {
    /// Its keyframes, by number.
    pub keyframes: Vec<Arc<Keyframe>>,
    /// None of its keyframes had this number or a higher one.
    pub next_id: KeyframeId,
    /// Its mesh, in the world frame.
    pub mesh: Option<Arc<TriMesh>>,
    /// The mesh's blocks; none where it came whole.
    pub mesh_blocks: Arc<MeshBlocks>,
    /// How often the mesh had changed.
    pub num_mesh_updates: usize,
    /// The frame of poses and mesh, where it was known.
    pub world_frame: Option<String>,
}

impl LiveScan {
    /// Takes up an earlier scan: what is painted of it is what the earlier run would have painted.
    /// What comes later must be in the same frame. Blocks of a mesh that come later replace those of
    /// the same key; a mesh that came whole is replaced by the first of either.
    ///
    /// # Errors
    /// [`MeshBlocksError`] where the blocks are those of another mesh; nothing is taken up then.
    pub fn resume(&mut self, earlier: EarlierScan) -> Result<(), MeshBlocksError> {
        if let Some(mesh) = earlier.mesh {
            // The region may be another one now.
            let (mesh, blocks) = self.region.cut_blocks(mesh, &earlier.mesh_blocks);
            self.assembler
                .resume_mesh(Arc::clone(&mesh), Arc::clone(&blocks))?;
            (self.mesh, self.mesh_blocks) = (Some(mesh), blocks);
        }
        for keyframe in earlier.keyframes {
            self.store.restore(keyframe);
        }
        self.store.reserve_ids(earlier.next_id);
        self.num_mesh_updates = earlier.num_mesh_updates;
        self.adopted_frame = earlier.world_frame;
        self.revision += 1;
        Ok(())
    }
}
