//! Small corrections of keyframes' poses, from the offset between photo and rendering.
//!
//! A keyframe whose photo is displaced from the rendering of the texture by a few pixels was
//! recorded with a pose that is off by a fraction of a degree. Its camera is turned so that the ray
//! of the image's middle moves by the offset. The rendering is the work of all keyframes; where the
//! keyframe painted it itself, it agrees with itself and says nothing: there the mask is off.
//!
//! Images are compared at a reduced size; offsets are in pixels of the full photo.

use std::sync::Arc;

use nalgebra::UnitQuaternion;
use rayon::prelude::*;

use crate::atlas::{AtlasLayout, AtlasTexture};
use crate::geom::{ImageError, RigidTransform};
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::TriMesh;
use crate::render::raster::{RasterWorkspace, ViewBuffer, rasterize};
use crate::render::textured::{RenderParams, render_textured};
use crate::texsmooth::align::{AlignError, AlignParams, align};

/// How poses are corrected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseParams {
    /// How photo and rendering are aligned.
    pub align: AlignParams,
    /// Rounds at most.
    pub max_rounds: usize,
    /// Share of an offset that a round takes out, in (0, 1]: neighbours move at the same time.
    pub damping: f64,
    /// A camera is turned by no more than this in all, radians.
    pub max_turn_rad: f64,
    /// Photos wider than this are compared at a whole fraction of their size.
    pub max_width_px: u32,
    /// Views that are not their own work over less than this share of the image say nothing.
    pub min_foreign_share: f64,
    /// Rounds end when they lower the residual by less than this share of it.
    pub min_gain: f64,
}

impl Default for PoseParams {
    fn default() -> Self {
        Self {
            align: AlignParams::default(),
            max_rounds: 4,
            damping: 0.8,
            max_turn_rad: 0.05,
            max_width_px: 480,
            min_foreign_share: 0.08,
            min_gain: 0.002,
        }
    }
}

/// How a keyframe stands against the rendering.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseMeasure {
    /// How far its photo is displaced, pixels of the full photo; `None` where that cannot be told.
    pub offset_px: Option<[f64; 2]>,
    /// Mean absolute difference of photo and rendering, 0–255, where others painted; `None` where there
    /// is too little of that.
    pub residual_255: Option<f64>,
}

/// Measures every keyframe against the texture. `label` says per triangle which of them painted it.
///
/// # Errors
/// [`AlignError`] for alignment settings out of range. A keyframe that does not decode measures
/// nothing.
pub fn measure_poses(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &AtlasTexture,
    label: &[Option<u32>],
    keyframes: &[Arc<Keyframe>],
    decode: &(dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &PoseParams,
) -> Result<Vec<PoseMeasure>, AlignError> {
    keyframes
        .par_iter()
        .enumerate()
        .map(|(index, keyframe)| {
            let Ok(frame) = decode(keyframe) else {
                return Ok(PoseMeasure::default());
            };
            let factor = frame.color.width().div_ceil(params.max_width_px.max(1));
            let photo = frame.color.reduced(factor);
            let Ok(camera) = frame.color_camera.reduced(factor) else {
                return Ok(PoseMeasure::default());
            };
            let camera_from_world = keyframe.world_from_camera.inverse();
            let sharp = RenderParams { supersampling: 1 };
            let Ok(render) =
                render_textured(mesh, layout, texture, &camera, &camera_from_world, &sharp)
            else {
                return Ok(PoseMeasure::default());
            };
            let mut buffer = ViewBuffer::default();
            let mut workspace = RasterWorkspace::default();
            rasterize(
                mesh,
                &camera,
                &camera_from_world,
                &mut workspace,
                &mut buffer,
            );
            let is_foreign = |triangle: u32| {
                let painter = label.get(triangle as usize).copied().flatten();
                painter.is_some_and(|painter| painter as usize != index)
            };
            let mask: Vec<bool> = render
                .mask
                .iter()
                .zip(&buffer.triangle)
                .map(|(&is_seen, &triangle)| is_seen && is_foreign(triangle))
                .collect();
            let num_foreign = mask.iter().filter(|is_foreign| **is_foreign).count();
            if (num_foreign as f64) < params.min_foreign_share * mask.len() as f64 {
                return Ok(PoseMeasure::default());
            }
            let found = align(&photo, &render.color, Some(&mask), &params.align)?;
            let differences = photo.pixels().iter().zip(render.color.pixels()).zip(&mask);
            let sum: u64 = differences
                .filter(|(_, counts)| **counts)
                .flat_map(|((a, b), _)| a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))))
                .sum();
            Ok(PoseMeasure {
                offset_px: found
                    .is_trusted
                    .then(|| found.offset_px.map(|px| f64::from(px) * f64::from(factor))),
                residual_255: Some(sum as f64 / (3 * num_foreign) as f64),
            })
        })
        .collect()
}

/// The keyframe, turned so that what its camera shows moves by a share of the offset; `None` when it
/// would then be turned by more than is allowed from where it was `recorded`.
pub fn turned(
    keyframe: &Keyframe,
    recorded: &RigidTransform,
    offset_px: [f64; 2],
    params: &PoseParams,
) -> Option<Keyframe> {
    let camera = &keyframe.color_camera.pinhole;
    let middle = [camera.width(), camera.height()].map(|side| 0.5 * (f64::from(side) - 1.0));
    let from = camera.ray(middle[0], middle[1]);
    let to = camera.ray(
        middle[0] + params.damping * offset_px[0],
        middle[1] + params.damping * offset_px[1],
    );
    let turn = UnitQuaternion::rotation_between(&from, &to)?;
    // camera_from_world' = turn · camera_from_world.
    let pose = &keyframe.world_from_camera;
    let world_from_camera =
        RigidTransform::from_parts(pose.rotation() * turn.inverse(), *pose.translation());
    let in_all = world_from_camera.rotation().angle_to(recorded.rotation());
    (in_all <= params.max_turn_rad).then(|| Keyframe {
        world_from_camera,
        ..keyframe.clone()
    })
}

#[cfg(test)]
mod tests;
