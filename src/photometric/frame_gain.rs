//! The gain of a keyframe that comes to others whose gains stand.
//!
//! While a scan grows, gains cannot all be solved for anew with each keyframe: everything painted would
//! change. Here a keyframe is compared with a few that are there, once, and keeps what comes out.
//! The points are those of its own depth image, a grid of pixels; another keyframe shows a point
//! where its own depth image has it, too. No mesh is needed, and the cost does not grow with the scan.
//!
//! Unknown is one factor per channel, in linear light. The logarithm of the ratio to each other
//! keyframe's colour (with its gain) is averaged with Cauchy's weights around the median, once per
//! point, and drawn to gain 1 by [`GainParams::prior_samples`].

use nalgebra::Point3;

use crate::keyframe::{DecodedFrame, Keyframe};

use super::gain::GainParams;
use super::points::window_mean;

/// Points along the longer side of the image.
const GRID_COLUMNS: u32 = 96;
/// Depths that differ by a larger share are of different surfaces.
const MAX_DEPTH_DIFFERENCE: f64 = 0.02;
/// With fewer points in common nothing is said.
const MIN_POINTS: usize = 40;
/// Rounds of reweighting.
const NUM_SWEEPS: usize = 5;

/// A keyframe as it was photographed, and its gain.
#[derive(Clone, Copy, Debug)]
pub struct GainedFrame<'a> {
    /// Its pose.
    pub keyframe: &'a Keyframe,
    /// Its images, colours as photographed.
    pub decoded: &'a DecodedFrame,
    /// What its linear light is multiplied by.
    pub factors: [f32; 3],
}

/// What the linear light of a keyframe is to be multiplied by, so that it shows what `others` show in
/// the same colours; `None` where too little is in common, or it has no depth image.
pub fn gain_of_frame(
    keyframe: &Keyframe,
    decoded: &DecodedFrame,
    others: &[GainedFrame<'_>],
    params: &GainParams,
) -> Option<[f32; 3]> {
    let points = grid_points(keyframe, decoded, params)?;
    let mut ratios: Vec<[f64; 3]> = Vec::new();
    for point in &points {
        ratios.extend(mean_ratio(point, others, params));
    }
    if ratios.len() < MIN_POINTS {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let factors = robust_mean(&ratios, params).map(|log| log.exp() as f32);
    Some(factors)
}

/// A point of the surface and what the new keyframe shows there.
struct GridPoint {
    in_world: Point3<f64>,
    log_linear: [f64; 3],
}

/// The points at a grid of pixels of the depth image; `None` without one.
fn grid_points(
    keyframe: &Keyframe,
    decoded: &DecodedFrame,
    params: &GainParams,
) -> Option<Vec<GridPoint>> {
    let depth = decoded.depth.as_ref()?;
    let color_from_depth = depth.depth_from_color.inverse();
    let (width, height) = (depth.camera.width(), depth.camera.height());
    let step_px = width.max(height).div_ceil(GRID_COLUMNS);
    let mut points = Vec::new();
    for y in (step_px / 2..height).step_by(step_px as usize) {
        for x in (step_px / 2..width).step_by(step_px as usize) {
            let at_px = [f64::from(x), f64::from(y)];
            let Some(depth_m) = depth.image.nearest(at_px) else {
                continue;
            };
            let in_depth = depth.camera.unproject(at_px, f64::from(depth_m));
            let in_color = color_from_depth.transform_point(&in_depth);
            if let Some(log_linear) = log_linear(decoded, &in_color, params) {
                points.push(GridPoint {
                    in_world: keyframe.world_from_camera.transform_point(&in_color),
                    log_linear,
                });
            }
        }
    }
    Some(points)
}

/// Logarithm of what the others show over what the new one shows, by channel: the mean over those that
/// see the point.
fn mean_ratio(
    point: &GridPoint,
    others: &[GainedFrame<'_>],
    params: &GainParams,
) -> Option<[f64; 3]> {
    let mut sum = [0.0; 3];
    let mut num = 0.0;
    for other in others {
        let Some(seen) = seen_by(other, point, params) else {
            continue;
        };
        for c in 0..3 {
            sum[c] += seen[c] + f64::from(other.factors[c]).ln() - point.log_linear[c];
        }
        num += 1.0;
    }
    (num > 0.0).then(|| sum.map(|sum| sum / num))
}

/// The point's colour in another keyframe, where that measured it.
fn seen_by(other: &GainedFrame<'_>, point: &GridPoint, params: &GainParams) -> Option<[f64; 3]> {
    let camera_from_world = other.keyframe.world_from_camera.inverse();
    let in_color = camera_from_world.transform_point(&point.in_world);
    let depth = other.decoded.depth.as_ref()?;
    let in_depth = depth.depth_from_color.transform_point(&in_color);
    let measured_m = depth.image.nearest(depth.camera.project(&in_depth)?)?;
    let difference_m = (f64::from(measured_m) - in_depth.z).abs();
    if difference_m > MAX_DEPTH_DIFFERENCE * in_depth.z {
        return None;
    }
    log_linear(other.decoded, &in_color, params)
}

/// Logarithm of the linear light where a point lands.
fn log_linear(
    decoded: &DecodedFrame,
    in_color: &Point3<f64>,
    params: &GainParams,
) -> Option<[f64; 3]> {
    let camera = &decoded.color_camera;
    let at_px = camera.project(in_color)?;
    if !camera.contains(at_px) {
        return None;
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a share below 0.1 of a width"
    )]
    let radius_px = (f64::from(camera.width()) * params.window_share).round() as i64;
    window_mean(&decoded.color, at_px, radius_px, params).map(|linear| linear.map(f64::ln))
}

/// Mean of the logarithms around their median, drawn to 0 and bounded.
fn robust_mean(ratios: &[[f64; 3]], params: &GainParams) -> [f64; 3] {
    let mut mean: [f64; 3] = std::array::from_fn(|c| {
        let mut values: Vec<f64> = ratios.iter().map(|ratio| ratio[c]).collect();
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f64::total_cmp).1
    });
    for _ in 0..NUM_SWEEPS {
        let mut sum = [0.0; 3];
        let mut total = params.prior_samples;
        for ratio in ratios {
            let square = (0..3).map(|c| (ratio[c] - mean[c]).powi(2)).sum::<f64>() / 3.0;
            let weight = 1.0 / (1.0 + square / params.robust_scale.powi(2));
            total += weight;
            for c in 0..3 {
                sum[c] += weight * ratio[c];
            }
        }
        mean = sum.map(|sum| sum / total);
    }
    mean.map(|log| log.clamp(-params.max_log_gain, params.max_log_gain))
}

#[cfg(test)]
mod tests;
