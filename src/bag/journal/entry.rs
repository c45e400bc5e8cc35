//! What a chunk of a journal says: one message beside the usual ones, exact to the bit.
//!
//! Camera infos and transforms go through arithmetic when they are read; a scan that is taken up
//! again is to paint the same bytes, so everything but pixels and vertices is here as it was.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::geom::{
    CameraError, CameraModel, Distortion, FrameError, PinholeCamera, RigidTransform, Stamp,
};
use crate::ingest::MeshBlockSpan;
use crate::ingest::event::MeshBlockKey;
use crate::keyframe::{FrameQuality, KeyframeId};
use crate::wire::{CdrReader, CdrWriter, Message, WireError};

/// What a chunk is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A scan begins: nothing before it counts. `keyframe_id` is the first that is free.
    Begin,
    /// A keyframe, with its images.
    Keyframe,
    /// A keyframe is gone.
    Removed,
    /// A keyframe has another pose.
    Pose,
    /// The whole mesh.
    Mesh,
}

impl Kind {
    const ALL: [Self; 5] = [
        Self::Begin,
        Self::Keyframe,
        Self::Removed,
        Self::Pose,
        Self::Mesh,
    ];

    fn from_byte(byte: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u8 == byte)
    }
}

/// `veneer/JournalEntry`: fields that a kind does not have are zero.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct JournalEntry<'a> {
    /// Counts the entries of a file.
    pub(super) sequence: u64,
    /// Checksum of the chunk before; 0 for the first.
    pub(super) follows_crc: u32,
    pub(super) kind: Kind,
    pub(super) keyframe_id: KeyframeId,
    pub(super) stamp: Stamp,
    pub(super) world_from_camera: RigidTransform,
    pub(super) color_camera: Option<CameraModel>,
    pub(super) depth_camera: Option<CameraModel>,
    pub(super) depth_from_color: RigidTransform,
    pub(super) quality: FrameQuality,
    pub(super) num_mesh_updates: u64,
    /// Empty where it is not known.
    pub(super) world_frame: &'a str,
    /// Of the mesh; none where it came whole.
    pub(super) mesh_blocks: Vec<MeshBlockSpan>,
}

impl<'a> JournalEntry<'a> {
    pub(super) fn new(kind: Kind, world_frame: &'a str) -> Self {
        Self {
            sequence: 0,
            follows_crc: 0,
            kind,
            keyframe_id: KeyframeId(0),
            stamp: Stamp::default(),
            world_from_camera: RigidTransform::identity(),
            color_camera: None,
            depth_camera: None,
            depth_from_color: RigidTransform::identity(),
            quality: FrameQuality::default(),
            num_mesh_updates: 0,
            world_frame,
            mesh_blocks: Vec::new(),
        }
    }
}

impl<'a> Message<'a> for JournalEntry<'a> {
    const TYPE_NAME: &'static str = "veneer/msg/JournalEntry";
    const SCHEMA: &'static str = "\
# One step of a scan, in a journal of veneer; images and mesh are beside it in the same chunk.
# Counts the steps.
uint64 sequence
# Checksum of the chunk before, which tells a step from one of a write that failed.
uint32 follows_crc
# 0 a scan begins and nothing before it counts, 1 keyframe, 2 keyframe gone, 3 its pose, 4 mesh.
uint8 kind
# The keyframe; of kind 0 the first free number.
uint32 keyframe_id
# When the colour image was taken, nanoseconds.
int64 stamp
# x, y, z in metres and quaternion x, y, z, w of the colour camera in the world.
float64[7] world_from_camera
# Cameras: fx, fy, cx, cy in pixels; width, height; lens (0 no camera, 1 ideal, 2 plumb_bob,
# 3 rational_polynomial, 4 equidistant) and its coefficients.
float64[4] color_intrinsics
uint32[2] color_size
uint8 color_lens
float64[] color_distortion
float64[4] depth_intrinsics
uint32[2] depth_size
uint8 depth_lens
float64[] depth_distortion
# The colour camera in the depth camera.
float64[7] depth_from_color
# Sharpness, mean luma, share of clipped pixels.
float32[3] quality
# How often the mesh had changed.
uint64 num_mesh_updates
# The frame of poses and mesh; empty where it is not known.
string world_frame
# The blocks that the mesh came in, one behind the other; none where it came whole. Three numbers
# that name each, and how many vertices and triangles it has.
int64[] mesh_block_keys
uint32[] mesh_block_sizes
";

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        let sequence = reader.scalar("sequence")?;
        let follows_crc = reader.scalar("follows_crc")?;
        let kind: u8 = reader.scalar("kind")?;
        let kind = Kind::from_byte(kind).ok_or_else(|| WireError::Field {
            field: "kind",
            reason: format!("is {kind}, which no entry is"),
        })?;
        let keyframe_id = KeyframeId(reader.scalar("keyframe_id")?);
        let stamp = Stamp::from_nanos(reader.scalar("stamp")?);
        let world_from_camera = read_pose(reader, "world_from_camera")?;
        let color_camera = read_camera(reader, "color camera")?;
        let depth_camera = read_camera(reader, "depth camera")?;
        let depth_from_color = read_pose(reader, "depth_from_color")?;
        let [sharpness, mean_luma, clipped] = reader.array("quality")?;
        Ok(Self {
            sequence,
            follows_crc,
            kind,
            keyframe_id,
            stamp,
            world_from_camera,
            color_camera,
            depth_camera,
            depth_from_color,
            quality: FrameQuality {
                sharpness,
                mean_luma,
                clipped,
            },
            num_mesh_updates: reader.scalar("num_mesh_updates")?,
            world_frame: reader.string("world_frame")?,
            mesh_blocks: read_blocks(reader)?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.scalar(self.sequence);
        writer.scalar(self.follows_crc);
        writer.scalar(self.kind as u8);
        writer.scalar(self.keyframe_id.0);
        writer.scalar(self.stamp.as_nanos());
        write_pose(writer, &self.world_from_camera);
        write_camera(writer, self.color_camera.as_ref());
        write_camera(writer, self.depth_camera.as_ref());
        write_pose(writer, &self.depth_from_color);
        let quality = &self.quality;
        writer.array(&[quality.sharpness, quality.mean_luma, quality.clipped]);
        writer.scalar(self.num_mesh_updates);
        writer.string(self.world_frame);
        let keys = self.mesh_blocks.iter().map(|block| block.key.0);
        writer.scalars(keys.flatten().collect::<Vec<_>>().as_slice());
        let sizes = self.mesh_blocks.iter();
        let sizes = sizes.flat_map(|block| [block.num_vertices, block.num_triangles]);
        writer.scalars(sizes.collect::<Vec<_>>().as_slice());
    }
}

fn read_blocks(reader: &mut CdrReader<'_>) -> Result<Vec<MeshBlockSpan>, WireError> {
    let keys: Vec<i64> = reader.scalars("mesh_block_keys")?;
    let sizes: Vec<u32> = reader.scalars("mesh_block_sizes")?;
    let (keys, key_rest) = keys.as_chunks::<3>();
    let (sizes, size_rest) = sizes.as_chunks::<2>();
    if keys.len() != sizes.len() || key_rest.len() + size_rest.len() > 0 {
        return Err(WireError::Field {
            field: "mesh_block_sizes",
            reason: format!("has {} sizes for {} keys", sizes.len(), keys.len()),
        });
    }
    let blocks = keys.iter().zip(sizes);
    let blocks = blocks.map(|(key, [num_vertices, num_triangles])| MeshBlockSpan {
        key: MeshBlockKey(*key),
        num_vertices: *num_vertices,
        num_triangles: *num_triangles,
    });
    Ok(blocks.collect())
}

fn write_pose(writer: &mut CdrWriter, pose: &RigidTransform) {
    let [x, y, z]: [f64; 3] = (*pose.translation()).into();
    let [qx, qy, qz, qw] = pose.quaternion_xyzw();
    writer.array(&[x, y, z, qx, qy, qz, qw]);
}

fn read_pose(reader: &mut CdrReader<'_>, field: &'static str) -> Result<RigidTransform, WireError> {
    let [x, y, z, qx, qy, qz, qw] = reader.array(field)?;
    let refused = |error: FrameError| WireError::Frame {
        field: field.to_owned(),
        error,
    };
    RigidTransform::try_from_quaternion([qx, qy, qz, qw], [x, y, z]).map_err(refused)?;
    // Normalised once more, a quaternion may differ in its last bit.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz));
    Ok(RigidTransform::from_parts(rotation, Vector3::new(x, y, z)))
}

const NO_CAMERA: u8 = 0;

fn write_camera(writer: &mut CdrWriter, camera: Option<&CameraModel>) {
    let (intrinsics, size) = camera.map_or(([0.0; 4], [0; 2]), |camera| {
        let pinhole = &camera.pinhole;
        (pinhole.intrinsics_px(), [pinhole.width(), pinhole.height()])
    });
    let (lens, coefficients): (u8, &[f64]) = match camera.map(|camera| &camera.distortion) {
        None => (NO_CAMERA, &[]),
        Some(Distortion::None) => (1, &[]),
        Some(Distortion::PlumbBob(d)) => (2, d),
        Some(Distortion::RationalPolynomial(d)) => (3, d),
        Some(Distortion::Equidistant(d)) => (4, d),
    };
    writer.array(&intrinsics);
    writer.array(&size);
    writer.scalar(lens);
    writer.scalars(coefficients);
}

fn read_camera(
    reader: &mut CdrReader<'_>,
    field: &'static str,
) -> Result<Option<CameraModel>, WireError> {
    let intrinsics_px: [f64; 4] = reader.array(field)?;
    let [width, height]: [u32; 2] = reader.array(field)?;
    let lens: u8 = reader.scalar(field)?;
    let coefficients: Vec<f64> = reader.scalars(field)?;
    if lens == NO_CAMERA {
        return Ok(None);
    }
    if let Some(index) = coefficients.iter().position(|d| !d.is_finite()) {
        let value = coefficients[index];
        return Err(CameraError::DistortionNotFinite { index, value }.into());
    }
    let distortion = match (lens, coefficients.as_slice()) {
        (1, []) => Distortion::None,
        (2, d) => Distortion::PlumbBob(exactly(field, lens, d)?),
        (3, d) => Distortion::RationalPolynomial(exactly(field, lens, d)?),
        (4, d) => Distortion::Equidistant(exactly(field, lens, d)?),
        (_, d) => return Err(bad_lens(field, lens, d.len())),
    };
    Ok(Some(CameraModel {
        pinhole: PinholeCamera::new(intrinsics_px, width, height)?,
        distortion,
    }))
}

fn exactly<const N: usize>(
    field: &'static str,
    lens: u8,
    coefficients: &[f64],
) -> Result<[f64; N], WireError> {
    let array = coefficients.try_into();
    array.map_err(|_| bad_lens(field, lens, coefficients.len()))
}

fn bad_lens(field: &'static str, lens: u8, num_coefficients: usize) -> WireError {
    WireError::Field {
        field,
        reason: format!("has lens {lens} with {num_coefficients} coefficients"),
    }
}
