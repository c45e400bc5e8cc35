//! What waits for a partner, intrinsics or a pose.

use std::sync::Arc;

use super::super::event::{Header, MeshUpdate};
use super::super::pose_buffer::LookupError;
use super::super::sync::Stamped;
use crate::geom::{CameraModel, EncodedColor, EncodedDepth, Stamp};

/// What an image message holds.
#[derive(Debug)]
pub(super) enum Pixels {
    Color(EncodedColor),
    Depth(EncodedDepth),
}

impl Pixels {
    pub(super) fn size_px(&self) -> (u32, u32) {
        match self {
            Self::Color(color) => (color.width(), color.height()),
            Self::Depth(depth) => (depth.width(), depth.height()),
        }
    }

    pub(super) fn check(&self, max_px: usize) -> Result<(), String> {
        let (width, height) = self.size_px();
        if u64::from(width) * u64::from(height) > max_px as u64 {
            return Err(format!(
                "image of {width}x{height} pixels, limits.image_px is {max_px}"
            ));
        }
        Ok(())
    }
}

/// An image with its intrinsics, once they are known.
#[derive(Debug)]
pub(super) struct Image {
    pub(super) topic: usize,
    pub(super) frame_id: Arc<str>,
    pub(super) pixels: Pixels,
    pub(super) camera: Option<CameraModel>,
}

/// A pair that waits for its pose.
#[derive(Debug)]
pub(super) struct WaitingFrame {
    pub(super) since: Stamp,
    pub(super) color: Stamped<Image>,
    pub(super) depth: Option<Stamped<Image>>,
}

/// A mesh update that waits for its transform.
#[derive(Debug)]
pub(super) struct WaitingMesh {
    pub(super) since: Stamp,
    pub(super) topic: usize,
    pub(super) header: Header,
    pub(super) update: MeshUpdate,
}

/// Why a frame does not leave now.
pub(super) enum NotYet {
    Wait,
    Refuse { class: String, text: String },
}

pub(super) fn not_yet(is_overdue: bool, error: &LookupError) -> NotYet {
    if !is_overdue && error.may_resolve() {
        return NotYet::Wait;
    }
    NotYet::Refuse {
        class: error.class().to_owned(),
        text: error.to_string(),
    }
}

/// Why an image's intrinsics cannot be used.
pub(super) fn unusable_camera(image: &Image) -> Option<String> {
    let (width, height) = image.pixels.size_px();
    let Some(camera) = image.camera else {
        return Some("no camera info".to_owned());
    };
    let pinhole = camera.pinhole;
    let is_same = (pinhole.width(), pinhole.height()) == (width, height);
    (!is_same).then(|| {
        format!(
            "image is {width}x{height} but its camera info is for {}x{}",
            pinhole.width(),
            pinhole.height()
        )
    })
}
