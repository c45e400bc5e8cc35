//! What is truly painted where: the oracle for any texture made from a scene's recording.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};

use super::hash::Stream;
use super::options::{SceneName, SynthError};
use super::scene::Scene;
use super::surface::Surface;
use super::texture::Linear;

/// Key of the MCAP metadata record that describes a synthetic recording.
pub const METADATA_NAME: &str = "veneer_synth";
/// Version of the scenes: a bag made by another one cannot be scored.
pub(super) const SCENE_VERSION: &str = "1";

/// The known texture of a scene.
#[derive(Clone, Debug)]
pub struct GroundTruth {
    pub(super) scene: Arc<Scene>,
    cells: SurfaceCells,
    /// Per surface: rotation and translation into its local frame.
    local_from_world: Vec<(Matrix3<f64>, Vector3<f64>)>,
}

/// A point farther than this from every surface has no truth, metres.
pub const TOLERANCE_M: f64 = 0.03;
/// Cosine between a point's normal and the surface's below which they are different sides.
const MIN_COSINE: f64 = 0.25;

/// A matched surface point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    pub(super) surface: usize,
    uv_m: [f64; 2],
}

impl GroundTruth {
    /// The truth of a scene and a seed, built anew.
    pub fn new(scene: SceneName, seed: u64) -> Self {
        Self::of(Arc::new(scene.build(seed)))
    }

    pub(super) fn of(scene: Arc<Scene>) -> Self {
        let cells = SurfaceCells::new(&scene.surfaces);
        let local_from_world = scene
            .surfaces
            .iter()
            .map(|surface| {
                let local_from_world = surface.world_from_local.inverse();
                let rotation = local_from_world.rotation().to_rotation_matrix();
                (rotation.into_inner(), *local_from_world.translation())
            })
            .collect();
        Self {
            scene,
            cells,
            local_from_world,
        }
    }

    /// The truth of a recording, from the metadata record named [`METADATA_NAME`].
    ///
    /// # Errors
    /// [`SynthError::Metadata`] when a field is missing, unknown, or of another version.
    pub fn from_metadata(metadata: &BTreeMap<String, String>) -> Result<Self, SynthError> {
        let field = |name: &'static str| {
            metadata.get(name).ok_or_else(|| SynthError::Metadata {
                field: name,
                value: String::new(),
            })
        };
        let version = field("scene_version")?;
        if version != SCENE_VERSION {
            return Err(SynthError::Metadata {
                field: "scene_version",
                value: version.clone(),
            });
        }
        let scene: SceneName = field("scene")?.parse()?;
        let seed = field("seed")?;
        let seed = seed.parse().map_err(|_| SynthError::Metadata {
            field: "seed",
            value: seed.clone(),
        })?;
        Ok(Self::new(scene, seed))
    }

    /// Names of the surfaces, in the order of [`super::SurfaceScore::surface`].
    pub fn surface_names(&self) -> impl Iterator<Item = &str> {
        self.scene
            .surfaces
            .iter()
            .map(|surface| surface.name.as_str())
    }

    /// The true colour, sRGB on the scale 0–255, averaged in linear light over a square of
    /// `footprint_m` on the surface nearest to the point; `None` when no surface within
    /// [`TOLERANCE_M`] faces the way `normal` points. World frame, metres.
    pub fn true_srgb(
        &self,
        point_in_world: &Point3<f64>,
        normal: &Vector3<f64>,
        footprint_m: f64,
    ) -> Option<[f32; 3]> {
        let found = self.find(point_in_world, normal)?;
        Some(self.srgb_at(found, footprint_m))
    }

    /// The surface that a point belongs to.
    pub(super) fn find(
        &self,
        point_in_world: &Point3<f64>,
        normal: &Vector3<f64>,
    ) -> Option<Match> {
        let normal = normal.try_normalize(0.0)?;
        let mut best: Option<(f64, Match)> = None;
        for &index in self.cells.near(point_in_world) {
            let surface = &self.scene.surfaces[index as usize];
            let (rotation, translation) = &self.local_from_world[index as usize];
            let point = rotation * point_in_world.coords + translation;
            let uv_m = surface.shape.nearest_uv(&point);
            let distance_m = (surface.shape.point_at(uv_m) - point).norm();
            if distance_m > TOLERANCE_M {
                continue;
            }
            let cosine = surface
                .shape
                .tangents(uv_m)
                .normal
                .dot(&(rotation * normal));
            if cosine < MIN_COSINE {
                continue;
            }
            // Where two faces are equally near (a box's edge), the normal decides.
            let cost = distance_m + 0.5 * TOLERANCE_M * (1.0 - cosine);
            if best.is_none_or(|(lowest, _)| cost < lowest) {
                let surface = index as usize;
                best = Some((cost, Match { surface, uv_m }));
            }
        }
        best.map(|(_, found)| found)
    }

    /// The point of a match on its true surface, world frame, metres.
    pub(super) fn point_of(&self, found: Match) -> Point3<f64> {
        let surface = &self.scene.surfaces[found.surface];
        let local = surface.shape.point_at(found.uv_m);
        surface
            .world_from_local
            .transform_point(&Point3::from(local))
    }

    pub(super) fn srgb_at(&self, found: Match, footprint_m: f64) -> [f32; 3] {
        let surface = &self.scene.surfaces[found.surface];
        surface.average(found.uv_m, footprint_m).map(srgb_255)
    }

    /// Random points of a surface for tests and surveys: position and normal in the world.
    pub fn sample_points(&self, num_points: u64, seed: u64) -> Vec<(Point3<f64>, Vector3<f64>)> {
        let random = Stream::new(seed, "sample points");
        let num_surfaces = self.scene.surfaces.len() as u64;
        (0..num_points)
            .map(|index| {
                let choice = random.sub(index);
                let pick = choice.bits(0) % num_surfaces.max(1);
                let surface = &self.scene.surfaces[usize::try_from(pick).unwrap_or(0)];
                let [w, h] = surface.shape.uv_size_m();
                let uv = [w * choice.uniform(1), h * choice.uniform(2)];
                let uv = surface.shape.nearest_uv(&surface.shape.point_at(uv));
                let point = Point3::from(surface.shape.point_at(uv));
                let normal = surface.shape.tangents(uv).normal;
                (
                    surface.world_from_local.transform_point(&point),
                    surface.world_from_local.transform_vector(&normal),
                )
            })
            .collect()
    }
}

#[cfg(test)]
impl GroundTruth {
    /// Whether the surface that a point belongs to faces a direction to within a cosine.
    pub(super) fn faces_head_on(
        &self,
        point: &Point3<f64>,
        direction: &Vector3<f64>,
        cosine: f64,
    ) -> bool {
        self.find(point, direction).is_some_and(|found| {
            let surface = &self.scene.surfaces[found.surface];
            let normal = surface.shape.tangents(found.uv_m).normal;
            surface
                .world_from_local
                .transform_vector(&normal)
                .dot(direction)
                > cosine
        })
    }
}

#[cfg(test)]
impl Surface {
    /// Distance from a point, metres.
    pub(super) fn distance_to(&self, point_in_world: &Point3<f64>) -> f64 {
        let point = self
            .world_from_local
            .inverse()
            .transform_point(point_in_world)
            .coords;
        (self.shape.point_at(self.shape.nearest_uv(&point)) - point).norm()
    }
}

impl Surface {
    /// Mean linear radiance over a square of the surface, metres.
    pub(super) fn average(&self, uv_m: [f64; 2], footprint_m: f64) -> Linear {
        // Four quarters keep the box narrow beside the grain, whose box average is approximate.
        const SIDE: u32 = 2;
        let share_m = footprint_m / f64::from(SIDE);
        let tangents = self.shape.tangents(uv_m);
        let per_m = [tangents.grad_u.norm(), tangents.grad_v.norm()];
        let mut sum = [0.0f32; 3];
        for k in 0..SIDE * SIDE {
            let offset = |k: u32| (f64::from(k) + 0.5 - 0.5 * f64::from(SIDE)) * share_m;
            let at = [
                uv_m[0] + offset(k % SIDE) * per_m[0],
                uv_m[1] + offset(k / SIDE) * per_m[1],
            ];
            let color = self.radiance(at, [share_m * per_m[0], share_m * per_m[1]]);
            for c in 0..3 {
                sum[c] += color[c];
            }
        }
        sum.map(|s| s / (SIDE * SIDE) as f32)
    }
}

/// sRGB on the scale 0–255, not rounded (IEC 61966-2-1).
pub(super) fn srgb_255(linear: f32) -> f32 {
    let linear = linear.clamp(0.0, 1.0);
    if linear <= 0.003_130_8 {
        255.0 * 12.92 * linear
    } else {
        255.0 * (1.055 * linear.powf(1.0 / 2.4) - 0.055)
    }
}

/// Surfaces by the cubic cells that they, widened by the tolerance, reach.
#[derive(Clone, Debug)]
struct SurfaceCells {
    low: Point3<f64>,
    num_cells: [usize; 3],
    surfaces_of_cell: Vec<Vec<u32>>,
}

const CELL_M: f64 = 0.12;

impl SurfaceCells {
    fn new(surfaces: &[Surface]) -> Self {
        let margin = Vector3::repeat(TOLERANCE_M);
        let bounds: Vec<[Point3<f64>; 2]> = surfaces
            .iter()
            .map(|surface| {
                let [low, high] = surface.world_bounds();
                [low - margin, high + margin]
            })
            .collect();
        let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
        let mut high = Point3::from(Vector3::repeat(f64::NEG_INFINITY));
        for [a, b] in &bounds {
            low = low.inf(a);
            high = high.sup(b);
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "scenes are metres wide"
        )]
        let num_cells = [0, 1, 2].map(|axis: usize| {
            ((high[axis] - low[axis]) / CELL_M).ceil().clamp(1.0, 200.0) as usize
        });
        let mut cells = Self {
            low,
            num_cells,
            surfaces_of_cell: vec![Vec::new(); num_cells.iter().product()],
        };
        for (index, [a, b]) in (0u32..).zip(&bounds) {
            let (from, to) = (cells.clamped(a), cells.clamped(b));
            for z in from[2]..=to[2] {
                for y in from[1]..=to[1] {
                    for x in from[0]..=to[0] {
                        let cell = cells.index([x, y, z]);
                        cells.surfaces_of_cell[cell].push(index);
                    }
                }
            }
        }
        cells
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.num_cells[1] + y) * self.num_cells[0] + x
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the grid; NaN becomes 0"
    )]
    fn clamped(&self, point: &Point3<f64>) -> [usize; 3] {
        [0, 1, 2].map(|axis: usize| {
            let cell = (point[axis] - self.low[axis]) / CELL_M;
            (cell.max(0.0) as usize).min(self.num_cells[axis] - 1)
        })
    }

    fn near(&self, point: &Point3<f64>) -> &[u32] {
        &self.surfaces_of_cell[self.index(self.clamped(point))]
    }
}
