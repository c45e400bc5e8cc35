//! What frames show of the same points of the surface.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::geom::color::linear_table;
use crate::geom::{ColorImage, ImageError};
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::TriMesh;
use crate::render::visibility::SurfacePoint;
use crate::render::{MeshRuns, VisibilityBuffer};

use super::gain::GainParams;

/// Frames in memory at a time.
const GROUP_SIZE: usize = 8;

/// A point of the surface.
pub(super) struct Point {
    position_m: Point3<f64>,
    normal: Vector3<f64>,
}

/// The colour of a point in a frame.
#[derive(Clone, Copy)]
pub(super) struct Observation {
    pub(super) point: u32,
    pub(super) frame: u32,
    /// Logarithm of the linear light, by channel.
    pub(super) log_linear: [f64; 3],
}

/// `num_points` points, one for each equal share of the area in the order of the triangles.
pub(super) fn spread_points(mesh: &TriMesh, num_points: usize) -> Vec<Point> {
    let areas: Vec<f64> = mesh.triangle_ids().map(|t| mesh.area_m2(t)).collect();
    let mut total_m2 = 0.0;
    for area in &areas {
        total_m2 += area;
    }
    let mut points = Vec::with_capacity(num_points);
    if !(total_m2 > 0.0 && total_m2.is_finite()) {
        return points;
    }
    let share_m2 = total_m2 / num_points as f64;
    let mut passed_m2 = 0.0;
    for (triangle, area) in mesh.triangle_ids().zip(areas) {
        passed_m2 += area;
        while points.len() < num_points && (points.len() as f64 + 0.5) * share_m2 <= passed_m2 {
            let [a, b, c] = mesh.corners_m(triangle);
            // The R2 sequence, folded into the triangle.
            let index = points.len() as f64 + 1.0;
            let (mut u, mut v) = (
                (index * 0.754_877_666_246_692_8).fract(),
                (index * 0.569_840_290_998_053_3).fract(),
            );
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            points.push(Point {
                position_m: a + (b - a) * u + (c - a) * v,
                normal: mesh.scaled_normal(triangle).normalize(),
            });
        }
    }
    points
}

/// Looks at the points through every frame; sorted by frame, then point. The second is the number
/// of frames that did not decode or cannot be drawn.
pub(super) fn observe(
    mesh: &TriMesh,
    points: &[Point],
    frames: &[Arc<Keyframe>],
    decode: &(dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    params: &GainParams,
    progress: &(dyn Fn(usize) + Sync),
) -> (Vec<Observation>, usize) {
    let runs = MeshRuns::new(mesh);
    let mut buffers = vec![VisibilityBuffer::default(); GROUP_SIZE];
    let mut observations = Vec::new();
    let mut num_failed = 0;
    for (group_index, group) in frames.chunks(GROUP_SIZE).enumerate() {
        let looks: Vec<Option<Vec<Observation>>> = group
            .par_iter()
            .zip(&mut buffers)
            .enumerate()
            .map(|(offset, (keyframe, buffer))| {
                let frame = decode(keyframe).ok();
                progress(1);
                #[expect(clippy::cast_possible_truncation, reason = "keyframes are u32")]
                let index = (group_index * GROUP_SIZE + offset) as u32;
                look(mesh, &runs, points, keyframe, &*frame?, buffer, params).map(|seen| {
                    let observation = |(point, log_linear)| Observation {
                        point,
                        frame: index,
                        log_linear,
                    };
                    seen.into_iter().map(observation).collect()
                })
            })
            .collect();
        for look in looks {
            match look {
                Some(seen) => observations.extend(seen),
                None => num_failed += 1,
            }
        }
    }
    (observations, num_failed)
}

fn look(
    mesh: &TriMesh,
    runs: &MeshRuns,
    points: &[Point],
    keyframe: &Keyframe,
    frame: &DecodedFrame,
    buffer: &mut VisibilityBuffer,
    params: &GainParams,
) -> Option<Vec<(u32, [f64; 3])>> {
    let camera = &frame.color_camera;
    let camera_from_world = keyframe.world_from_camera.inverse();
    let far_m = params.visibility.far_m;
    let part = runs.in_view(camera, &camera_from_world, far_m);
    buffer
        .update_part(mesh, &part, camera, &camera_from_world, &params.visibility)
        .ok()?;
    let [fx, fy, ..] = camera.intrinsics_px();
    let focal_px = fx.min(fy);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a share below 0.1 of a width"
    )]
    let radius_px = (f64::from(camera.width()) * params.window_share).round() as i64;
    let rotation = camera_from_world.rotation().to_rotation_matrix();
    let mut seen = Vec::new();
    for (index, point) in (0u32..).zip(points) {
        let in_camera = camera_from_world.transform_point(&point.position_m);
        let Some(position_px) = camera.project(&in_camera) else {
            continue;
        };
        if !camera.contains(position_px) {
            continue;
        }
        let normal = rotation * point.normal;
        let cosine = -normal.dot(&in_camera.coords) / in_camera.coords.norm();
        if cosine < params.min_cosine {
            continue;
        }
        let surface_point = SurfacePoint {
            position_px,
            depth_m: in_camera.z,
            slope_m: in_camera.z / (focal_px * cosine),
        };
        if !buffer.is_visible(&surface_point) || buffer.is_near_depth_edge(&surface_point) {
            continue;
        }
        if let Some(linear) = window_mean(&frame.color, position_px, radius_px, params) {
            seen.push((index, linear.map(f64::ln)));
        }
    }
    Some(seen)
}

/// Mean linear light of the window around a pixel; `None` where it leaves the image or a pixel in
/// it is too dark or too bright to be trusted.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "checked against the image"
)]
pub(super) fn window_mean(
    image: &ColorImage,
    [x_px, y_px]: [f64; 2],
    radius_px: i64,
    params: &GainParams,
) -> Option<[f64; 3]> {
    let (x, y) = (x_px.round() as i64, y_px.round() as i64);
    let (width, height) = (i64::from(image.width()), i64::from(image.height()));
    let is_inside =
        x >= radius_px && y >= radius_px && x + radius_px < width && y + radius_px < height;
    if !is_inside {
        return None;
    }
    let linear = linear_table();
    let trusted = params.min_byte..=params.max_byte;
    let mut sum = [0.0; 3];
    for row in y - radius_px..=y + radius_px {
        let start = (row * width + x - radius_px) as usize;
        let pixels = &image.pixels()[start..=start + 2 * radius_px as usize];
        for pixel in pixels {
            if !pixel.iter().all(|byte| trusted.contains(byte)) {
                return None;
            }
            for (sum, byte) in sum.iter_mut().zip(pixel) {
                *sum += f64::from(linear[usize::from(*byte)]);
            }
        }
    }
    let side = (2 * radius_px + 1) as f64;
    Some(sum.map(|sum| sum / (side * side)))
}
