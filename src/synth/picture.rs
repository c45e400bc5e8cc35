//! Painted pictures (posters, labels, pages) whose average over any box is exact and costs O(1).
//!
//! A [`Canvas`] is painted once, in linear light, with antialiased shapes given by their signed
//! distance; a [`Picture`] is its summed-area table (Crow 1984). Between pixels the picture is
//! piecewise constant, and the bilinear interpolation of the table is its exact integral.

use std::sync::Arc;

use super::font::{self, ADVANCE_DOTS, HEIGHT_DOTS};
use super::texture::Linear;

/// A picture being painted; coordinates are metres from its top-left corner, v down.
#[derive(Clone, Debug)]
pub(super) struct Canvas {
    width: usize,
    height: usize,
    pixel_m: f64,
    pixels: Vec<Linear>,
}

/// Sides beyond this are refused by clamping: no picture of a scene comes near it.
const MAX_SIDE_PX: f64 = 4096.0;

impl Canvas {
    /// A canvas of `size_m` in one colour, with pixels of about `pixel_m`.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 1..=4096"
    )]
    pub(super) fn new(size_m: [f64; 2], pixel_m: f64, color: Linear) -> Self {
        let [width, height] =
            size_m.map(|side| (side / pixel_m).round().clamp(1.0, MAX_SIDE_PX) as usize);
        Self {
            width,
            height,
            pixel_m: size_m[0] / width as f64,
            pixels: vec![color; width * height],
        }
    }

    /// Width and height in metres.
    pub(super) fn size_m(&self) -> [f64; 2] {
        [self.width, self.height].map(|side| side as f64 * self.pixel_m)
    }

    /// Paints where `signed_distance_m` (negative inside) says, within `bounds` (x0, y0, x1, y1).
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the canvas"
    )]
    pub(super) fn shape(
        &mut self,
        bounds_m: [f64; 4],
        color: Linear,
        signed_distance_m: impl Fn(f64, f64) -> f64,
    ) {
        let clamp = |v: f64, max: usize| (v / self.pixel_m).clamp(0.0, max as f64);
        let x0 = (clamp(bounds_m[0], self.width) - 1.0).max(0.0) as usize;
        let y0 = (clamp(bounds_m[1], self.height) - 1.0).max(0.0) as usize;
        let x1 = (clamp(bounds_m[2], self.width) as usize + 2).min(self.width);
        let y1 = (clamp(bounds_m[3], self.height) as usize + 2).min(self.height);
        for y in y0..y1 {
            for x in x0..x1 {
                let (x_m, y_m) = (
                    (x as f64 + 0.5) * self.pixel_m,
                    (y as f64 + 0.5) * self.pixel_m,
                );
                let distance_px = signed_distance_m(x_m, y_m) / self.pixel_m;
                let coverage = (0.5 - distance_px).clamp(0.0, 1.0) as f32;
                let pixel = &mut self.pixels[y * self.width + x];
                for c in 0..3 {
                    pixel[c] += coverage * (color[c] - pixel[c]);
                }
            }
        }
    }

    /// An axis-aligned rectangle.
    pub(super) fn rect(&mut self, [x, y, w, h]: [f64; 4], color: Linear) {
        self.shape([x, y, x + w, y + h], color, |px, py| {
            let dx = (px - (x + w / 2.0)).abs() - w / 2.0;
            let dy = (py - (y + h / 2.0)).abs() - h / 2.0;
            dx.max(dy)
        });
    }

    /// A filled disc.
    pub(super) fn disc(&mut self, [x, y]: [f64; 2], radius: f64, color: Linear) {
        self.shape(
            [x - radius, y - radius, x + radius, y + radius],
            color,
            |px, py| (px - x).hypot(py - y) - radius,
        );
    }

    /// A circle drawn with a pen of `pen` metres.
    pub(super) fn ring(&mut self, [x, y]: [f64; 2], radius: f64, pen: f64, color: Linear) {
        let outer = radius + pen / 2.0;
        self.shape(
            [x - outer, y - outer, x + outer, y + outer],
            color,
            |px, py| ((px - x).hypot(py - y) - radius).abs() - pen / 2.0,
        );
    }

    /// A straight line with round ends, drawn with a pen of `pen` metres.
    pub(super) fn line(&mut self, a: [f64; 2], b: [f64; 2], pen: f64, color: Linear) {
        let half = pen / 2.0;
        let bounds = [
            a[0].min(b[0]) - half,
            a[1].min(b[1]) - half,
            a[0].max(b[0]) + half,
            a[1].max(b[1]) + half,
        ];
        self.shape(bounds, color, |px, py| {
            distance_to_segment([px, py], a, b) - half
        });
    }

    /// A vertical gradient over the whole width between rows `y0` and `y1`.
    pub(super) fn gradient(&mut self, [y0, y1]: [f64; 2], from: Linear, to: Linear) {
        for (row, pixels) in self.pixels.chunks_exact_mut(self.width).enumerate() {
            let y_m = (row as f64 + 0.5) * self.pixel_m;
            if y_m < y0 || y_m > y1 {
                continue;
            }
            #[expect(clippy::cast_possible_truncation, reason = "a fraction in [0, 1]")]
            let t = ((y_m - y0) / (y1 - y0)) as f32;
            pixels.fill(std::array::from_fn(|c| from[c] + t * (to[c] - from[c])));
        }
    }

    /// A line of text whose capitals are `height` metres high, its top left at `(x, y)`. `weight`
    /// is the pen's width in dots of the 5×7 matrix: 1 is regular, 1.5 bold.
    pub(super) fn text(
        &mut self,
        [x, y]: [f64; 2],
        height: f64,
        weight: f64,
        color: Linear,
        text: &str,
    ) {
        let dot = height / HEIGHT_DOTS;
        let half = weight * dot / 2.0;
        for (index, character) in text.chars().enumerate() {
            let left = x + index as f64 * ADVANCE_DOTS * dot;
            let segments = font::strokes(character);
            if segments.is_empty() {
                continue;
            }
            let bounds = [
                left - half,
                y - half,
                left + 5.0 * dot + half,
                y + height + half,
            ];
            self.shape(bounds, color, |px, py| {
                let p = [(px - left) / dot, (py - y) / dot];
                let nearest = segments
                    .iter()
                    .map(|&[a, b]| distance_to_segment(p, a, b))
                    .fold(f64::INFINITY, f64::min);
                nearest * dot - half
            });
        }
    }

    /// [`Self::text`] with its middle at `x`.
    pub(super) fn text_centred(
        &mut self,
        [x, y]: [f64; 2],
        height: f64,
        weight: f64,
        color: Linear,
        text: &str,
    ) {
        let width = text_width_m(text, height);
        self.text([x - width / 2.0, y], height, weight, color, text);
    }

    /// The finished picture, turned by a quarter clockwise: what was up points right.
    pub(super) fn turned(self) -> Self {
        let mut pixels = Vec::with_capacity(self.pixels.len());
        for x in 0..self.width {
            for y in (0..self.height).rev() {
                pixels.push(self.pixels[y * self.width + x]);
            }
        }
        Self {
            width: self.height,
            height: self.width,
            pixel_m: self.pixel_m,
            pixels,
        }
    }

    /// The finished picture.
    pub(super) fn finish(self) -> Arc<Picture> {
        Arc::new(Picture::new(&self))
    }
}

/// Width in metres of a line of text whose capitals are `height` high.
pub(super) fn text_width_m(text: &str, height: f64) -> f64 {
    let dots = text.chars().count() as f64 * ADVANCE_DOTS - 1.0;
    dots.max(0.0) * height / HEIGHT_DOTS
}

fn distance_to_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length2 = dx * dx + dy * dy;
    let t = if length2 > 0.0 {
        (((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (p[0] - a[0] - t * dx).hypot(p[1] - a[1] - t * dy)
}

/// A picture ready for box averages.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    width: usize,
    height: usize,
    pixel_m: f64,
    /// `(width + 1) × (height + 1)` sums over all pixels above and to the left.
    sums: Vec<[f64; 3]>,
}

impl Picture {
    fn new(canvas: &Canvas) -> Self {
        let stride = canvas.width + 1;
        let mut sums = vec![[0.0; 3]; stride * (canvas.height + 1)];
        for y in 0..canvas.height {
            let mut row = [0.0; 3];
            for x in 0..canvas.width {
                let pixel = canvas.pixels[y * canvas.width + x];
                for c in 0..3 {
                    row[c] += f64::from(pixel[c]);
                    sums[(y + 1) * stride + x + 1][c] = sums[y * stride + x + 1][c] + row[c];
                }
            }
        }
        Self {
            width: canvas.width,
            height: canvas.height,
            pixel_m: canvas.pixel_m,
            sums,
        }
    }

    /// Mean linear colour over a box of `width_m` around `uv_m`; the part outside the picture is
    /// left out of the mean, and a box wholly outside reads the nearest border.
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    pub(super) fn average(&self, uv_m: [f64; 2], width_m: [f64; 2]) -> Linear {
        let [x0, x1] = box_px(uv_m[0], width_m[0], self.pixel_m, self.width);
        let [y0, y1] = box_px(uv_m[1], width_m[1], self.pixel_m, self.height);
        let inverse_area = 1.0 / ((x1 - x0) * (y1 - y0));
        let (a, b, c, d) = (
            self.integral(x1, y1),
            self.integral(x0, y1),
            self.integral(x1, y0),
            self.integral(x0, y0),
        );
        std::array::from_fn(|k| ((a[k] - b[k] - c[k] + d[k]) * inverse_area) as f32)
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "box_px clamps to the picture"
    )]
    fn integral(&self, x: f64, y: f64) -> [f64; 3] {
        let (xi, yi) = (
            (x as usize).min(self.width - 1),
            (y as usize).min(self.height - 1),
        );
        let (fx, fy) = (x - xi as f64, y - yi as f64);
        let stride = self.width + 1;
        let at = yi * stride + xi;
        let (p00, p10) = (&self.sums[at], &self.sums[at + 1]);
        let (p01, p11) = (&self.sums[at + stride], &self.sums[at + stride + 1]);
        std::array::from_fn(|k| {
            let top = p00[k] + fx * (p10[k] - p00[k]);
            let bottom = p01[k] + fx * (p11[k] - p01[k]);
            top + fy * (bottom - top)
        })
    }
}

/// Ends of the box in pixels, inside the picture and at least a hundredth of a pixel apart (the
/// difference of four sums needs that much to keep its digits).
fn box_px(centre_m: f64, width_m: f64, pixel_m: f64, num_pixels: usize) -> [f64; 2] {
    const MIN_WIDTH_PX: f64 = 0.01;
    let max = num_pixels as f64;
    let half = (0.5 * width_m / pixel_m).max(MIN_WIDTH_PX);
    let centre = centre_m / pixel_m;
    let low = (centre - half).clamp(0.0, max - MIN_WIDTH_PX);
    [low, (centre + half).clamp(low + MIN_WIDTH_PX, max)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_average_is_the_exact_mean() {
        let mut canvas = Canvas::new([0.04, 0.03], 0.01, [0.0; 3]);
        canvas.rect([0.01, 0.0, 0.01, 0.03], [1.0, 0.5, 0.25]);
        let picture = canvas.finish();
        // The box spans x from 0.5 to 2.5 px: half black, then the stripe, then half black.
        let mean = picture.average([0.015, 0.015], [0.02, 0.01]);
        for (value, expected) in mean.iter().zip([0.5, 0.25, 0.125]) {
            assert!((value - expected).abs() < 1e-6, "{mean:?}");
        }
        let tiny = picture.average([0.015, 0.015], [1e-9, 1e-9]);
        assert!((tiny[0] - 1.0).abs() < 1e-6);
        let outside = picture.average([9.0, 9.0], [0.001, 0.001]);
        assert!(outside.iter().all(|v| v.abs() < 1e-6));
    }

    #[test]
    fn text_paints_ink_inside_its_box_only() {
        let mut canvas = Canvas::new([0.2, 0.05], 0.001, [1.0; 3]);
        canvas.text([0.02, 0.01], 0.02, 1.0, [0.0; 3], "AB");
        let picture = canvas.finish();
        let inside = picture.average([0.035, 0.02], [0.03, 0.02]);
        assert!(inside[0] < 0.8 && inside[0] > 0.3, "{inside:?}");
        let right = picture.average([0.15, 0.02], [0.05, 0.04]);
        assert!((right[0] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn turning_moves_the_top_to_the_right() {
        let mut canvas = Canvas::new([0.04, 0.02], 0.01, [0.0; 3]);
        canvas.rect([0.0, 0.0, 0.04, 0.01], [1.0; 3]);
        let picture = canvas.turned().finish();
        assert!(picture.average([0.015, 0.02], [0.002, 0.002])[0] > 0.99);
        assert!(picture.average([0.005, 0.02], [0.002, 0.002])[0] < 0.01);
    }
}
