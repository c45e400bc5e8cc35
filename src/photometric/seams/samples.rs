//! Edges between labels, and the colours on their two sides.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::atlas::{AtlasTexture, TexelSource};
use crate::geom::color::linear_from_srgb;
use crate::geom::{ColorImage, PinholeCamera, RigidTransform};
use crate::mesh::adjacency::EdgeTable;

use super::super::PhotometricError;
use super::SeamParams;
use super::nodes::Nodes;
use super::surface::Surface;

/// Samples along an edge.
const MIN_SAMPLES: usize = 3;
const MAX_SAMPLES: usize = 48;

/// Texels of an edge for each sample.
const TEXELS_PER_SAMPLE: f32 = 1.5;

/// How far inside a triangle colours are read, texels; from both the colour at the edge is
/// extrapolated, so that a gradient across it is no step.
const NEAR_TEXEL: f32 = 0.75;
const FAR_TEXEL: f32 = 2.25;

/// One side of a seam.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    pub(super) triangle: u32,
    /// The triangle's corners at the seam's start and end.
    pub(super) corners: [usize; 2],
}

/// An edge between triangles of two labels.
#[derive(Clone, Debug)]
pub(super) struct Seam {
    pub(super) sides: [Side; 2],
    /// Its vertices.
    pub(super) ends: [u32; 2],
    pub(super) length_m: f64,
    num_samples: usize,
    /// Colour of the second side less that of the first, linear, at (k + ½) / n of the way; `None`
    /// where one side is not there or the step is too large.
    pub(super) steps: Vec<Option<[f32; 3]>>,
    /// Of each step, how large it may be by chance (one standard deviation): the surface's own
    /// colours, seen through poses and a mesh that are not exact. 0 where that is not known.
    pub(super) doubts: Vec<f32>,
}

impl Seam {
    /// Share of the way from start to end of a sample.
    pub(super) fn share_of(&self, sample: usize) -> f64 {
        (sample as f64 + 0.5) / self.num_samples as f64
    }
}

/// The seams in the order of the edges; of edges with more than two triangles, between each and
/// the next.
pub(super) fn find_seams(surface: &Surface<'_>) -> Result<Vec<Seam>, PhotometricError> {
    let (mesh, labels) = (surface.mesh, surface.labels);
    let table = EdgeTable::new(mesh.triangles(), mesh.num_vertices())?;
    let mut seams = Vec::new();
    for half_edges in table.edges() {
        for pair in half_edges.windows(2) {
            let triangles = [pair[0] / 3, pair[1] / 3].map(|t| t as usize);
            let is_seam = labels[triangles[0]] != labels[triangles[1]]
                && triangles.iter().all(|t| surface.sources[*t].is_some());
            if is_seam {
                seams.push(seam(surface, [pair[0], pair[1]]));
            }
        }
    }
    Ok(seams)
}

fn seam(surface: &Surface<'_>, half_edges: [u32; 2]) -> Seam {
    let mesh = surface.mesh;
    let side = |half_edge: u32| {
        let corner = half_edge as usize % 3;
        Side {
            triangle: half_edge / 3,
            corners: [corner, (corner + 1) % 3],
        }
    };
    let mut sides = half_edges.map(side);
    let vertex =
        |side: &Side, end: usize| mesh.triangles()[side.triangle as usize][side.corners[end]];
    let ends = [0, 1].map(|end| vertex(&sides[0], end));
    if vertex(&sides[1], 0) != ends[0] {
        sides[1].corners.reverse();
    }
    let [start_m, end_m] = ends.map(|v| mesh.positions_m()[v as usize]);
    let length_texel = sides
        .iter()
        .map(|side| {
            let corners = surface.corners_texel(side.triangle);
            let [a, b] = side.corners.map(|k| corners[k]);
            (b[0] - a[0]).hypot(b[1] - a[1])
        })
        .fold(0.0, f32::max);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped; a float that is not finite becomes 0 or the largest"
    )]
    let num_samples = ((length_texel / TEXELS_PER_SAMPLE) as usize).clamp(MIN_SAMPLES, MAX_SAMPLES);
    Seam {
        sides,
        ends,
        length_m: (end_m - start_m).norm(),
        num_samples,
        steps: vec![None; num_samples],
        doubts: vec![0.0; num_samples],
    }
}

/// Reads the steps of all seams anew.
pub(super) fn sample(
    seams: &mut [Seam],
    surface: &Surface<'_>,
    texture: &AtlasTexture,
    max_step: f64,
) {
    seams.par_iter_mut().for_each(|seam| {
        for k in 0..seam.num_samples {
            let share = seam.share_of(k);
            let color = |side: &Side| {
                let source = surface.sources[side.triangle as usize]?;
                color_at_edge(side, share, surface, source, texture)
            };
            let [first, second] = &seam.sides;
            let step = color(first)
                .zip(color(second))
                .map(|(first, second)| std::array::from_fn(|c| second[c] - first[c]));
            seam.steps[k] =
                step.filter(|step: &[f32; 3]| step.iter().all(|s| f64::from(s.abs()) <= max_step));
        }
    });
}

/// A keyframe's photo as seams look at it: small, so that a pixel is a mean over its surroundings.
#[derive(Clone, Debug)]
pub struct SeamPhoto {
    /// The photo, reduced.
    pub color: ColorImage,
    /// Its camera.
    pub camera: PinholeCamera,
    /// Its pose.
    pub camera_from_world: RigidTransform,
}

/// Takes the steps from the photos instead: both show the points of the edge, so that a change of
/// the surface's own colour there is in both and no step.
pub(super) fn sample_photos(
    seams: &mut [Seam],
    surface: &Surface<'_>,
    photos: &[Option<SeamPhoto>],
    params: &SeamParams,
) {
    let (mesh, labels) = (surface.mesh, surface.labels);
    let max_step = params.max_step;
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let misplaced_px = params.misplaced_px as f32;
    seams.par_iter_mut().for_each(|seam| {
        let photo_of = |side: &Side| {
            let label = labels[side.triangle as usize]?;
            photos.get(label as usize)?.as_ref()
        };
        let photos = (photo_of(&seam.sides[0]), photo_of(&seam.sides[1]));
        let [start_m, end_m] = seam.ends.map(|v| mesh.positions_m()[v as usize]);
        for k in 0..seam.num_samples {
            let point_m = start_m + (end_m - start_m) * seam.share_of(k);
            let seen = match photos {
                (Some(first), Some(second)) => {
                    first.linear_at(&point_m).zip(second.linear_at(&point_m))
                }
                _ => None,
            };
            let step = seen.map(|((first, _), (second, _))| {
                std::array::from_fn::<f32, 3, _>(|c| second[c] - first[c])
            });
            seam.steps[k] = step.filter(|step| step.iter().all(|s| f64::from(s.abs()) <= max_step));
            seam.doubts[k] = seen.map_or(0.0, |((_, first), (_, second))| {
                (first * first + second * second).sqrt() * misplaced_px + STEP_NOISE
            });
        }
    });
}

/// Linear light by which two photos differ without a reason.
const STEP_NOISE: f32 = 0.002;

/// The share of a mean step that is believed, by the square of its doubt (the positive part of
/// James and Stein's estimator).
pub(super) fn belief(step: &[f64; 3], variance: f64) -> f64 {
    let square = step.iter().map(|s| s * s).sum::<f64>() / 3.0;
    if variance <= 0.0 {
        1.0
    } else {
        (1.0 - variance / square.max(f64::MIN_POSITIVE)).max(0.0)
    }
}

/// Lowers each step by the doubt about it.
pub(super) fn shrink(seams: &mut [Seam]) {
    for seam in seams {
        for (step, doubt) in seam.steps.iter_mut().zip(&seam.doubts) {
            if let Some(step) = step {
                let share = belief(&step.map(f64::from), f64::from(*doubt).powi(2));
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
                step.iter_mut().for_each(|s| *s *= share as f32);
            }
        }
    }
}

impl SeamPhoto {
    /// Linear colour where a point lands, and how much it changes per pixel there; `None` outside the
    /// photo, or where it is clipped.
    fn linear_at(&self, point_m: &Point3<f64>) -> Option<([f32; 3], f32)> {
        let pixel = self
            .camera
            .project(&self.camera_from_world.transform_point(point_m))?;
        if !self.camera.contains(pixel) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let [x, y] = pixel.map(|px| px as f32);
        let srgb = self.color.sample_bilinear([x, y]);
        let is_clipped = srgb.iter().any(|value| *value > 250.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a mean of bytes"
        )]
        let linear = |srgb: [f32; 3]| srgb.map(|value| linear_from_srgb((value + 0.5) as u8));
        let beside = |dx: f32, dy: f32| {
            let at = [x + dx, y + dy];
            linear(self.color.sample_bilinear(at))
        };
        let slope = |a: [f32; 3], b: [f32; 3]| {
            let square: f32 = a.iter().zip(&b).map(|(a, b)| (a - b) * (a - b)).sum();
            square / 12.0
        };
        let across = slope(beside(-1.0, 0.0), beside(1.0, 0.0));
        let down = slope(beside(0.0, -1.0), beside(0.0, 1.0));
        (!is_clipped).then(|| (linear(srgb), (across + down).sqrt()))
    }
}

/// Adds what the global correction has done to the steps.
pub(super) fn add_corrections(seams: &mut [Seam], nodes: &Nodes, corrections: &[[f32; 3]]) {
    for seam in seams {
        let at = |side: &Side, end: usize| {
            let node = nodes.of(side.triangle)[side.corners[end]];
            corrections.get(node as usize).copied().unwrap_or([0.0; 3])
        };
        let [first, second] = [0, 1].map(|side| {
            let side = &seam.sides[side];
            [at(side, 0), at(side, 1)]
        });
        for k in 0..seam.num_samples {
            #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
            let share = seam.share_of(k) as f32;
            if let Some(step) = &mut seam.steps[k] {
                for (c, step) in step.iter_mut().enumerate() {
                    let between =
                        |ends: &[[f32; 3]; 2]| ends[0][c] + share * (ends[1][c] - ends[0][c]);
                    *step += between(&second) - between(&first);
                }
            }
        }
    }
}

/// The colour of a side at its edge; `None` where its label does not show there.
fn color_at_edge(
    side: &Side,
    share: f64,
    surface: &Surface<'_>,
    source: TexelSource,
    texture: &AtlasTexture,
) -> Option<[f32; 3]> {
    let corners = surface.corners_texel(side.triangle);
    let page = texture.pages.get(surface.page_of(side.triangle) as usize)?;
    let [start, end] = side.corners.map(|k| corners[k]);
    let apex = corners[3 - side.corners[0] - side.corners[1]];
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let share = share as f32;
    let edge = [0, 1].map(|axis| start[axis] + (end[axis] - start[axis]) * share);
    let along = [end[0] - start[0], end[1] - start[1]];
    let across = [apex[0] - start[0], apex[1] - start[1]];
    let height_texel =
        (along[0] * across[1] - along[1] * across[0]).abs() / along[0].hypot(along[1]);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "negative and not finite ones become 0, large ones are not on the page"
    )]
    let inside = |depth_texel: f32| -> Option<(f32, [f32; 3])> {
        let part = depth_texel / height_texel;
        let [x, y] = [0, 1].map(|axis| edge[axis] + (apex[axis] - edge[axis]) * part);
        let (x, y) = (x as u32, y as u32);
        if x >= page.width || y >= page.height {
            return None;
        }
        let index = y as usize * page.width as usize + x as usize;
        let centre = [x as f32 + 0.5 - start[0], y as f32 + 0.5 - start[1]];
        let depth_texel =
            (along[0] * centre[1] - along[1] * centre[0]).abs() / along[0].hypot(along[1]);
        (page.source[index] == source)
            .then(|| (depth_texel, page.srgb[index].map(linear_from_srgb)))
    };
    if height_texel.is_nan() || height_texel < 1.0 {
        return None;
    }
    let (near_texel, near) = inside(NEAR_TEXEL)?;
    if height_texel < 1.5 * FAR_TEXEL {
        return Some(near);
    }
    match inside(FAR_TEXEL) {
        Some((far_texel, far)) if far_texel - near_texel > 0.5 => {
            let slope = near_texel / (far_texel - near_texel);
            Some(std::array::from_fn(|c| {
                near[c] - (far[c] - near[c]) * slope
            }))
        }
        _ => Some(near),
    }
}

/// Mean absolute step of the seams that are levelled now, weighted by length: of each seam the step
/// of its mean colours.
pub(super) fn mean_step(seams: &[Seam], surface: &Surface<'_>) -> f64 {
    let (mut sum, mut total_m) = (0.0, 0.0);
    let is_levelled = |seam: &&Seam| {
        let mut sides = seam.sides.iter();
        sides.any(|side| surface.is_levelled(side.triangle))
    };
    for seam in seams.iter().filter(is_levelled) {
        let mut mean = [0.0; 3];
        let mut num_valid = 0.0;
        for step in seam.steps.iter().flatten() {
            num_valid += 1.0;
            for c in 0..3 {
                mean[c] += f64::from(step[c]);
            }
        }
        if num_valid > 0.0 {
            sum += seam.length_m * mean.iter().map(|m| (m / num_valid).abs()).sum::<f64>() / 3.0;
            total_m += seam.length_m;
        }
    }
    if total_m > 0.0 { sum / total_m } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE_PX: u32 = 20;

    /// A photo along z whose bytes are a function of the column.
    fn photo(byte: impl Fn(u32) -> u8) -> SeamPhoto {
        let middle_px = 0.5 * f64::from(SIDE_PX - 1);
        let pixels = (0..SIDE_PX * SIDE_PX).map(|i| [byte(i % SIDE_PX); 3]);
        SeamPhoto {
            color: ColorImage::new(SIDE_PX, SIDE_PX, pixels.collect()).unwrap(),
            camera: PinholeCamera::new([10.0, 10.0, middle_px, middle_px], SIDE_PX, SIDE_PX)
                .unwrap(),
            camera_from_world: RigidTransform::identity(),
        }
    }

    #[test]
    fn the_slope_is_that_of_linear_light_per_pixel() {
        let ahead_m = Point3::new(0.0, 0.0, 1.0);
        let (_, flat) = photo(|_| 90).linear_at(&ahead_m).unwrap();
        assert_eq!(flat, 0.0);
        // Over the two columns around 9.5, from 8.5 to 10.5, where bytes are halfway.
        let (_, slope) = photo(|x| (10 * x) as u8).linear_at(&ahead_m).unwrap();
        let rise = linear_from_srgb(105) - linear_from_srgb(85);
        assert!((slope - rise / 2.0).abs() < 1e-6, "{slope} {rise}");
        assert!(photo(|_| 255).linear_at(&ahead_m).is_none());
    }

    #[test]
    fn a_step_is_believed_as_far_as_it_exceeds_its_doubt() {
        let step = [0.04f64; 3];
        assert_eq!(belief(&step, 0.0), 1.0);
        assert_eq!(belief(&step, 0.04f64.powi(2) * 1.01), 0.0);
        let half = belief(&step, 0.5 * 0.04f64.powi(2));
        assert!((half - 0.5).abs() < 1e-12, "{half}");
    }
}
