//! A keyframe's images, decoded and undistorted.

use crate::geom::{ColorImage, DepthImage, PinholeCamera, RigidTransform};

/// The pixels of a keyframe: both images as ideal pinhole cameras see them.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedFrame {
    /// The colour image.
    pub color: ColorImage,
    /// Its camera.
    pub color_camera: PinholeCamera,
    /// The depth image, where there is one.
    pub depth: Option<DecodedDepth>,
}

/// The depth half of a decoded keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedDepth {
    /// The depth image.
    pub image: DepthImage,
    /// Its camera.
    pub camera: PinholeCamera,
    /// Pose of the colour camera's optical frame in the depth camera's.
    pub depth_from_color: RigidTransform,
}
