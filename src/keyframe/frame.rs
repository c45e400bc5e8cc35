//! One kept frame: immutable, its images encoded.

use crate::geom::{CameraModel, EncodedColor, RigidTransform, Stamp};

pub use crate::geom::FrameDepth as KeyframeDepth;

/// Number of a keyframe in the order of admission; never reused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct KeyframeId(pub u32);

/// What a frame's pixels say of its worth.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FrameQuality {
    /// Sharpness: mean squared Laplacian over mean squared gradient of the luma, a ratio that
    /// falls with blur and hardly depends on the scene's contrast.
    pub sharpness: f32,
    /// Mean luma in [0, 1].
    pub mean_luma: f32,
    /// Share of pixels that are black or white to the last bit, in [0, 1].
    pub clipped: f32,
}

/// A posed RGB-D frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// Its number.
    pub id: KeyframeId,
    /// When the colour image was taken.
    pub stamp: Stamp,
    /// Pose of the colour camera's optical frame in the mesh's frame.
    pub world_from_camera: RigidTransform,
    /// The colour image.
    pub color: EncodedColor,
    /// The colour camera.
    pub color_camera: CameraModel,
    /// The depth image, where one was synchronised.
    pub depth: Option<KeyframeDepth>,
    /// What its pixels say of its worth.
    pub quality: FrameQuality,
}

impl Keyframe {
    /// Bytes of its encoded images.
    pub fn num_bytes(&self) -> usize {
        let half = self.depth.as_ref();
        self.color.bytes().len() + half.map_or(0, |half| half.image.bytes().len())
    }
}
