//! A synchronised RGB-D frame at a known pose: what ingest makes and the keyframe store takes.

use super::{CameraModel, EncodedColor, EncodedDepth, RigidTransform, Stamp};

/// One colour image, its depth where there is one, and where the camera stood.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedFrame {
    /// When the colour image was taken.
    pub stamp: Stamp,
    /// Pose of the colour camera's optical frame in the world (the mesh's frame).
    pub world_from_camera: RigidTransform,
    /// The colour image.
    pub color: EncodedColor,
    /// The colour camera; its size is the image's.
    pub color_camera: CameraModel,
    /// The depth image, where one was synchronised.
    pub depth: Option<FrameDepth>,
}

/// The depth half of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameDepth {
    /// The depth image.
    pub image: EncodedDepth,
    /// The depth camera; its size may differ from the colour camera's.
    pub camera: CameraModel,
    /// Pose of the colour camera's optical frame in the depth camera's (identity when the depth
    /// is registered to colour). When the two images were taken at different times, the motion
    /// between them is part of it.
    pub depth_from_color: RigidTransform,
}
