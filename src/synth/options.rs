//! What to synthesise: scene, sensor, faults, formats.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::bag::{BagError, Compression};
use crate::geom::{CameraError, ImageError, PinholeCamera};
use crate::mesh::MeshError;

use super::scene::{Scene, room, tabletop};

/// Why a recording could not be synthesised, or its description not be read.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// There is no such scene.
    #[error("there is no scene '{0}' (there are: room, tabletop)")]
    Scene(String),
    /// An option is out of its range.
    #[error("{name} is {value}, which is not {range}")]
    Option {
        /// Which option.
        name: &'static str,
        /// Its value.
        value: String,
        /// What it must be.
        range: &'static str,
    },
    /// The image size or the focal length cannot belong to a camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// An image could not be encoded.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The mesh cannot be indexed: the edge length is too small.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The bag could not be written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A bag's description of its scene cannot be used.
    #[error("the bag's description of its synthetic scene has '{value}' as {field}")]
    Metadata {
        /// Which field.
        field: &'static str,
        /// Its value, empty when missing.
        value: String,
    },
}

/// The scenes there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SceneName {
    /// A furnished living room of 5 × 4 × 2.5 m.
    Room,
    /// A cluttered table-top of 1.2 × 0.8 m in a plain studio.
    Tabletop,
}

impl SceneName {
    /// All scenes, in the order in which help lists them.
    pub const ALL: [Self; 2] = [Self::Room, Self::Tabletop];

    /// How many frames show all of the scene.
    pub const fn default_num_frames(self) -> u32 {
        match self {
            Self::Room => 120,
            Self::Tabletop => 60,
        }
    }

    pub(super) fn build(self, seed: u64) -> Scene {
        match self {
            Self::Room => room::build(seed),
            Self::Tabletop => tabletop::build(seed),
        }
    }

    /// Edge of the cubes in which the growing mesh is sent, metres.
    pub(super) const fn block_m(self) -> f64 {
        match self {
            Self::Room => 0.8,
            Self::Tabletop => 0.2,
        }
    }
}

impl fmt::Display for SceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Room => "room",
            Self::Tabletop => "tabletop",
        })
    }
}

impl FromStr for SceneName {
    type Err = SynthError;
    fn from_str(name: &str) -> Result<Self, SynthError> {
        Self::ALL
            .into_iter()
            .find(|scene| scene.to_string() == name)
            .ok_or_else(|| SynthError::Scene(name.to_owned()))
    }
}

/// How colour images are recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SynthColorFormat {
    /// JPEG of this quality, 1 to 100; without chroma subsampling from 90 on.
    Jpeg(u8),
    /// PNG: no loss.
    Png,
    /// Raw `rgb8`.
    Raw,
}

/// How depth images are recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SynthDepthFormat {
    /// compressedDepth: 16-bit PNG of millimetres.
    Png,
    /// compressedDepth: RVL of millimetres (smaller and faster where depth is noisy).
    Rvl,
    /// Raw `16UC1`, millimetres.
    Raw,
}

/// Faults, all off (0) by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SynthNoise {
    /// Standard deviation of the published position per axis and frame, metres, 0 to 1.
    pub pose_translation_m: f64,
    /// Standard deviation of the published orientation per axis and frame, radians, 0 to 1.
    pub pose_rotation_rad: f64,
    /// Standard deviation of depth over depth squared, 1/m, 0 to 0.1 (structured light: 0.0015).
    pub depth_quadratic_per_m: f64,
    /// Probability that a pixel beside a depth jump has no depth, 0 to 1.
    pub depth_dropout: f64,
    /// Standard deviation of the exposure's slow walk in stops, 0 to 3; the white balance walks a
    /// quarter of it.
    pub exposure_stops: f64,
    /// Time the shutter stays open, seconds, 0 to 1: moving images smear.
    pub shutter_s: f64,
    /// Standard deviation of read noise, sRGB levels of 255, 0 to 50.
    pub image_255: f64,
    /// Standard deviation of mesh vertices per axis, metres, 0 to 0.1.
    pub mesh_vertex_m: f64,
    /// Share of mesh faces left out, 0 to 1.
    pub missing_faces: f64,
    /// How many wall parts appear twice, 0 to 100.
    pub double_walls: u32,
    /// Distance of a doubled part from its wall, metres, 0 to 1.
    pub double_wall_offset_m: f64,
}

impl SynthNoise {
    /// What a good hand-held scan looks like: a few millimetres and tenths of a degree.
    pub fn realistic() -> Self {
        Self {
            pose_translation_m: 0.002,
            pose_rotation_rad: 0.002,
            depth_quadratic_per_m: 0.0015,
            depth_dropout: 0.5,
            exposure_stops: 0.15,
            shutter_s: 0.008,
            image_255: 1.5,
            mesh_vertex_m: 0.002,
            missing_faces: 0.01,
            double_walls: 3,
            double_wall_offset_m: 0.03,
        }
    }
}

/// What to synthesise beside the scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SynthOptions {
    /// Seed of every random choice.
    pub seed: u64,
    /// Number of RGB-D frames along the whole path, 1 to 100 000; `None`:
    /// [`SceneName::default_num_frames`].
    pub num_frames: Option<u32>,
    /// Image width in pixels, 16 to 4096.
    pub width: u32,
    /// Image height in pixels, 16 to 4096.
    pub height: u32,
    /// Frames per second, 0.1 to 1000: sets stamps, tremor and smear, not the path.
    pub fps: f64,
    /// Colour rays to a pixel's side, 1 to 8.
    pub supersampling: u32,
    /// Edge length of the mesh, metres, 0.002 to 1; `None`: 0.05 (room), 0.01 (table-top).
    pub mesh_edge_m: Option<f64>,
    /// Number of mesh updates as the camera reveals the scene, up to the number of frames; 0: the
    /// whole mesh before the first frame.
    pub grow: u32,
    /// Colour images.
    pub color: SynthColorFormat,
    /// Depth images.
    pub depth: SynthDepthFormat,
    /// Compression of the bag's chunks.
    #[serde(skip)]
    pub compression: Compression,
    /// Faults.
    pub noise: SynthNoise,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            num_frames: None,
            width: 640,
            height: 480,
            fps: 5.0,
            supersampling: 2,
            mesh_edge_m: None,
            grow: 0,
            color: SynthColorFormat::Jpeg(95),
            depth: SynthDepthFormat::Png,
            compression: Compression::None,
            noise: SynthNoise::default(),
        }
    }
}

impl SynthOptions {
    /// The sensor: 63° wide for an image of 4:3, as depth cameras are.
    ///
    /// # Errors
    /// [`SynthError::Camera`] when the size is absurd.
    pub fn camera(&self) -> Result<PinholeCamera, SynthError> {
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let focal_px = 525.0 / 640.0 * width;
        let centre = [(width - 1.0) / 2.0, (height - 1.0) / 2.0];
        Ok(PinholeCamera::new(
            [focal_px, focal_px, centre[0], centre[1]],
            self.width,
            self.height,
        )?)
    }

    pub(super) fn check(&self) -> Result<(), SynthError> {
        let noise = &self.noise;
        let quality = match self.color {
            SynthColorFormat::Jpeg(quality) => f64::from(quality),
            SynthColorFormat::Png | SynthColorFormat::Raw => 100.0,
        };
        let num_frames = self.num_frames.map_or(1.0, f64::from);
        let checks = [
            ("num_frames", num_frames, 1.0, 1e5, "between 1 and 100000"),
            (
                "width",
                f64::from(self.width),
                16.0,
                4096.0,
                "between 16 and 4096",
            ),
            (
                "height",
                f64::from(self.height),
                16.0,
                4096.0,
                "between 16 and 4096",
            ),
            ("fps", self.fps, 0.1, 1e3, "between 0.1 and 1000"),
            (
                "supersampling",
                f64::from(self.supersampling),
                1.0,
                8.0,
                "between 1 and 8",
            ),
            (
                "mesh_edge_m",
                self.mesh_edge_m.unwrap_or(0.05),
                0.002,
                1.0,
                "between 0.002 and 1",
            ),
            ("JPEG quality", quality, 1.0, 100.0, "between 1 and 100"),
            (
                "pose_translation_m",
                noise.pose_translation_m,
                0.0,
                1.0,
                "between 0 and 1",
            ),
            (
                "pose_rotation_rad",
                noise.pose_rotation_rad,
                0.0,
                1.0,
                "between 0 and 1",
            ),
            (
                "depth_quadratic_per_m",
                noise.depth_quadratic_per_m,
                0.0,
                0.1,
                "between 0 and 0.1",
            ),
            (
                "depth_dropout",
                noise.depth_dropout,
                0.0,
                1.0,
                "between 0 and 1",
            ),
            (
                "exposure_stops",
                noise.exposure_stops,
                0.0,
                3.0,
                "between 0 and 3",
            ),
            ("shutter_s", noise.shutter_s, 0.0, 1.0, "between 0 and 1"),
            ("image_255", noise.image_255, 0.0, 50.0, "between 0 and 50"),
            (
                "mesh_vertex_m",
                noise.mesh_vertex_m,
                0.0,
                0.1,
                "between 0 and 0.1",
            ),
            (
                "missing_faces",
                noise.missing_faces,
                0.0,
                1.0,
                "between 0 and 1",
            ),
            (
                "double_walls",
                f64::from(noise.double_walls),
                0.0,
                100.0,
                "between 0 and 100",
            ),
            (
                "double_wall_offset_m",
                noise.double_wall_offset_m,
                0.0,
                1.0,
                "between 0 and 1",
            ),
        ];
        for (name, value, low, high, range) in checks {
            if !(low..=high).contains(&value) {
                return Err(SynthError::Option {
                    name,
                    value: value.to_string(),
                    range,
                });
            }
        }
        Ok(())
    }
}
