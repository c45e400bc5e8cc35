//! How much of one view another view shows, from poses and depth alone.
//!
//! A view is stood for by a grid of points on the surface it sees. Another view shows such a point
//! when the point projects into its image at a comparable distance (so that the resolution is
//! comparable) and under a comparable direction. Occlusion is not looked at: it would need the
//! mesh, and neighbouring views are occluded alike.

use nalgebra::{Point3, Vector3};

use crate::geom::{DepthImage, FrameDepth, PinholeCamera, PosedFrame, RigidTransform};

const NUM_COLUMNS: u32 = 6;
const NUM_ROWS: u32 = 4;
/// Points that stand for a view.
pub(super) const NUM_SAMPLES: usize = (NUM_COLUMNS * NUM_ROWS) as usize;
/// Distance of what a view sees where no depth was measured, metres: across a room.
const DEFAULT_DEPTH_M: f64 = 2.0;
/// Another view is comparable up to this ratio of distances, either way.
const MAX_DISTANCE_RATIO: f64 = 2.0;
/// Another view is comparable up to 60° between the two rays.
const MIN_RAY_COSINE: f64 = 0.5;

/// A view: its camera, and points of the surface it sees.
#[derive(Clone, Debug)]
pub(super) struct View {
    camera: PinholeCamera,
    camera_from_world: RigidTransform,
    center_in_world: Point3<f64>,
    samples: [Sample; NUM_SAMPLES],
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    point_in_world: Point3<f64>,
    /// Unit, from the camera.
    ray_in_world: Vector3<f64>,
    distance_m: f64,
}

impl View {
    /// The view of a frame; `depth` is its depth image, decoded.
    pub(super) fn new(frame: &PosedFrame, depth: Option<&DepthImage>) -> Self {
        let camera = frame.color_camera.pinhole;
        let half = frame.depth.as_ref().zip(depth);
        let depths_m = sample_depths_m(&camera, half);
        let center_in_world = Point3::from(*frame.world_from_camera.translation());
        let samples = std::array::from_fn(|i| {
            let point = camera.unproject(sample_px(&camera, i), depths_m[i]);
            let point_in_world = frame.world_from_camera.transform_point(&point);
            let ray = point_in_world - center_in_world;
            let distance_m = ray.norm();
            Sample {
                point_in_world,
                ray_in_world: ray / distance_m.max(f64::MIN_POSITIVE),
                distance_m,
            }
        });
        Self {
            camera,
            camera_from_world: frame.world_from_camera.inverse(),
            center_in_world,
            samples,
        }
    }

    /// The same surface as seen from another pose of the camera.
    pub(super) fn moved_to(&self, world_from_camera: &RigidTransform) -> Self {
        let moved = *world_from_camera * self.camera_from_world;
        let center_in_world = Point3::from(*world_from_camera.translation());
        let samples = self.samples.map(|sample| {
            let point_in_world = moved.transform_point(&sample.point_in_world);
            let ray = point_in_world - center_in_world;
            Sample {
                point_in_world,
                ray_in_world: ray / sample.distance_m.max(f64::MIN_POSITIVE),
                distance_m: sample.distance_m,
            }
        });
        Self {
            camera: self.camera,
            camera_from_world: world_from_camera.inverse(),
            center_in_world,
            samples,
        }
    }

    /// Which samples of `self` another view shows, one bit each.
    pub(super) fn shown_by(&self, other: &Self) -> u32 {
        self.samples
            .iter()
            .enumerate()
            .filter(|(_, sample)| other.shows(sample))
            .fold(0, |bits, (i, _)| bits | 1 << i)
    }

    fn shows(&self, sample: &Sample) -> bool {
        let ray = sample.point_in_world - self.center_in_world;
        let distance_m = ray.norm();
        let is_comparable = distance_m <= MAX_DISTANCE_RATIO * sample.distance_m
            && sample.distance_m <= MAX_DISTANCE_RATIO * distance_m
            && ray.dot(&sample.ray_in_world) >= MIN_RAY_COSINE * distance_m;
        is_comparable
            && self
                .camera
                .project(
                    &self
                        .camera_from_world
                        .transform_point(&sample.point_in_world),
                )
                .is_some_and(|pixel| self.camera.contains(pixel))
    }
}

/// Share of `view` that at least one of `others` shows.
pub(super) fn covered_share<'a>(view: &View, others: impl Iterator<Item = &'a View>) -> f64 {
    let shown = others.fold(0, |bits, other| bits | view.shown_by(other));
    f64::from(shown.count_ones()) / NUM_SAMPLES as f64
}

fn sample_px(camera: &PinholeCamera, i: usize) -> [f64; 2] {
    let (column, row) = (
        (i % NUM_COLUMNS as usize) as f64,
        (i / NUM_COLUMNS as usize) as f64,
    );
    [
        (column + 0.5) / f64::from(NUM_COLUMNS) * f64::from(camera.width() - 1),
        (row + 0.5) / f64::from(NUM_ROWS) * f64::from(camera.height() - 1),
    ]
}

/// Measured depth at the samples; the median of the others where there is none.
fn sample_depths_m(
    camera: &PinholeCamera,
    half: Option<(&FrameDepth, &DepthImage)>,
) -> [f64; NUM_SAMPLES] {
    let measured: [Option<f64>; NUM_SAMPLES] = std::array::from_fn(|i| {
        let (half, image) = half?;
        // The rays of the two cameras differ by little where they sit side by side.
        let ray = camera.unproject(sample_px(camera, i), DEFAULT_DEPTH_M);
        let pixel = half
            .camera
            .pinhole
            .project(&half.depth_from_color.transform_point(&ray))?;
        image.nearest(pixel).map(f64::from)
    });
    let mut known: Vec<f64> = measured.iter().copied().flatten().collect();
    known.sort_by(f64::total_cmp);
    let median_m = known
        .get(known.len() / 2)
        .copied()
        .unwrap_or(DEFAULT_DEPTH_M);
    measured.map(|depth_m| depth_m.unwrap_or(median_m))
}
