//! `foxglove_msgs/SceneUpdate`: what Foxglove and Lichtblick show, as far as veneer uses it:
//! entities that hold models (glTF files).
//!
//! The other primitives of an entity are read past only where their lists are empty.

use std::borrow::Cow;

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::geometry::WirePose;
use super::header;
use super::{Message, schema};
use crate::geom::Stamp;

/// `type` that deletes the entity of an id.
pub const MATCHING_ID: u8 = 0;
/// `type` that deletes all entities of the topic.
pub const ALL: u8 = 1;

/// `foxglove_msgs/SceneEntityDeletion`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneEntityDeletion<'a> {
    /// Entities older than this.
    pub timestamp: Stamp,
    /// [`MATCHING_ID`] or [`ALL`].
    pub kind: u8,
    /// Which entity.
    pub id: Cow<'a, str>,
}

/// `foxglove_msgs/ModelPrimitive`.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelPrimitive<'a> {
    /// Pose in the entity's frame.
    pub pose: WirePose,
    /// Factor along each axis.
    pub scale: [f64; 3],
    /// RGBA in [0, 1], where it overrides the model's.
    pub color: [f64; 4],
    /// Whether it does.
    pub has_color: bool,
    /// Where the file is; empty where `data` holds it.
    pub url: &'a str,
    /// `model/gltf-binary` …
    pub media_type: &'a str,
    /// The file.
    pub data: Cow<'a, [u8]>,
}

/// `foxglove_msgs/SceneEntity`.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneEntity<'a> {
    /// When it was made.
    pub timestamp: Stamp,
    /// Its frame.
    pub frame_id: &'a str,
    /// Replaces an entity of the same id.
    pub id: Cow<'a, str>,
    /// Seconds and nanoseconds until it vanishes; 0 = never.
    pub lifetime: (i32, u32),
    /// Whether it moves with its frame.
    pub frame_locked: bool,
    /// Names and values.
    pub metadata: Vec<(Cow<'a, str>, Cow<'a, str>)>,
    /// Models.
    pub models: Vec<ModelPrimitive<'a>>,
}

/// `foxglove_msgs/SceneUpdate`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct SceneUpdate<'a> {
    /// Applied first.
    pub deletions: Vec<SceneEntityDeletion<'a>>,
    /// Applied then.
    pub entities: Vec<SceneEntity<'a>>,
}

const MIN_DELETION_BYTES: usize = 16;
const MIN_ENTITY_BYTES: usize = 64;
const MIN_MODEL_BYTES: usize = 124;

/// The lists of an entity that veneer neither fills nor reads.
const OTHER_PRIMITIVES: [&str; 7] = [
    "entities.arrows",
    "entities.cubes",
    "entities.spheres",
    "entities.cylinders",
    "entities.lines",
    "entities.triangles",
    "entities.texts",
];

impl<'a> ModelPrimitive<'a> {
    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            pose: WirePose::read(
                reader,
                "entities.models.pose.position",
                "entities.models.pose.orientation",
            )?,
            scale: reader.array("entities.models.scale")?,
            color: reader.array("entities.models.color")?,
            has_color: reader.bool("entities.models.override_color")?,
            url: reader.string("entities.models.url")?,
            media_type: reader.string("entities.models.media_type")?,
            data: reader.bytes("entities.models.data")?.into(),
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.pose.write(writer);
        writer.array(&self.scale);
        writer.array(&self.color);
        writer.bool(self.has_color);
        writer.string(self.url);
        writer.string(self.media_type);
        writer.bytes(&self.data);
    }
}

impl<'a> SceneEntity<'a> {
    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            timestamp: header::read_time(
                reader,
                "entities.timestamp.sec",
                "entities.timestamp.nanosec",
            )?,
            frame_id: reader.string("entities.frame_id")?,
            id: reader.string("entities.id")?.into(),
            lifetime: (
                reader.scalar("entities.lifetime.sec")?,
                reader.scalar("entities.lifetime.nanosec")?,
            ),
            frame_locked: reader.bool("entities.frame_locked")?,
            metadata: reader.sequence("entities.metadata", 8, |reader| {
                Ok((
                    reader.string("entities.metadata.key")?.into(),
                    reader.string("entities.metadata.value")?.into(),
                ))
            })?,
            models: {
                for field in OTHER_PRIMITIVES {
                    let num_primitives: u32 = reader.scalar(field)?;
                    if num_primitives != 0 {
                        return Err(WireError::Field {
                            field,
                            reason: format!("has {num_primitives} entries; only models are read"),
                        });
                    }
                }
                reader.sequence("entities.models", MIN_MODEL_BYTES, ModelPrimitive::read)?
            },
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        header::write_time(writer, self.timestamp);
        writer.string(self.frame_id);
        writer.string(&self.id);
        writer.scalar(self.lifetime.0);
        writer.scalar(self.lifetime.1);
        writer.bool(self.frame_locked);
        writer.sequence_len(self.metadata.len());
        for (key, value) in &self.metadata {
            writer.string(key);
            writer.string(value);
        }
        for _ in OTHER_PRIMITIVES {
            writer.sequence_len(0);
        }
        writer.sequence_len(self.models.len());
        self.models.iter().for_each(|model| model.write(writer));
    }
}

impl<'a> Message<'a> for SceneUpdate<'a> {
    const TYPE_NAME: &'static str = "foxglove_msgs/msg/SceneUpdate";
    const SCHEMA: &'static str = schema::SCENE_UPDATE;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            deletions: reader.sequence("deletions", MIN_DELETION_BYTES, |reader| {
                Ok(SceneEntityDeletion {
                    timestamp: header::read_time(
                        reader,
                        "deletions.timestamp.sec",
                        "deletions.timestamp.nanosec",
                    )?,
                    kind: reader.scalar("deletions.type")?,
                    id: reader.string("deletions.id")?.into(),
                })
            })?,
            entities: reader.sequence("entities", MIN_ENTITY_BYTES, SceneEntity::read)?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.sequence_len(self.deletions.len());
        for deletion in &self.deletions {
            header::write_time(writer, deletion.timestamp);
            writer.scalar(deletion.kind);
            writer.string(&deletion.id);
        }
        writer.sequence_len(self.entities.len());
        self.entities.iter().for_each(|entity| entity.write(writer));
    }
}
