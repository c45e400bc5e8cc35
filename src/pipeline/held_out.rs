//! Keyframes that the texture does not see, to judge it by.

use std::sync::Arc;

use rayon::prelude::*;

use crate::atlas::{AtlasLayout, AtlasTexture};
use crate::geom::{ColorImage, ImageError, RigidTransform};
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::TriMesh;
use crate::render::raster::{RasterWorkspace, ViewBuffer, rasterize};
use crate::render::textured::{RenderParams, render_textured};

/// Which keyframes are kept from the texture, to be compared with its rendering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutParams {
    /// How many keyframes, spread evenly over the run; never more than a tenth of them. 0 holds
    /// none back.
    pub num_views: usize,
}

impl Default for HeldOutParams {
    fn default() -> Self {
        Self { num_views: 6 }
    }
}

/// Photos wider than this are compared at a whole fraction of their size: the atlas' texels are
/// not finer, and a person cannot see more in the report.
const MAX_WIDTH_PX: u32 = 1024;

/// A photo that the texture has not seen, and the texture rendered at its pose.
#[derive(Debug)]
pub struct HeldOutView {
    /// The keyframe.
    pub keyframe: Arc<Keyframe>,
    /// The photo, undistorted, at most [`MAX_WIDTH_PX`] wide.
    pub photo: ColorImage,
    /// The rendering, of the same size.
    pub render: ColorImage,
    /// Per pixel: whether the textured mesh is there.
    pub mask: Vec<bool>,
    /// Per pixel: the triangle that is there, `u32::MAX` for none.
    pub triangle: Vec<u32>,
}

/// Splits keyframes into those that paint and those that judge, both in order.
pub(super) fn split(
    keyframes: Vec<Arc<Keyframe>>,
    params: &HeldOutParams,
) -> (Vec<Arc<Keyframe>>, Vec<Arc<Keyframe>>) {
    let num_held_out = params.num_views.min(keyframes.len() / 10);
    let num_keyframes = keyframes.len();
    // The middle of each of `num_held_out` equal parts of the run.
    let is_held_out = |index: usize| {
        (0..num_held_out).any(|k| (2 * k + 1) * num_keyframes / (2 * num_held_out) == index)
    };
    let mut painting = Vec::with_capacity(num_keyframes);
    let mut judging = Vec::with_capacity(num_held_out);
    for (index, keyframe) in keyframes.into_iter().enumerate() {
        if is_held_out(index) {
            judging.push(keyframe);
        } else {
            painting.push(keyframe);
        }
    }
    (painting, judging)
}

/// Renders the texture at the pose of each keyframe. One that does not decode is left out: its
/// images were decoded when it was admitted, so that this is rare.
pub(super) fn render_views(
    keyframes: &[Arc<Keyframe>],
    decode: &(dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &AtlasTexture,
) -> Vec<HeldOutView> {
    let views: Vec<Option<HeldOutView>> = keyframes
        .par_iter()
        .map(|keyframe| {
            let frame = decode(keyframe).ok()?;
            let factor = frame.color.width().div_ceil(MAX_WIDTH_PX);
            let photo = frame.color.reduced(factor);
            let camera = frame.color_camera.reduced(factor).ok()?;
            let camera_from_world: RigidTransform = keyframe.world_from_camera.inverse();
            let rendered = render_textured(
                mesh,
                layout,
                texture,
                &camera,
                &camera_from_world,
                &RenderParams::default(),
            )
            .ok()?;
            let mut buffer = ViewBuffer::default();
            rasterize(
                mesh,
                &camera,
                &camera_from_world,
                &mut RasterWorkspace::default(),
                &mut buffer,
            );
            Some(HeldOutView {
                keyframe: Arc::clone(keyframe),
                photo,
                render: rendered.color,
                mask: rendered.mask,
                triangle: buffer.triangle,
            })
        })
        .collect();
    views.into_iter().flatten().collect()
}
