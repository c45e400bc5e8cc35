//! What a journal's file holds, without the images: enough to tell what it lacks.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::geom::{RigidTransform, Stamp};
use crate::keyframe::KeyframeId;

use super::ScanState;
use super::step::{Change, Step};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HeldKeyframe {
    world_from_camera: RigidTransform,
    num_bytes: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct HeldMesh {
    pub(super) num_updates: u64,
    num_bytes: u64,
}

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Index {
    pub(super) epoch: u64,
    /// Of the last step, and the checksum of its chunk.
    pub(super) sequence: u64,
    pub(super) crc: u32,
    /// Where the last step ends.
    pub(super) num_bytes: u64,
    pub(super) keyframes: BTreeMap<KeyframeId, HeldKeyframe>,
    pub(super) mesh: Option<HeldMesh>,
    pub(super) next_id: KeyframeId,
    num_preamble_bytes: u64,
}

impl Index {
    /// A file without steps.
    pub(super) fn new(num_preamble_bytes: u64, epoch: u64) -> Self {
        Self {
            epoch,
            sequence: 0,
            crc: 0,
            num_bytes: num_preamble_bytes,
            keyframes: BTreeMap::new(),
            mesh: None,
            next_id: KeyframeId(0),
            num_preamble_bytes,
        }
    }

    /// The next step.
    pub(super) fn step(&self, change: Change, scan: &ScanState) -> Step {
        Step {
            sequence: self.sequence + 1,
            follows_crc: self.crc,
            change,
            world_frame: scan.world_frame.clone().unwrap_or_default(),
        }
    }

    /// A step follows, whose chunk has this checksum and takes so many bytes.
    pub(super) fn note(&mut self, step: &Step, crc: u32, num_bytes: u64) {
        self.sequence = step.sequence;
        self.crc = crc;
        self.num_bytes += num_bytes;
        match &step.change {
            Change::Begin(next_id) => {
                self.keyframes.clear();
                self.mesh = None;
                self.next_id = *next_id;
            }
            Change::Keyframe(keyframe) => {
                let held = HeldKeyframe {
                    world_from_camera: keyframe.world_from_camera,
                    num_bytes,
                };
                self.keyframes.insert(keyframe.id, held);
                self.next_id = self
                    .next_id
                    .max(KeyframeId(keyframe.id.0.saturating_add(1)));
            }
            Change::Removed(id) => {
                self.keyframes.remove(id);
            }
            Change::Pose(id, world_from_camera) => {
                if let Some(held) = self.keyframes.get_mut(id) {
                    held.world_from_camera = *world_from_camera;
                }
            }
            Change::Mesh { num_updates, .. } => {
                self.mesh = Some(HeldMesh {
                    num_updates: *num_updates,
                    num_bytes,
                });
            }
        }
    }

    /// The steps from what the file holds to `scan`.
    pub(super) fn changes_to(&self, scan: &ScanState) -> Vec<Change> {
        let is_same_scan = self.epoch == scan.epoch;
        let mut changes = Vec::new();
        if !is_same_scan {
            changes.push(Change::Begin(scan.next_id));
        }
        for keyframe in scan.keyframes.values() {
            let held = self.keyframes.get(&keyframe.id).filter(|_| is_same_scan);
            match held {
                None => changes.push(Change::Keyframe(Arc::clone(keyframe))),
                Some(held) if held.world_from_camera != keyframe.world_from_camera => {
                    changes.push(Change::Pose(keyframe.id, keyframe.world_from_camera));
                }
                Some(_) => {}
            }
        }
        let held_ids = self.keyframes.keys().filter(|_| is_same_scan);
        let gone = held_ids.filter(|id| !scan.keyframes.contains_key(id));
        changes.extend(gone.map(|id| Change::Removed(*id)));
        let held_mesh = self.mesh.filter(|_| is_same_scan);
        if let Some(mesh) = &scan.mesh
            && held_mesh.is_none_or(|held| held.num_updates != scan.num_mesh_updates)
        {
            let newest = scan.keyframes.values().next_back();
            changes.push(Change::Mesh {
                num_updates: scan.num_mesh_updates,
                mesh: Arc::clone(mesh),
                blocks: Arc::clone(&scan.mesh_blocks),
                stamp: newest.map_or_else(Stamp::default, |keyframe| keyframe.stamp),
            });
        }
        changes
    }

    /// Bytes that a file of only what is held would not have.
    pub(super) fn num_dead_bytes(&self) -> u64 {
        let keyframes = self.keyframes.values().map(|held| held.num_bytes);
        let mesh = self.mesh.map(|held| held.num_bytes);
        let num_live_bytes: u64 = keyframes.chain(mesh).sum();
        self.num_bytes
            .saturating_sub(self.num_preamble_bytes + num_live_bytes)
    }
}
