//! Going on with a scan of an earlier run.

use std::sync::Arc;

use super::LiveScan;
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
    /// How often the mesh had changed.
    pub num_mesh_updates: usize,
    /// The frame of poses and mesh, where it was known.
    pub world_frame: Option<String>,
}

impl LiveScan {
    /// Takes up an earlier scan: what is painted of it is what the earlier run would have painted.
    /// As after [`Self::adopt`], what comes later must be in the same frame, and blocks of a mesh
    /// that come later replace the whole mesh.
    pub fn resume(&mut self, earlier: EarlierScan) {
        for keyframe in earlier.keyframes {
            self.store.restore(keyframe);
        }
        self.store.reserve_ids(earlier.next_id);
        self.mesh = earlier.mesh;
        self.num_mesh_updates = earlier.num_mesh_updates;
        self.adopted_frame = earlier.world_frame;
        self.revision += 1;
    }
}
