//! Normalised correlation over a mask for all whole offsets at once (Padfield 2012), and its peak.

use rayon::prelude::*;
use realfft::num_complex::Complex32;

use super::fft2::{Fft2, Spectrum, good_size};
use super::plane::Plane;

/// The best offset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peak {
    /// Columns and rows, to a fraction by a parabola through the neighbours.
    pub(super) offset_px: [f32; 2],
    /// Correlation at the peak times the share by which it stands above the next peak, in [0, 1].
    pub(super) confidence: f32,
}

/// Offsets over which less than this share of the mask is compared are not looked at.
const MIN_OVERLAP: f32 = 0.5;

/// Finds the offset within bounds at which `photo` correlates best with `render`; `None` without
/// contrast or mask.
pub(super) fn find_peak(
    photo: &Plane,
    render: &Plane,
    max_offset_px: [f32; 2],
    is_phase: bool,
) -> Option<Peak> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at most half of an image's side"
    )]
    // A pixel more on each side, so that a peak on the bound has neighbours.
    let reach = max_offset_px.map(|max| max.ceil() as usize + 1);
    let surface = if is_phase {
        phase_surface(photo, render, reach)
    } else {
        ncc_surface(photo, render, reach)
    }?;
    surface.peak()
}

/// A value per offset, from −reach to reach on both axes, row-major.
struct Surface {
    reach: [usize; 2],
    value: Vec<f32>,
}

/// Images padded by the reach, so that nothing wraps around into an offset that is looked at.
struct Padded {
    size: [usize; 2],
    fft: Fft2,
}

impl Padded {
    fn new(plane: &Plane, reach: [usize; 2]) -> Self {
        let size = [
            good_size(plane.width + reach[0]),
            good_size(plane.height + reach[1]),
        ];
        Self {
            size,
            fft: Fft2::new(size[0], size[1]),
        }
    }

    fn spectrum(&self, plane: &Plane, of: impl Fn(usize) -> f32 + Sync) -> Spectrum {
        let mut padded = vec![0.0f32; self.size[0] * self.size[1]];
        padded
            .par_chunks_mut(self.size[0])
            .take(plane.height)
            .enumerate()
            .for_each(|(y, row)| {
                for (x, value) in row[..plane.width].iter_mut().enumerate() {
                    *value = of(y * plane.width + x);
                }
            });
        self.fft.forward(&padded)
    }

    /// Σ a(x + d) · b(x) for every offset within reach.
    fn correlate(&self, a: &[Complex32], b: &[Complex32], reach: [usize; 2]) -> Vec<f32> {
        let product: Spectrum = a.par_iter().zip(b).map(|(a, b)| a * b.conj()).collect();
        self.within(&self.fft.inverse(product), reach)
    }

    fn within(&self, plane: &[f32], reach: [usize; 2]) -> Vec<f32> {
        let scale = 1.0 / (self.size[0] * self.size[1]) as f32;
        let wrapped =
            |offset: usize, axis: usize| (offset + self.size[axis] - reach[axis]) % self.size[axis];
        let mut out = Vec::with_capacity((2 * reach[0] + 1) * (2 * reach[1] + 1));
        for dy in 0..=2 * reach[1] {
            let row = wrapped(dy, 1) * self.size[0];
            out.extend((0..=2 * reach[0]).map(|dx| scale * plane[row + wrapped(dx, 0)]));
        }
        out
    }
}

/// Mean over the weights; values are small around it, which keeps sums of squares exact enough.
fn mean(plane: &Plane) -> Option<f32> {
    let (mut sum, mut total) = (0.0f64, 0.0f64);
    for (index, value) in plane.value.iter().enumerate() {
        sum += f64::from(*value);
        total += f64::from(plane.weight_at(index));
    }
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let mean = (sum / total) as f32;
    (total > 0.0).then_some(mean)
}

fn ncc_surface(photo: &Plane, render: &Plane, reach: [usize; 2]) -> Option<Surface> {
    let (mean_photo, mean_render) = (mean(photo)?, mean(render)?);
    let padded = Padded::new(photo, reach);
    // To the scale of a unit of contrast, for the sake of f32.
    let of_photo = |i: usize| (photo.value[i] - mean_photo) / 64.0;
    let of_render = |i: usize| (render.value[i] - mean_render) / 64.0 * render.weight_at(i);
    let ones = padded.spectrum(photo, |_| 1.0);
    let image = padded.spectrum(photo, of_photo);
    let image_squared = padded.spectrum(photo, |i| of_photo(i).powi(2));
    let weight = padded.spectrum(render, |i| render.weight_at(i));
    let other = padded.spectrum(render, of_render);
    let other_squared = padded.spectrum(render, |i| of_render(i).powi(2));

    let correlate = |a: &Spectrum, b: &Spectrum| padded.correlate(a, b, reach);
    let num = correlate(&ones, &weight);
    let product = correlate(&image, &other);
    let sum_image = correlate(&image, &weight);
    let sum_other = correlate(&ones, &other);
    let squares_image = correlate(&image_squared, &weight);
    let squares_other = correlate(&ones, &other_squared);

    let most = num.iter().copied().fold(0.0, f32::max);
    let value = (0..num.len())
        .map(|i| {
            let n = num[i];
            if n < MIN_OVERLAP * most || n < 16.0 {
                return 0.0;
            }
            let covariance = product[i] - sum_image[i] * sum_other[i] / n;
            let var_image = squares_image[i] - sum_image[i] * sum_image[i] / n;
            let var_other = squares_other[i] - sum_other[i] * sum_other[i] / n;
            // A quarter of a grey level of contrast is none.
            let least = n * (0.25f32 / 64.0).powi(2);
            if var_image < least || var_other < least {
                return 0.0;
            }
            covariance / (var_image * var_other).sqrt()
        })
        .collect();
    Some(Surface { reach, value })
}

fn phase_surface(photo: &Plane, render: &Plane, reach: [usize; 2]) -> Option<Surface> {
    let (mean_photo, mean_render) = (mean(photo)?, mean(render)?);
    let padded = Padded::new(photo, reach);
    let window = |size: usize, at: usize| {
        let phase = (at as f32 + 0.5) / size as f32 * std::f32::consts::PI;
        phase.sin().powi(2)
    };
    let windowed =
        |i: usize| window(photo.width, i % photo.width) * window(photo.height, i / photo.width);
    let image = padded.spectrum(photo, |i| {
        // Only what the rendering can show, give or take the offset.
        windowed(i) * (photo.value[i] - mean_photo) * render.weight_at(i)
    });
    let other = padded.spectrum(render, |i| {
        windowed(i) * (render.value[i] - mean_render) * render.weight_at(i)
    });
    let strongest = image
        .iter()
        .zip(&other)
        .map(|(a, b)| (a * b.conj()).norm())
        .fold(0.0f32, f32::max);
    if strongest <= 0.0 {
        return None;
    }
    let floor = 1e-6 * strongest;
    let phases: Spectrum = image
        .par_iter()
        .zip(&other)
        .map(|(a, b)| {
            let product = a * b.conj();
            product / (product.norm() + floor)
        })
        .collect();
    let plane = padded.fft.inverse(phases);
    let value = padded.within(&plane, reach);
    Some(Surface { reach, value })
}

impl Surface {
    fn width(&self) -> usize {
        2 * self.reach[0] + 1
    }

    fn height(&self) -> usize {
        2 * self.reach[1] + 1
    }

    fn at(&self, x: usize, y: usize) -> f32 {
        self.value[y * self.width() + x]
    }

    /// Whether no neighbour is higher; the border is none, for its neighbours are unknown.
    fn is_summit(&self, x: usize, y: usize) -> bool {
        let here = self.at(x, y);
        (y - 1..=y + 1).all(|v| (x - 1..=x + 1).all(|u| self.at(u, v) <= here))
    }

    fn peak(&self) -> Option<Peak> {
        let mut summits: Vec<(f32, usize, usize)> = Vec::new();
        for y in 1..self.height() - 1 {
            for x in 1..self.width() - 1 {
                if self.at(x, y) > 0.0 && self.is_summit(x, y) {
                    summits.push((self.at(x, y), x, y));
                }
            }
        }
        let &(best, x, y) = summits
            .iter()
            .reduce(|best, next| if next.0 > best.0 { next } else { best })?;
        // Plateaus touch the peak; they are the peak.
        let is_apart = |&&(_, u, v): &&(f32, usize, usize)| u.abs_diff(x) > 2 || v.abs_diff(y) > 2;
        let next = summits
            .iter()
            .filter(is_apart)
            .map(|&(value, ..)| value)
            .fold(0.0, f32::max);
        let parabola = |low: f32, high: f32| {
            let curvature = low - 2.0 * best + high;
            if curvature < 0.0 {
                (0.5 * (low - high) / curvature).clamp(-0.5, 0.5)
            } else {
                0.0
            }
        };
        let offset = |at: usize, reach: usize, fraction: f32| at as f32 - reach as f32 + fraction;
        Some(Peak {
            offset_px: [
                offset(
                    x,
                    self.reach[0],
                    parabola(self.at(x - 1, y), self.at(x + 1, y)),
                ),
                offset(
                    y,
                    self.reach[1],
                    parabola(self.at(x, y - 1), self.at(x, y + 1)),
                ),
            ],
            confidence: (best.min(1.0) * (1.0 - next / best)).clamp(0.0, 1.0),
        })
    }
}
