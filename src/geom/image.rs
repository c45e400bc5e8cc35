//! Decoded images: sRGB colour and metric depth.

use std::sync::Arc;

use super::color::{linear_from_srgb, srgb_from_linear};

/// Why an image was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ImageError {
    /// Width or height is zero or past [`crate::geom::camera::MAX_IMAGE_SIDE_PX`].
    #[error("image size {width}x{height} is not usable")]
    Size {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// The buffer is shorter or longer than the size says.
    #[error("image of {width}x{height} needs {expected} {unit}, has {actual}")]
    Length {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// What is counted: `pixels` or `bytes`.
        unit: &'static str,
        /// How many the size asks for.
        expected: usize,
        /// How many there are.
        actual: usize,
    },
    /// Rows start closer together than their pixels need (`step` in ROS).
    #[error("image rows of {width} pixels need {min_row_bytes} bytes, step is {row_bytes}")]
    Row {
        /// Width in pixels.
        width: u32,
        /// Bytes that the pixels of a row take.
        min_row_bytes: usize,
        /// Bytes from one row to the next, as given.
        row_bytes: usize,
    },
    /// The encoding's name is not one that veneer reads.
    #[error("image encoding '{0}' is not supported")]
    Encoding(String),
    /// The codec refused the bytes.
    #[error("{codec} image does not decode: {reason}")]
    Codec {
        /// `jpeg`, `png` or `rvl`.
        codec: &'static str,
        /// The codec's words.
        reason: String,
    },
}

fn check_size(width: u32, height: u32) -> Result<usize, ImageError> {
    let sides = 1..=crate::geom::camera::MAX_IMAGE_SIDE_PX;
    if sides.contains(&width) && sides.contains(&height) {
        Ok(width as usize * height as usize)
    } else {
        Err(ImageError::Size { width, height })
    }
}

/// A compressed image may claim any size in a few bytes; past this many pixels (a quarter of a
/// gigabyte once decoded) it is refused.
const MAX_DECODED_PIXELS: usize = 1 << 26;

pub(crate) fn check_decoded_size(width: u32, height: u32) -> Result<usize, ImageError> {
    let num_pixels = check_size(width, height)?;
    if num_pixels > MAX_DECODED_PIXELS {
        return Err(ImageError::Size { width, height });
    }
    Ok(num_pixels)
}

pub(crate) fn check_length(width: u32, height: u32, actual: usize) -> Result<(), ImageError> {
    let expected = check_size(width, height)?;
    if actual == expected {
        Ok(())
    } else {
        Err(ImageError::Length {
            width,
            height,
            unit: "pixels",
            expected,
            actual,
        })
    }
}

/// A colour image: sRGB bytes, row-major from the top left, never empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColorImage {
    width: u32,
    height: u32,
    pixels: Vec<[u8; 3]>,
}

impl ColorImage {
    /// An image of `width`×`height` sRGB pixels.
    ///
    /// # Errors
    /// [`ImageError`] when the size is unusable or `pixels` does not match it.
    pub fn new(width: u32, height: u32, pixels: Vec<[u8; 3]>) -> Result<Self, ImageError> {
        check_length(width, height, pixels.len())?;
        Ok(Self {
            width,
            height,
            pixels,
        })
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All pixels, row-major.
    pub fn pixels(&self) -> &[[u8; 3]] {
        &self.pixels
    }

    /// The pixel at column `x`, row `y`; coordinates past the edge are clamped to it.
    pub fn pixel_clamped(&self, x: u32, y: u32) -> [u8; 3] {
        let x = x.min(self.width - 1) as usize;
        let y = y.min(self.height - 1) as usize;
        self.pixels[y * self.width as usize + x]
    }

    /// The image of the same size with `map` applied to each pixel.
    #[must_use]
    pub fn mapped(&self, map: impl Fn([u8; 3]) -> [u8; 3]) -> Self {
        Self {
            width: self.width,
            height: self.height,
            pixels: self.pixels.iter().map(|pixel| map(*pixel)).collect(),
        }
    }

    /// Blocks of `factor`×`factor` pixels averaged in linear light; columns and rows that do not
    /// fill a block are left out. Its camera: [`super::PinholeCamera::reduced`].
    #[must_use]
    pub fn reduced(&self, factor: u32) -> Self {
        let factor = factor.clamp(1, self.width.min(self.height));
        if factor == 1 {
            return self.clone();
        }
        let (width, height) = (self.width / factor, self.height / factor);
        let share = 1.0 / (factor * factor) as f32;
        let mut pixels = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0; 3];
                for (dy, dx) in (0..factor).flat_map(|dy| (0..factor).map(move |dx| (dy, dx))) {
                    let pixel = self.pixel_clamped(x * factor + dx, y * factor + dy);
                    for (sum, byte) in sum.iter_mut().zip(pixel) {
                        *sum += linear_from_srgb(byte);
                    }
                }
                pixels.push(sum.map(|sum| srgb_from_linear(sum * share)));
            }
        }
        Self {
            width,
            height,
            pixels,
        }
    }

    /// Bilinear sample in sRGB bytes' scale (0–255); the lookup is clamped to the image.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the image before the casts"
    )]
    pub fn sample_bilinear(&self, [x_px, y_px]: [f32; 2]) -> [f32; 3] {
        let x_px = x_px.clamp(0.0, (self.width - 1) as f32);
        let y_px = y_px.clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (x_px as u32, y_px as u32);
        let (fx, fy) = (x_px - x0 as f32, y_px - y0 as f32);
        let p00 = self.pixel_clamped(x0, y0);
        let p10 = self.pixel_clamped(x0 + 1, y0);
        let p01 = self.pixel_clamped(x0, y0 + 1);
        let p11 = self.pixel_clamped(x0 + 1, y0 + 1);
        std::array::from_fn(|c| {
            let top = f32::from(p00[c]) + fx * (f32::from(p10[c]) - f32::from(p00[c]));
            let bottom = f32::from(p01[c]) + fx * (f32::from(p11[c]) - f32::from(p01[c]));
            top + fy * (bottom - top)
        })
    }
}

/// A depth image along z; 0 where nothing was measured (NaN, infinite and negative inputs become 0
/// at construction). Depths that were recorded in whole millimetres are kept so, at half the
/// memory. Pixels are shared: a clone costs nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthImage {
    width: u32,
    height: u32,
    depths: Depths,
}

#[derive(Clone, Debug, PartialEq)]
enum Depths {
    Metres(Arc<[f32]>),
    Millimetres(Arc<[u16]>),
}

/// Division, not a product with 0.001: it gives the float nearest to the decimal value.
fn metres_from_mm(mm: u16) -> f32 {
    f32::from(mm) / 1000.0
}

impl DepthImage {
    /// A depth image of `width`×`height` pixels, in metres.
    ///
    /// # Errors
    /// [`ImageError`] when the size is unusable or `depth_m` does not match it.
    pub fn new(width: u32, height: u32, mut depth_m: Vec<f32>) -> Result<Self, ImageError> {
        check_length(width, height, depth_m.len())?;
        for depth in &mut depth_m {
            if !(depth.is_finite() && *depth > 0.0) {
                *depth = 0.0;
            }
        }
        Ok(Self {
            width,
            height,
            depths: Depths::Metres(depth_m.into()),
        })
    }

    /// A depth image of `width`×`height` pixels, in millimetres.
    ///
    /// # Errors
    /// [`ImageError`] when the size is unusable or `depth_mm` does not match it.
    pub fn from_mm(width: u32, height: u32, depth_mm: Vec<u16>) -> Result<Self, ImageError> {
        check_length(width, height, depth_mm.len())?;
        Ok(Self {
            width,
            height,
            depths: Depths::Millimetres(depth_mm.into()),
        })
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Bytes that the pixels take.
    pub fn num_bytes(&self) -> usize {
        match &self.depths {
            Depths::Metres(depth_m) => size_of_val(&**depth_m),
            Depths::Millimetres(depth_mm) => size_of_val(&**depth_mm),
        }
    }

    /// All depths in metres, row-major; 0 = no measurement.
    pub fn depths_m(&self) -> Vec<f32> {
        match &self.depths {
            Depths::Metres(depth_m) => depth_m.to_vec(),
            Depths::Millimetres(depth_mm) => {
                depth_mm.iter().map(|&mm| metres_from_mm(mm)).collect()
            }
        }
    }

    /// The image of another size whose pixels are pixels of this one, by index; `None` has no
    /// measurement.
    ///
    /// # Errors
    /// [`ImageError`] when the size is unusable or `sources` does not match it.
    pub(crate) fn gathered(
        &self,
        width: u32,
        height: u32,
        sources: impl Iterator<Item = Option<usize>>,
    ) -> Result<Self, ImageError> {
        match &self.depths {
            Depths::Metres(depth_m) => {
                let pick = |source: Option<usize>| {
                    source
                        .and_then(|at| depth_m.get(at))
                        .copied()
                        .unwrap_or(0.0)
                };
                Self::new(width, height, sources.map(pick).collect())
            }
            Depths::Millimetres(depth_mm) => {
                let pick = |source: Option<usize>| {
                    source.and_then(|at| depth_mm.get(at)).copied().unwrap_or(0)
                };
                Self::from_mm(width, height, sources.map(pick).collect())
            }
        }
    }

    /// Depth at the pixel nearest to a position; `None` outside the image or without measurement.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "range-checked before the casts"
    )]
    pub fn nearest(&self, [x_px, y_px]: [f64; 2]) -> Option<f32> {
        let (x, y) = (x_px + 0.5, y_px + 0.5);
        let inside =
            x >= 0.0 && y >= 0.0 && x < f64::from(self.width) && y < f64::from(self.height);
        if !inside {
            return None;
        }
        let index = y as usize * self.width as usize + x as usize;
        let depth_m = match &self.depths {
            Depths::Metres(depth_m) => depth_m[index],
            Depths::Millimetres(depth_mm) => metres_from_mm(depth_mm[index]),
        };
        (depth_m > 0.0).then_some(depth_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn length_must_match_size() {
        assert!(ColorImage::new(2, 2, vec![[0; 3]; 3]).is_err());
        assert!(ColorImage::new(0, 0, vec![]).is_err());
        assert!(DepthImage::new(1 << 15, 1, vec![0.0; 1 << 15]).is_err());
    }

    #[test]
    fn reducing_averages_whole_blocks() {
        let pixels = (0..20)
            .map(|i| [if i % 5 < 2 { 80 } else { 200 }; 3])
            .collect();
        let image = ColorImage::new(5, 4, pixels).unwrap();
        let half = image.reduced(2);
        assert_eq!((half.width(), half.height()), (2, 2));
        assert_eq!(half.pixels(), &[[80; 3], [200; 3], [80; 3], [200; 3]]);
        assert_eq!(image.reduced(100).width(), 1);
        assert_eq!(image.reduced(1), image);
    }

    #[test]
    fn bilinear_is_exact_on_a_ramp() {
        let pixels = (0..12).map(|i| [(i % 4) * 10, (i / 4) * 20, 7]).collect();
        let image = ColorImage::new(4, 3, pixels).unwrap();
        let [r, g, b] = image.sample_bilinear([1.25, 0.5]);
        assert!((r - 12.5).abs() < 1e-5 && (g - 10.0).abs() < 1e-5 && (b - 7.0).abs() < 1e-5);
        assert_eq!(image.sample_bilinear([-5.0, 99.0]), [0.0, 40.0, 7.0]);
    }

    #[test]
    fn invalid_depth_reads_as_none() {
        let image = DepthImage::new(2, 2, vec![f32::NAN, -1.0, f32::INFINITY, 2.0]).unwrap();
        assert_eq!(image.nearest([0.0, 0.0]), None);
        assert_eq!(image.nearest([1.4, 0.6]), Some(2.0));
        assert_eq!(image.nearest([1.6, 0.6]), None);
    }

    #[test]
    fn millimetres_read_as_the_metres_they_are() {
        let depth_mm: Vec<u16> = (0..=u16::MAX).collect();
        let depth_m: Vec<f32> = depth_mm.iter().map(|&mm| f32::from(mm) / 1000.0).collect();
        let in_mm = DepthImage::from_mm(256, 256, depth_mm).unwrap();
        let in_m = DepthImage::new(256, 256, depth_m).unwrap();
        assert_eq!(in_mm.depths_m(), in_m.depths_m());
        assert_eq!(2 * in_mm.num_bytes(), in_m.num_bytes());
        for position in [[0.0, 0.0], [7.4, 99.6], [255.2, 255.4], [256.0, 3.0]] {
            assert_eq!(in_mm.nearest(position), in_m.nearest(position));
        }
        let picks = || [Some(5), None, Some(65_535)].into_iter();
        let picked = in_mm.gathered(3, 1, picks()).unwrap();
        assert_eq!(picked.depths_m(), [0.005, 0.0, 65.535]);
        assert_eq!(
            in_m.gathered(3, 1, picks()).unwrap().depths_m(),
            picked.depths_m()
        );
        assert!(in_mm.gathered(2, 1, picks()).is_err());
    }
}
