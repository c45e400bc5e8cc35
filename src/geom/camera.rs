//! Pinhole cameras and the lens models of `sensor_msgs/CameraInfo`.

use nalgebra::{Point3, Vector3};

/// Why intrinsics were refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// Zero or absurd image size.
    #[error("camera image size {width}x{height} is outside 1..={max}")]
    Size {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Largest accepted side.
        max: u32,
    },
    /// A focal length is not positive and finite or cannot belong to the image's size (as when it
    /// is given for an image of side 1), or the principal point is not finite.
    #[error(
        "camera matrix is invalid: fx {fx}, fy {fy}, cx {cx}, cy {cy} (focal lengths are 0.01 to 10000 times the image's longer side)"
    )]
    Intrinsics {
        /// Focal length in x, pixels.
        fx: f64,
        /// Focal length in y, pixels.
        fy: f64,
        /// Principal point, pixels.
        cx: f64,
        /// Principal point, pixels.
        cy: f64,
    },
    /// The distortion model is unknown, or has the wrong number of coefficients.
    #[error(
        "distortion model '{model}' with {num_coefficients} coefficients is not supported (plumb_bob with 4 or 5, rational_polynomial with 8, equidistant with 4)"
    )]
    Distortion {
        /// `distortion_model` as given.
        model: String,
        /// Number of coefficients given.
        num_coefficients: usize,
    },
    /// A distortion coefficient is NaN or infinite.
    #[error("distortion coefficient {index} is {value}")]
    DistortionNotFinite {
        /// Which coefficient.
        index: usize,
        /// Its value.
        value: f64,
    },
}

/// Images have at most this many pixels a side: larger is a broken header, not a camera.
pub const MAX_IMAGE_SIDE_PX: u32 = 1 << 14;

/// Focal lengths in units of the longer side: from a field of view of 178° to one of 0.006°.
const MIN_FOCAL_SIDES: f64 = 0.01;
const MAX_FOCAL_SIDES: f64 = 1e4;

/// An undistorted pinhole camera. The centre of the first pixel is (0, 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholeCamera {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: u32,
    height: u32,
}

impl PinholeCamera {
    /// Intrinsics in pixels for images of `width`×`height`.
    ///
    /// # Errors
    /// [`CameraError`] when a value cannot belong to a camera.
    pub fn new([fx, fy, cx, cy]: [f64; 4], width: u32, height: u32) -> Result<Self, CameraError> {
        let sides = 1..=MAX_IMAGE_SIDE_PX;
        if !sides.contains(&width) || !sides.contains(&height) {
            return Err(CameraError::Size {
                width,
                height,
                max: MAX_IMAGE_SIDE_PX,
            });
        }
        let side_px = f64::from(width.max(height));
        let focal_ok =
            |f: f64| (MIN_FOCAL_SIDES * side_px..=MAX_FOCAL_SIDES * side_px).contains(&f);
        if !focal_ok(fx) || !focal_ok(fy) || !cx.is_finite() || !cy.is_finite() {
            return Err(CameraError::Intrinsics { fx, fy, cx, cy });
        }
        Ok(Self {
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        })
    }

    /// fx, fy, cx, cy in pixels.
    pub fn intrinsics_px(&self) -> [f64; 4] {
        [self.fx, self.fy, self.cx, self.cy]
    }

    /// Image width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Image height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Pixel of a point in the optical frame; `None` at or behind the camera plane. The pixel may
    /// lie outside the image: see [`Self::contains`].
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<[f64; 2]> {
        if point_in_camera.z <= 0.0 {
            return None;
        }
        let inv_z = 1.0 / point_in_camera.z;
        Some([
            self.fx * point_in_camera.x * inv_z + self.cx,
            self.fy * point_in_camera.y * inv_z + self.cy,
        ])
    }

    /// Point in the optical frame at `depth_m` along z.
    pub fn unproject(&self, [x_px, y_px]: [f64; 2], depth_m: f64) -> Point3<f64> {
        Point3::from(self.ray(x_px, y_px) * depth_m)
    }

    /// Direction through a pixel in the optical frame, with z = 1.
    pub fn ray(&self, x_px: f64, y_px: f64) -> Vector3<f64> {
        Vector3::new((x_px - self.cx) / self.fx, (y_px - self.cy) / self.fy, 1.0)
    }

    /// Whether a bilinear lookup at this pixel reads only pixels of the image.
    pub fn contains(&self, [x_px, y_px]: [f64; 2]) -> bool {
        x_px >= 0.0
            && y_px >= 0.0
            && x_px <= f64::from(self.width - 1)
            && y_px <= f64::from(self.height - 1)
    }

    /// The camera of [`super::ColorImage::reduced`].
    ///
    /// # Errors
    /// [`CameraError::Size`] when nothing of the image is left.
    pub fn reduced(&self, factor: u32) -> Result<Self, CameraError> {
        let factor = factor.max(1);
        let scale = 1.0 / f64::from(factor);
        Self::new(
            [
                self.fx * scale,
                self.fy * scale,
                (self.cx + 0.5) * scale - 0.5,
                (self.cy + 0.5) * scale - 0.5,
            ],
            (self.width / factor).max(1),
            (self.height / factor).max(1),
        )
    }

    /// The same camera with its image resampled to `width`×`height` (pixel centres at integers).
    ///
    /// # Errors
    /// [`CameraError::Size`] when the new size is zero or absurd.
    pub fn resized(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self::new(
            [
                self.fx * sx,
                self.fy * sy,
                (self.cx + 0.5) * sx - 0.5,
                (self.cy + 0.5) * sy - 0.5,
            ],
            width,
            height,
        )
    }
}

/// Lens distortion, with the coefficients in the order of `sensor_msgs/CameraInfo.d`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// An ideal lens.
    None,
    /// `plumb_bob`: k1, k2, p1, p2, k3 (Brown–Conrady).
    PlumbBob([f64; 5]),
    /// `rational_polynomial`: k1, k2, p1, p2, k3, k4, k5, k6.
    RationalPolynomial([f64; 8]),
    /// `equidistant`: k1, k2, k3, k4 (Kannala–Brandt fisheye).
    Equidistant([f64; 4]),
}

impl Distortion {
    /// From the two fields of `sensor_msgs/CameraInfo`. No coefficients, or all zero ones, mean an
    /// ideal lens — except for `equidistant`, whose zero coefficients still are a fisheye.
    ///
    /// # Errors
    /// [`CameraError`] for an unknown model, a wrong count or a value that is not finite.
    pub fn from_ros(model: &str, coefficients: &[f64]) -> Result<Self, CameraError> {
        if let Some((index, &value)) = coefficients
            .iter()
            .enumerate()
            .find(|(_, v)| !v.is_finite())
        {
            return Err(CameraError::DistortionNotFinite { index, value });
        }
        let unsupported = || CameraError::Distortion {
            model: model.to_owned(),
            num_coefficients: coefficients.len(),
        };
        match (model, coefficients) {
            ("equidistant" | "fisheye", &[k1, k2, k3, k4]) => {
                Ok(Self::Equidistant([k1, k2, k3, k4]))
            }
            ("plumb_bob" | "rational_polynomial" | "radtan" | "none" | "", d)
                if d.iter().all(|&v| v == 0.0) =>
            {
                Ok(Self::None)
            }
            ("plumb_bob" | "radtan", &[k1, k2, p1, p2]) => {
                Ok(Self::PlumbBob([k1, k2, p1, p2, 0.0]))
            }
            ("plumb_bob" | "radtan", &[k1, k2, p1, p2, k3]) => {
                Ok(Self::PlumbBob([k1, k2, p1, p2, k3]))
            }
            ("rational_polynomial", &[k1, k2, p1, p2, k3, k4, k5, k6, ref rest @ ..])
                if rest.iter().all(|&v| v == 0.0) =>
            {
                Ok(Self::RationalPolynomial([k1, k2, p1, p2, k3, k4, k5, k6]))
            }
            _ => Err(unsupported()),
        }
    }

    /// Distorted normalised image coordinates (x/z, y/z) of an ideal ray.
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        match *self {
            Self::None => [x, y],
            Self::PlumbBob([k1, k2, p1, p2, k3]) => {
                let r2 = x * x + y * y;
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                tangential([x, y], r2, radial, p1, p2)
            }
            Self::RationalPolynomial([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let r2 = x * x + y * y;
                let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
                    / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
                tangential([x, y], r2, radial, p1, p2)
            }
            Self::Equidistant([k1, k2, k3, k4]) => {
                let r = x.hypot(y);
                if r < 1e-12 {
                    return [x, y];
                }
                let theta = r.atan();
                let t2 = theta * theta;
                let theta_d = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
                [x * theta_d / r, y * theta_d / r]
            }
        }
    }
}

fn tangential([x, y]: [f64; 2], r2: f64, radial: f64, p1: f64, p2: f64) -> [f64; 2] {
    [
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    ]
}

/// A camera as its driver calibrated it: pinhole intrinsics and a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    /// Intrinsics, before and after undistortion alike.
    pub pinhole: PinholeCamera,
    /// The lens of the recorded image.
    pub distortion: Distortion,
}

impl CameraModel {
    /// A camera whose images are undistorted already.
    pub fn ideal(pinhole: PinholeCamera) -> Self {
        Self {
            pinhole,
            distortion: Distortion::None,
        }
    }

    /// Pixel in the recorded (distorted) image that shows the undistorted pixel.
    pub fn distort_px(&self, [x_px, y_px]: [f64; 2]) -> [f64; 2] {
        let [fx, fy, cx, cy] = self.pinhole.intrinsics_px();
        let [x, y] = self
            .distortion
            .distort([(x_px - cx) / fx, (y_px - cy) / fy]);
        [fx * x + cx, fy * y + cy]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn focal_lengths_that_no_camera_has_are_refused() {
        for fx in [0.0, -500.0, 1e-300, 0.8, 1e300, f64::NAN, f64::INFINITY] {
            let refused = PinholeCamera::new([fx, 500.0, 320.0, 240.0], 640, 480);
            assert!(
                matches!(refused, Err(CameraError::Intrinsics { .. })),
                "{fx}"
            );
        }
        assert!(PinholeCamera::new([10.0, 50_000.0, 320.0, 240.0], 640, 480).is_ok());
    }

    #[test]
    fn projection_inverts_unprojection() {
        let camera = PinholeCamera::new([500.0, 510.0, 319.5, 239.5], 640, 480).unwrap();
        let point = camera.unproject([12.0, 400.0], 2.5);
        assert!((point.z - 2.5).abs() < 1e-12);
        let [x_px, y_px] = camera.project(&point).unwrap();
        assert!((x_px - 12.0).abs() < 1e-9 && (y_px - 400.0).abs() < 1e-9);
        assert_eq!(camera.project(&Point3::new(0.0, 0.0, -1.0)), None);
    }

    #[test]
    fn resizing_keeps_the_corners_of_the_image() {
        let camera = PinholeCamera::new([500.0, 510.0, 319.5, 239.5], 640, 480).unwrap();
        let half = camera.resized(320, 240).unwrap();
        // The image's top-left corner is at pixel (-0.5, -0.5) at every size.
        let corner = camera.ray(-0.5, -0.5);
        assert!((half.ray(-0.5, -0.5) - corner).norm() < 1e-12);
    }

    #[test]
    fn refuses_what_no_camera_has() {
        assert!(PinholeCamera::new([500.0, 0.0, 1.0, 1.0], 640, 480).is_err());
        assert!(PinholeCamera::new([500.0, 500.0, f64::NAN, 1.0], 640, 480).is_err());
        assert!(PinholeCamera::new([500.0, 500.0, 1.0, 1.0], 0, 480).is_err());
        assert!(PinholeCamera::new([500.0, 500.0, 1.0, 1.0], u32::MAX, 480).is_err());
        assert!(Distortion::from_ros("plumb_bob", &[0.1; 3]).is_err());
        assert!(Distortion::from_ros("magic", &[0.1; 5]).is_err());
        assert!(Distortion::from_ros("plumb_bob", &[f64::INFINITY; 5]).is_err());
        assert_eq!(
            Distortion::from_ros("plumb_bob", &[0.0; 5]),
            Ok(Distortion::None)
        );
    }
}
