//! Mean absolute error, mean squared error and PSNR over masked pixels, on sRGB bytes (0–255).

use crate::geom::ColorImage;

use super::{MetricError, check};

/// Exact sums over the compared pixels, all three channels alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct PixelError {
    num_pixels: u64,
    sum_abs: u64,
    sum_squares: u64,
}

impl PixelError {
    /// Compares two images where `mask` is true, or everywhere.
    ///
    /// # Errors
    /// [`MetricError`] when the sizes differ.
    pub fn between(
        a: &ColorImage,
        b: &ColorImage,
        mask: Option<&[bool]>,
    ) -> Result<Self, MetricError> {
        check(a, b, mask)?;
        let mut error = Self::default();
        for (index, (pa, pb)) in a.pixels().iter().zip(b.pixels()).enumerate() {
            if mask.is_none_or(|mask| mask[index]) {
                error.num_pixels += 1;
                for (ca, cb) in pa.iter().zip(pb) {
                    let difference = u64::from(ca.abs_diff(*cb));
                    error.sum_abs += difference;
                    error.sum_squares += difference * difference;
                }
            }
        }
        Ok(error)
    }

    /// How many pixels were compared.
    pub fn num_pixels(&self) -> u64 {
        self.num_pixels
    }

    /// Mean absolute difference of a channel, 0–255; `None` without pixels.
    pub fn mean_abs(&self) -> Option<f64> {
        self.mean(self.sum_abs)
    }

    /// Mean squared difference of a channel, 0–255²; `None` without pixels.
    pub fn mean_squared(&self) -> Option<f64> {
        self.mean(self.sum_squares)
    }

    /// Peak signal-to-noise ratio in dB, peak 255; infinite for equal images, `None` without
    /// pixels.
    pub fn psnr_db(&self) -> Option<f64> {
        self.mean_squared()
            .map(|mse| 10.0 * (255.0 * 255.0 / mse).log10())
    }

    fn mean(&self, sum: u64) -> Option<f64> {
        (self.num_pixels > 0).then(|| sum as f64 / (3 * self.num_pixels) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(value: u8) -> ColorImage {
        ColorImage::new(4, 2, vec![[value; 3]; 8]).unwrap()
    }

    #[test]
    fn a_constant_offset_has_the_analytic_psnr() {
        let error = PixelError::between(&flat(100), &flat(110), None).unwrap();
        assert_eq!(error.mean_abs(), Some(10.0));
        // 20 log10(255 / 10)
        assert!((error.psnr_db().unwrap() - 28.130_803_608_679_1).abs() < 1e-12);
    }

    #[test]
    fn only_masked_pixels_count() {
        let mut pixels = vec![[50; 3]; 8];
        pixels[3] = [53, 50, 46];
        let b = ColorImage::new(4, 2, pixels).unwrap();
        let mut mask = vec![false; 8];
        mask[0] = true;
        mask[3] = true;
        let error = PixelError::between(&flat(50), &b, Some(&mask)).unwrap();
        assert_eq!(error.num_pixels(), 2);
        assert_eq!(error.mean_abs(), Some(7.0 / 6.0));
        assert_eq!(error.mean_squared(), Some(25.0 / 6.0));
        mask[3] = false;
        let error = PixelError::between(&flat(50), &b, Some(&mask)).unwrap();
        assert_eq!(error.psnr_db(), Some(f64::INFINITY));
        let none = PixelError::between(&flat(50), &b, Some(&[false; 8])).unwrap();
        assert_eq!(none.psnr_db(), None);
    }

    #[test]
    fn sizes_must_agree() {
        let other = ColorImage::new(2, 4, vec![[0; 3]; 8]).unwrap();
        assert!(PixelError::between(&flat(0), &other, None).is_err());
        assert!(PixelError::between(&flat(0), &flat(0), Some(&[true; 7])).is_err());
    }
}
