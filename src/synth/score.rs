//! How far a painted atlas is from the truth, texel by texel.

use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use crate::atlas::{AtlasLayout, AtlasTexture, TexturePage};
use crate::mesh::{TriMesh, TriangleId};

use super::sight::{PaintingView, Sight};
use super::truth::{GroundTruth, Match};

/// Errors of a texture against the truth. Errors are absolute differences of sRGB values on the
/// scale 0–255, the mean over the three channels of each texel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Texels that a keyframe painted and that have a true colour: all errors are over these.
    pub num_seen_texels: u64,
    /// Texels that a keyframe painted although no camera sees the true surface there: it lies
    /// against another, nearer than any scan could tell. They are in no error.
    pub num_hidden_texels: u64,
    /// Texels that a keyframe painted where no surface of the scene is (ghost walls, noise).
    pub num_unmatched_texels: u64,
    /// Texels whose centre a triangle covers, whoever painted them.
    pub num_covered_texels: u64,
    /// Mean absolute error.
    pub mean_abs_error_255: f64,
    /// Root of the mean squared error over channels.
    pub rms_error_255: f64,
    /// Absolute error that 50, 90, 95 and 99 % of the texels stay under (bins of a quarter).
    pub percentiles_255: Percentiles,
    /// Share of the mesh's area whose texels a keyframe painted, in [0, 1].
    pub seen_area_share: f64,
    /// Per surface with seen texels, the largest total error first.
    pub surfaces: Vec<SurfaceScore>,
}

/// Percentiles of the absolute error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 90 %.
    pub p90: f64,
    /// 95 %.
    pub p95: f64,
    /// 99 %.
    pub p99: f64,
}

/// The error on one surface.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SurfaceScore {
    /// Index of the surface in the scene.
    pub surface: usize,
    /// Its name.
    pub name: String,
    /// Seen texels on it.
    pub num_texels: u64,
    /// Mean absolute error on it.
    pub mean_abs_error_255: f64,
}

const BINS_PER_UNIT: f64 = 4.0;
const NUM_BINS: usize = 255 * 4 + 1;
/// Triangles to a parallel piece; fixed, so that sums do not depend on the thread count.
const CHUNK_TRIANGLES: usize = 1024;

#[derive(Clone)]
struct Tally {
    num_hidden: u64,
    num_unmatched: u64,
    num_covered: u64,
    abs_sum: f64,
    square_sum: f64,
    bins: Vec<u64>,
    seen_area_m2: f64,
    area_m2: f64,
    /// Per surface: texels and sum of errors.
    surfaces: Vec<(u64, f64)>,
}

/// Compares each texel that a keyframe painted, and some view truly shows, with the truth at the
/// texel's own size; without `views`, every painted texel counts. The mesh,
/// in the frame of the recording, is the one that `layout` places; a texel on the common edge of
/// two triangles counts for both.
pub fn score(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &AtlasTexture,
    truth: &GroundTruth,
    views: &[PaintingView],
) -> Score {
    let sight = Sight::new(&truth.scene.surfaces, views);
    let num_surfaces = truth.scene.surfaces.len();
    let triangles: Vec<TriangleId> = mesh.triangle_ids().collect();
    let tallies: Vec<Tally> = triangles
        .par_chunks(CHUNK_TRIANGLES)
        .map(|chunk| {
            let mut tally = Tally::new(num_surfaces);
            for &triangle in chunk {
                tally.add_triangle(triangle, mesh, layout, texture, truth, &sight);
            }
            tally
        })
        .collect();
    let mut total = Tally::new(num_surfaces);
    for tally in &tallies {
        total.merge(tally);
    }
    total.finish(truth)
}

impl Tally {
    fn new(num_surfaces: usize) -> Self {
        Self {
            num_hidden: 0,
            num_unmatched: 0,
            num_covered: 0,
            abs_sum: 0.0,
            square_sum: 0.0,
            bins: vec![0; NUM_BINS],
            seen_area_m2: 0.0,
            area_m2: 0.0,
            surfaces: vec![(0, 0.0); num_surfaces],
        }
    }

    fn add_triangle(
        &mut self,
        triangle: TriangleId,
        mesh: &TriMesh,
        layout: &AtlasLayout,
        texture: &AtlasTexture,
        truth: &GroundTruth,
        sight: &Sight,
    ) {
        let area_m2 = mesh.area_m2(triangle);
        self.area_m2 += area_m2;
        let Some(corners) = layout.corners_texel.get(triangle.index()) else {
            return;
        };
        let corners = corners.map(|corner| corner.map(f64::from));
        let area_texel2 = 0.5 * doubled_area(corners[0], corners[1], corners[2]).abs();
        let Some(page) = texture.pages.get(layout.page_of(triangle) as usize) else {
            return;
        };
        if !(area_texel2 > 0.0 && area_m2 > 0.0) {
            return;
        }
        let footprint_m = (area_m2 / area_texel2).sqrt();
        let points = mesh.corners_m(triangle);
        let normal = mesh.scaled_normal(triangle);
        let (mut num_covered, mut num_seen) = (0u32, 0u32);
        for_each_covered(corners, page, |at, [a, b, c]| {
            num_covered += 1;
            let Some(painter) = page.source[at].as_keyframe() else {
                return;
            };
            num_seen += 1;
            let point =
                Point3::from(points[0].coords * a + points[1].coords * b + points[2].coords * c);
            let Some(found) = truth.find(&point, &normal) else {
                self.num_unmatched += 1;
                return;
            };
            if sight.is_seen(&truth.point_of(found), painter) {
                self.add_texel(page.srgb[at], found, footprint_m, truth);
            } else {
                self.num_hidden += 1;
            }
        });
        self.num_covered += u64::from(num_covered);
        if num_covered > 0 {
            self.seen_area_m2 += area_m2 * f64::from(num_seen) / f64::from(num_covered);
        }
    }

    fn add_texel(&mut self, srgb: [u8; 3], found: Match, footprint_m: f64, truth: &GroundTruth) {
        let expected = truth.srgb_at(found, footprint_m);
        let differences: [f64; 3] =
            std::array::from_fn(|k| f64::from(srgb[k]) - f64::from(expected[k]));
        let error = differences.iter().map(|d| d.abs()).sum::<f64>() / 3.0;
        self.abs_sum += error;
        self.square_sum += differences.iter().map(|d| d * d).sum::<f64>() / 3.0;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "errors are in 0..=255"
        )]
        let bin = ((error * BINS_PER_UNIT) as usize).min(NUM_BINS - 1);
        self.bins[bin] += 1;
        let (num, sum) = &mut self.surfaces[found.surface];
        *num += 1;
        *sum += error;
    }

    fn merge(&mut self, other: &Self) {
        self.num_hidden += other.num_hidden;
        self.num_unmatched += other.num_unmatched;
        self.num_covered += other.num_covered;
        self.abs_sum += other.abs_sum;
        self.square_sum += other.square_sum;
        self.seen_area_m2 += other.seen_area_m2;
        self.area_m2 += other.area_m2;
        for (mine, theirs) in self.bins.iter_mut().zip(&other.bins) {
            *mine += theirs;
        }
        for (mine, theirs) in self.surfaces.iter_mut().zip(&other.surfaces) {
            mine.0 += theirs.0;
            mine.1 += theirs.1;
        }
    }

    fn finish(self, truth: &GroundTruth) -> Score {
        let num_seen_texels: u64 = self.bins.iter().sum();
        let per_texel = 1.0 / num_seen_texels.max(1) as f64;
        let mut surfaces: Vec<SurfaceScore> = self
            .surfaces
            .iter()
            .enumerate()
            .filter(|(_, (num, _))| *num > 0)
            .map(|(surface, (num, sum))| SurfaceScore {
                surface,
                name: truth.scene.surfaces[surface].name.clone(),
                num_texels: *num,
                mean_abs_error_255: sum / *num as f64,
            })
            .collect();
        let total = |s: &SurfaceScore| s.mean_abs_error_255 * s.num_texels as f64;
        surfaces.sort_by(|a, b| {
            total(b)
                .total_cmp(&total(a))
                .then(a.surface.cmp(&b.surface))
        });
        Score {
            num_seen_texels,
            num_hidden_texels: self.num_hidden,
            num_unmatched_texels: self.num_unmatched,
            num_covered_texels: self.num_covered,
            mean_abs_error_255: self.abs_sum * per_texel,
            rms_error_255: (self.square_sum * per_texel).sqrt(),
            percentiles_255: Percentiles {
                p50: percentile(&self.bins, num_seen_texels, 0.50),
                p90: percentile(&self.bins, num_seen_texels, 0.90),
                p95: percentile(&self.bins, num_seen_texels, 0.95),
                p99: percentile(&self.bins, num_seen_texels, 0.99),
            },
            seen_area_share: if self.area_m2 > 0.0 {
                self.seen_area_m2 / self.area_m2
            } else {
                0.0
            },
            surfaces,
        }
    }
}

/// Upper end of the bin in which the share is reached.
fn percentile(bins: &[u64], num: u64, share: f64) -> f64 {
    let wanted = share * num as f64;
    let mut so_far = 0;
    for (index, count) in bins.iter().enumerate() {
        so_far += count;
        if so_far > 0 && so_far as f64 >= wanted {
            return (index + 1) as f64 / BINS_PER_UNIT;
        }
    }
    0.0
}

/// Calls with the index on the page and the barycentric weights of each texel centre inside.
fn for_each_covered(
    corners: [[f64; 2]; 3],
    page: &TexturePage,
    mut call: impl FnMut(usize, [f64; 3]),
) {
    let [a, b, c] = corners;
    let inverse = 1.0 / doubled_area(a, b, c);
    let range = |axis: usize, size: u32| {
        let values = [a[axis], b[axis], c[axis]];
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let max = f64::from(size);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the page; NaN becomes 0"
        )]
        let range = low.floor().clamp(0.0, max) as u32..high.ceil().clamp(0.0, max) as u32;
        range
    };
    for y in range(1, page.height) {
        for x in range(0, page.width) {
            let centre = [f64::from(x) + 0.5, f64::from(y) + 0.5];
            let weights = [
                doubled_area(centre, b, c) * inverse,
                doubled_area(a, centre, c) * inverse,
                doubled_area(a, b, centre) * inverse,
            ];
            if weights.iter().all(|w| *w >= 0.0) {
                call(y as usize * page.width as usize + x as usize, weights);
            }
        }
    }
}

fn doubled_area(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}
