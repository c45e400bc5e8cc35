//! What can arrive, in our own types.

use std::sync::Arc;

use crate::geom::{CameraModel, EncodedColor, EncodedDepth, RigidTransform, Stamp};
use crate::mesh::{SoupReport, TriMesh};

/// Stamp and frame of a message.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// When the data was taken.
    pub stamp: Stamp,
    /// The frame the data is in.
    pub frame_id: Arc<str>,
}

/// One transform of a TF message.
#[derive(Clone, Debug, PartialEq)]
pub struct StampedTransform {
    /// Stamp and parent frame.
    pub header: Header,
    /// The child frame.
    pub child_frame_id: Arc<str>,
    /// Maps a point in the child frame to the parent frame.
    pub parent_from_child: RigidTransform,
}

/// A better pose of a frame of the past.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseCorrection {
    /// When the colour image was taken.
    pub stamp: Stamp,
    /// In the event: pose of the body in the header's frame. Given out: pose of the colour camera's
    /// optical frame in the world.
    pub pose: RigidTransform,
}

/// Whose poses corrections are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CorrectedBody {
    /// The colour camera's optical frame.
    Camera,
    /// What the configuration names as the frame of poses, else the colour camera.
    PoseFrame,
}

/// A change of the mesh, in its header's frame.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshUpdate {
    /// The mesh is this, all of it.
    Whole(TriMesh),
    /// These blocks replace those of the same key; an empty block removes its key.
    Blocks {
        /// Whether all earlier blocks are dropped first.
        clear: bool,
        /// Blocks by key.
        blocks: Vec<(MeshBlockKey, TriMesh)>,
    },
}

/// Identity of a mesh block: nvblox's grid index, or a `MeshUpdate` key in the first place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MeshBlockKey(pub [i64; 3]);

/// One message in our own types. Which topic plays which part was settled by the source.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A colour image.
    Color(Header, EncodedColor),
    /// A depth image.
    Depth(Header, EncodedDepth),
    /// Intrinsics of the colour camera.
    ColorInfo(Header, CameraModel),
    /// Intrinsics of the depth camera.
    DepthInfo(Header, CameraModel),
    /// Transforms from `/tf`.
    Transforms(Vec<StampedTransform>),
    /// Transforms from `/tf_static`.
    StaticTransforms(Vec<StampedTransform>),
    /// A pose topic: pose of the camera's optical frame, or of the frame the configuration names,
    /// in the header's frame.
    Pose(Header, RigidTransform),
    /// Odometry: pose of the child frame in the header's frame.
    Odometry(StampedTransform),
    /// Better poses of frames of the past, in any order: a loop was closed.
    Corrections(Header, CorrectedBody, Vec<PoseCorrection>),
    /// The mesh changed; the report counts what the soup lost on the way.
    Mesh(Header, MeshUpdate, SoupReport),
}
