//! Steps of a scan as MCAP records and back: one step, one chunk.
//!
//! A chunk's checksum covers all its records, so a step is there whole or not at all. Beside the
//! [`JournalEntry`] lie the messages that a driver would send, so that a journal is a recording
//! too: images, camera infos, transforms, mesh.

use std::sync::Arc;

use crate::bag::record::{self, ChunkHeader, MAGIC, MessageHeader, op};
use crate::bag::scan_writer::ScanTopics;
use crate::geom::{EncodedColor, EncodedDepth, FrameDepth, RigidTransform, Stamp};
use crate::ingest::{MeshBlocks, MeshBlocksError, MeshUpdate};
use crate::keyframe::{Keyframe, KeyframeId};
use crate::mesh::TriMesh;
use crate::wire::geometry::WirePose;
use crate::wire::tf_message::TransformStamped;
use crate::wire::{
    CameraInfo, CompressedImage, Image, MeshGeometryStamped, Message, TfMessage, WireError,
    WireHeader,
};

use super::entry::{JournalEntry, Kind};

/// Larger chunks are neither written nor read: a broken length must not drive an allocation.
pub(super) const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// A step of a scan.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Change {
    /// A scan begins whose keyframes count from this number.
    Begin(KeyframeId),
    Keyframe(Arc<Keyframe>),
    Removed(KeyframeId),
    Pose(KeyframeId, RigidTransform),
    Mesh {
        num_updates: u64,
        mesh: Arc<TriMesh>,
        blocks: Arc<MeshBlocks>,
        /// When it was so, for other readers of the recording.
        stamp: Stamp,
    },
}

/// A change in its place.
#[derive(Debug)]
pub(super) struct Step {
    /// Counts the steps of a file, from 1.
    pub(super) sequence: u64,
    /// Checksum of the chunk before; 0 for the first.
    pub(super) follows_crc: u32,
    pub(super) change: Change,
    /// Empty where it was not known.
    pub(super) world_frame: String,
}

const ENTRY: u16 = 1;
const COLOR: u16 = 2;
const RAW_COLOR: u16 = 3;
const DEPTH: u16 = 4;
const RAW_DEPTH: u16 = 5;
const COLOR_INFO: u16 = 6;
const DEPTH_INFO: u16 = 7;
const TRANSFORMS: u16 = 8;
const MESH: u16 = 9;

/// Topic, type and definition of each channel.
fn channels(topics: &ScanTopics) -> [(u16, String, &'static str, &'static str); 9] {
    fn of<'m, M: Message<'m>>(id: u16, topic: String) -> (u16, String, &'static str, &'static str) {
        (id, topic, M::TYPE_NAME, M::SCHEMA)
    }
    let compressed = format!("{}/compressed", topics.color);
    let compressed_depth = format!("{}/compressedDepth", topics.depth);
    [
        of::<JournalEntry<'_>>(ENTRY, "/veneer/journal".to_owned()),
        of::<CompressedImage<'_>>(COLOR, compressed),
        of::<Image<'_>>(RAW_COLOR, topics.color.clone()),
        of::<CompressedImage<'_>>(DEPTH, compressed_depth),
        of::<Image<'_>>(RAW_DEPTH, topics.depth.clone()),
        of::<CameraInfo<'_>>(COLOR_INFO, topics.color_info.clone()),
        of::<CameraInfo<'_>>(DEPTH_INFO, topics.depth_info.clone()),
        of::<TfMessage<'_>>(TRANSFORMS, "/tf".to_owned()),
        of::<MeshGeometryStamped<'_>>(MESH, topics.mesh.clone()),
    ]
}

/// What every journal starts with, byte for byte.
pub(super) fn preamble() -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    put_record(&mut bytes, op::HEADER, |body| {
        put_text(body, "ros2");
        // Of the format, not of the program: older journals start alike.
        put_text(body, "veneer journal 2");
    });
    for (id, topic, type_name, schema) in channels(&ScanTopics::default()) {
        put_record(&mut bytes, op::SCHEMA, |body| {
            body.extend(id.to_le_bytes());
            put_text(body, type_name);
            put_text(body, "ros2msg");
            put_text(body, schema);
        });
        put_record(&mut bytes, op::CHANNEL, |body| {
            body.extend(id.to_le_bytes());
            body.extend(id.to_le_bytes());
            put_text(body, &topic);
            put_text(body, "cdr");
            // No metadata.
            put_text(body, "");
        });
    }
    bytes
}

/// What a journal that was closed ends with.
pub(super) fn ending() -> Vec<u8> {
    let mut bytes = Vec::new();
    // Neither checksum nor summary.
    put_record(&mut bytes, op::DATA_END, |body| body.extend([0; 4]));
    put_record(&mut bytes, op::FOOTER, |body| body.extend([0; 20]));
    bytes.extend(MAGIC);
    bytes
}

fn put_record(out: &mut Vec<u8>, opcode: u8, put_body: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let length_at = out.len();
    out.extend([0; 8]);
    put_body(out);
    let length = (out.len() - length_at - 8) as u64;
    out[length_at..length_at + 8].copy_from_slice(&length.to_le_bytes());
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    let length = u32::try_from(text.len()).unwrap_or(u32::MAX);
    out.extend(length.to_le_bytes());
    out.extend(text.as_bytes());
}

/// A chunk record, uncompressed (images are compressed already), and its checksum.
pub(super) fn chunk(step: &Step) -> (Vec<u8>, u32) {
    let mut records = Records {
        bytes: Vec::new(),
        sequence: step.sequence,
        log_time: 0,
    };
    records.put_step(step);
    let log_time = records.log_time.to_le_bytes();
    let records = records.bytes;
    let crc = crc32fast::hash(&records);
    let mut out = Vec::with_capacity(records.len() + 64);
    put_record(&mut out, op::CHUNK, |body| {
        body.extend(log_time);
        body.extend(log_time);
        body.extend((records.len() as u64).to_le_bytes());
        body.extend(crc.to_le_bytes());
        put_text(body, "");
        body.extend((records.len() as u64).to_le_bytes());
        body.extend(&records);
    });
    (out, crc)
}

/// Messages of a chunk that is being written.
struct Records {
    bytes: Vec<u8>,
    sequence: u64,
    /// Nanoseconds.
    log_time: u64,
}

impl Records {
    fn put<'m>(&mut self, channel: u16, message: &impl Message<'m>) {
        let sequence = u32::try_from(self.sequence & u64::from(u32::MAX)).unwrap_or(0);
        let log_time = self.log_time.to_le_bytes();
        put_record(&mut self.bytes, op::MESSAGE, |body| {
            body.extend(channel.to_le_bytes());
            body.extend(sequence.to_le_bytes());
            body.extend(log_time);
            body.extend(log_time);
            body.extend(message.encode());
        });
    }

    /// MCAP has no times before 1970.
    fn set_log_time(&mut self, stamp: Stamp) {
        self.log_time = u64::try_from(stamp.as_nanos()).unwrap_or(0);
    }

    fn put_step(&mut self, step: &Step) {
        let entry = |kind| JournalEntry {
            sequence: step.sequence,
            follows_crc: step.follows_crc,
            ..JournalEntry::new(kind, &step.world_frame)
        };
        match &step.change {
            Change::Begin(next_id) => self.put(
                ENTRY,
                &JournalEntry {
                    keyframe_id: *next_id,
                    ..entry(Kind::Begin)
                },
            ),
            Change::Keyframe(keyframe) => {
                self.put_keyframe(entry(Kind::Keyframe), keyframe, &step.world_frame);
            }
            Change::Removed(id) => self.put(
                ENTRY,
                &JournalEntry {
                    keyframe_id: *id,
                    ..entry(Kind::Removed)
                },
            ),
            Change::Pose(id, world_from_camera) => self.put(
                ENTRY,
                &JournalEntry {
                    keyframe_id: *id,
                    world_from_camera: *world_from_camera,
                    ..entry(Kind::Pose)
                },
            ),
            Change::Mesh {
                num_updates,
                mesh,
                blocks,
                stamp,
            } => {
                self.set_log_time(*stamp);
                let entry = JournalEntry {
                    num_mesh_updates: *num_updates,
                    mesh_blocks: blocks.spans().to_vec(),
                    stamp: *stamp,
                    ..entry(Kind::Mesh)
                };
                self.put(ENTRY, &entry);
                let header = WireHeader {
                    stamp: *stamp,
                    frame_id: &step.world_frame,
                };
                self.put(MESH, &MeshGeometryStamped::from_mesh(header, mesh));
            }
        }
    }

    fn put_keyframe(&mut self, entry: JournalEntry<'_>, keyframe: &Keyframe, world: &str) {
        let topics = ScanTopics::default();
        let stamp = keyframe.stamp;
        self.set_log_time(stamp);
        let depth = keyframe.depth.as_ref();
        self.put(
            ENTRY,
            &JournalEntry {
                keyframe_id: keyframe.id,
                stamp,
                world_from_camera: keyframe.world_from_camera,
                color_camera: Some(keyframe.color_camera),
                depth_camera: depth.map(|half| half.camera),
                depth_from_color: depth
                    .map_or_else(RigidTransform::identity, |half| half.depth_from_color),
                quality: keyframe.quality,
                ..entry
            },
        );
        let in_frame = |frame_id| WireHeader { stamp, frame_id };
        let header = in_frame(&topics.color_frame);
        let mut transforms = vec![TransformStamped {
            header: in_frame(world),
            child_frame_id: &topics.color_frame,
            transform: WirePose::from(&keyframe.world_from_camera),
        }];
        if let Some(half) = depth {
            transforms.push(TransformStamped {
                header,
                child_frame_id: &topics.depth_frame,
                transform: WirePose::from(&half.depth_from_color.inverse()),
            });
        }
        self.put(TRANSFORMS, &TfMessage { transforms });
        let info = CameraInfo::from_camera(header, &keyframe.color_camera);
        self.put(COLOR_INFO, &info);
        if let Some(message) = CompressedImage::from_color(header, &keyframe.color) {
            self.put(COLOR, &message);
        } else if let Some(message) = Image::from_color(header, &keyframe.color) {
            self.put(RAW_COLOR, &message);
        }
        if let Some(half) = depth {
            self.put_depth(in_frame(&topics.depth_frame), half);
        }
    }

    fn put_depth(&mut self, header: WireHeader<'_>, half: &FrameDepth) {
        self.put(DEPTH_INFO, &CameraInfo::from_camera(header, &half.camera));
        if let Some(message) = CompressedImage::from_depth(header, &half.image) {
            self.put(DEPTH, &message);
        } else if let Some(message) = Image::from_depth(header, &half.image) {
            self.put(RAW_DEPTH, &message);
        }
    }
}

/// Why a chunk gives no step.
#[derive(Debug, thiserror::Error)]
pub(super) enum ChunkError {
    #[error("its head is broken")]
    Head,
    #[error("its checksum does not match")]
    Checksum,
    #[error("it lacks {0}")]
    Lacks(&'static str),
    #[error(transparent)]
    Wire(#[from] WireError),
    #[error(transparent)]
    Blocks(#[from] MeshBlocksError),
}

/// The checksum that a chunk's body says it has, where it says any.
pub(super) fn said_crc(body: &[u8]) -> Option<u32> {
    ChunkHeader::parse(body).map(|header| header.uncompressed_crc)
}

/// The step of a chunk's body.
pub(super) fn read_step(body: &[u8]) -> Result<Step, ChunkError> {
    let header = ChunkHeader::parse(body).ok_or(ChunkError::Head)?;
    let records = &body[header.num_bytes..];
    let num_bytes = records.len() as u64;
    if !header.compression.is_empty()
        || header.uncompressed_size != num_bytes
        || header.compressed_size != num_bytes
    {
        return Err(ChunkError::Head);
    }
    if crc32fast::hash(records) != header.uncompressed_crc {
        return Err(ChunkError::Checksum);
    }
    let messages = Messages { records };
    let entry = JournalEntry::decode(messages.of(ENTRY).ok_or(ChunkError::Lacks("its entry"))?)?;
    let change = match entry.kind {
        Kind::Begin => Change::Begin(entry.keyframe_id),
        Kind::Keyframe => Change::Keyframe(Arc::new(messages.keyframe(&entry)?)),
        Kind::Removed => Change::Removed(entry.keyframe_id),
        Kind::Pose => Change::Pose(entry.keyframe_id, entry.world_from_camera),
        Kind::Mesh => {
            let mesh = messages.mesh()?;
            Change::Mesh {
                num_updates: entry.num_mesh_updates,
                blocks: Arc::new(MeshBlocks::new(entry.mesh_blocks, &mesh)?),
                mesh: Arc::new(mesh),
                stamp: entry.stamp,
            }
        }
    };
    Ok(Step {
        sequence: entry.sequence,
        follows_crc: entry.follows_crc,
        change,
        world_frame: entry.world_frame.to_owned(),
    })
}

/// The messages of a chunk that is read.
#[derive(Clone, Copy)]
struct Messages<'a> {
    records: &'a [u8],
}

impl<'a> Messages<'a> {
    fn of(self, channel: u16) -> Option<&'a [u8]> {
        let mut at = 0;
        while let Ok(found) = record::record_at(self.records, at, self.records.len()) {
            let body = &self.records[found.body.clone()];
            if found.opcode == op::MESSAGE
                && MessageHeader::parse(body).is_some_and(|m| m.channel_id == channel)
            {
                return body.get(MessageHeader::NUM_BYTES..);
            }
            at = found.body.end;
        }
        None
    }

    fn keyframe(self, entry: &JournalEntry<'_>) -> Result<Keyframe, ChunkError> {
        let depth = match entry.depth_camera {
            None => None,
            Some(camera) => Some(FrameDepth {
                image: self.depth()?,
                camera,
                depth_from_color: entry.depth_from_color,
            }),
        };
        Ok(Keyframe {
            id: entry.keyframe_id,
            stamp: entry.stamp,
            world_from_camera: entry.world_from_camera,
            color: self.color()?,
            color_camera: entry.color_camera.ok_or(ChunkError::Lacks("its camera"))?,
            depth,
            quality: entry.quality,
        })
    }

    fn color(self) -> Result<EncodedColor, ChunkError> {
        if let Some(bytes) = self.of(COLOR) {
            return Ok(CompressedImage::decode(bytes)?.to_color()?);
        }
        let bytes = self.of(RAW_COLOR);
        let bytes = bytes.ok_or(ChunkError::Lacks("its colour image"))?;
        Ok(Image::decode(bytes)?.to_color()?)
    }

    fn depth(self) -> Result<EncodedDepth, ChunkError> {
        if let Some(bytes) = self.of(DEPTH) {
            return Ok(CompressedImage::decode(bytes)?.to_depth()?);
        }
        let bytes = self.of(RAW_DEPTH);
        let bytes = bytes.ok_or(ChunkError::Lacks("its depth image"))?;
        Ok(Image::decode(bytes)?.to_depth()?)
    }

    fn mesh(self) -> Result<TriMesh, ChunkError> {
        let bytes = self.of(MESH).ok_or(ChunkError::Lacks("its mesh"))?;
        match MeshGeometryStamped::decode(bytes)?.to_update()? {
            (MeshUpdate::Whole(mesh), _) => Ok(mesh),
            (MeshUpdate::Blocks { .. }, _) => Err(ChunkError::Lacks("a whole mesh")),
        }
    }
}
