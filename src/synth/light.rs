//! Light that is part of the known texture: fixed irradiance, baked once per surface.
//!
//! Each surface carries a coarse grid of relative irradiance: ambient light, darkened where nearby
//! surfaces close the hemisphere in, plus one broad lamp with soft shadows. It does not depend on
//! the view, so that albedo times irradiance is a texture like any other; the sensor and the
//! ground truth both read it by the same bilinear interpolation.

use nalgebra::{Point3, Rotation3, Unit, Vector3};
use rayon::prelude::*;

use super::bvh::Bvh;
use super::surface::{Shape, Surface};
use super::texture::Linear;

/// The light of a scene.
#[derive(Clone, Debug)]
pub(super) struct Lighting {
    /// Irradiance of an open surface, per channel.
    pub(super) ambient: Linear,
    /// Bodies nearer than this close the hemisphere, metres.
    pub(super) ambient_reach_m: f64,
    /// More of it from below: what the floor throws back at a surface that faces down.
    pub(super) bounce: Linear,
    /// Irradiance of a surface that faces the whole lamp, per channel.
    pub(super) lamp: Linear,
    /// Middle and the two half axes of the rectangular lamp, metres.
    pub(super) lamp_center_m: Point3<f64>,
    pub(super) lamp_axes_m: [Vector3<f64>; 2],
    /// Spacing of the grid, metres.
    pub(super) cell_m: f64,
}

/// Relative irradiance over a surface, on a grid from edge to edge of (u, v).
#[derive(Clone, Debug)]
pub(super) struct LightMap {
    num_cells: [usize; 2],
    cells_per_m: [f64; 2],
    nodes: Vec<Linear>,
}

impl Default for LightMap {
    fn default() -> Self {
        Self {
            num_cells: [1, 1],
            cells_per_m: [0.0; 2],
            nodes: vec![[1.0; 3]; 4],
        }
    }
}

impl LightMap {
    /// Irradiance at surface coordinates, bilinear.
    #[inline]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the grid"
    )]
    pub(super) fn irradiance(&self, uv_m: [f64; 2]) -> Linear {
        let at = |axis: usize| {
            let max = self.num_cells[axis] as f64;
            let x = (uv_m[axis] * self.cells_per_m[axis]).clamp(0.0, max);
            let cell = (x as usize).min(self.num_cells[axis] - 1);
            (cell, (x - cell as f64) as f32)
        };
        let ((i, fx), (j, fy)) = (at(0), at(1));
        let stride = self.num_cells[0] + 1;
        let first = j * stride + i;
        let [p00, p10] = [self.nodes[first], self.nodes[first + 1]];
        let [p01, p11] = [self.nodes[first + stride], self.nodes[first + stride + 1]];
        std::array::from_fn(|c| {
            let top = p00[c] + fx * (p10[c] - p00[c]);
            let bottom = p01[c] + fx * (p11[c] - p01[c]);
            top + fy * (bottom - top)
        })
    }
}

/// Directions of the hemisphere's quadrature.
const NUM_AMBIENT_RAYS: u32 = 48;
/// The lamp is seen as this many points a side.
const LAMP_SIDE: u32 = 4;

/// Bakes the light of every surface; the same for any number of threads.
pub(super) fn bake(surfaces: &mut [Surface], lighting: &Lighting) {
    let bvh = Bvh::new(surfaces);
    let shared: &[Surface] = surfaces;
    let maps: Vec<LightMap> = shared
        .par_iter()
        .map(|surface| bake_surface(surface, &bvh, lighting))
        .collect();
    for (surface, map) in surfaces.iter_mut().zip(maps) {
        surface.light = map;
    }
}

fn bake_surface(surface: &Surface, bvh: &Bvh, lighting: &Lighting) -> LightMap {
    const MAX_CELLS: f64 = 96.0;
    let size_m = surface.shape.uv_size_m();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 2..=96"
    )]
    let num_cells =
        size_m.map(|side| (side / lighting.cell_m).ceil().clamp(2.0, MAX_CELLS) as usize);
    let mut nodes = Vec::with_capacity((num_cells[0] + 1) * (num_cells[1] + 1));
    for j in 0..=num_cells[1] {
        for i in 0..=num_cells[0] {
            // A hair inside, so that edges are lit as the face is and not as the neighbour.
            let inset = |k: usize, axis: usize| {
                (k as f64 / num_cells[axis] as f64).clamp(0.02, 0.98) * size_m[axis]
            };
            let uv = surface.on_surface([inset(i, 0), inset(j, 1)]);
            nodes.push(lighting.irradiance_at(surface, uv, bvh));
        }
    }
    LightMap {
        num_cells,
        cells_per_m: [0, 1].map(|axis: usize| num_cells[axis] as f64 / size_m[axis]),
        nodes,
    }
}

impl Surface {
    /// The nearest coordinates that lie on the surface: a disc fills only part of its square.
    fn on_surface(&self, uv: [f64; 2]) -> [f64; 2] {
        match self.shape {
            Shape::Disc { .. } => self.shape.nearest_uv(&self.shape.point_at(uv)),
            _ => uv,
        }
    }
}

impl Lighting {
    fn irradiance_at(&self, surface: &Surface, uv: [f64; 2], bvh: &Bvh) -> Linear {
        const LIFT_M: f64 = 1e-4;
        let tangents = surface.shape.tangents(uv);
        let normal = surface.world_from_local.transform_vector(&tangents.normal);
        let on_surface = Point3::from(surface.shape.point_at(uv));
        let origin = surface.world_from_local.transform_point(&on_surface) + normal * LIFT_M;
        let openness = self.openness(&origin, &normal, bvh);
        let lamp = self.lamp_share(&origin, &normal, bvh);
        #[expect(clippy::cast_possible_truncation, reason = "a cosine")]
        let down = (-normal.z).max(0.0) as f32;
        std::array::from_fn(|c| {
            (self.ambient[c] + self.bounce[c] * down) * openness + self.lamp[c] * lamp
        })
    }

    /// Cosine-weighted share of the hemisphere that is open; a body counts less the farther it
    /// is, and not at all beyond the reach.
    #[expect(clippy::cast_possible_truncation, reason = "a share in [0, 1]")]
    fn openness(&self, origin: &Point3<f64>, normal: &Vector3<f64>, bvh: &Bvh) -> f32 {
        let world_from_up =
            Rotation3::rotation_between(&Vector3::z(), normal).unwrap_or_else(|| {
                Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
            });
        let mut open = 0.0;
        for k in 0..NUM_AMBIENT_RAYS {
            // Fibonacci points of the unit disc, lifted to the hemisphere: cosine-weighted.
            let radius2 = (f64::from(k) + 0.5) / f64::from(NUM_AMBIENT_RAYS);
            let angle = 2.399_963_229_728_653 * f64::from(k);
            let direction = world_from_up
                * Vector3::new(
                    radius2.sqrt() * angle.cos(),
                    radius2.sqrt() * angle.sin(),
                    (1.0 - radius2).sqrt(),
                );
            let hit = bvh.nearest_hit(origin, &direction, [0.0, self.ambient_reach_m]);
            open += hit.map_or(1.0, |(_, hit)| (hit.t / self.ambient_reach_m).sqrt());
        }
        (open / f64::from(NUM_AMBIENT_RAYS)) as f32
    }

    /// Mean over the lamp's points of the cosine at the surface, 0 where it is hidden.
    #[expect(clippy::cast_possible_truncation, reason = "a share in [0, 1]")]
    fn lamp_share(&self, origin: &Point3<f64>, normal: &Vector3<f64>, bvh: &Bvh) -> f32 {
        let mut share = 0.0;
        for k in 0..LAMP_SIDE * LAMP_SIDE {
            let offset = |k: u32| (f64::from(k) + 0.5) / f64::from(LAMP_SIDE) * 2.0 - 1.0;
            let target = self.lamp_center_m
                + self.lamp_axes_m[0] * offset(k % LAMP_SIDE)
                + self.lamp_axes_m[1] * offset(k / LAMP_SIDE);
            let to_lamp = target - origin;
            let cosine = Unit::new_normalize(to_lamp).dot(normal);
            if cosine <= 0.0 {
                continue;
            }
            if bvh.nearest_hit(origin, &to_lamp, [0.0, 0.999]).is_none() {
                share += cosine;
            }
        }
        (share / f64::from(LAMP_SIDE * LAMP_SIDE)) as f32
    }
}
