//! A grey image of floats with a weight per pixel.

use rayon::prelude::*;

use crate::geom::ColorImage;

/// Row-major; a pixel of weight 0 has value 0.
#[derive(Clone, Debug)]
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    /// BT.601 luma, 0–255.
    pub(super) value: Vec<f32>,
    /// In [0, 1]; empty when all count.
    pub(super) weight: Vec<f32>,
}

impl Plane {
    pub(super) fn luma(image: &ColorImage, mask: Option<&[bool]>) -> Self {
        let luma = |p: &[u8; 3]| {
            0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2])
        };
        let pixels = image.pixels().par_iter();
        let (value, weight) = match mask {
            None => (pixels.map(luma).collect(), Vec::new()),
            Some(mask) => (
                pixels
                    .zip(mask)
                    .map(|(p, &counts)| if counts { luma(p) } else { 0.0 })
                    .collect(),
                mask.par_iter()
                    .map(|&counts| f32::from(u8::from(counts)))
                    .collect(),
            ),
        };
        Self {
            width: image.width() as usize,
            height: image.height() as usize,
            value,
            weight,
        }
    }

    pub(super) fn weight_at(&self, index: usize) -> f32 {
        self.weight.get(index).copied().unwrap_or(1.0)
    }

    /// Weighted means of `factor`² pixels; what does not fill a block at the right and the bottom is
    /// left out. Pixel centres stay where they are but for a shift that is the same for all planes of
    /// one size, so that offsets only scale.
    pub(super) fn reduced(&self, factor: usize) -> Self {
        if factor <= 1 {
            return self.clone();
        }
        let (width, height) = (self.width / factor, self.height / factor);
        let rows: Vec<(Vec<f32>, Vec<f32>)> = (0..height)
            .into_par_iter()
            .map(|row| self.reduced_row(row, width, factor))
            .collect();
        let mut value = Vec::with_capacity(width * height);
        let mut weight = Vec::new();
        for (values, weights) in rows {
            value.extend(values);
            weight.extend(weights);
        }
        Self {
            width,
            height,
            value,
            weight,
        }
    }

    fn reduced_row(&self, row: usize, width: usize, factor: usize) -> (Vec<f32>, Vec<f32>) {
        let mut value = vec![0.0f32; width];
        let area = (factor * factor) as f32;
        let is_full = self.weight.is_empty();
        let mut weight = vec![0.0f32; if is_full { 0 } else { width }];
        for y in row * factor..(row + 1) * factor {
            let line = y * self.width..y * self.width + width * factor;
            // Values are 0 where the weight is: their sum needs no product.
            for (sum, block) in value
                .iter_mut()
                .zip(self.value[line.clone()].chunks(factor))
            {
                *sum += block.iter().sum::<f32>();
            }
            if !is_full {
                let blocks = self.weight[line].chunks(factor);
                for (sum, block) in weight.iter_mut().zip(blocks) {
                    *sum += block.iter().sum::<f32>();
                }
            }
        }
        if is_full {
            value.iter_mut().for_each(|sum| *sum /= area);
        } else {
            for (value, weight) in value.iter_mut().zip(&mut weight) {
                // Half-covered blocks would compare different pixels of photo and rendering.
                let is_covered = *weight > 0.99 * area;
                *value = if is_covered { *value / area } else { 0.0 };
                *weight = f32::from(u8::from(is_covered));
            }
        }
        (value, weight)
    }
}
