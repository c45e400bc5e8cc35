//! Frames that come and go while a scan runs.

use std::sync::Arc;

use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::TriMesh;
use crate::render::MeshRuns;

use super::cues::{self, FrameWorkspace};
use super::label::CandidateTable;
use super::{AssignError, AssignParams, Assignment, FailedFrame, FramePose};

/// The scores of some frames against one mesh, column by column.
///
/// What [`Self::assignment`] returns depends on the frames that are in the table alone: not on the
/// order in which they came, nor on frames that were there and are gone. It equals, in every field
/// and to the last bit, what [`super::assign`] makes of the same frames at once.
///
/// Frames are named by a number of the caller's choice, which labels repeat; ties go to the highest.
///
/// Memory: per frame 16 bytes for each triangle that it may paint (and 8 for each valid vertex or
/// triangle where the colour cue asks for them), [`Self::num_bytes`], given back when the frame is
/// removed; per triangle and vertex of the mesh some 100 bytes, however many frames there are.
/// Whoever bounds the number of frames, as the keyframe store does, bounds it all.
///
/// A table is for one mesh: when triangles are added or moved, their rows have to be scored against
/// every frame, which is what adding the frames to a new table does.
#[derive(Debug)]
pub struct FrameTable {
    mesh: Arc<TriMesh>,
    runs: MeshRuns,
    params: AssignParams,
    columns: CandidateTable,
    workspace: FrameWorkspace,
}

impl FrameTable {
    /// A table without frames.
    ///
    /// # Errors
    /// [`AssignError::Param`] for a parameter out of range.
    pub fn new(mesh: Arc<TriMesh>, params: AssignParams) -> Result<Self, AssignError> {
        params.check()?;
        Ok(Self {
            runs: MeshRuns::new(&mesh),
            columns: CandidateTable::new(mesh.num_triangles(), mesh.num_vertices()),
            mesh,
            params,
            workspace: FrameWorkspace::default(),
        })
    }

    /// Scores a frame, in place of the one of the same number. One that cannot be used is no error:
    /// it goes to the report, as in a batch.
    pub fn add(&mut self, frame: u32, keyframe: &Keyframe, decoded: &DecodedFrame) {
        self.add_pose(frame, &keyframe.into(), decoded);
    }

    pub(crate) fn add_pose(&mut self, frame: u32, pose: &FramePose, decoded: &DecodedFrame) {
        let (mesh, runs) = (&self.mesh, &self.runs);
        let scored =
            cues::score_frame(mesh, runs, pose, decoded, &self.params, &mut self.workspace);
        match scored {
            Ok(candidates) => self.columns.add(frame, pose.quality, candidates),
            Err(error) => self.add_failed(frame, error.to_string()),
        }
    }

    /// Notes that a frame could not be decoded, and why.
    pub fn add_failed(&mut self, frame: u32, reason: String) {
        self.columns.fail(FailedFrame { frame, reason });
    }

    /// Takes a frame out again; whether it was there.
    pub fn remove(&mut self, frame: u32) -> bool {
        self.columns.remove(frame)
    }

    /// Which frame paints which triangle, of those in the table now.
    pub fn assignment(&self) -> Assignment {
        let typical = self.columns.typical_quality();
        self.columns.assign(&self.mesh, &self.params, typical)
    }

    /// Bytes that the frames take.
    pub fn num_bytes(&self) -> usize {
        self.columns.num_bytes()
    }
}
