//! The RGB-D sensor: an analytic ray caster over the primitives.
//!
//! It shares no code with the product's z-buffer and knows no triangles, so that what it shows is
//! an oracle. Colour is the area average over each pixel in linear light, by a regular grid of
//! sub-pixel rays whose textures are averaged over the ray's own share of the pixel; depth is
//! exact, along z, through the pixel's centre. All rays leave one point, so each surface is bound
//! by a rectangle of pixels and each tile of the image tests only the surfaces that reach it,
//! nearest first.

use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

use crate::geom::{PinholeCamera, RigidTransform};

use super::surface::{Hit, Shape, Surface};
use super::texture::Linear;

/// What the ideal sensor sees.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CastImage {
    /// Mean linear radiance per pixel, row-major.
    pub(super) linear: Vec<Linear>,
    /// Depth along z in metres through the pixel's centre; 0 where nothing is hit.
    pub(super) depth_m: Vec<f32>,
}

const TILE_PX: u32 = 16;
/// Nothing nearer than this is seen.
const NEAR_M: f64 = 0.02;
/// What is seen where no surface is.
const VOID: Linear = [0.2, 0.22, 0.25];

/// A surface as one camera sees it.
struct View<'a> {
    surface: &'a Surface,
    camera_in_local: Vector3<f64>,
    local_from_camera: Matrix3<f64>,
    /// Pixels that it may cover: x0, y0, x1, y1.
    bounds_px: [f64; 4],
    min_depth_m: f64,
}

/// Casts one image with `supersampling`² colour rays a pixel.
pub(super) fn cast(
    surfaces: &[Surface],
    camera: &PinholeCamera,
    world_from_camera: &RigidTransform,
    supersampling: u32,
) -> CastImage {
    let camera_from_world = world_from_camera.inverse();
    let mut views: Vec<View<'_>> = surfaces
        .iter()
        .filter_map(|surface| View::new(surface, camera, &camera_from_world))
        .collect();
    views.sort_by(|a, b| a.min_depth_m.total_cmp(&b.min_depth_m));
    let num_strips = camera.height().div_ceil(TILE_PX);
    let strips: Vec<CastImage> = (0..num_strips)
        .into_par_iter()
        .map(|strip| cast_strip(&views, camera, strip * TILE_PX, supersampling.max(1)))
        .collect();
    let num_pixels = camera.width() as usize * camera.height() as usize;
    let mut image = CastImage {
        linear: Vec::with_capacity(num_pixels),
        depth_m: Vec::with_capacity(num_pixels),
    };
    for strip in strips {
        image.linear.extend(strip.linear);
        image.depth_m.extend(strip.depth_m);
    }
    image
}

fn cast_strip(
    views: &[View<'_>],
    camera: &PinholeCamera,
    y0: u32,
    supersampling: u32,
) -> CastImage {
    let width = camera.width();
    let y1 = (y0 + TILE_PX).min(camera.height());
    let num_pixels = width as usize * (y1 - y0) as usize;
    let mut strip = CastImage {
        linear: vec![[0.0; 3]; num_pixels],
        depth_m: vec![0.0; num_pixels],
    };
    let mut reaching: Vec<&View<'_>> = Vec::new();
    for x0 in (0..width).step_by(TILE_PX as usize) {
        let x1 = (x0 + TILE_PX).min(width);
        reaching.clear();
        reaching.extend(views.iter().filter(|view| view.reaches([x0, y0, x1, y1])));
        for y in y0..y1 {
            for x in x0..x1 {
                let at = (y - y0) as usize * width as usize + x as usize;
                let (color, depth_m) = cast_pixel(&reaching, camera, [x, y], supersampling);
                strip.linear[at] = color;
                strip.depth_m[at] = depth_m;
            }
        }
    }
    strip
}

fn cast_pixel(
    views: &[&View<'_>],
    camera: &PinholeCamera,
    [x, y]: [u32; 2],
    supersampling: u32,
) -> (Linear, f32) {
    let centre = camera.ray(f64::from(x), f64::from(y));
    #[expect(clippy::cast_possible_truncation, reason = "depth images are f32")]
    let depth_m = nearest(views, &centre).map_or(0.0, |(_, hit)| hit.t as f32);
    let step = 1.0 / f64::from(supersampling);
    let mut sum = [0.0f32; 3];
    for j in 0..supersampling {
        for i in 0..supersampling {
            let offset = |k: u32| (f64::from(k) + 0.5) * step - 0.5;
            let ray = camera.ray(f64::from(x) + offset(i), f64::from(y) + offset(j));
            let color = nearest(views, &ray)
                .map_or(VOID, |(view, hit)| view.radiance(&hit, &ray, camera, step));
            for c in 0..3 {
                sum[c] += color[c];
            }
        }
    }
    let inverse = 1.0 / (supersampling * supersampling) as f32;
    (sum.map(|s| s * inverse), depth_m)
}

#[inline]
fn nearest<'a, 'b>(
    views: &[&'a View<'b>],
    ray_in_camera: &Vector3<f64>,
) -> Option<(&'a View<'b>, Hit)> {
    let mut best: Option<(&View<'_>, Hit)> = None;
    let mut depth_m = f64::INFINITY;
    for view in views {
        // Views come by their nearest point: no later one can be nearer.
        if view.min_depth_m > depth_m {
            break;
        }
        let direction = view.local_from_camera * ray_in_camera;
        let hit =
            view.surface
                .shape
                .intersect(&view.camera_in_local, &direction, [NEAR_M, depth_m]);
        if let Some(hit) = hit {
            depth_m = hit.t;
            best = Some((view, hit));
        }
    }
    best
}

impl<'a> View<'a> {
    /// `None` when the surface lies wholly behind the camera or beside the image.
    fn new(
        surface: &'a Surface,
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
    ) -> Option<Self> {
        let camera_from_local = *camera_from_world * surface.world_from_local;
        let local_from_camera = camera_from_local.inverse();
        let is_flat = matches!(surface.shape, Shape::Rect { .. } | Shape::Disc { .. });
        if is_flat && local_from_camera.translation().z >= 0.0 {
            // The camera is behind it.
            return None;
        }
        let mut bounds_px = [
            f64::INFINITY,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NEG_INFINITY,
        ];
        let mut min_depth_m = f64::INFINITY;
        for point in visible_hull(surface, &camera_from_local) {
            let Some([x, y]) = camera.project(&point) else {
                continue;
            };
            min_depth_m = min_depth_m.min(point.z);
            bounds_px[0] = bounds_px[0].min(x);
            bounds_px[1] = bounds_px[1].min(y);
            bounds_px[2] = bounds_px[2].max(x);
            bounds_px[3] = bounds_px[3].max(y);
        }
        let is_beside = bounds_px[0] > f64::from(camera.width())
            || bounds_px[1] > f64::from(camera.height())
            || bounds_px[2] < -1.0
            || bounds_px[3] < -1.0;
        (min_depth_m.is_finite() && !is_beside).then(|| Self {
            surface,
            camera_in_local: *local_from_camera.translation(),
            local_from_camera: local_from_camera
                .rotation()
                .to_rotation_matrix()
                .into_inner(),
            bounds_px,
            // Rounding of the hull must not hide a hit.
            min_depth_m: min_depth_m - 1e-6,
        })
    }

    fn reaches(&self, [x0, y0, x1, y1]: [u32; 4]) -> bool {
        let [left, top, right, bottom] = self.bounds_px;
        left <= f64::from(x1)
            && right >= f64::from(x0) - 1.0
            && top <= f64::from(y1)
            && bottom >= f64::from(y0) - 1.0
    }

    /// Mean radiance over the share `step` of a pixel (in each direction) around a ray.
    #[inline]
    fn radiance(
        &self,
        hit: &Hit,
        ray_in_camera: &Vector3<f64>,
        camera: &PinholeCamera,
        step: f64,
    ) -> Linear {
        /// At grazing angles the box would grow without bound.
        const MAX_WIDTH_M: f64 = 0.3;
        let [fx, fy, ..] = camera.intrinsics_px();
        let tangents = self.surface.shape.tangents(hit.uv_m);
        let direction = self.local_from_camera * ray_in_camera;
        let facing = tangents.normal.dot(&direction);
        let slide = |axis: usize, focal_px: f64| {
            // One pixel moves the ray by `delta` and the hit along the tangent plane.
            let delta = self.local_from_camera.column(axis) / focal_px;
            (delta - direction * (tangents.normal.dot(&delta) / facing)) * (hit.t * step)
        };
        let (dx, dy) = (slide(0, fx), slide(1, fy));
        let width = |gradient: &Vector3<f64>| {
            gradient
                .dot(&dx)
                .abs()
                .max(gradient.dot(&dy).abs())
                .min(MAX_WIDTH_M)
        };
        self.surface
            .radiance(hit.uv_m, [width(&tangents.grad_u), width(&tangents.grad_v)])
    }
}

/// Corners of the surface's box in the camera's frame, its edges clipped at the near plane.
fn visible_hull(surface: &Surface, camera_from_local: &RigidTransform) -> Vec<Point3<f64>> {
    let [low, high] = surface.shape.bounds();
    let is_flat = low.z == high.z;
    let num_corners: usize = if is_flat { 4 } else { 8 };
    let corners: Vec<Point3<f64>> = (0..num_corners)
        .map(|corner| {
            let pick = |axis: usize| {
                if corner >> axis & 1 == 1 {
                    high[axis]
                } else {
                    low[axis]
                }
            };
            camera_from_local.transform_point(&Point3::new(pick(0), pick(1), pick(2)))
        })
        .collect();
    let mut hull = Vec::with_capacity(2 * num_corners);
    for (index, a) in corners.iter().enumerate() {
        if a.z >= NEAR_M {
            hull.push(*a);
        }
        for bit in [1, 2, 4] {
            let Some(b) = corners.get(index ^ bit).filter(|_| index & bit == 0) else {
                continue;
            };
            if (a.z < NEAR_M) != (b.z < NEAR_M) {
                hull.push(a + (b - a) * ((NEAR_M - a.z) / (b.z - a.z)));
            }
        }
    }
    hull
}
