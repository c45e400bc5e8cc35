//! Takes the lens out of an image, by a map that is built once per camera.
//!
//! For each pixel of the undistorted image the map holds where the recorded image shows it
//! ([`CameraModel::distort_px`]), in 1/256 px. Colour is interpolated bilinearly, depth is taken
//! from the nearest pixel (depths on either side of an edge must not mix).
//!
//! The undistorted camera has the recorded one's intrinsics. A pixel is valid when its source is
//! at most half a pixel outside the recorded image and its ray is inside the radius up to which
//! the lens model is monotonic: beyond it polynomial models fold back and would show the scene
//! twice. Invalid depth pixels read as no measurement; the colour image is cropped to a rectangle
//! without invalid pixels, and [`UndistortionMap::color_camera`] is the camera of that rectangle.
//! The rectangle is found by trimming the side with most invalid pixels, which is exact for the
//! convex regions that lenses give.

use rayon::prelude::*;

use super::camera::{CameraModel, Distortion, PinholeCamera};
use super::image::{ColorImage, DepthImage, ImageError};

/// Where one pixel comes from.
#[derive(Clone, Copy, Debug)]
struct Tap {
    /// Index of the upper left of the four source pixels; [`INVALID`] where there is none.
    index: u32,
    /// Position right of and below it in 1/256 px, 0..=256.
    fraction: [u16; 2],
}

const INVALID: u32 = u32::MAX;
/// Steps in which the radius is searched for the lens model's fold.
const NUM_RADIUS_STEPS: u32 = 4096;

/// A rectangle of pixels; `x1` and `y1` are past its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PixelRect {
    x0: u32,
    y0: u32,
    x1: u32,
    y1: u32,
}

/// The undistortion of one camera's images.
#[derive(Clone, Debug)]
pub struct UndistortionMap {
    camera: PinholeCamera,
    color_camera: PinholeCamera,
    crop: PixelRect,
    taps: Vec<Tap>,
}

impl UndistortionMap {
    /// The map of a camera.
    ///
    /// # Errors
    /// [`ImageError::Size`] when the lens model leaves no valid pixel.
    pub fn new(camera: &CameraModel) -> Result<Self, ImageError> {
        let pinhole = camera.pinhole;
        let (width, height) = (pinhole.width(), pinhole.height());
        let max_radius = monotonic_radius(camera);
        let mut taps = vec![
            Tap {
                index: INVALID,
                fraction: [0; 2]
            };
            width as usize * height as usize
        ];
        taps.par_chunks_mut(width as usize)
            .zip(0u32..height)
            .for_each(|(row, y)| {
                for (tap, x) in row.iter_mut().zip(0u32..) {
                    *tap = tap_at(camera, max_radius, [x, y]);
                }
            });
        let crop = valid_rectangle(&taps, width, height);
        let cropped_away = || ImageError::Size {
            width: crop.x1 - crop.x0,
            height: crop.y1 - crop.y0,
        };
        let [fx, fy, cx, cy] = pinhole.intrinsics_px();
        let color_camera = PinholeCamera::new(
            [fx, fy, cx - f64::from(crop.x0), cy - f64::from(crop.y0)],
            crop.x1 - crop.x0,
            crop.y1 - crop.y0,
        )
        .map_err(|_| cropped_away())?;
        Ok(Self {
            camera: pinhole,
            color_camera,
            crop,
            taps,
        })
    }

    /// The camera of undistorted colour images.
    pub fn color_camera(&self) -> &PinholeCamera {
        &self.color_camera
    }

    /// The camera of undistorted depth images: the recorded one's intrinsics and size.
    pub fn depth_camera(&self) -> &PinholeCamera {
        &self.camera
    }

    /// Bytes that the map takes.
    pub fn num_bytes(&self) -> usize {
        self.taps.len() * size_of::<Tap>()
    }

    /// The undistorted colour image, of [`Self::color_camera`].
    ///
    /// # Errors
    /// [`ImageError::Length`] when the image does not have the camera's size.
    pub fn color(&self, recorded: &ColorImage) -> Result<ColorImage, ImageError> {
        self.check_size(recorded.width(), recorded.height())?;
        let source = recorded.pixels();
        let (right, below) = self.steps();
        let width = self.camera.width() as usize;
        let mut pixels = Vec::with_capacity(
            self.color_camera.width() as usize * self.color_camera.height() as usize,
        );
        for row in self.taps[self.crop.y0 as usize * width..self.crop.y1 as usize * width]
            .chunks_exact(width)
        {
            for tap in &row[self.crop.x0 as usize..self.crop.x1 as usize] {
                pixels.push(if tap.index == INVALID {
                    [0; 3]
                } else {
                    bilinear(source, *tap, right, below)
                });
            }
        }
        ColorImage::new(
            self.color_camera.width(),
            self.color_camera.height(),
            pixels,
        )
    }

    /// The undistorted depth image, of [`Self::depth_camera`].
    ///
    /// # Errors
    /// [`ImageError::Length`] when the image does not have the camera's size.
    pub fn depth(&self, recorded: &DepthImage) -> Result<DepthImage, ImageError> {
        self.check_size(recorded.width(), recorded.height())?;
        let (right, below) = self.steps();
        let nearest = self.taps.iter().map(|tap| {
            let [fx, fy] = tap.fraction.map(|f| usize::from(f >= 128));
            (tap.index != INVALID).then(|| tap.index as usize + fx * right + fy * below)
        });
        recorded.gathered(self.camera.width(), self.camera.height(), nearest)
    }

    /// Index steps to the right and the lower neighbour; 0 in an image of one column or row.
    fn steps(&self) -> (usize, usize) {
        let right = usize::from(self.camera.width() > 1);
        let below = if self.camera.height() > 1 {
            self.camera.width() as usize
        } else {
            0
        };
        (right, below)
    }

    fn check_size(&self, width: u32, height: u32) -> Result<(), ImageError> {
        if (width, height) == (self.camera.width(), self.camera.height()) {
            return Ok(());
        }
        Err(ImageError::Length {
            width: self.camera.width(),
            height: self.camera.height(),
            unit: "pixels",
            expected: self.taps.len(),
            actual: width as usize * height as usize,
        })
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a mean of bytes, weighted to 65536, is a byte"
)]
fn bilinear(source: &[[u8; 3]], tap: Tap, right: usize, below: usize) -> [u8; 3] {
    let i = tap.index as usize;
    let [p00, p10] = [source[i], source[i + right]];
    let [p01, p11] = [source[i + below], source[i + right + below]];
    let [fx, fy] = tap.fraction.map(u32::from);
    let weights = [
        (256 - fx) * (256 - fy),
        fx * (256 - fy),
        (256 - fx) * fy,
        fx * fy,
    ];
    std::array::from_fn(|c| {
        let sum = weights[0] * u32::from(p00[c])
            + weights[1] * u32::from(p10[c])
            + weights[2] * u32::from(p01[c])
            + weights[3] * u32::from(p11[c]);
        ((sum + (1 << 15)) >> 16) as u8
    })
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the image before the casts"
)]
fn tap_at(camera: &CameraModel, max_radius: f64, [x, y]: [u32; 2]) -> Tap {
    let invalid = Tap {
        index: INVALID,
        fraction: [0; 2],
    };
    let pixel = [f64::from(x), f64::from(y)];
    let ray = camera.pinhole.ray(pixel[0], pixel[1]);
    if ray.x.hypot(ray.y) > max_radius {
        return invalid;
    }
    let source_px = camera.distort_px(pixel);
    let size = [camera.pinhole.width(), camera.pinhole.height()];
    let mut first = [0u32; 2];
    let mut fraction = [0u16; 2];
    for axis in 0..2 {
        let last = f64::from(size[axis] - 1);
        if !(source_px[axis] >= -0.5 && source_px[axis] <= last + 0.5) {
            return invalid;
        }
        let position = (source_px[axis].clamp(0.0, last) * 256.0).round() as u32;
        first[axis] = (position / 256).min(size[axis].saturating_sub(2));
        fraction[axis] = (position - first[axis] * 256) as u16;
    }
    Tap {
        index: first[1] * size[0] + first[0],
        fraction,
    }
}

/// The largest ray radius (x/z, y/z) up to which the distorted radius rises.
fn monotonic_radius(camera: &CameraModel) -> f64 {
    let radial = match camera.distortion {
        Distortion::PlumbBob([k1, k2, _, _, k3]) => Distortion::PlumbBob([k1, k2, 0.0, 0.0, k3]),
        Distortion::RationalPolynomial([k1, k2, _, _, k3, k4, k5, k6]) => {
            Distortion::RationalPolynomial([k1, k2, 0.0, 0.0, k3, k4, k5, k6])
        }
        lens @ (Distortion::None | Distortion::Equidistant(_)) => lens,
    };
    let pinhole = &camera.pinhole;
    let (right, bottom) = (
        f64::from(pinhole.width() - 1),
        f64::from(pinhole.height() - 1),
    );
    let corner_radius = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]]
        .map(|[x, y]| {
            let ray = pinhole.ray(x, y);
            ray.x.hypot(ray.y)
        })
        .into_iter()
        .fold(0.0, f64::max);
    let mut before = 0.0;
    for step in 1..=NUM_RADIUS_STEPS {
        let radius = corner_radius * 1.01 * f64::from(step) / f64::from(NUM_RADIUS_STEPS);
        let [distorted, _] = radial.distort([radius, 0.0]);
        // Written so that NaN, from a pole of the rational model, ends the search as well.
        let is_rising = distorted > before;
        if !is_rising {
            return corner_radius * 1.01 * f64::from(step - 1) / f64::from(NUM_RADIUS_STEPS);
        }
        before = distorted;
    }
    f64::INFINITY
}

fn valid_rectangle(taps: &[Tap], width: u32, height: u32) -> PixelRect {
    let num_invalid = |x: std::ops::Range<u32>, y: std::ops::Range<u32>| {
        y.flat_map(|y| x.clone().map(move |x| (x, y)))
            .filter(|&(x, y)| taps[(y * width + x) as usize].index == INVALID)
            .count()
    };
    let mut rect = PixelRect {
        x0: 0,
        y0: 0,
        x1: width,
        y1: height,
    };
    while rect.x0 < rect.x1 && rect.y0 < rect.y1 {
        let PixelRect { x0, y0, x1, y1 } = rect;
        let per_column = f64::from(y1 - y0);
        let per_row = f64::from(x1 - x0);
        let shares = [
            num_invalid(x0..x0 + 1, y0..y1) as f64 / per_column,
            num_invalid(x1 - 1..x1, y0..y1) as f64 / per_column,
            num_invalid(x0..x1, y0..y0 + 1) as f64 / per_row,
            num_invalid(x0..x1, y1 - 1..y1) as f64 / per_row,
        ];
        let worst = (0..4).fold(0, |best, i| if shares[i] > shares[best] { i } else { best });
        if shares[worst] == 0.0 {
            break;
        }
        match worst {
            0 => rect.x0 += 1,
            1 => rect.x1 -= 1,
            2 => rect.y0 += 1,
            _ => rect.y1 -= 1,
        }
    }
    rect
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lenses() -> Vec<Distortion> {
        vec![
            Distortion::PlumbBob([-0.28, 0.07, 0.0008, -0.0005, 0.0]),
            Distortion::PlumbBob([0.12, -0.05, 0.001, 0.0, 0.0]),
            Distortion::RationalPolynomial([0.4, -0.2, 1e-4, -2e-4, 0.02, 0.6, -0.1, 0.01]),
            Distortion::Equidistant([-0.01, 0.004, -0.002, 0.0003]),
        ]
    }

    fn model(distortion: Distortion) -> CameraModel {
        CameraModel {
            pinhole: PinholeCamera::new([190.0, 195.0, 161.0, 118.0], 320, 240).unwrap(),
            distortion,
        }
    }

    /// Ideal coordinates of a distorted point, by Newton with a numerical Jacobian.
    fn inverted(lens: &Distortion, target: [f64; 2]) -> [f64; 2] {
        let mut p = target;
        for _ in 0..60 {
            let f = lens.distort(p);
            let r = [f[0] - target[0], f[1] - target[1]];
            let h = 1e-7;
            let fx = lens.distort([p[0] + h, p[1]]);
            let fy = lens.distort([p[0], p[1] + h]);
            let j = [
                [(fx[0] - f[0]) / h, (fy[0] - f[0]) / h],
                [(fx[1] - f[1]) / h, (fy[1] - f[1]) / h],
            ];
            let det = j[0][0] * j[1][1] - j[0][1] * j[1][0];
            p[0] -= (j[1][1] * r[0] - j[0][1] * r[1]) / det;
            p[1] -= (j[0][0] * r[1] - j[1][0] * r[0]) / det;
        }
        p
    }

    /// A smooth scene in ideal pixel coordinates.
    fn scene(x: f64, y: f64) -> [f64; 3] {
        [
            128.0 + 100.0 * (x * 0.04).sin() * (y * 0.03).cos(),
            100.0 + 0.3 * x,
            40.0 + 0.6 * y,
        ]
    }

    #[test]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the scene's values are bytes"
    )]
    fn undistorted_images_show_the_ideal_scene() {
        for lens in lenses() {
            let camera = model(lens);
            let [fx, fy, cx, cy] = camera.pinhole.intrinsics_px();
            // The recorded image, made with the numerically inverted lens.
            let mut pixels = Vec::new();
            let mut depths = Vec::new();
            for y in 0..240 {
                for x in 0..320 {
                    let target = [(f64::from(x) - cx) / fx, (f64::from(y) - cy) / fy];
                    let ideal = inverted(&lens, target);
                    let [u, v] = [fx * ideal[0] + cx, fy * ideal[1] + cy];
                    pixels.push(scene(u, v).map(|c| c.round().clamp(0.0, 255.0) as u8));
                    depths.push((1.0 + 0.002 * u + 0.001 * v).clamp(0.1, 9.0) as f32);
                }
            }
            let recorded = ColorImage::new(320, 240, pixels).unwrap();
            let recorded_depth = DepthImage::new(320, 240, depths).unwrap();
            let map = UndistortionMap::new(&camera).unwrap();
            let color = map.color(&recorded).unwrap();
            let crop = map.crop;
            assert!(
                color.width() > 200 && color.height() > 150,
                "{lens:?} {crop:?}"
            );
            for y in 0..color.height() {
                for x in 0..color.width() {
                    // The same ray through the cropped camera and the recorded one.
                    let ray = map.color_camera().ray(f64::from(x), f64::from(y));
                    let [u, v] = [fx * ray.x + cx, fy * ray.y + cy];
                    let expected = scene(u, v);
                    let actual = color.pixel_clamped(x, y);
                    for c in 0..3 {
                        let error = (f64::from(actual[c]) - expected[c].clamp(0.0, 255.0)).abs();
                        assert!(error < 3.0, "{lens:?} at {x},{y}: {error}");
                    }
                }
            }
            let depth = map.depth(&recorded_depth).unwrap();
            for (i, &depth_m) in depth.depths_m().iter().enumerate() {
                let (u, v) = ((i % 320) as f64, (i / 320) as f64);
                let expected = 1.0 + 0.002 * u + 0.001 * v;
                assert!(depth_m == 0.0 || (f64::from(depth_m) - expected).abs() < 0.005);
            }
        }
    }

    #[test]
    fn a_folding_lens_is_cut_off_before_its_fold() {
        // x (1 − 0.4 x²) turns back at x = 0.913; the image reaches 1.6.
        let camera = CameraModel {
            pinhole: PinholeCamera::new([100.0, 100.0, 160.0, 120.0], 320, 240).unwrap(),
            distortion: Distortion::PlumbBob([-0.4, 0.0, 0.0, 0.0, 0.0]),
        };
        let map = UndistortionMap::new(&camera).unwrap();
        let corner = map.color_camera().ray(0.0, 0.0);
        assert!(corner.x.hypot(corner.y) < 0.92, "{corner:?}");
        let depth = DepthImage::new(320, 240, vec![1.0; 320 * 240]).unwrap();
        let undistorted = map.depth(&depth).unwrap();
        assert_eq!(undistorted.nearest([0.0, 0.0]), None);
        assert_eq!(undistorted.nearest([160.0, 120.0]), Some(1.0));
    }

    #[test]
    fn an_ideal_lens_changes_nothing() {
        let camera = model(Distortion::None);
        let pixels = (0..320 * 240u32)
            .map(|i| [(i % 251) as u8, (i % 13) as u8, (i % 7) as u8])
            .collect();
        let image = ColorImage::new(320, 240, pixels).unwrap();
        let map = UndistortionMap::new(&camera).unwrap();
        assert_eq!(map.color(&image).unwrap(), image);
        assert_eq!(map.color_camera(), &camera.pinhole);
    }

    #[test]
    fn images_of_one_pixel_and_of_the_wrong_size_do_not_panic() {
        let camera = CameraModel {
            pinhole: PinholeCamera::new([1.0, 1.0, 0.0, 0.0], 1, 1).unwrap(),
            distortion: Distortion::Equidistant([0.0; 4]),
        };
        let map = UndistortionMap::new(&camera).unwrap();
        let image = ColorImage::new(1, 1, vec![[1, 2, 3]]).unwrap();
        assert_eq!(map.color(&image).unwrap(), image);
        assert!(
            map.color(&ColorImage::new(2, 1, vec![[0; 3]; 2]).unwrap())
                .is_err()
        );
        let nothing = CameraModel {
            pinhole: PinholeCamera::new([1.0, 1.0, 1e9, 0.0], 4, 4).unwrap(),
            distortion: Distortion::PlumbBob([-0.4, 0.0, 0.0, 0.0, 0.0]),
        };
        assert!(UndistortionMap::new(&nothing).is_err());
    }
}
