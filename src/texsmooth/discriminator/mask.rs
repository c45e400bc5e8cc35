//! Which places of a layer's output count.

use super::layer::{KERNEL, Shape};

/// Rows, columns, and 1 or 0 for each place.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PlaceMask {
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) counts: Vec<f32>,
}

impl PlaceMask {
    /// Through one layer: a place counts where the mean over its 4×4, zeros around the image among
    /// them, exceeds the threshold.
    pub(super) fn through(&self, shape: &Shape, threshold: f32) -> Self {
        let [height, width] = [self.height, self.width].map(|s| shape.output_side(s).unwrap_or(0));
        let at = |y: usize, x: usize| {
            if y < self.height && x < self.width {
                self.counts[y * self.width + x]
            } else {
                0.0
            }
        };
        let mut counts = Vec::with_capacity(height * width);
        for y in 0..height {
            for x in 0..width {
                let mut sum = 0.0;
                for ky in 0..KERNEL {
                    let row = (y * shape.stride + ky).wrapping_sub(shape.padding);
                    for kx in 0..KERNEL {
                        sum += at(row, (x * shape.stride + kx).wrapping_sub(shape.padding));
                    }
                }
                let mean = sum / (KERNEL * KERNEL) as f32;
                counts.push(f32::from(u8::from(mean > threshold)));
            }
        }
        Self {
            height,
            width,
            counts,
        }
    }
}
