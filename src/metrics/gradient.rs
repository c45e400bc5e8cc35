//! Difference of sharpness by gradient: the mean of |‖∇a‖ − ‖∇b‖| over all pixels, on luma bytes
//! (0–255). Central differences inside, one-sided at the border, as `numpy.gradient` takes them.

use rayon::prelude::*;

use crate::geom::ColorImage;

use super::{MetricError, check, luma_byte};

/// Mean absolute difference of the gradients' norms, in luma steps per pixel.
///
/// # Errors
/// [`MetricError::Size`] when the sizes differ.
pub fn gradient_difference(a: &ColorImage, b: &ColorImage) -> Result<f64, MetricError> {
    check(a, b, None)?;
    let planes = [a, b].map(LumaPlane::of);
    let height = a.height() as usize;
    let rows: Vec<f64> = (0..height)
        .into_par_iter()
        .map(|y| {
            (0..a.width() as usize)
                .map(|x| (planes[0].gradient_norm(x, y) - planes[1].gradient_norm(x, y)).abs())
                .sum()
        })
        .collect();
    Ok(rows.iter().sum::<f64>() / a.pixels().len() as f64)
}

struct LumaPlane {
    width: usize,
    height: usize,
    luma: Vec<u8>,
}

impl LumaPlane {
    fn of(image: &ColorImage) -> Self {
        Self {
            width: image.width() as usize,
            height: image.height() as usize,
            luma: image.pixels().iter().map(|&rgb| luma_byte(rgb)).collect(),
        }
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        f64::from(self.luma[y * self.width + x])
    }

    fn gradient_norm(&self, x: usize, y: usize) -> f64 {
        let (left, right) = (x.saturating_sub(1), (x + 1).min(self.width - 1));
        let (above, below) = (y.saturating_sub(1), (y + 1).min(self.height - 1));
        // An image of one column has no slope along it.
        let along_x = (self.at(right, y) - self.at(left, y)) / (right - left).max(1) as f64;
        let along_y = (self.at(x, below) - self.at(x, above)) / (below - above).max(1) as f64;
        along_x.hypot(along_y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(width: u32, height: u32, of: impl Fn(u32, u32) -> u32) -> ColorImage {
        let pixels = (0..width * height).map(|i| [of(i % width, i / width) as u8; 3]);
        ColorImage::new(width, height, pixels.collect()).unwrap()
    }

    #[test]
    fn ramps_differ_by_their_slopes() {
        let steep = grey(20, 10, |x, y| 3 * x + 4 * y);
        let flat = grey(20, 10, |_, _| 77);
        let along_x = grey(20, 10, |x, _| 2 * x);
        assert!((gradient_difference(&steep, &flat).unwrap() - 5.0).abs() < 1e-12);
        assert!((gradient_difference(&steep, &along_x).unwrap() - 3.0).abs() < 1e-12);
        assert_eq!(gradient_difference(&steep, &steep).unwrap(), 0.0);
        // Norms are compared, not directions.
        let down = grey(20, 10, |_, y| 2 * y);
        assert_eq!(gradient_difference(&along_x, &down).unwrap(), 0.0);
    }

    #[test]
    fn sizes_must_agree_and_small_ones_do() {
        let one = grey(1, 1, |_, _| 5);
        assert_eq!(gradient_difference(&one, &one).unwrap(), 0.0);
        assert!(gradient_difference(&one, &grey(2, 1, |_, _| 5)).is_err());
    }
}
