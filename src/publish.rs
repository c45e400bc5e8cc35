//! From a painted scan to messages (stand-in).

use std::sync::Arc;

use crate::atlas::{AtlasLayout, AtlasTexture};
use crate::geom::Stamp;
use crate::keyframe::Keyframe;
use crate::mesh::TriMesh;
use crate::wire::{CdrWriter, WireHeader};

/// What is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum OutputTopic {
    /// Chart geometry and texels.
    TexturedMesh,
    /// For rviz2.
    Markers,
    /// For Foxglove.
    Scene,
    /// For mesh_tools.
    MeshGeometry,
    /// For mesh_tools.
    MeshMaterials,
    /// Where the kept frames were taken.
    Keyframes,
}

impl OutputTopic {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::TexturedMesh,
        Self::Markers,
        Self::Scene,
        Self::MeshGeometry,
        Self::MeshMaterials,
        Self::Keyframes,
    ];

    /// The name below `~/`.
    pub fn name(self) -> &'static str {
        match self {
            Self::TexturedMesh => "textured_mesh",
            Self::Markers => "markers",
            Self::Scene => "scene",
            Self::MeshGeometry => "mesh_geometry",
            Self::MeshMaterials => "mesh_materials",
            Self::Keyframes => "keyframes",
        }
    }

    /// `package/msg/Name`.
    pub fn type_name(self) -> &'static str {
        match self {
            Self::TexturedMesh => "veneer/msg/TexturedMeshBlock",
            Self::Markers => "visualization_msgs/msg/MarkerArray",
            Self::Scene => "foxglove_msgs/msg/SceneUpdate",
            Self::MeshGeometry => "mesh_msgs/msg/MeshGeometryStamped",
            Self::MeshMaterials => "mesh_msgs/msg/MeshMaterialsStamped",
            Self::Keyframes => "geometry_msgs/msg/PoseArray",
        }
    }
}

/// One painted state of the scan.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// When.
    pub stamp: Stamp,
    /// The mesh's frame.
    pub frame_id: &'a str,
    /// Which session.
    pub session: u64,
    /// Which revision.
    pub revision: u64,
    /// The mesh.
    pub mesh: &'a TriMesh,
    /// Where its triangles lie.
    pub layout: &'a AtlasLayout,
    /// The texels.
    pub texture: &'a AtlasTexture,
    /// The keyframes.
    pub keyframes: &'a [Arc<Keyframe>],
}

/// Settings.
#[derive(Clone, Copy, Debug, Default)]
pub struct PublishParams {}

/// A message.
#[derive(Clone, Debug)]
pub struct Outgoing {
    /// Where to.
    pub topic: OutputTopic,
    /// CDR with its header.
    pub bytes: Vec<u8>,
}

/// Why nothing was made.
#[derive(Debug, thiserror::Error)]
#[error("not published")]
pub struct PublishError;

/// Makes messages.
#[derive(Debug)]
pub struct Publisher;

impl Publisher {
    /// A publisher.
    pub fn new(_: PublishParams) -> Self {
        Self
    }

    /// Messages in the order to be sent.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn publish(
        &mut self,
        snapshot: &Snapshot<'_>,
        wanted: &dyn Fn(OutputTopic) -> bool,
    ) -> Result<Vec<Outgoing>, PublishError> {
        let mut out = Vec::new();
        if wanted(OutputTopic::Keyframes) {
            let mut writer = CdrWriter::little_endian();
            let header = WireHeader {
                stamp: snapshot.stamp,
                frame_id: snapshot.frame_id,
            };
            let (sec, nanosec) = header.stamp.to_ros();
            writer.scalar(sec);
            writer.scalar(nanosec);
            writer.string(header.frame_id);
            writer.sequence_len(snapshot.keyframes.len());
            for keyframe in snapshot.keyframes {
                let pose = &keyframe.world_from_camera;
                let position: [f64; 3] = (*pose.translation()).into();
                writer.array(&position);
                writer.array(&pose.quaternion_xyzw());
            }
            out.push(Outgoing {
                topic: OutputTopic::Keyframes,
                bytes: writer.into_bytes(),
            });
        }
        Ok(out)
    }
}
