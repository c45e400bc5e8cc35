//! Small corrections of keyframes' poses, from the offset between photo and rendering.
//!
//! A keyframe whose photo is displaced from the rendering of the texture by a few pixels was
//! recorded with a pose that is off by a fraction of a degree. Its camera is turned so that the ray
//! of the image's middle moves by the offset. The rendering is the work of all keyframes; where the
//! keyframe painted it itself, it agrees with itself and says nothing: there the mask is off.
//!
//! Images are compared at a reduced size; offsets are in pixels of the full photo.

use nalgebra::UnitQuaternion;

use crate::atlas::{AtlasLayout, AtlasTexture};
use crate::geom::{ColorImage, PinholeCamera, RigidTransform};
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::TriMesh;
use crate::render::raster::{RasterWorkspace, ViewBuffer, rasterize};
use crate::render::textured::shade_textured;
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

/// A photo as it is compared.
#[derive(Clone, Debug)]
pub struct PosePhoto {
    /// Reduced by `factor`.
    pub color: ColorImage,
    /// Its camera.
    pub camera: PinholeCamera,
    /// Pixels of the full photo along a side of one of these.
    pub factor: u32,
}

impl PosePhoto {
    /// The frame's photo at the size of [`PoseParams::max_width_px`]; `None` where that is nothing.
    pub fn new(frame: &DecodedFrame, params: &PoseParams) -> Option<Self> {
        let factor = frame.color.width().div_ceil(params.max_width_px.max(1));
        let camera = frame.color_camera.reduced(factor).ok()?;
        let color = frame.color.reduced(factor);
        Some(Self {
            color,
            camera,
            factor,
        })
    }
}

/// The texture that poses are measured against.
#[derive(Clone, Copy)]
pub struct Painted<'a> {
    /// The mesh.
    pub mesh: &'a TriMesh,
    /// Its layout.
    pub layout: &'a AtlasLayout,
    /// The texture.
    pub texture: &'a AtlasTexture,
    /// Per triangle: which of the keyframes painted it.
    pub label: &'a [Option<u32>],
}

/// Measures a keyframe, that of index `index`, whose photo is `photo`, against the texture.
///
/// # Errors
/// [`AlignError`] for alignment settings out of range.
pub fn measure_pose(
    painted: Painted<'_>,
    index: usize,
    camera_from_world: &RigidTransform,
    photo: &PosePhoto,
    params: &PoseParams,
) -> Result<PoseMeasure, AlignError> {
    let Painted {
        mesh,
        layout,
        texture,
        label,
    } = painted;
    let camera = &photo.camera;
    let mut buffer = ViewBuffer::default();
    let mut workspace = RasterWorkspace::default();
    rasterize(mesh, camera, camera_from_world, &mut workspace, &mut buffer);
    let Ok(render) = shade_textured(mesh, layout, texture, camera, camera_from_world, &buffer)
    else {
        return Ok(PoseMeasure::default());
    };
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
    let found = align(&photo.color, &render.color, Some(&mask), &params.align)?;
    let differences = photo.color.pixels().iter().zip(render.color.pixels());
    let sum: u64 = differences
        .zip(&mask)
        .filter(|(_, counts)| **counts)
        .flat_map(|((a, b), _)| a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))))
        .sum();
    let offset_px = || {
        found
            .offset_px
            .map(|px| f64::from(px) * f64::from(photo.factor))
    };
    Ok(PoseMeasure {
        offset_px: found.is_trusted.then(offset_px),
        residual_255: Some(sum as f64 / (3 * num_foreign) as f64),
    })
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
