//! A data set's table of contents: which files make a frame, with its pose and cameras.
//!
//! Each format module turns its folder into a [`Scan`]; from there on all formats are alike.
//! Poses are optical frames (x right, y down, z forward) in the data set's world, stamps ascend.

use std::path::{Path, PathBuf};

use crate::geom::{CameraError, CameraModel, Distortion, PinholeCamera, RigidTransform, Stamp};

use super::ImportError;

/// Stamp of the first frame of a data set whose clock starts at zero: a zero stamp means
/// "the latest" to TF, so it must not name a frame.
pub(super) const FIRST_STAMP_OF_RELATIVE_CLOCK: Stamp = Stamp::from_nanos(1_000_000_000);

/// What a folder holds.
#[derive(Debug, Default)]
pub(super) struct Scan {
    /// In time order.
    pub(super) frames: Vec<ScanFrame>,
    /// The mesh to import.
    pub(super) mesh: Option<PathBuf>,
    /// Frames that the folder names but that cannot be used, with the reason.
    pub(super) refusals: Vec<String>,
    /// Choices that were made for the user, and what is missing.
    pub(super) notes: Vec<String>,
}

/// One posed frame, still on disk.
#[derive(Debug, Clone)]
pub(super) struct ScanFrame {
    /// When the colour image was taken.
    pub(super) stamp: Stamp,
    /// Pose of the colour camera.
    pub(super) world_from_camera: RigidTransform,
    /// A JPEG or PNG file.
    pub(super) color: PathBuf,
    pub(super) color_intrinsics: Intrinsics,
    pub(super) depth: Option<ScanDepth>,
}

/// The depth half of a frame; the depth camera is at the colour camera's pose.
#[derive(Debug, Clone)]
pub(super) struct ScanDepth {
    pub(super) stamp: Stamp,
    /// A 16-bit grey PNG file, 0 = no measurement.
    pub(super) path: PathBuf,
    /// `None`: registered to colour, so the colour camera at the depth image's size.
    pub(super) intrinsics: Option<Intrinsics>,
    /// An 8-bit grey PNG file of the depth's size.
    pub(super) confidence: Option<PathBuf>,
    /// Millimetres per count.
    pub(super) mm_per_count: f64,
    /// A count besides 0 that means "no measurement".
    pub(super) invalid_count: Option<u16>,
}

/// A camera as the data set describes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Intrinsics {
    /// fx, fy, cx, cy in pixels.
    pub(super) intrinsics_px: [f64; 4],
    /// The image size they are for; `None`: that of the image.
    pub(super) size_px: Option<[u32; 2]>,
    pub(super) distortion: Distortion,
}

/// Why an image and its intrinsics do not make a camera.
#[derive(Debug, thiserror::Error)]
pub(super) enum ScanCameraError {
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error("the image is {width}x{height}, its intrinsics are for {}x{}", expected[0], expected[1])]
    Size {
        width: u32,
        height: u32,
        expected: [u32; 2],
    },
}

impl Intrinsics {
    /// An ideal lens, intrinsics for whatever size the image has.
    pub(super) fn pinhole(intrinsics_px: [f64; 4]) -> Self {
        Self {
            intrinsics_px,
            size_px: None,
            distortion: Distortion::None,
        }
    }

    /// The camera of an image of this size.
    pub(super) fn camera(&self, width: u32, height: u32) -> Result<CameraModel, ScanCameraError> {
        if let Some(expected) = self.size_px
            && expected != [width, height]
        {
            return Err(ScanCameraError::Size {
                width,
                height,
                expected,
            });
        }
        Ok(CameraModel {
            pinhole: PinholeCamera::new(self.intrinsics_px, width, height)?,
            distortion: self.distortion,
        })
    }
}

/// The text of a file.
pub(super) fn read_text(path: &Path) -> Result<String, ImportError> {
    let bytes = std::fs::read(path).map_err(|source| ImportError::Read {
        path: path.to_owned(),
        source,
    })?;
    // Data set files are ASCII; a stray byte in a comment is no reason to refuse them.
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// A JSON file.
pub(super) fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, ImportError> {
    serde_json::from_str(&read_text(path)?).map_err(|error| ImportError::Malformed {
        path: path.to_owned(),
        reason: error.to_string(),
    })
}

/// Names of the files of a folder, sorted.
pub(super) fn file_names(folder: &Path) -> Result<Vec<String>, ImportError> {
    let refuse = |source| ImportError::Read {
        path: folder.to_owned(),
        source,
    };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(refuse)? {
        // A name that is not Unicode belongs to no data set.
        if let Ok(name) = entry.map_err(refuse)?.file_name().into_string() {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}

/// The part between a prefix and a suffix as a number: 17 of `frame_00017.jpg`.
pub(super) fn number_in_name(name: &str, prefix: &str, suffix: &str) -> Option<u32> {
    let digits = name.strip_prefix(prefix)?.strip_suffix(suffix)?;
    let is_number = !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit());
    is_number.then(|| digits.parse().ok()).flatten()
}

impl Scan {
    /// Sorts the frames by stamp (equal stamps keep their order).
    pub(super) fn sort_by_time(&mut self) {
        self.frames.sort_by_key(|frame| frame.stamp);
    }

    /// Moves all stamps so that the first frame is at [`FIRST_STAMP_OF_RELATIVE_CLOCK`]; for data
    /// sets whose clock starts anywhere near zero.
    pub(super) fn rebase_relative_clock(&mut self) {
        let Some(first) = self.frames.iter().map(|frame| frame.stamp).min() else {
            return;
        };
        let shift = |stamp: Stamp| {
            let since_first = stamp.as_nanos().saturating_sub(first.as_nanos());
            Stamp::from_nanos(since_first.saturating_add(FIRST_STAMP_OF_RELATIVE_CLOCK.as_nanos()))
        };
        for frame in &mut self.frames {
            frame.stamp = shift(frame.stamp);
            if let Some(depth) = &mut frame.depth {
                depth.stamp = shift(depth.stamp);
            }
        }
    }

    /// Settles which mesh is imported: the user's (relative to the folder, or else to the working
    /// directory), or the first of the format's own names that exists.
    pub(super) fn choose_mesh(
        &mut self,
        folder: &Path,
        chosen: Option<&Path>,
        default_names: &[&str],
    ) -> Result<(), ImportError> {
        self.mesh = match chosen {
            Some(name) => {
                let in_folder = folder.join(name);
                let path = if in_folder.is_file() {
                    in_folder
                } else {
                    name.to_owned()
                };
                if !path.is_file() {
                    return Err(ImportError::NoSuchMesh {
                        name: name.to_owned(),
                        folder: folder.to_owned(),
                    });
                }
                Some(path)
            }
            None => default_names
                .iter()
                .map(|name| folder.join(name))
                .find(|path| path.is_file()),
        };
        if self.mesh.is_none() {
            self.notes.push(format!(
                "no mesh: the folder has none of {}; name one, or replay has nothing to paint",
                default_names.join(", ")
            ));
        }
        Ok(())
    }
}
