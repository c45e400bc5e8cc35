//! Which data set, and how it is imported.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::str::FromStr;

use crate::bag::Compression;
use crate::bag::scan_writer::ScanTopics;

use super::ImportError;

/// A layout that can be imported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImportFormat {
    /// `cameras.json`, `intrinsics.json`, `frames/`.
    Capture,
    /// TUM RGB-D: `rgb.txt`, `depth.txt`, `groundtruth.txt`.
    Tum,
    /// 7-Scenes: `frame-NNNNNN.{color.png,depth.png,pose.txt}`.
    SevenScenes,
    /// 3D Scanner App: `frame_NNNNN.{jpg,json}`, `depth_NNNNN.png`, `export.obj`.
    ThreeDScanner,
}

impl ImportFormat {
    /// All formats with the names they are asked for by.
    pub const NAMES: [(&'static str, Self); 4] = [
        ("capture", Self::Capture),
        ("tum", Self::Tum),
        ("7scenes", Self::SevenScenes),
        ("3dscanner", Self::ThreeDScanner),
    ];

    /// Formats that are known by name but cannot be imported yet.
    pub const NOT_YET: [&'static str; 3] = ["stray", "record3d", "scannet"];

    /// The name it is asked for by.
    pub fn name(self) -> &'static str {
        let named = Self::NAMES.iter().find(|(_, format)| *format == self);
        named.map_or("", |(name, _)| name)
    }
}

/// A format's name was not understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImportFormatError {
    /// A format that is planned.
    #[error("the format '{0}' cannot be imported yet; capture, tum, 7scenes and 3dscanner can")]
    NotYet(String),
    /// No format at all.
    #[error("'{0}' is no format; there are capture, tum, 7scenes and 3dscanner")]
    Unknown(String),
}

impl FromStr for ImportFormat {
    type Err = ImportFormatError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        if let Some(&(_, format)) = Self::NAMES.iter().find(|(known, _)| *known == name) {
            return Ok(format);
        }
        Err(if Self::NOT_YET.contains(&name) {
            ImportFormatError::NotYet(name.to_owned())
        } else {
            ImportFormatError::Unknown(name.to_owned())
        })
    }
}

/// How depth images are stored in the bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum DepthOutput {
    /// `compressedDepth`, 16-bit PNG.
    #[default]
    Png16,
    /// `sensor_msgs/Image`, `16UC1`.
    Raw,
}

/// A direction along an axis of the data set's world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum SignedAxis {
    X,
    NegX,
    Y,
    NegY,
    Z,
    NegZ,
}

impl SignedAxis {
    /// All directions with the names they are asked for by.
    pub const ALL: [(&'static str, Self); 6] = [
        ("x", Self::X),
        ("-x", Self::NegX),
        ("y", Self::Y),
        ("-y", Self::NegY),
        ("z", Self::Z),
        ("-z", Self::NegZ),
    ];
}

/// Which way is up in the data set's world; the bag's world has z up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum WorldUp {
    /// The world is not turned.
    #[default]
    AsRecorded,
    /// Found from how the cameras are held and from the mesh's level faces; not turned when these
    /// do not tell.
    Level,
    /// This axis.
    Axis(SignedAxis),
}

impl FromStr for WorldUp {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let axis = SignedAxis::ALL.iter().find(|(known, _)| *known == name);
        match (name, axis) {
            ("auto", _) => Ok(Self::Level),
            ("keep", _) => Ok(Self::AsRecorded),
            (_, Some((_, axis))) => Ok(Self::Axis(*axis)),
            _ => Err(format!("'{name}' is not auto, keep, x, y, z, -x, -y or -z")),
        }
    }
}

/// What to import, and how.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// The mesh file (`.ply`, `.obj`) in the folder, or a path; `None`: the format's own name.
    pub mesh: Option<PathBuf>,
    /// `capture` only: the refined intrinsics and depth scale, and the mesh made with them.
    pub refined: bool,
    /// `tum` and `7scenes` only: fx, fy, cx, cy in pixels for colour and depth, without lens
    /// distortion, instead of the data set's usual ones.
    pub intrinsics_px: Option<[f64; 4]>,
    /// How depth images are stored.
    pub depth_output: DepthOutput,
    /// Depth below this ARKit confidence (0 low, 1 medium, 2 high) is left out; 0 keeps all.
    pub min_confidence: u8,
    /// Write the mesh as this many growing updates instead of one piece.
    pub grow: Option<NonZeroU32>,
    /// `tum` only: a depth image, and a pose at the trajectory's ends, may be this far from its
    /// colour image, seconds, 0..=1.
    pub max_time_difference_s: f64,
    /// Compression of the bag's chunks. The images in it are compressed already.
    pub compression: Compression,
    /// Which way is up in the data set's world.
    pub up: WorldUp,
    /// Topic and frame names.
    pub topics: ScanTopics,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            mesh: None,
            refined: false,
            intrinsics_px: None,
            depth_output: DepthOutput::default(),
            min_confidence: 1,
            grow: None,
            // The data set's own tools associate within 20 ms.
            max_time_difference_s: 0.02,
            compression: Compression::None,
            up: WorldUp::default(),
            topics: ScanTopics::default(),
        }
    }
}

/// ARKit's highest confidence.
const MAX_CONFIDENCE: u8 = 2;

impl ImportOptions {
    /// Whether every value is in range and applies to the format.
    ///
    /// # Errors
    /// [`ImportError::Option`] that names the option.
    pub fn check(&self, format: ImportFormat) -> Result<(), ImportError> {
        use ImportFormat::{Capture, SevenScenes, Tum};
        let refuse = |reason: String| Err(ImportError::Option { reason });
        if self.refined && format != Capture {
            return refuse(format!(
                "'refined' is for capture, not for {}",
                format.name()
            ));
        }
        if self.intrinsics_px.is_some() && !matches!(format, Tum | SevenScenes) {
            let name = format.name();
            return refuse(format!(
                "'intrinsics' is for tum and 7scenes, not for {name}"
            ));
        }
        if self.min_confidence > MAX_CONFIDENCE {
            let value = self.min_confidence;
            return refuse(format!(
                "'min-confidence' is {value}, not 0..={MAX_CONFIDENCE}"
            ));
        }
        if !(0.0..=1.0).contains(&self.max_time_difference_s) {
            let value = self.max_time_difference_s;
            return refuse(format!("'max-time-difference' is {value}, not 0..=1 s"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_known_or_refused_by_name() {
        for (name, format) in ImportFormat::NAMES {
            assert_eq!(name.parse::<ImportFormat>(), Ok(format));
            assert_eq!(format.name(), name);
        }
        for name in ImportFormat::NOT_YET {
            let error = name.parse::<ImportFormat>().unwrap_err();
            assert_eq!(error, ImportFormatError::NotYet(name.to_owned()));
            for (known, _) in ImportFormat::NAMES {
                assert!(error.to_string().contains(known), "{error}");
            }
        }
        assert!(matches!(
            "TUM".parse::<ImportFormat>(),
            Err(ImportFormatError::Unknown(_))
        ));
    }

    #[test]
    fn ways_up_are_known_by_name() {
        assert_eq!("auto".parse(), Ok(WorldUp::Level));
        assert_eq!("keep".parse(), Ok(WorldUp::AsRecorded));
        assert_eq!("-y".parse(), Ok(WorldUp::Axis(SignedAxis::NegY)));
        let error = "up".parse::<WorldUp>().unwrap_err();
        assert!(error.contains("'up'") && error.contains("-z"), "{error}");
    }

    #[test]
    fn options_that_do_not_apply_are_refused() {
        let refined = ImportOptions {
            refined: true,
            ..ImportOptions::default()
        };
        assert!(refined.check(ImportFormat::Capture).is_ok());
        assert!(refined.check(ImportFormat::Tum).is_err());
        let intrinsics = ImportOptions {
            intrinsics_px: Some([500.0, 500.0, 320.0, 240.0]),
            ..ImportOptions::default()
        };
        assert!(intrinsics.check(ImportFormat::Tum).is_ok());
        assert!(intrinsics.check(ImportFormat::ThreeDScanner).is_err());
        for confidence in [3, 255] {
            let options = ImportOptions {
                min_confidence: confidence,
                ..ImportOptions::default()
            };
            assert!(options.check(ImportFormat::Capture).is_err());
        }
    }
}
