//! The scene as triangles: each primitive cut at a chosen edge length, hidden parts left out, and
//! the faults that a real reconstruction has.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::mesh::{MeshError, TriMesh};

use super::bvh::Bvh;
use super::hash::Stream;
use super::options::SynthNoise;
use super::scene::Scene;
use super::surface::{Shape, Surface};

/// A surface cut into triangles, counter-clockwise seen from its visible side.
#[derive(Clone, Debug, Default)]
pub(super) struct Patch {
    pub(super) points_in_world: Vec<Point3<f64>>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Per triangle: the surface coordinates of its corners.
    pub(super) corners_uv_m: Vec<[[f64; 2]; 3]>,
}

/// Patches of all surfaces, without what lies inside other bodies.
pub(super) fn visible_patches(scene: &Scene, edge_m: f64) -> Vec<Patch> {
    let mut segments_of_body: BTreeMap<u32, u32> = BTreeMap::new();
    for surface in &scene.surfaces {
        let num = num_segments(&surface.shape, edge_m * surface.edge_scale);
        let entry = segments_of_body.entry(surface.body).or_default();
        *entry = num.max(*entry);
    }
    let bvh = Bvh::new(&scene.surfaces);
    scene
        .surfaces
        .par_iter()
        .map(|surface| {
            let segments = segments_of_body.get(&surface.body).copied().unwrap_or(24);
            let mut patch = cut(surface, edge_m * surface.edge_scale, segments);
            patch.remove_hidden(scene, &bvh);
            patch
        })
        .collect()
}

/// Corners around a round shape; a multiple of four, so that rims seen from above and from below
/// have the same corners.
fn num_segments(shape: &Shape, edge_m: f64) -> u32 {
    let radius_m = match *shape {
        Shape::Rect { .. } => return 0,
        Shape::Disc { radius_m, .. } | Shape::Sphere { radius_m } => radius_m,
        Shape::Mantle {
            top_radius_m,
            bottom_radius_m,
            ..
        } => top_radius_m.max(bottom_radius_m),
    };
    num_steps(TAU * radius_m, edge_m)
        .max(24)
        .next_multiple_of(4)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 1..=4096"
)]
fn num_steps(length_m: f64, edge_m: f64) -> u32 {
    (length_m / edge_m - 1e-9).ceil().clamp(1.0, 4096.0) as u32
}

/// How the corners of a cut grid map to surface coordinates.
struct Grid<F: Fn(f64, f64) -> [f64; 2]> {
    num_columns: u32,
    num_rows: u32,
    /// The last column is the first.
    wraps: bool,
    /// The first row, the last row is a single point.
    collapses: [bool; 2],
    /// Surface coordinates at (column, row).
    uv: F,
}

fn cut(surface: &Surface, edge_m: f64, segments: u32) -> Patch {
    let [width, height] = surface.shape.uv_size_m();
    match surface.shape {
        Shape::Rect { .. } => {
            let (nx, ny) = (num_steps(width, edge_m), num_steps(height, edge_m));
            let uv = |i: f64, j: f64| [width * i / f64::from(nx), height * j / f64::from(ny)];
            Grid {
                num_columns: nx,
                num_rows: ny,
                wraps: false,
                collapses: [false; 2],
                uv,
            }
            .cut(surface)
        }
        Shape::Mantle { .. } => {
            let rows = num_steps(height, edge_m);
            let uv = |i: f64, j: f64| {
                [
                    width * i / f64::from(segments),
                    height * j / f64::from(rows),
                ]
            };
            Grid {
                num_columns: segments,
                num_rows: rows,
                wraps: true,
                collapses: [false; 2],
                uv,
            }
            .cut(surface)
        }
        Shape::Sphere { .. } => {
            let rows = segments / 2;
            let uv = |i: f64, j: f64| {
                [
                    width * i / f64::from(segments),
                    height * j / f64::from(rows),
                ]
            };
            Grid {
                num_columns: segments,
                num_rows: rows,
                wraps: true,
                collapses: [true; 2],
                uv,
            }
            .cut(surface)
        }
        Shape::Disc {
            radius_m,
            inner_radius_m,
        } => {
            let rows = num_steps(radius_m - inner_radius_m, edge_m);
            let uv = |i: f64, j: f64| {
                let r = inner_radius_m + (radius_m - inner_radius_m) * j / f64::from(rows);
                let (sin, cos) = (TAU * i / f64::from(segments)).sin_cos();
                [radius_m + r * sin, radius_m + r * cos]
            };
            let collapses = [inner_radius_m == 0.0, false];
            Grid {
                num_columns: segments,
                num_rows: rows,
                wraps: true,
                collapses,
                uv,
            }
            .cut(surface)
        }
    }
}

impl<F: Fn(f64, f64) -> [f64; 2]> Grid<F> {
    fn cut(&self, surface: &Surface) -> Patch {
        let mut patch = Patch::default();
        let per_row = if self.wraps {
            self.num_columns
        } else {
            self.num_columns + 1
        };
        let mut row_starts = Vec::new();
        let mut num_points = 0u32;
        for j in 0..=self.num_rows {
            row_starts.push(num_points);
            let num = if self.is_collapsed(j) { 1 } else { per_row };
            for i in 0..num {
                let uv = (self.uv)(f64::from(i), f64::from(j));
                let point = Point3::from(surface.shape.point_at(uv));
                patch
                    .points_in_world
                    .push(surface.world_from_local.transform_point(&point));
            }
            num_points += num;
        }
        let index = |i: u32, j: u32| {
            let column = if self.is_collapsed(j) { 0 } else { i % per_row };
            row_starts[j as usize] + column
        };
        for j in 0..self.num_rows {
            for i in 0..self.num_columns {
                let corner = |di: u32, dj: u32| {
                    // Half-way along a row that is one point.
                    let column = if self.is_collapsed(j + dj) {
                        f64::from(i) + 0.5
                    } else {
                        f64::from(i + di)
                    };
                    (index(i + di, j + dj), (self.uv)(column, f64::from(j + dj)))
                };
                let [a, b, c, d] = [corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0)];
                for triangle in [[a, b, c], [a, c, d]] {
                    let ids = triangle.map(|(id, _)| id);
                    if ids[0] != ids[1] && ids[1] != ids[2] && ids[2] != ids[0] {
                        patch.triangles.push(ids);
                        patch.corners_uv_m.push(triangle.map(|(_, uv)| uv));
                    }
                }
            }
        }
        patch
    }

    fn is_collapsed(&self, row: u32) -> bool {
        (row == 0 && self.collapses[0]) || (row == self.num_rows && self.collapses[1])
    }
}

impl Patch {
    fn remove_hidden(&mut self, scene: &Scene, bvh: &Bvh) {
        let is_visible: Vec<bool> = self
            .triangles
            .iter()
            .map(|triangle| !self.is_hidden(triangle, scene, bvh))
            .collect();
        let mut keep = is_visible.iter();
        self.triangles
            .retain(|_| keep.next().copied().unwrap_or(true));
        let mut keep = is_visible.iter();
        self.corners_uv_m
            .retain(|_| keep.next().copied().unwrap_or(true));
    }

    /// Whether the air just above the triangle is inside bodies, or is a gap too narrow for any
    /// scanner, at its middle and near its corners.
    fn is_hidden(&self, triangle: &[u32; 3], scene: &Scene, bvh: &Bvh) -> bool {
        const LIFT_M: f64 = 5e-4;
        const GAP_M: f64 = 0.025;
        let [a, b, c] = triangle.map(|v| self.points_in_world[v as usize]);
        let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else {
            return false;
        };
        let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0) + normal * LIFT_M;
        let near_corner =
            |corner: Point3<f64>| middle + (corner - a + (a - middle) + normal * LIFT_M) * 0.9;
        [middle, near_corner(a), near_corner(b), near_corner(c)]
            .iter()
            .all(|point| {
                scene.solids.iter().any(|solid| solid.contains(point))
                    || bvh.nearest_hit(point, &normal, [0.0, GAP_M]).is_some()
            })
    }
}

/// The scene's mesh with the faults of `noise`; surfaces of one body share vertices.
///
/// # Errors
/// [`MeshError`] when there are more vertices than indices can name.
pub(super) fn scene_mesh(
    scene: &Scene,
    edge_m: f64,
    noise: &SynthNoise,
    seed: u64,
) -> Result<TriMesh, MeshError> {
    let patches = visible_patches(scene, edge_m);
    let mut soup = Soup::default();
    for (surface, patch) in scene.surfaces.iter().zip(&patches) {
        soup.add(surface.body, patch);
    }
    if noise.double_walls > 0 {
        soup.add_double_walls(scene, &patches, noise, seed);
    }
    let missing = Stream::new(seed, "missing faces");
    let mut number = 0;
    soup.triangles.retain(|_| {
        number += 1;
        missing.uniform(number) >= noise.missing_faces
    });
    let jitter = Stream::new(seed, "mesh vertices");
    if noise.mesh_vertex_m > 0.0 {
        for (index, point) in (0u64..).zip(&mut soup.points) {
            let axis = |k: u64| jitter.gaussian(3 * index + k);
            *point += Vector3::new(axis(0), axis(1), axis(2)) * noise.mesh_vertex_m;
        }
    }
    TriMesh::from_soup(soup.points, soup.triangles).map(|(mesh, _)| mesh)
}

#[derive(Default)]
struct Soup {
    points: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    /// Vertices of a body by their position in micrometres.
    by_position: BTreeMap<(u32, [i64; 3]), u32>,
}

impl Soup {
    fn add(&mut self, body: u32, patch: &Patch) {
        for triangle in &patch.triangles {
            let corners = triangle.map(|v| self.vertex(body, patch.points_in_world[v as usize]));
            self.triangles.push(corners);
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "scenes are metres wide, and TriMesh refuses too many vertices"
    )]
    fn vertex(&mut self, body: u32, point: Point3<f64>) -> u32 {
        let key = [point.x, point.y, point.z].map(|v| (v * 1e6).round() as i64);
        *self.by_position.entry((body, key)).or_insert_with(|| {
            self.points.push(point);
            (self.points.len() - 1) as u32
        })
    }

    /// Repeats part of some walls a little before or behind them, as a drifting pose does.
    fn add_double_walls(
        &mut self,
        scene: &Scene,
        patches: &[Patch],
        noise: &SynthNoise,
        seed: u64,
    ) {
        const MIN_AREA_M2: f64 = 0.25;
        let choice = Stream::new(seed, "double walls");
        let large: Vec<usize> = scene
            .surfaces
            .iter()
            .enumerate()
            .filter(|(_, surface)| {
                let [w, h] = surface.shape.uv_size_m();
                matches!(surface.shape, Shape::Rect { .. }) && w * h >= MIN_AREA_M2
            })
            .map(|(index, _)| index)
            .collect();
        for number in 0..u64::from(noise.double_walls) {
            let choice = choice.sub(number);
            let pick = choice.bits(0) % large.len().max(1) as u64;
            let Some(&index) = usize::try_from(pick).ok().and_then(|pick| large.get(pick)) else {
                return;
            };
            let (surface, patch) = (&scene.surfaces[index], &patches[index]);
            let [w, h] = surface.shape.uv_size_m();
            let low = [w * choice.range(1, 0.0, 0.5), h * choice.range(2, 0.0, 0.5)];
            let side = if choice.uniform(3) < 0.5 { -1.0 } else { 1.0 };
            let inward = surface.world_from_local.transform_vector(&Vector3::z());
            let shift = inward * (side * noise.double_wall_offset_m);
            let mut ghost = Patch {
                points_in_world: patch.points_in_world.iter().map(|p| p + shift).collect(),
                ..Patch::default()
            };
            for (triangle, corners) in patch.triangles.iter().zip(&patch.corners_uv_m) {
                let inside = corners.iter().all(|[u, v]| {
                    (low[0]..=low[0] + 0.5 * w).contains(u)
                        && (low[1]..=low[1] + 0.5 * h).contains(v)
                });
                if inside {
                    ghost.triangles.push(*triangle);
                }
            }
            // Bodies of their own, beyond those of the scene.
            let body = u32::MAX - u32::try_from(number).unwrap_or(u32::MAX / 2);
            self.add(body, &ghost);
        }
    }
}
