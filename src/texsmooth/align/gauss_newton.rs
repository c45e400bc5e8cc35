//! Sub-pixel refinement of an offset.
//!
//! Minimises Σ w · (I(x + d) − a · Î(x) − b)² over the mask for the offset d, the gain a and the
//! brightness b. Slopes are the rendering's, so that noise of the photo does not pull the offset
//! towards where it started; w falls with the residual (Cauchy), so that what the rendering does
//! not have counts little.

use nalgebra::{Matrix4, Vector4};
use rayon::prelude::*;

use super::plane::Plane;

const MAX_STEPS: usize = 8;
/// A step shorter than this ends the search, pixels.
const DONE_PX: f32 = 0.004;
/// Residual at which a pixel counts half, grey levels.
const HALF_WEIGHT_LEVEL: f32 = 12.0;
/// About as many pixels are asked; more would not make the offset better.
const MAX_PIXELS: usize = 350_000;
/// Rows to a partial sum; fixed, so that sums do not depend on the thread count.
const CHUNK_ROWS: usize = 16;

/// The offset nearby; `None` when it goes farther than `bound_px` from the start, or when the image has
/// no slopes to go by.
pub(super) fn refine(
    photo: &Plane,
    render: &Plane,
    start_px: [f32; 2],
    bound_px: f32,
) -> Option<[f32; 2]> {
    let stride = (photo.value.len() / MAX_PIXELS).max(1);
    let rows: Vec<usize> = (1..render.height.checked_sub(1)?).step_by(stride).collect();
    let mut offset_px = start_px;
    // Gain and brightness are unknown at first; the first step finds them unweighted.
    let mut tone = None;
    for _ in 0..MAX_STEPS {
        let partial: Vec<Sums> = rows
            .par_chunks(CHUNK_ROWS)
            .map(|rows| {
                let mut sums = Sums::default();
                for &y in rows {
                    sums.add_row(photo, render, y, offset_px, tone);
                }
                sums
            })
            .collect();
        let mut sums = Sums::default();
        partial.iter().for_each(|other| sums.merge(other));
        let [dx, dy, gain, brightness] = sums.solve()?;
        let is_first = tone.replace([gain, brightness]).is_none();
        if !(dx.is_finite() && dy.is_finite()) {
            return None;
        }
        if is_first {
            // Unweighted, the step may be led astray by what does not match.
            continue;
        }
        let step = [dx.clamp(-1.0, 1.0), dy.clamp(-1.0, 1.0)];
        offset_px = [offset_px[0] + step[0], offset_px[1] + step[1]];
        let is_near = (0..2).all(|axis| (offset_px[axis] - start_px[axis]).abs() <= bound_px);
        if !is_near {
            return None;
        }
        if step.iter().all(|d| d.abs() < DONE_PX) {
            break;
        }
    }
    Some(offset_px)
}

/// Normal equations of (dx, dy, a, b): the upper triangle, the right side, the number of pixels.
#[derive(Clone, Copy, Default)]
struct Sums {
    matrix: [f64; 10],
    right: [f64; 4],
    num_pixels: usize,
}

impl Sums {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_possible_wrap,
        reason = "positions within an image"
    )]
    fn add_row(
        &mut self,
        photo: &Plane,
        render: &Plane,
        y: usize,
        [dx, dy]: [f32; 2],
        tone: Option<[f32; 2]>,
    ) {
        let width = render.width;
        let y_photo = y as f32 + dy;
        let (column, row) = (dx.floor(), y_photo.floor());
        if row < 0.0 || row as usize + 1 >= photo.height {
            return;
        }
        let (fx, fy) = (dx - column, y_photo - row);
        let shift = column as isize;
        let first = 1.max(-shift) as usize;
        let last = (width as isize - 1).min(width as isize - 1 - shift).max(0) as usize;
        if first >= last {
            return;
        }
        let at = y * width;
        let lines: [&[f32]; 3] =
            [at - width, at, at + width].map(|start| &render.value[start..start + width]);
        let weights: Option<[&[f32]; 3]> = (!render.weight.is_empty()).then(|| {
            [at - width, at, at + width].map(|start| &render.weight[start..start + width])
        });
        let top = row as usize * photo.width;
        let (upper, lower) = (
            &photo.value[top..top + photo.width],
            &photo.value[top + photo.width..top + 2 * photo.width],
        );
        // A row's sums fit f32's precision and are quicker; rows are added in f64.
        let mut matrix = [0.0f32; 10];
        let mut right = [0.0f32; 4];
        for x in first..last {
            if let Some([above, here, below]) = weights {
                // Values off the mask are no slopes.
                let least = here[x]
                    .min(here[x - 1])
                    .min(here[x + 1])
                    .min(above[x])
                    .min(below[x]);
                if least <= 0.0 {
                    continue;
                }
            }
            let u = (x as isize + shift) as usize;
            let top = upper[u] + fx * (upper[u + 1] - upper[u]);
            let bottom = lower[u] + fx * (lower[u + 1] - lower[u]);
            let target = top + fy * (bottom - top);
            let value = lines[1][x];
            let slope_x = 0.5 * (lines[1][x + 1] - lines[1][x - 1]);
            let slope_y = 0.5 * (lines[2][x] - lines[0][x]);
            let gain = tone.map_or(1.0, |[gain, _]| gain);
            let weight = tone.map_or(1.0, |[gain, brightness]| {
                let residual = (target - gain * value - brightness) / HALF_WEIGHT_LEVEL;
                1.0 / (1.0 + residual * residual)
            });
            // I(x + d + δ) ≈ I(x + d) + a ∇Î · δ: so −a ∇Î · δ + a Î + b = I(x + d).
            let j = [-gain * slope_x, -gain * slope_y, value, 1.0];
            let mut k = 0;
            for a in 0..4 {
                let weighted = weight * j[a];
                right[a] += weighted * target;
                for &other in &j[a..] {
                    matrix[k] += weighted * other;
                    k += 1;
                }
            }
            self.num_pixels += 1;
        }
        for (sum, value) in self.matrix.iter_mut().zip(matrix) {
            *sum += f64::from(value);
        }
        for (sum, value) in self.right.iter_mut().zip(right) {
            *sum += f64::from(value);
        }
    }

    fn merge(&mut self, other: &Self) {
        for (sum, value) in self.matrix.iter_mut().zip(other.matrix) {
            *sum += value;
        }
        for (sum, value) in self.right.iter_mut().zip(other.right) {
            *sum += value;
        }
        self.num_pixels += other.num_pixels;
    }

    /// (dx, dy, a, b); `None` where the pixels do not tell.
    fn solve(&self) -> Option<[f32; 4]> {
        if self.num_pixels < 16 {
            return None;
        }
        let m = &self.matrix;
        #[rustfmt::skip]
        let matrix = Matrix4::new(
            m[0], m[1], m[2], m[3],
            m[1], m[4], m[5], m[6],
            m[2], m[5], m[7], m[8],
            m[3], m[6], m[8], m[9],
        );
        let scale = Vector4::from_fn(|i, _| 1.0 / matrix[(i, i)].max(1e-12).sqrt());
        let scaled = Matrix4::from_fn(|r, c| matrix[(r, c)] * scale[r] * scale[c])
            + Matrix4::identity() * 1e-9;
        let right = Vector4::from(self.right).component_mul(&scale);
        // No slope along an axis: nothing is known of the offset.
        if matrix[(0, 0)] < 1e-9 * matrix[(3, 3)] || matrix[(1, 1)] < 1e-9 * matrix[(3, 3)] {
            return None;
        }
        let solution = scaled.cholesky()?.solve(&right).component_mul(&scale);
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let solution = [0, 1, 2, 3].map(|i| solution[i] as f32);
        Some(solution)
    }
}
