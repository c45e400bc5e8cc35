//! From a scene to a bag: film it, add the faults, write the messages.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;

use crate::bag::scan_writer::{ScanTopics, ScanWriter};
use crate::geom::{
    CameraModel, ColorEncoding, ColorImage, DepthEncoding, EncodedColor, EncodedDepth, ImageError,
    PinholeCamera, RigidTransform, Stamp,
};
use crate::ingest::MeshUpdate;

use super::caster::{self, CastImage};
use super::growth::Growth;
use super::hash::Stream;
use super::options::{SceneName, SynthColorFormat, SynthDepthFormat, SynthError, SynthOptions};
use super::path::HandHeldPath;
use super::scene::Scene;
use super::sensor;
use super::tessellate;
use super::truth::{GroundTruth, METADATA_NAME, SCENE_VERSION};

/// What was written.
#[derive(Clone, Debug)]
pub struct SynthSummary {
    /// The truth that the recording can be scored against.
    pub truth: GroundTruth,
    /// RGB-D frames.
    pub num_frames: u32,
    /// Triangles of the whole mesh.
    pub num_triangles: usize,
    /// Mesh messages.
    pub num_mesh_messages: u32,
    /// The bag.
    pub bag: crate::bag::BagSummary,
}

/// When the first frame is taken: 2024-01-01 00:00:00 UTC, so that viewers show a sane date.
const FIRST_STAMP_NANOS: i64 = 1_704_067_200_000_000_000;
/// Frames that are filmed at once; encoding one overlaps with casting the next.
const BATCH_FRAMES: u32 = 4;
/// Images that make up a smeared one.
const NUM_SMEAR_IMAGES: u32 = 8;

/// One frame, ready to be written.
struct SynthFrame {
    stamp: Stamp,
    true_pose: RigidTransform,
    published_pose: RigidTransform,
    color: EncodedColor,
    depth: EncodedDepth,
    true_depth_m: Vec<f32>,
}

/// Everything that filming a frame needs.
struct Film<'a> {
    scene: &'a Scene,
    path: HandHeldPath,
    camera: PinholeCamera,
    options: &'a SynthOptions,
}

/// Films a scene into a bag. `progress` is called with (frames done, frames in all).
///
/// # Errors
/// [`SynthError`] when an option is out of range or the bag cannot be written.
pub fn synthesize(
    scene_name: SceneName,
    options: &SynthOptions,
    out: &Path,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<SynthSummary, SynthError> {
    options.check()?;
    let truth = GroundTruth::new(scene_name, options.seed);
    record(scene_name, truth, options, out, progress)
}

/// [`synthesize`] with the scene built already.
fn record(
    scene_name: SceneName,
    truth: GroundTruth,
    options: &SynthOptions,
    out: &Path,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<SynthSummary, SynthError> {
    let num_frames = options
        .num_frames
        .unwrap_or(scene_name.default_num_frames());
    let scene = Arc::clone(&truth.scene);
    let film = Film::new(&scene, options, num_frames)?;
    let camera = film.camera;
    let edge_m = options.mesh_edge_m.unwrap_or(scene.edge_m);
    let mesh = tessellate::scene_mesh(&scene, edge_m, &options.noise, options.seed)?;
    let num_triangles = mesh.num_triangles();

    let mut bag = ScanWriter::create(out, &ScanTopics::default(), options.compression)?;
    bag.metadata(METADATA_NAME, describe(scene_name, options, num_frames))?;
    let mut num_mesh_messages = 0;
    let mut growth = None;
    if options.grow == 0 {
        bag.mesh(film.stamp(0), &MeshUpdate::Whole(mesh))?;
        num_mesh_messages = 1;
    } else {
        growth = Some(Growth::new(mesh, scene_name.block_m()));
    }
    let num_updates = options.grow.min(num_frames);
    for batch in (0..num_frames).step_by(BATCH_FRAMES as usize) {
        let end = (batch + BATCH_FRAMES).min(num_frames);
        let frames: Vec<Result<SynthFrame, SynthError>> = (batch..end)
            .into_par_iter()
            .map(|index| film.frame(index))
            .collect();
        for (index, frame) in (batch..end).zip(frames) {
            let frame = frame?;
            write_frame(&mut bag, &frame, &CameraModel::ideal(camera))?;
            if let Some(growth) = &mut growth {
                growth.see(&camera, &frame.true_pose, &frame.true_depth_m);
                if index + 1 == num_frames {
                    growth.see_rest();
                }
                if is_update_due(index, num_frames, num_updates) {
                    let blocks = growth.take_changed();
                    let update = MeshUpdate::Blocks {
                        clear: num_mesh_messages == 0,
                        blocks,
                    };
                    bag.mesh(frame.stamp, &update)?;
                    num_mesh_messages += 1;
                }
            }
            progress(u64::from(index) + 1, u64::from(num_frames));
        }
    }
    Ok(SynthSummary {
        truth,
        num_frames,
        num_triangles,
        num_mesh_messages,
        bag: bag.finish()?,
    })
}

/// Whether one of `num_updates` evenly spread updates follows frame `index`; the last follows the
/// last frame.
fn is_update_due(index: u32, num_frames: u32, num_updates: u32) -> bool {
    let due = |frames: u32| u64::from(frames) * u64::from(num_updates) / u64::from(num_frames);
    due(index + 1) > due(index)
}

fn write_frame(
    bag: &mut ScanWriter,
    frame: &SynthFrame,
    camera: &CameraModel,
) -> Result<(), SynthError> {
    bag.pose(frame.stamp, &frame.published_pose)?;
    bag.color_info(frame.stamp, camera)?;
    bag.depth_info(frame.stamp, camera)?;
    bag.color(frame.stamp, &frame.color)?;
    bag.depth(frame.stamp, &frame.depth)?;
    Ok(())
}

/// The metadata record: what [`GroundTruth::from_metadata`] needs, and all options for people.
fn describe(scene: SceneName, options: &SynthOptions, num_frames: u32) -> BTreeMap<String, String> {
    let settings = serde_json::to_string(options).unwrap_or_default();
    [
        ("scene", scene.to_string()),
        ("scene_version", SCENE_VERSION.to_owned()),
        ("seed", options.seed.to_string()),
        ("num_frames", num_frames.to_string()),
        ("options", settings),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .into()
}

impl<'a> Film<'a> {
    fn new(
        scene: &'a Scene,
        options: &'a SynthOptions,
        num_frames: u32,
    ) -> Result<Self, SynthError> {
        let duration_s = f64::from(num_frames.saturating_sub(1)) / options.fps;
        Ok(Self {
            scene,
            path: HandHeldPath::new(&scene.waypoints_m, duration_s, options.seed),
            camera: options.camera()?,
            options,
        })
    }

    fn time_s(&self, index: u32) -> f64 {
        f64::from(index) / self.options.fps
    }

    fn stamp(&self, index: u32) -> Stamp {
        let offset = Stamp::from_seconds(self.time_s(index)).as_nanos();
        Stamp::from_nanos(FIRST_STAMP_NANOS + offset)
    }

    fn frame(&self, index: u32) -> Result<SynthFrame, SynthError> {
        let time_s = self.time_s(index);
        let true_pose = self.path.world_from_camera(time_s);
        let image = self.expose(&true_pose, time_s);
        let noise = &self.options.noise;
        let gain = sensor::frame_gain(noise, self.options.seed, time_s);
        let pixels = sensor::develop(
            &image.linear,
            gain,
            noise.image_255,
            self.stream("image", index),
        );
        let width = self.camera.width() as usize;
        let depth_mm = sensor::measure(&image, width, noise, self.stream("depth", index));
        Ok(SynthFrame {
            stamp: self.stamp(index),
            published_pose: self.published(&true_pose, index),
            true_pose,
            color: encode_color(&self.camera, pixels, self.options.color)?,
            depth: encode_depth(&self.camera, &depth_mm, self.options.depth)?,
            true_depth_m: image.depth_m,
        })
    }

    fn stream(&self, name: &str, index: u32) -> Stream {
        Stream::new(self.options.seed, name).sub(u64::from(index))
    }

    /// Colour over the shutter's time, depth at its middle.
    fn expose(&self, true_pose: &RigidTransform, time_s: f64) -> CastImage {
        let cast = |pose: &RigidTransform, supersampling: u32| {
            caster::cast(&self.scene.surfaces, &self.camera, pose, supersampling)
        };
        let shutter_s = self.options.noise.shutter_s;
        let mut image = cast(true_pose, self.options.supersampling);
        if shutter_s <= 0.0 {
            return image;
        }
        image.linear.fill([0.0; 3]);
        for k in 0..NUM_SMEAR_IMAGES {
            let share = (f64::from(k) + 0.5) / f64::from(NUM_SMEAR_IMAGES) - 0.5;
            let pose = self.path.world_from_camera(time_s + share * shutter_s);
            // The images' many poses take over part of the supersampling.
            let instant = cast(&pose, self.options.supersampling.min(2));
            for (sum, pixel) in image.linear.iter_mut().zip(&instant.linear) {
                for c in 0..3 {
                    sum[c] += pixel[c] / NUM_SMEAR_IMAGES as f32;
                }
            }
        }
        image
    }

    fn published(&self, true_pose: &RigidTransform, index: u32) -> RigidTransform {
        let noise = &self.options.noise;
        if noise.pose_translation_m <= 0.0 && noise.pose_rotation_rad <= 0.0 {
            return *true_pose;
        }
        let random = self.stream("pose", index);
        let axes = |first: u64| Vector3::from_fn(|k, _| random.gaussian(first + k as u64));
        let twist = UnitQuaternion::from_scaled_axis(axes(0) * noise.pose_rotation_rad);
        RigidTransform::from_parts(
            true_pose.rotation() * twist,
            true_pose.translation() + axes(3) * noise.pose_translation_m,
        )
    }
}

fn encode_color(
    camera: &PinholeCamera,
    pixels: Vec<[u8; 3]>,
    format: SynthColorFormat,
) -> Result<EncodedColor, ImageError> {
    let (width, height) = (camera.width(), camera.height());
    match format {
        SynthColorFormat::Jpeg(quality) => {
            let size =
                |side: u32| u16::try_from(side).map_err(|_| ImageError::Size { width, height });
            let mut bytes = Vec::new();
            jpeg_encoder::Encoder::new(&mut bytes, quality)
                .encode(
                    pixels.as_flattened(),
                    size(width)?,
                    size(height)?,
                    jpeg_encoder::ColorType::Rgb,
                )
                .map_err(|error| ImageError::Codec {
                    codec: "jpeg",
                    reason: error.to_string(),
                })?;
            EncodedColor::from_file(bytes.into())
        }
        SynthColorFormat::Png => {
            EncodedColor::png_from_image(&ColorImage::new(width, height, pixels)?)
        }
        SynthColorFormat::Raw => EncodedColor::from_raw(
            ColorEncoding::Rgb8,
            width,
            height,
            3 * width,
            pixels.as_flattened().into(),
        ),
    }
}

fn encode_depth(
    camera: &PinholeCamera,
    depth_mm: &[u16],
    format: SynthDepthFormat,
) -> Result<EncodedDepth, ImageError> {
    let (width, height) = (camera.width(), camera.height());
    match format {
        SynthDepthFormat::Png => EncodedDepth::png_from_u16_mm(width, height, depth_mm),
        SynthDepthFormat::Rvl => EncodedDepth::rvl_from_u16_mm(width, height, depth_mm),
        SynthDepthFormat::Raw => {
            let bytes: Vec<u8> = depth_mm.iter().flat_map(|mm| mm.to_le_bytes()).collect();
            let encoding = DepthEncoding::U16Mm { big_endian: false };
            EncodedDepth::from_raw(encoding, width, height, 2 * width, bytes.into())
        }
    }
}

#[cfg(test)]
mod tests;
