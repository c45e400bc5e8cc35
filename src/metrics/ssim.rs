//! Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004, "Image quality assessment: from
//! error visibility to structural similarity").
//!
//! K1 = 0.01, K2 = 0.03, L = 255, sRGB bytes, under one of two windows:
//!
//! - [`SsimWindow::Gaussian`], the paper's: 11×11, σ = 1.5, population moments;
//! - [`SsimWindow::Uniform`], the default of scikit-image, which the authors of the texturing
//!   method used: 7×7, sample moments (n − 1).
//!
//! As in both programs only windows that lie wholly in the image count. With a mask the moments
//! are those of the masked pixels of the window (its weights renormalised), and the mean runs over
//! masked window centres; with a full mask that is the unmasked value.

use rayon::prelude::*;

use crate::geom::ColorImage;

use super::{MetricError, check};

const SIGMA_PX: f64 = 1.5;
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SsimChannels {
    /// The luma of BT.601, as Matlab's `rgb2gray` gives it to the authors' program.
    Luma,
    /// Each of red, green and blue; the mean of the three.
    Rgb,
}

/// What the moments are weighted by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SsimWindow {
    /// 11×11, σ = 1.5, population moments.
    Gaussian,
    /// 7×7, all pixels alike, sample moments.
    Uniform,
}

impl SsimWindow {
    /// Pixels on each side of the window's centre.
    fn radius_px(self) -> usize {
        match self {
            Self::Gaussian => 5,
            Self::Uniform => 3,
        }
    }

    /// Weights along one axis; their sum is 1.
    fn weights(self) -> Vec<f64> {
        let radius = self.radius_px();
        let weight = |i: usize| match self {
            Self::Gaussian => {
                let distance = i as f64 - radius as f64;
                (-distance * distance / (2.0 * SIGMA_PX * SIGMA_PX)).exp()
            }
            Self::Uniform => 1.0,
        };
        let weights: Vec<f64> = (0..=2 * radius).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        weights.into_iter().map(|w| w / sum).collect()
    }

    /// What turns the population's variance over a window, of which the share `weight` is masked
    /// in, into the estimate that is used.
    fn variance_factor(self, weight: f64) -> f64 {
        match self {
            Self::Gaussian => 1.0,
            Self::Uniform => {
                let side = (2 * self.radius_px() + 1) as f64;
                let num_pixels = (weight * side * side).round();
                // A single pixel has no variance either way.
                num_pixels / (num_pixels - 1.0).max(1.0)
            }
        }
    }
}

/// Mean structural similarity under the paper's window, see [`ssim_windowed`].
///
/// # Errors
/// [`MetricError`] when the sizes differ.
pub fn ssim(
    a: &ColorImage,
    b: &ColorImage,
    mask: Option<&[bool]>,
    channels: SsimChannels,
) -> Result<Option<f64>, MetricError> {
    ssim_windowed(a, b, mask, channels, SsimWindow::Gaussian)
}

/// Mean structural similarity in [−1, 1]; `None` when no window fits (an image smaller than
/// the window, or an empty mask).
///
/// # Errors
/// [`MetricError`] when the sizes differ.
pub fn ssim_windowed(
    a: &ColorImage,
    b: &ColorImage,
    mask: Option<&[bool]>,
    channels: SsimChannels,
    window: SsimWindow,
) -> Result<Option<f64>, MetricError> {
    check(a, b, mask)?;
    let (width, height) = (a.width() as usize, a.height() as usize);
    let window_px = 2 * window.radius_px() + 1;
    if width < window_px || height < window_px {
        return Ok(None);
    }
    let plane = |image: &ColorImage, of: &dyn Fn(&[u8; 3]) -> f64| -> Vec<f64> {
        image.pixels().iter().map(of).collect()
    };
    let luma = |p: &[u8; 3]| {
        0.298_936 * f64::from(p[0]) + 0.587_043 * f64::from(p[1]) + 0.114_021 * f64::from(p[2])
    };
    let mean = |of: &dyn Fn(&[u8; 3]) -> f64| {
        mean_ssim(&plane(a, of), &plane(b, of), mask, [width, height], window)
    };
    Ok(match channels {
        SsimChannels::Luma => mean(&luma),
        SsimChannels::Rgb => {
            let per_channel: Option<Vec<f64>> =
                (0..3).map(|c| mean(&|p| f64::from(p[c]))).collect();
            per_channel.map(|values| values.iter().sum::<f64>() / 3.0)
        }
    })
}

/// Moments at one pixel: weight, a, b, a², b², ab.
type Moments = [f64; 6];

fn mean_ssim(
    a: &[f64],
    b: &[f64],
    mask: Option<&[bool]>,
    [width, height]: [usize; 2],
    window: SsimWindow,
) -> Option<f64> {
    let weights = window.weights();
    let (radius_px, window_px) = (window.radius_px(), weights.len());
    let rows: Vec<Vec<Moments>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let at = |x: usize| -> Moments {
                let i = y * width + x;
                if mask.is_some_and(|mask| !mask[i]) {
                    return [0.0; 6];
                }
                [1.0, a[i], b[i], a[i] * a[i], b[i] * b[i], a[i] * b[i]]
            };
            let row: Vec<Moments> = (0..width).map(at).collect();
            row.windows(window_px)
                .map(|moments| weighted(moments.iter(), &weights))
                .collect()
        })
        .collect();
    // One sum per row, added up in the order of the rows: the same for any thread count.
    let sums: Vec<(f64, usize)> = (radius_px..height - radius_px)
        .into_par_iter()
        .map(|y| {
            let is_centre = |x: usize| mask.is_none_or(|mask| mask[y * width + x + radius_px]);
            let mut sum = 0.0;
            let mut count = 0;
            for x in (0..width + 1 - window_px).filter(|&x| is_centre(x)) {
                let column = (y - radius_px..=y + radius_px).map(|row| &rows[row][x]);
                let moments = weighted(column, &weights);
                sum += similarity(&moments, window.variance_factor(moments[0]));
                count += 1;
            }
            (sum, count)
        })
        .collect();
    let count: usize = sums.iter().map(|(_, count)| count).sum();
    (count > 0).then(|| sums.iter().map(|(sum, _)| sum).sum::<f64>() / count as f64)
}

fn weighted<'a>(window: impl Iterator<Item = &'a Moments>, weights: &[f64]) -> Moments {
    let mut sum = [0.0; 6];
    for (moments, weight) in window.zip(weights) {
        for (total, moment) in sum.iter_mut().zip(moments) {
            *total += weight * moment;
        }
    }
    sum
}

fn similarity(&[weight, a, b, aa, bb, ab]: &Moments, variance_factor: f64) -> f64 {
    let [mean_a, mean_b, aa, bb, ab] = [a, b, aa, bb, ab].map(|sum| sum / weight);
    let var_a = variance_factor * (aa - mean_a * mean_a);
    let var_b = variance_factor * (bb - mean_b * mean_b);
    let covariance = variance_factor * (ab - mean_a * mean_b);
    ((2.0 * mean_a * mean_b + C1) * (2.0 * covariance + C2))
        / ((mean_a * mean_a + mean_b * mean_b + C1) * (var_a + var_b + C2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, of: impl Fn(u32, u32) -> [u8; 3]) -> ColorImage {
        let pixels = (0..width * height)
            .map(|i| of(i % width, i / width))
            .collect();
        ColorImage::new(width, height, pixels).unwrap()
    }

    fn noise(x: u32, y: u32, seed: u32) -> u8 {
        let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ seed;
        h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
        ((h ^ (h >> 13)) & 0xFF) as u8
    }

    #[test]
    fn flat_images_have_only_the_luminance_term() {
        let a = image(20, 16, |_, _| [80; 3]);
        let b = image(20, 16, |_, _| [120; 3]);
        let expected = (2.0 * 80.0 * 120.0 + C1) / (80.0f64.powi(2) + 120.0f64.powi(2) + C1);
        let value = ssim(&a, &b, None, SsimChannels::Rgb).unwrap().unwrap();
        assert!((value - expected).abs() < 1e-9, "{value} {expected}");
    }

    #[test]
    fn an_image_is_like_itself_and_unlike_its_negative() {
        let a = image(40, 30, |x, y| {
            [noise(x, y, 1), noise(x, y, 2), noise(x, y, 3)]
        });
        let negative = image(40, 30, |x, y| {
            [
                255 - noise(x, y, 1),
                255 - noise(x, y, 2),
                255 - noise(x, y, 3),
            ]
        });
        for channels in [SsimChannels::Luma, SsimChannels::Rgb] {
            assert!((ssim(&a, &a, None, channels).unwrap().unwrap() - 1.0).abs() < 1e-12);
            assert!(ssim(&a, &negative, None, channels).unwrap().unwrap() < -0.8);
        }
    }

    /// The definition, window by window, in two dimensions.
    fn by_definition(a: &ColorImage, b: &ColorImage, mask: &[bool]) -> f64 {
        let (width, height) = (a.width() as usize, a.height() as usize);
        let (mut sum, mut count) = (0.0, 0.0);
        for cy in 5..height - 5 {
            for cx in (5..width - 5).filter(|cx| mask[cy * width + cx]) {
                let mut samples = Vec::new();
                for y in cy - 5..=cy + 5 {
                    for x in cx - 5..=cx + 5 {
                        let i = y * width + x;
                        if mask[i] {
                            let (dx, dy) = (x.abs_diff(cx), y.abs_diff(cy));
                            let w = (-((dx * dx + dy * dy) as f64) / 4.5).exp();
                            samples.push((w, a.pixels()[i][1].into(), b.pixels()[i][1].into()));
                        }
                    }
                }
                let total: f64 = samples.iter().map(|s| s.0).sum();
                let mean = |of: &dyn Fn(&(f64, f64, f64)) -> f64| {
                    samples.iter().map(|s| s.0 * of(s)).sum::<f64>() / total
                };
                let (ma, mb) = (mean(&|s| s.1), mean(&|s| s.2));
                let va = mean(&|s| (s.1 - ma).powi(2));
                let vb = mean(&|s| (s.2 - mb).powi(2));
                let cov = mean(&|s| (s.1 - ma) * (s.2 - mb));
                sum += (2.0 * ma * mb + 6.5025) * (2.0 * cov + 58.5225)
                    / ((ma * ma + mb * mb + 6.5025) * (va + vb + 58.5225));
                count += 1.0;
            }
        }
        sum / count
    }

    #[test]
    fn separable_passes_equal_the_definition() {
        let grey = |v: u8| [v; 3];
        let a = image(31, 23, |x, y| grey(noise(x, y, 7)));
        let b = image(31, 23, |x, y| grey(noise(x, y, 7) / 2 + noise(x, y, 8) / 2));
        let full = vec![true; 31 * 23];
        let half: Vec<bool> = (0..31 * 23).map(|i| (i % 31) + (i / 31) < 26).collect();
        for mask in [full, half] {
            let value = ssim(&a, &b, Some(&mask), SsimChannels::Rgb)
                .unwrap()
                .unwrap();
            let expected = by_definition(&a, &b, &mask);
            assert!((value - expected).abs() < 1e-9, "{value} {expected}");
        }
        let unmasked = ssim(&a, &b, None, SsimChannels::Luma).unwrap().unwrap();
        assert!((unmasked - by_definition(&a, &b, &vec![true; 31 * 23])).abs() < 1e-4);
    }

    #[test]
    fn nothing_to_compare_is_none() {
        let small = image(10, 40, |_, _| [1; 3]);
        assert_eq!(ssim(&small, &small, None, SsimChannels::Rgb), Ok(None));
        let a = image(12, 12, |_, _| [1; 3]);
        let none = ssim(&a, &a, Some(&[false; 144]), SsimChannels::Luma);
        assert_eq!(none, Ok(None));
    }
}
