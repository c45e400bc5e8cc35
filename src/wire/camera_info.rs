//! `sensor_msgs/CameraInfo`.

use crate::geom::{CameraModel, Distortion, PinholeCamera};

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, schema};

/// `sensor_msgs/RegionOfInterest`, pixels of the full image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct RegionOfInterest {
    /// Left edge.
    pub x_offset: u32,
    /// Top edge.
    pub y_offset: u32,
    /// Height; 0 = the whole image.
    pub height: u32,
    /// Width; 0 = the whole image.
    pub width: u32,
    /// Whether the region is to be rectified apart.
    pub do_rectify: bool,
}

/// `sensor_msgs/CameraInfo`.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo<'a> {
    /// Stamp and optical frame.
    pub header: WireHeader<'a>,
    /// Height of the full image in pixels.
    pub height: u32,
    /// Width of the full image in pixels.
    pub width: u32,
    /// Name of the lens model.
    pub distortion_model: &'a str,
    /// Coefficients of the lens model.
    pub d: Vec<f64>,
    /// Camera matrix of the raw image, row-major 3×3, pixels.
    pub k: [f64; 9],
    /// Rectification, row-major 3×3.
    pub r: [f64; 9],
    /// Camera matrix of the rectified image, row-major 3×4, pixels.
    pub p: [f64; 12],
    /// Pixels joined along x; 0 = 1.
    pub binning_x: u32,
    /// Pixels joined along y; 0 = 1.
    pub binning_y: u32,
    /// The part of the full image that is sent.
    pub roi: RegionOfInterest,
}

impl<'a> Message<'a> for CameraInfo<'a> {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/CameraInfo";
    const SCHEMA: &'static str = schema::CAMERA_INFO;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            height: reader.scalar("height")?,
            width: reader.scalar("width")?,
            distortion_model: reader.string("distortion_model")?,
            d: reader.scalars("d")?,
            k: reader.array("k")?,
            r: reader.array("r")?,
            p: reader.array("p")?,
            binning_x: reader.scalar("binning_x")?,
            binning_y: reader.scalar("binning_y")?,
            roi: RegionOfInterest {
                x_offset: reader.scalar("roi.x_offset")?,
                y_offset: reader.scalar("roi.y_offset")?,
                height: reader.scalar("roi.height")?,
                width: reader.scalar("roi.width")?,
                do_rectify: reader.bool("roi.do_rectify")?,
            },
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.scalar(self.height);
        writer.scalar(self.width);
        writer.string(self.distortion_model);
        writer.scalars(&self.d);
        writer.array(&self.k);
        writer.array(&self.r);
        writer.array(&self.p);
        writer.scalar(self.binning_x);
        writer.scalar(self.binning_y);
        writer.scalar(self.roi.x_offset);
        writer.scalar(self.roi.y_offset);
        writer.scalar(self.roi.height);
        writer.scalar(self.roi.width);
        writer.bool(self.roi.do_rectify);
    }
}

/// Which of the images that share a camera info is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Rectification {
    /// The image as the sensor gave it: `k` and the lens.
    #[default]
    Raw,
    /// An image that `image_proc` rectified: `p` (`k` where `p` is unset) and no lens. The small
    /// rotation `r` of stereo pairs is part of what the optical frame then means.
    Rectified,
}

impl<'a> CameraInfo<'a> {
    /// The camera of the images that come with this info, with binning and region of interest
    /// worked in.
    ///
    /// # Errors
    /// [`WireError::Camera`] when the matrix is unset or the lens unknown.
    pub fn to_camera(&self, rectification: Rectification) -> Result<CameraModel, WireError> {
        let intrinsics = match rectification {
            Rectification::Rectified if self.p[0] != 0.0 => {
                [self.p[0], self.p[5], self.p[2], self.p[6]]
            }
            _ => [self.k[0], self.k[4], self.k[2], self.k[5]],
        };
        let distortion = match rectification {
            Rectification::Raw => Distortion::from_ros(self.distortion_model, &self.d)?,
            Rectification::Rectified => Distortion::None,
        };
        let whole_unless = |side: u32, whole: u32| if side == 0 { whole } else { side };
        let width = whole_unless(self.roi.width, self.width);
        let height = whole_unless(self.roi.height, self.height);
        let [fx, fy, cx, cy] = intrinsics;
        let (bin_x, bin_y) = (self.binning_x.max(1), self.binning_y.max(1));
        // The centre of a binned pixel lies between those it joins, hence the halves.
        let binned =
            |c: f64, offset: u32, bin: u32| (c - f64::from(offset) + 0.5) / f64::from(bin) - 0.5;
        let pinhole = PinholeCamera::new(
            [
                fx / f64::from(bin_x),
                fy / f64::from(bin_y),
                binned(cx, self.roi.x_offset, bin_x),
                binned(cy, self.roi.y_offset, bin_y),
            ],
            width / bin_x,
            height / bin_y,
        )?;
        Ok(CameraModel {
            pinhole,
            distortion,
        })
    }

    /// The info of a camera.
    pub fn from_camera(header: WireHeader<'a>, camera: &CameraModel) -> Self {
        let [fx, fy, cx, cy] = camera.pinhole.intrinsics_px();
        let (distortion_model, d) = match camera.distortion {
            Distortion::None => ("plumb_bob", vec![0.0; 5]),
            Distortion::PlumbBob(d) => ("plumb_bob", d.to_vec()),
            Distortion::RationalPolynomial(d) => ("rational_polynomial", d.to_vec()),
            Distortion::Equidistant(d) => ("equidistant", d.to_vec()),
        };
        Self {
            header,
            height: camera.pinhole.height(),
            width: camera.pinhole.width(),
            distortion_model,
            d,
            k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
            binning_x: 0,
            binning_y: 0,
            roi: RegionOfInterest::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info() -> CameraInfo<'static> {
        let pinhole = PinholeCamera::new([500.0, 510.0, 319.5, 239.5], 640, 480).unwrap();
        let camera = CameraModel {
            pinhole,
            distortion: Distortion::PlumbBob([0.1, -0.2, 0.001, 0.002, 0.05]),
        };
        CameraInfo::from_camera(WireHeader::default(), &camera)
    }

    #[test]
    fn a_camera_round_trips() {
        let camera = info().to_camera(Rectification::Raw).unwrap();
        assert_eq!(
            CameraInfo::from_camera(WireHeader::default(), &camera),
            info()
        );
        let rectified = info().to_camera(Rectification::Rectified).unwrap();
        assert_eq!(rectified.distortion, Distortion::None);
        assert_eq!(rectified.pinhole, camera.pinhole);
    }

    #[test]
    fn binning_and_region_keep_the_rays() {
        let full = info().to_camera(Rectification::Raw).unwrap().pinhole;
        let mut part = info();
        (part.binning_x, part.binning_y) = (2, 2);
        part.roi = RegionOfInterest {
            x_offset: 100,
            y_offset: 40,
            width: 200,
            height: 100,
            do_rectify: false,
        };
        let part = part.to_camera(Rectification::Raw).unwrap().pinhole;
        assert_eq!((part.width(), part.height()), (100, 50));
        // Pixel (0, 0) joins the full image's (100..=101, 40..=41).
        assert!((part.ray(0.0, 0.0) - full.ray(100.5, 40.5)).norm() < 1e-12);
        assert!((part.ray(99.0, 49.0) - full.ray(298.5, 138.5)).norm() < 1e-12);
    }

    #[test]
    fn an_uncalibrated_camera_is_refused_with_its_numbers() {
        let mut unset = info();
        unset.k = [0.0; 9];
        let words = unset.to_camera(Rectification::Raw).unwrap_err().to_string();
        assert!(words.contains("fx 0"), "{words}");
    }
}
