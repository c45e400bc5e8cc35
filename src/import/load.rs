//! The images of one frame, from disk to what the bag holds.
//!
//! Photos keep their bytes. Depth keeps its bytes too when they are 16-bit PNG millimetres and
//! nothing asks for a change; otherwise it is decoded, changed and encoded again, without loss but
//! for the rounding to whole millimetres.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::geom::camera::MAX_IMAGE_SIDE_PX;
use crate::geom::{
    CameraError, CameraModel, DepthEncoding, DepthImage, EncodedColor, EncodedDepth, ImageError,
    RigidTransform, Stamp,
};

use super::scan::{ScanCameraError, ScanDepth, ScanFrame};
use super::{DepthOutput, ImportOptions};

/// Why an image of a frame was refused.
#[derive(Debug, thiserror::Error)]
pub(super) enum LoadError {
    #[error("cannot be read: {0}")]
    Read(#[from] std::io::Error),
    #[error(transparent)]
    Image(#[from] ImageError),
    #[error(transparent)]
    Camera(#[from] ScanCameraError),
    #[error("is no {bits}-bit grey PNG: {reason}")]
    GreyPng { bits: u8, reason: String },
    #[error(
        "the depth is {}x{}, its confidence {}x{}",
        depth[0], depth[1], confidence[0], confidence[1]
    )]
    ConfidenceSize {
        depth: [u32; 2],
        confidence: [u32; 2],
    },
}

/// A frame in memory.
pub(super) struct LoadedFrame {
    pub(super) stamp: Stamp,
    pub(super) world_from_camera: RigidTransform,
    pub(super) color: EncodedColor,
    pub(super) color_camera: CameraModel,
    pub(super) depth: Option<LoadedDepth>,
    /// The depth image that was refused, while the photo is good.
    pub(super) refused_depth: Option<(PathBuf, LoadError)>,
}

/// The depth half of a frame in memory.
pub(super) struct LoadedDepth {
    pub(super) stamp: Stamp,
    pub(super) image: EncodedDepth,
    pub(super) camera: CameraModel,
    /// In metres, where the mesh grows by it.
    pub(super) decoded: Option<DepthImage>,
}

fn read(path: &Path) -> Result<Arc<[u8]>, LoadError> {
    Ok(std::fs::read(path)?.into())
}

/// Reads a frame's images.
///
/// # Errors
/// [`LoadError`] when there is no usable photo; a bad depth image is reported beside it.
pub(super) fn load(frame: &ScanFrame, options: &ImportOptions) -> Result<LoadedFrame, LoadError> {
    let color = EncodedColor::from_file(read(&frame.color)?)?;
    let color_camera = frame
        .color_intrinsics
        .camera(color.width(), color.height())?;
    let loaded = frame
        .depth
        .as_ref()
        .map(|depth| (depth, load_depth(depth, &color_camera, options)));
    let (depth, refused_depth) = match loaded {
        None => (None, None),
        Some((_, Ok(depth))) => (Some(depth), None),
        Some((depth, Err(error))) => (None, Some((depth.path.clone(), error))),
    };
    Ok(LoadedFrame {
        stamp: frame.stamp,
        world_from_camera: frame.world_from_camera,
        color,
        color_camera,
        depth,
        refused_depth,
    })
}

fn load_depth(
    depth: &ScanDepth,
    color_camera: &CameraModel,
    options: &ImportOptions,
) -> Result<LoadedDepth, LoadError> {
    let bytes = read(&depth.path)?;
    let confidence = match &depth.confidence {
        Some(path) if options.min_confidence > 0 => Some(GreyPng::decode(&read(path)?, 8)?),
        _ => None,
    };
    let image = encode_depth(depth, bytes, confidence.as_ref(), options)?;
    let camera = match &depth.intrinsics {
        Some(intrinsics) => intrinsics.camera(image.width(), image.height())?,
        None => CameraModel {
            pinhole: color_camera
                .pinhole
                .resized(image.width(), image.height())
                .map_err(|error: CameraError| ScanCameraError::from(error))?,
            distortion: color_camera.distortion,
        },
    };
    let decoded = match options.grow {
        Some(_) => Some(image.decode()?),
        None => None,
    };
    Ok(LoadedDepth {
        stamp: depth.stamp,
        image,
        camera,
        decoded,
    })
}

fn encode_depth(
    depth: &ScanDepth,
    bytes: Arc<[u8]>,
    confidence: Option<&GreyPng>,
    options: &ImportOptions,
) -> Result<EncodedDepth, LoadError> {
    let is_mm = depth.mm_per_count == 1.0;
    let keeps_png = options.depth_output == DepthOutput::Png16;
    if keeps_png && is_mm && confidence.is_none() && depth.invalid_count.is_none() {
        return Ok(EncodedDepth::from_compressed(
            DepthEncoding::Png16Mm,
            bytes,
        )?);
    }
    let mut counts = GreyPng::decode(&bytes, 16)?;
    let num_cleared = counts.clear(depth.invalid_count, confidence, options.min_confidence)?;
    if keeps_png && is_mm && num_cleared == 0 {
        return Ok(EncodedDepth::from_compressed(
            DepthEncoding::Png16Mm,
            bytes,
        )?);
    }
    counts.scale(depth.mm_per_count);
    Ok(match options.depth_output {
        DepthOutput::Png16 => {
            EncodedDepth::png_from_u16_mm(counts.width, counts.height, &counts.values)?
        }
        DepthOutput::Raw => EncodedDepth::from_raw(
            DepthEncoding::U16Mm { big_endian: false },
            counts.width,
            counts.height,
            counts.width * 2,
            counts.values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        )?,
    })
}

/// A grey PNG of 8 or 16 bits.
struct GreyPng {
    width: u32,
    height: u32,
    values: Vec<u16>,
}

/// Deflate cannot expand by more than this (zlib's technical notes).
const MAX_DEFLATE_RATIO: u64 = 1032;

impl GreyPng {
    fn decode(bytes: &[u8], bits: u8) -> Result<Self, LoadError> {
        let refuse = |reason: String| LoadError::GreyPng { bits, reason };
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .map_err(|error| refuse(error.to_string()))?;
        let info = reader.info();
        let (width, height) = (info.width, info.height);
        if info.color_type != png::ColorType::Grayscale || info.bit_depth as u8 != bits {
            let found = (info.color_type, info.bit_depth);
            return Err(refuse(format!("it is {found:?}")));
        }
        let num_bytes = u64::from(width) * u64::from(height) * u64::from(bits / 8);
        let is_plausible = width <= MAX_IMAGE_SIDE_PX
            && height <= MAX_IMAGE_SIDE_PX
            && num_bytes <= bytes.len() as u64 * MAX_DEFLATE_RATIO;
        let Some(size) = reader.output_buffer_size().filter(|_| is_plausible) else {
            let found = bytes.len();
            return Err(refuse(format!("{width}x{height} out of {found} bytes")));
        };
        let mut raw = vec![0; size];
        reader
            .next_frame(&mut raw)
            .map_err(|error| refuse(error.to_string()))?;
        let values = if bits == 16 {
            let (pairs, _) = raw.as_chunks::<2>();
            pairs.iter().map(|&pair| u16::from_be_bytes(pair)).collect()
        } else {
            raw.iter().map(|&byte| u16::from(byte)).collect()
        };
        Ok(Self {
            width,
            height,
            values,
        })
    }

    /// Zeroes what is invalid or not trusted; how many pixels that changed.
    fn clear(
        &mut self,
        invalid_count: Option<u16>,
        confidence: Option<&Self>,
        min_confidence: u8,
    ) -> Result<usize, LoadError> {
        let mut num_cleared = 0;
        let mut clear = |value: &mut u16| {
            num_cleared += usize::from(*value != 0);
            *value = 0;
        };
        if let Some(invalid) = invalid_count {
            self.values
                .iter_mut()
                .filter(|value| **value == invalid)
                .for_each(&mut clear);
        }
        if let Some(confidence) = confidence {
            if (confidence.width, confidence.height) != (self.width, self.height) {
                return Err(LoadError::ConfidenceSize {
                    depth: [self.width, self.height],
                    confidence: [confidence.width, confidence.height],
                });
            }
            self.values
                .iter_mut()
                .zip(&confidence.values)
                .filter(|(_, confidence)| **confidence < u16::from(min_confidence))
                .for_each(|(value, _)| clear(value));
        }
        Ok(num_cleared)
    }

    /// Counts to millimetres, rounded; what does not fit into 16 bits is no measurement.
    fn scale(&mut self, mm_per_count: f64) {
        if mm_per_count == 1.0 {
            return;
        }
        for value in &mut self.values {
            let mm = (f64::from(*value) * mm_per_count).round();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "range-checked"
            )]
            let scaled = if (0.0..=65535.0).contains(&mm) {
                mm as u16
            } else {
                0
            };
            *value = scaled;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey_png(width: u32, height: u32, bits: u8, values: &[u16]) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        let raw: Vec<u8> = if bits == 16 {
            encoder.set_depth(png::BitDepth::Sixteen);
            values.iter().flat_map(|v| v.to_be_bytes()).collect()
        } else {
            values.iter().map(|&v| u8::try_from(v).unwrap()).collect()
        };
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&raw).unwrap();
        writer.finish().unwrap();
        file
    }

    fn depth_at(path: PathBuf) -> ScanDepth {
        ScanDepth {
            stamp: Stamp::from_nanos(0),
            path,
            intrinsics: None,
            confidence: None,
            mm_per_count: 1.0,
            invalid_count: None,
        }
    }

    fn encoded(
        depth: &ScanDepth,
        counts: &[u16],
        confidence: Option<&[u16]>,
        options: &ImportOptions,
    ) -> (Vec<u8>, EncodedDepth) {
        let bytes = grey_png(2, 2, 16, counts);
        let confidence =
            confidence.map(|values| GreyPng::decode(&grey_png(2, 2, 8, values), 8).unwrap());
        let image = encode_depth(depth, bytes.clone().into(), confidence.as_ref(), options);
        (bytes, image.unwrap())
    }

    fn mm(image: &EncodedDepth) -> Vec<f32> {
        let depths = image.decode().unwrap();
        depths
            .depths_m()
            .iter()
            .map(|m| (m * 1000.0).round())
            .collect()
    }

    #[test]
    fn bytes_are_kept_unless_something_changes() {
        let options = ImportOptions::default();
        let depth = depth_at(PathBuf::new());
        let counts = [0, 1, 1500, 65535];
        let (bytes, image) = encoded(&depth, &counts, None, &options);
        assert_eq!(image.bytes()[..], bytes[..]);
        // Nothing that was measured is below the confidence: the bytes stay.
        let (bytes, image) = encoded(&depth, &counts, Some(&[0, 1, 2, 1]), &options);
        assert_eq!(image.bytes()[..], bytes[..]);
        let (_, image) = encoded(&depth, &counts, Some(&[0, 1, 0, 2]), &options);
        assert_eq!(mm(&image), [0.0, 1.0, 0.0, 65535.0]);
        let strict = ImportOptions {
            min_confidence: 2,
            ..ImportOptions::default()
        };
        let (_, image) = encoded(&depth, &counts, Some(&[0, 1, 0, 2]), &strict);
        assert_eq!(mm(&image), [0.0, 0.0, 0.0, 65535.0]);
    }

    #[test]
    fn counts_become_millimetres() {
        let options = ImportOptions::default();
        let tum = ScanDepth {
            mm_per_count: 0.2,
            ..depth_at(PathBuf::new())
        };
        let (_, image) = encoded(&tum, &[0, 5000, 5003, 65535], None, &options);
        assert_eq!(mm(&image), [0.0, 1000.0, 1001.0, 13107.0]);
        let seven_scenes = ScanDepth {
            invalid_count: Some(65535),
            ..depth_at(PathBuf::new())
        };
        let (_, image) = encoded(&seven_scenes, &[0, 700, 65535, 65534], None, &options);
        assert_eq!(mm(&image), [0.0, 700.0, 0.0, 65534.0]);
        let doubled = ScanDepth {
            mm_per_count: 2.0,
            ..depth_at(PathBuf::new())
        };
        // What no longer fits is no measurement, not a wrapped one.
        let (_, image) = encoded(&doubled, &[0, 7, 32767, 40000], None, &options);
        assert_eq!(mm(&image), [0.0, 14.0, 65534.0, 0.0]);
    }

    #[test]
    fn raw_output_has_the_same_millimetres() {
        let raw = ImportOptions {
            depth_output: DepthOutput::Raw,
            ..ImportOptions::default()
        };
        let depth = depth_at(PathBuf::new());
        let (_, image) = encoded(&depth, &[0, 1, 1500, 65535], None, &raw);
        assert_eq!(image.encoding(), DepthEncoding::U16Mm { big_endian: false });
        assert_eq!(mm(&image), [0.0, 1.0, 1500.0, 65535.0]);
    }

    #[test]
    fn what_is_no_depth_is_refused() {
        let eight_bits = grey_png(2, 2, 8, &[1, 2, 3, 4]);
        let error = GreyPng::decode(&eight_bits, 16).err().unwrap();
        assert!(
            matches!(error, LoadError::GreyPng { bits: 16, .. }),
            "{error}"
        );
        let whole = grey_png(2, 2, 16, &[1, 2, 3, 4]);
        for length in 0..whole.len() - 12 {
            // All but the trailing IEND chunk is needed.
            assert!(
                GreyPng::decode(&whole[..length], 16).is_err(),
                "cut at {length}"
            );
        }
        let mut huge = whole;
        huge[16..24].copy_from_slice(&[0, 0, 0x3f, 0xff, 0, 0, 0x3f, 0xff]);
        assert!(GreyPng::decode(&huge, 16).is_err());
        let mut depth = GreyPng::decode(&grey_png(2, 2, 16, &[1; 4]), 16).unwrap();
        let confidence = GreyPng::decode(&grey_png(4, 1, 8, &[1; 4]), 8).unwrap();
        assert!(matches!(
            depth.clear(None, Some(&confidence), 1),
            Err(LoadError::ConfidenceSize { .. })
        ));
    }
}
