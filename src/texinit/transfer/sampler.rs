//! From a texel of a triangle to its colour in one image.

use nalgebra::{Point3, Vector2, Vector3};

use crate::geom::color::{linear_table, srgb_from_linear};
use crate::geom::{ColorImage, PinholeCamera};
use crate::render::SurfacePoint;
use crate::render::visibility::depth_slope_m;

use super::{Lookup, TransferParams};

/// Change of a triangle's depth per pixel, metres.
pub(super) fn slope_m(camera: &PinholeCamera, corners_in_camera: &[Point3<f64>; 3]) -> f64 {
    let [a, b, c] = corners_in_camera;
    let center = (a.coords + b.coords + c.coords) / 3.0;
    depth_slope_m(camera, &Point3::from(center), &(b - a).cross(&(c - a)))
}

/// One triangle seen by one camera.
pub(super) struct TriangleSampler {
    /// Corners as (column · z, row · z, z).
    corners: [Vector3<f64>; 3],
    /// Change of the same per texel to the right and per texel down.
    per_texel: [Vector3<f64>; 2],
    /// Pixels of the corners, where the lookup is affine.
    corners_px: Option<[Vector2<f64>; 3]>,
    num_samples: [u32; 2],
    pixels_per_texel: f64,
    sin_elevation: f64,
    slope_m: f64,
    max_px: [f64; 2],
}

impl TriangleSampler {
    /// `None` for a triangle without area on its page, or wholly behind the camera; where the lookup
    /// is affine, partly behind it.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "float to int casts saturate, and the value is clamped"
    )]
    pub(super) fn new(
        corners_in_camera: [Point3<f64>; 3],
        corners_texel: &[[f32; 2]; 3],
        camera: &PinholeCamera,
        params: &TransferParams,
    ) -> Option<Self> {
        let [fx, fy, cx, cy] = camera.intrinsics_px();
        let corners =
            corners_in_camera.map(|p| Vector3::new(fx * p.x + cx * p.z, fy * p.y + cy * p.z, p.z));
        let [a, b, c] = corners_texel.map(|corner| corner.map(f64::from));
        let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
        let area2_texel = u[0] * v[1] - u[1] * v[0];
        let (along_u, along_v) = (corners[1] - corners[0], corners[2] - corners[0]);
        let per_texel = [
            (along_u * v[1] - along_v * u[1]) / area2_texel,
            (along_v * u[0] - along_u * v[0]) / area2_texel,
        ];
        let is_usable = area2_texel != 0.0
            && corners.iter().any(|h| h.z > 0.0)
            && per_texel.iter().flatten().all(|value| value.is_finite());
        if !is_usable {
            return None;
        }

        let corners_px = match params.lookup {
            Lookup::Footprint => None,
            Lookup::NearestAffine if corners.iter().all(|h| h.z > 0.0) => {
                Some(corners.map(|h| h.xy() / h.z))
            }
            Lookup::NearestAffine => return None,
        };

        let center = (corners[0] + corners[1] + corners[2]) / 3.0;
        let pixels = per_texel.map(|step| {
            // Derivative of (h.x / h.z, h.y / h.z).
            [0, 1].map(|axis| (step[axis] - center[axis] / center.z * step.z) / center.z)
        });
        let reach = match params.lookup {
            Lookup::Footprint => params.max_samples.clamp(1, 16),
            Lookup::NearestAffine => 1,
        };
        let num_samples = pixels.map(|[x, y]| {
            let footprint_px = (x * x + y * y).sqrt();
            // A quarter of a pixel more than one sample's reach is not worth a second sample.
            // Towards the camera's plane it grows without bound, and says nothing.
            if center.z > 0.0 {
                ((footprint_px - 0.25).ceil() as u32).clamp(1, reach)
            } else {
                1
            }
        });
        let area_px2 = (pixels[0][0] * pixels[1][1] - pixels[0][1] * pixels[1][0]).abs();
        let [p, q, r] = corners_in_camera;
        let normal = (q - p).cross(&(r - p));
        let view = (p.coords + q.coords + r.coords) / 3.0;
        let sin_elevation = normal.dot(&view).abs() / (normal.norm() * view.norm());
        Some(Self {
            corners,
            per_texel,
            corners_px,
            num_samples,
            pixels_per_texel: area_px2.sqrt(),
            sin_elevation: if sin_elevation.is_finite() {
                sin_elevation
            } else {
                0.0
            },
            slope_m: slope_m(camera, &corners_in_camera),
            max_px: [camera.width(), camera.height()].map(|side| f64::from(side - 1)),
        })
    }

    /// How far the image's colours can be trusted here.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to a byte before the cast"
    )]
    pub(super) fn confidence(&self) -> u8 {
        (255.0 * self.pixels_per_texel.min(1.0) * self.sin_elevation)
            .round()
            .clamp(1.0, 255.0) as u8
    }

    /// The texel with these barycentric weights.
    pub(super) fn at(&self, weights: [f32; 3]) -> TexelSampler<'_> {
        let [a, b, c] = weights.map(f64::from);
        let mut center = self.corners[0] * a + self.corners[1] * b + self.corners[2] * c;
        if let Some([p, q, r]) = self.corners_px {
            let pixel = p * a + q * b + r * c;
            center = Vector3::new(pixel.x * center.z, pixel.y * center.z, center.z);
        }
        TexelSampler {
            triangle: self,
            center,
        }
    }
}

/// One texel of a triangle.
pub(super) struct TexelSampler<'a> {
    triangle: &'a TriangleSampler,
    center: Vector3<f64>,
}

impl TexelSampler<'_> {
    /// Where the camera sees the texel's centre; `None` behind the camera.
    pub(super) fn surface_point(&self) -> Option<SurfacePoint> {
        let h = &self.center;
        (h.z > 0.0).then(|| SurfacePoint {
            position_px: [h.x / h.z, h.y / h.z],
            depth_m: h.z,
            slope_m: self.triangle.slope_m,
        })
    }

    /// The same where the image has a colour for it.
    pub(super) fn point_inside(&self) -> Option<SurfacePoint> {
        let [max_x, max_y] = self.triangle.max_px;
        self.surface_point().filter(|point| {
            let [x, y] = point.position_px;
            x >= 0.0 && y >= 0.0 && x <= max_x && y <= max_y
        })
    }

    /// sRGB of the texel; `None` behind the camera. Lookups are clamped to the image.
    pub(super) fn color(&self, image: &ColorImage) -> Option<[u8; 3]> {
        if self.triangle.corners_px.is_some() {
            return (self.center.z > 0.0).then(|| nearest_srgb(image, &self.center));
        }
        if self.triangle.num_samples == [1, 1] {
            return (self.center.z > 0.0).then(|| sample_srgb(image, &self.center));
        }
        Some(self.linear_color(image)?.map(srgb_from_linear))
    }

    /// Linear light in [0, 1], averaged over the texel's footprint.
    pub(super) fn linear_color(&self, image: &ColorImage) -> Option<[f32; 3]> {
        let [columns, rows] = self.triangle.num_samples;
        let table = linear_table();
        let mut sum = [0.0f32; 3];
        let mut num = 0u16;
        let offset = |i: u32, n: u32| (f64::from(i) + 0.5) / f64::from(n) - 0.5;
        for j in 0..rows {
            for i in 0..columns {
                let h = self.center
                    + self.triangle.per_texel[0] * offset(i, columns)
                    + self.triangle.per_texel[1] * offset(j, rows);
                if h.z > 0.0 {
                    num += 1;
                    let linear = sample_linear(image, table, &h);
                    for (sum, value) in sum.iter_mut().zip(linear) {
                        *sum += value;
                    }
                }
            }
        }
        (num > 0).then(|| sum.map(|sum| sum / f32::from(num)))
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to int casts saturate, and the lookup is clamped"
)]
fn nearest_srgb(image: &ColorImage, h: &Vector3<f64>) -> [u8; 3] {
    image.pixel_clamped((h.x / h.z + 0.5) as u32, (h.y / h.z + 0.5) as u32)
}

/// Bilinear sample in linear light; averages of sRGB samples would be too dark at edges.
fn sample_linear(image: &ColorImage, table: &[f32; 256], h: &Vector3<f64>) -> [f32; 3] {
    let (pixels, fx, fy) = footprint(image, h);
    let mut color = [0.0f32; 3];
    for (c, value) in color.iter_mut().enumerate() {
        let light = |i: usize| table[usize::from(pixels[i][c])];
        let top = light(0) + fx * (light(1) - light(0));
        let bottom = light(2) + fx * (light(3) - light(2));
        *value = top + fy * (bottom - top);
    }
    color
}

/// Bilinear sample in sRGB.
fn sample_srgb(image: &ColorImage, h: &Vector3<f64>) -> [u8; 3] {
    let (pixels, fx, fy) = footprint(image, h);
    let mut color = [0u8; 3];
    for (c, byte) in color.iter_mut().enumerate() {
        let value = |i: usize| f32::from(pixels[i][c]);
        let top = value(0) + fx * (value(1) - value(0));
        let bottom = value(2) + fx * (value(3) - value(2));
        *byte = round_byte(top + fy * (bottom - top));
    }
    color
}

/// The four pixels around a position, clamped to the image, and the position among them.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the image before the casts"
)]
fn footprint(image: &ColorImage, h: &Vector3<f64>) -> ([[u8; 3]; 4], f32, f32) {
    let (max_x, max_y) = (image.width() - 1, image.height() - 1);
    let x_px = ((h.x / h.z) as f32).max(0.0).min(max_x as f32);
    let y_px = ((h.y / h.z) as f32).max(0.0).min(max_y as f32);
    let (x, y) = (x_px as u32, y_px as u32);
    let (left, right) = (x.min(max_x) as usize, (x + 1).min(max_x) as usize);
    let width = image.width() as usize;
    let rows = [y.min(max_y), (y + 1).min(max_y)].map(|row| row as usize * width);
    let pixels = image.pixels();
    let around = [
        pixels[rows[0] + left],
        pixels[rows[0] + right],
        pixels[rows[1] + left],
        pixels[rows[1] + right],
    ];
    (around, x_px - x as f32, y_px - y as f32)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to int casts saturate"
)]
fn round_byte(value: f32) -> u8 {
    (value + 0.5) as u8
}
