//! A keyframe's images as the stages use them: decoded and without lens distortion.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::frame::Keyframe;
use crate::geom::{
    CameraModel, ColorImage, DepthImage, Distortion, FrameDepth, ImageError, PinholeCamera,
    RigidTransform, UndistortionMap,
};

/// A decoded keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedFrame {
    /// The colour image, without lens distortion.
    pub color: ColorImage,
    /// Its camera: the keyframe's, cropped to where the lens shows something.
    pub color_camera: PinholeCamera,
    /// The depth image, where there is one.
    pub depth: Option<DecodedDepth>,
}

/// The decoded depth half of a keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedDepth {
    /// The depth image, without lens distortion.
    pub image: DepthImage,
    /// Its camera.
    pub camera: PinholeCamera,
    /// Pose of the colour camera's optical frame in the depth camera's.
    pub depth_from_color: RigidTransform,
}

impl DecodedFrame {
    /// Decodes a keyframe.
    ///
    /// # Errors
    /// [`ImageError`] when an image does not decode, does not have its camera's size, or lies
    /// outside its lens model.
    pub fn decode(keyframe: &Keyframe, lenses: &LensCache) -> Result<Self, ImageError> {
        Self::decode_with_depth(keyframe, None, lenses)
    }

    /// The same where the depth half is known already.
    pub(super) fn decode_with_depth(
        keyframe: &Keyframe,
        known_depth: Option<DecodedDepth>,
        lenses: &LensCache,
    ) -> Result<Self, ImageError> {
        let decode_color = || {
            let recorded = keyframe.color.decode()?;
            Ok::<_, ImageError>(match lenses.map(&keyframe.color_camera)? {
                Some(map) => (map.color(&recorded)?, *map.color_camera()),
                None => (recorded, keyframe.color_camera.pinhole),
            })
        };
        let decode_depth = || match (known_depth, &keyframe.depth) {
            (Some(known), _) => Ok(Some(known)),
            (None, Some(half)) => {
                let recorded = half.image.decode()?;
                DecodedDepth::undistorted(half, recorded, lenses).map(Some)
            }
            (None, None) => Ok(None),
        };
        // Few frames come at a time: the two halves keep two cores busy with one.
        let (color, depth) = rayon::join(decode_color, decode_depth);
        let ((color, color_camera), depth) = (color?, depth?);
        Ok(Self {
            color,
            color_camera,
            depth,
        })
    }

    /// Bytes that the pixels take.
    pub fn num_bytes(&self) -> usize {
        let color = size_of_val(self.color.pixels());
        let depth = self
            .depth
            .as_ref()
            .map_or(0, |depth| depth.image.num_bytes());
        color + depth
    }
}

impl DecodedDepth {
    /// The depth half of a keyframe, from its image as recorded.
    ///
    /// # Errors
    /// [`ImageError`] when the image does not have its camera's size or lies outside its lens
    /// model.
    pub(super) fn undistorted(
        half: &FrameDepth,
        recorded: DepthImage,
        lenses: &LensCache,
    ) -> Result<Self, ImageError> {
        let image = match lenses.map(&half.camera)? {
            Some(map) => map.depth(&recorded)?,
            None => recorded,
        };
        Ok(Self {
            image,
            camera: half.camera.pinhole,
            depth_from_color: half.depth_from_color,
        })
    }
}

/// Undistortion maps of the cameras seen last.
#[derive(Debug, Default)]
pub struct LensCache {
    /// The one used last comes last.
    maps: Mutex<Vec<(CameraModel, Arc<UndistortionMap>)>>,
}

/// Colour and depth of two rigs; a map of 1920×1440 takes 22 MB.
const MAX_MAPS: usize = 4;

impl LensCache {
    /// The map of a camera; `None` where its images are undistorted already.
    ///
    /// # Errors
    /// [`ImageError::Size`] when the lens model leaves no valid pixel.
    pub fn map(&self, camera: &CameraModel) -> Result<Option<Arc<UndistortionMap>>, ImageError> {
        if camera.distortion == Distortion::None {
            return Ok(None);
        }
        // Not held while a map is made: that is parallel work, and a thread that waits for it may
        // take up another frame that asks for the lock.
        let known = lock(&self.maps)
            .iter()
            .find(|(known, _)| known == camera)
            .map(|(_, map)| map.clone());
        let map = match known {
            Some(map) => map,
            None => Arc::new(UndistortionMap::new(camera)?),
        };
        let mut maps = lock(&self.maps);
        maps.retain(|(known, _)| known != camera);
        maps.push((*camera, map.clone()));
        if maps.len() > MAX_MAPS {
            maps.remove(0);
        }
        Ok(Some(map))
    }
}

/// A poisoned lock is taken all the same: its holders leave the data whole at every step.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
