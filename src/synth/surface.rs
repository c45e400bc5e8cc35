//! The analytic primitives: one-sided surfaces with metric 2D coordinates.
//!
//! A surface's local frame looks at it from outside, like an optical frame: x right, y down, z
//! into the body. Coordinates (u, v) are metres to the right and down from the top left. A ray
//! hits a surface only from its outer side.

use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};

use crate::geom::RigidTransform;

use super::light::LightMap;
use super::texture::{Linear, Texture};

/// The shape of a surface in its local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// x in [0, w], y in [0, h], z = 0.
    Rect { size_m: [f64; 2] },
    /// A disc or a ring in the plane z = 0 around the origin; (u, v) = (x + r, y + r).
    Disc { radius_m: f64, inner_radius_m: f64 },
    /// Mantle of a truncated cone around y, from y = 0 (top) to y = h; u is the angle to the right
    /// of −z times the mean radius. Seen from inside when `is_inward` (u then runs leftwards, so
    /// that pictures still read from left to right).
    Mantle {
        top_radius_m: f64,
        bottom_radius_m: f64,
        height_m: f64,
        is_inward: bool,
    },
    /// A sphere around the origin; u = r·longitude, v = r·angle from the top (−y).
    Sphere { radius_m: f64 },
}

/// Where a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// Ray parameter.
    pub(super) t: f64,
    /// Surface coordinates, metres.
    pub(super) uv_m: [f64; 2],
}

/// Local geometry at a point of a surface, in the local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tangents {
    /// Gradient of u along the surface (unit length where u is metric).
    pub(super) grad_u: Vector3<f64>,
    /// Gradient of v along the surface.
    pub(super) grad_v: Vector3<f64>,
    /// Outward unit normal.
    pub(super) normal: Vector3<f64>,
}

impl Shape {
    /// Size of the rectangle that (u, v) fill.
    pub(super) fn uv_size_m(&self) -> [f64; 2] {
        match *self {
            Self::Rect { size_m } => size_m,
            Self::Disc { radius_m, .. } => [2.0 * radius_m; 2],
            Self::Mantle {
                top_radius_m,
                bottom_radius_m,
                height_m,
                ..
            } => [
                TAU * mean_radius(top_radius_m, bottom_radius_m),
                height_m.hypot(top_radius_m - bottom_radius_m),
            ],
            Self::Sphere { radius_m } => [TAU * radius_m, PI * radius_m],
        }
    }

    /// Corners of a box around the shape in its local frame: (low, high).
    pub(super) fn bounds(&self) -> [Vector3<f64>; 2] {
        match *self {
            Self::Rect { size_m: [w, h] } => [Vector3::zeros(), Vector3::new(w, h, 0.0)],
            Self::Disc { radius_m: r, .. } => [Vector3::new(-r, -r, 0.0), Vector3::new(r, r, 0.0)],
            Self::Mantle {
                top_radius_m,
                bottom_radius_m,
                height_m,
                ..
            } => {
                let r = top_radius_m.max(bottom_radius_m);
                [Vector3::new(-r, 0.0, -r), Vector3::new(r, height_m, r)]
            }
            Self::Sphere { radius_m } => {
                let r = Vector3::repeat(radius_m);
                [-r, r]
            }
        }
    }

    /// First crossing from the outer side with `t` in (`t_min`, `t_max`); ray in the local frame.
    #[inline]
    pub(super) fn intersect(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        [t_min, t_max]: [f64; 2],
    ) -> Option<Hit> {
        match *self {
            Self::Rect { size_m: [w, h] } => {
                let t = plane_crossing(origin, direction, [t_min, t_max])?;
                let (u, v) = (origin.x + t * direction.x, origin.y + t * direction.y);
                (u >= 0.0 && v >= 0.0 && u <= w && v <= h).then_some(Hit { t, uv_m: [u, v] })
            }
            Self::Disc {
                radius_m,
                inner_radius_m,
            } => {
                let t = plane_crossing(origin, direction, [t_min, t_max])?;
                let (x, y) = (origin.x + t * direction.x, origin.y + t * direction.y);
                let r2 = x * x + y * y;
                (r2 <= radius_m * radius_m && r2 >= inner_radius_m * inner_radius_m).then_some(
                    Hit {
                        t,
                        uv_m: [x + radius_m, y + radius_m],
                    },
                )
            }
            Self::Mantle { .. } => self.intersect_mantle(origin, direction, [t_min, t_max]),
            Self::Sphere { radius_m } => {
                let a = direction.norm_squared();
                let b = origin.dot(direction);
                let c = origin.norm_squared() - radius_m * radius_m;
                let root = (b * b - a * c).max(-1.0);
                if root < 0.0 {
                    return None;
                }
                let t = (-b - root.sqrt()) / a;
                (t > t_min && t < t_max).then(|| Hit {
                    t,
                    uv_m: self.uv_of(&(origin + direction * t)),
                })
            }
        }
    }

    fn intersect_mantle(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        [t_min, t_max]: [f64; 2],
    ) -> Option<Hit> {
        let Self::Mantle {
            top_radius_m,
            bottom_radius_m,
            height_m,
            is_inward,
        } = *self
        else {
            return None;
        };
        // x² + z² = (r + k·y)²
        let k = (bottom_radius_m - top_radius_m) / height_m;
        let r = top_radius_m + k * origin.y;
        let s = k * direction.y;
        let a = direction.x * direction.x + direction.z * direction.z - s * s;
        let b = origin.x * direction.x + origin.z * direction.z - r * s;
        let c = origin.x * origin.x + origin.z * origin.z - r * r;
        let discriminant = b * b - a * c;
        if discriminant < 0.0 || a.abs() < 1e-12 {
            return None;
        }
        let root = discriminant.sqrt();
        let ends = [(-b - root) / a, (-b + root) / a];
        let sorted = if a > 0.0 { ends } else { [ends[1], ends[0]] };
        sorted
            .into_iter()
            .filter(|&t| t > t_min && t < t_max)
            .find_map(|t| {
                let point = origin + direction * t;
                let radius = top_radius_m + k * point.y;
                let on_mantle = point.y >= 0.0 && point.y <= height_m && radius >= 0.0;
                let outward = Vector3::new(point.x, -k * radius, point.z);
                let is_front = (outward.dot(direction) < 0.0) != is_inward;
                (on_mantle && is_front).then(|| Hit {
                    t,
                    uv_m: self.uv_of(&point),
                })
            })
    }

    /// Surface coordinates of a point on (or near) the surface.
    pub(super) fn uv_of(&self, point: &Vector3<f64>) -> [f64; 2] {
        match *self {
            Self::Rect { .. } => [point.x, point.y],
            Self::Disc { radius_m, .. } => [point.x + radius_m, point.y + radius_m],
            Self::Mantle {
                top_radius_m,
                bottom_radius_m,
                height_m,
                is_inward,
            } => {
                let slant = height_m.hypot(top_radius_m - bottom_radius_m) / height_m;
                let sign = if is_inward { -1.0 } else { 1.0 };
                let angle = (sign * point.x).atan2(-point.z).rem_euclid(TAU);
                [
                    angle * mean_radius(top_radius_m, bottom_radius_m),
                    point.y * slant,
                ]
            }
            Self::Sphere { radius_m } => {
                let longitude = point.x.atan2(-point.z).rem_euclid(TAU);
                let from_top = point.x.hypot(point.z).atan2(-point.y);
                [longitude * radius_m, from_top * radius_m]
            }
        }
    }

    /// The point at surface coordinates, in the local frame.
    pub(super) fn point_at(&self, [u, v]: [f64; 2]) -> Vector3<f64> {
        match *self {
            Self::Rect { .. } => Vector3::new(u, v, 0.0),
            Self::Disc { radius_m, .. } => Vector3::new(u - radius_m, v - radius_m, 0.0),
            Self::Mantle {
                top_radius_m,
                bottom_radius_m,
                height_m,
                is_inward,
            } => {
                let share = v / height_m.hypot(top_radius_m - bottom_radius_m);
                let radius = top_radius_m + share * (bottom_radius_m - top_radius_m);
                let angle = u / mean_radius(top_radius_m, bottom_radius_m);
                let sign = if is_inward { -1.0 } else { 1.0 };
                Vector3::new(
                    sign * radius * angle.sin(),
                    share * height_m,
                    -radius * angle.cos(),
                )
            }
            Self::Sphere { radius_m } => {
                let (longitude, from_top) = (u / radius_m, v / radius_m);
                let ring = radius_m * from_top.sin();
                Vector3::new(
                    ring * longitude.sin(),
                    -radius_m * from_top.cos(),
                    -ring * longitude.cos(),
                )
            }
        }
    }

    /// Tangents at surface coordinates.
    #[inline]
    pub(super) fn tangents(&self, [u, v]: [f64; 2]) -> Tangents {
        match *self {
            Self::Rect { .. } | Self::Disc { .. } => Tangents {
                grad_u: Vector3::x(),
                grad_v: Vector3::y(),
                normal: -Vector3::z(),
            },
            Self::Mantle {
                top_radius_m,
                bottom_radius_m,
                height_m,
                is_inward,
            } => {
                let mean = mean_radius(top_radius_m, bottom_radius_m);
                let slant = height_m.hypot(top_radius_m - bottom_radius_m);
                let radius = top_radius_m + v / slant * (bottom_radius_m - top_radius_m);
                let sign = if is_inward { -1.0 } else { 1.0 };
                let (sin, cos) = (u / mean).sin_cos();
                let radial = Vector3::new(sign * sin, 0.0, -cos);
                let along = Vector3::new(sign * cos, 0.0, sin);
                let k = (bottom_radius_m - top_radius_m) / slant;
                let down = Vector3::new(0.0, height_m / slant, 0.0) + radial * k;
                let outward = radial * (height_m / slant) - Vector3::y() * k;
                Tangents {
                    grad_u: along * (mean / radius.max(1e-6)),
                    grad_v: down,
                    normal: outward * sign,
                }
            }
            Self::Sphere { radius_m } => {
                let (sin_lon, cos_lon) = (u / radius_m).sin_cos();
                let (sin, cos) = (v / radius_m).sin_cos();
                Tangents {
                    grad_u: Vector3::new(cos_lon, 0.0, sin_lon) / sin.max(1e-3),
                    grad_v: Vector3::new(cos * sin_lon, sin, -cos * cos_lon),
                    normal: Vector3::new(sin * sin_lon, -cos, -sin * cos_lon),
                }
            }
        }
    }

    /// Surface coordinates of the nearest point of the surface.
    pub(super) fn nearest_uv(&self, point: &Vector3<f64>) -> [f64; 2] {
        let uv = self.uv_of(point);
        match *self {
            Self::Rect { size_m: [w, h] } => [uv[0].clamp(0.0, w), uv[1].clamp(0.0, h)],
            Self::Disc {
                radius_m,
                inner_radius_m,
            } => {
                let r = point.x.hypot(point.y);
                if r < 1e-12 {
                    return [radius_m + inner_radius_m, radius_m];
                }
                let scale = r.clamp(inner_radius_m, radius_m) / r;
                [point.x * scale + radius_m, point.y * scale + radius_m]
            }
            Self::Mantle {
                top_radius_m,
                bottom_radius_m,
                height_m,
                ..
            } => {
                // In the half plane through the axis the mantle is a segment.
                let slant = height_m.hypot(top_radius_m - bottom_radius_m);
                let along = [(bottom_radius_m - top_radius_m) / slant, height_m / slant];
                let ring = point.x.hypot(point.z) - top_radius_m;
                [
                    uv[0],
                    (ring * along[0] + point.y * along[1]).clamp(0.0, slant),
                ]
            }
            Self::Sphere { .. } => uv,
        }
    }
}

fn mean_radius(top_radius_m: f64, bottom_radius_m: f64) -> f64 {
    0.5 * (top_radius_m + bottom_radius_m)
}

#[inline]
fn plane_crossing(
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
    [t_min, t_max]: [f64; 2],
) -> Option<f64> {
    // Only rays that go inwards (+z) see the plane.
    if direction.z <= 1e-12 {
        return None;
    }
    let t = -origin.z / direction.z;
    (t > t_min && t < t_max).then_some(t)
}

/// A painted, lit surface of the scene.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    /// What it is, for reports.
    pub(super) name: String,
    /// The body it belongs to: surfaces of one body share vertices where they meet.
    pub(super) body: u32,
    pub(super) world_from_local: RigidTransform,
    pub(super) shape: Shape,
    pub(super) texture: Texture,
    pub(super) light: LightMap,
    /// Factor on the mesh's edge length (large plain backdrops are meshed coarsely).
    pub(super) edge_scale: f64,
}

impl Surface {
    /// Mean linear radiance over a box of `width_m` around `uv_m`.
    #[inline]
    pub(super) fn radiance(&self, uv_m: [f64; 2], width_m: [f64; 2]) -> Linear {
        self.texture
            .radiance(uv_m, width_m, self.light.irradiance(uv_m))
    }

    /// Corners of an axis-aligned box around it in the world: (low, high).
    pub(super) fn world_bounds(&self) -> [Point3<f64>; 2] {
        let [low, high] = self.shape.bounds();
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for corner in 0..8u8 {
            let pick = |axis: usize| {
                if corner >> axis & 1 == 1 {
                    high[axis]
                } else {
                    low[axis]
                }
            };
            let point =
                self.world_from_local
                    .transform_point(&Point3::new(pick(0), pick(1), pick(2)));
            for axis in 0..3 {
                bounds[0][axis] = bounds[0][axis].min(point[axis]);
                bounds[1][axis] = bounds[1][axis].max(point[axis]);
            }
        }
        bounds.map(Point3::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shapes() -> Vec<Shape> {
        vec![
            Shape::Rect { size_m: [0.8, 0.5] },
            Shape::Disc {
                radius_m: 0.4,
                inner_radius_m: 0.1,
            },
            Shape::Mantle {
                top_radius_m: 0.2,
                bottom_radius_m: 0.35,
                height_m: 0.6,
                is_inward: false,
            },
            Shape::Mantle {
                top_radius_m: 0.3,
                bottom_radius_m: 0.3,
                height_m: 0.4,
                is_inward: true,
            },
            Shape::Sphere { radius_m: 0.4 },
        ]
    }

    /// Points of the surface away from seams, poles and rims.
    fn interior(shape: &Shape) -> Vec<[f64; 2]> {
        let [w, h] = shape.uv_size_m();
        let mut points = Vec::new();
        for i in 1..10 {
            for j in 1..10 {
                let uv = [
                    w * f64::from(i) / 10.0 + 1e-3,
                    h * f64::from(j) / 10.0 + 1e-3,
                ];
                let on_ring = match *shape {
                    Shape::Disc {
                        radius_m,
                        inner_radius_m,
                    } => {
                        let r = (uv[0] - radius_m).hypot(uv[1] - radius_m);
                        r > inner_radius_m && r < radius_m
                    }
                    _ => true,
                };
                if on_ring {
                    points.push(uv);
                }
            }
        }
        points
    }

    #[test]
    fn coordinates_round_trip_through_points() {
        for shape in shapes() {
            for uv in interior(&shape) {
                let point = shape.point_at(uv);
                let back = shape.uv_of(&point);
                let nearest = shape.nearest_uv(&point);
                for axis in 0..2 {
                    assert!(
                        (back[axis] - uv[axis]).abs() < 1e-9,
                        "{shape:?} {uv:?} {back:?}"
                    );
                    assert!((nearest[axis] - uv[axis]).abs() < 1e-9, "{shape:?} {uv:?}");
                }
            }
        }
    }

    #[test]
    fn gradients_match_finite_differences() {
        let step = 1e-6;
        for shape in shapes() {
            for uv in interior(&shape) {
                let tangents = shape.tangents(uv);
                let dp_du = (shape.point_at([uv[0] + step, uv[1]]) - shape.point_at(uv)) / step;
                let dp_dv = (shape.point_at([uv[0], uv[1] + step]) - shape.point_at(uv)) / step;
                assert!(
                    (dp_du.dot(&tangents.grad_u) - 1.0).abs() < 1e-4,
                    "{shape:?} {uv:?}"
                );
                assert!(
                    (dp_dv.dot(&tangents.grad_v) - 1.0).abs() < 1e-4,
                    "{shape:?} {uv:?}"
                );
                assert!(dp_du.dot(&tangents.normal).abs() < 1e-4);
                assert!(dp_dv.dot(&tangents.normal).abs() < 1e-4);
                assert!((tangents.normal.norm() - 1.0).abs() < 1e-9);
                // Right × down points into the body.
                assert!(dp_du.cross(&dp_dv).dot(&tangents.normal) < 0.0, "{shape:?}");
            }
        }
    }

    #[test]
    fn rays_hit_the_outer_side_only() {
        let all = [0.0, f64::INFINITY];
        for shape in shapes() {
            for uv in interior(&shape) {
                let point = shape.point_at(uv);
                let normal = shape.tangents(uv).normal;
                let tilt = Vector3::new(0.02, 0.013, -0.017);
                let toward = -normal * 0.05 + tilt * 0.5;
                let hit = shape.intersect(&(point - toward), &toward, all).unwrap();
                assert!((hit.t - 1.0).abs() < 1e-9, "{shape:?} {uv:?} {hit:?}");
                assert!((hit.uv_m[0] - uv[0]).abs() + (hit.uv_m[1] - uv[1]).abs() < 1e-9);
                let away = shape.intersect(&(point + toward), &-toward, [0.0, 1.5]);
                assert_eq!(away, None, "{shape:?} {uv:?}");
            }
        }
    }
}
