//! From painted states of the scan to the messages that show them (L7). Knows neither DDS nor files.
//!
//! | topic below `~/` | type | what is sent |
//! |---|---|---|
//! | `textured_mesh` | veneer/TexturedMeshBlock | charts and tiles that changed, exactly |
//! | `markers` | visualization_msgs/MarkerArray | pieces with their own texture, for rviz2 |
//! | `scene` | foxglove_msgs/SceneUpdate | the same as GLB files, for Foxglove and Lichtblick |
//! | `mesh_geometry`, `mesh_materials` | mesh_msgs | the same as meshes of their own, for mesh_tools |
//! | `keyframes` | geometry_msgs/PoseArray | where the kept frames were taken |
//!
//! No message is longer than [`PublishParams::max_message_bytes`]: longer ones do not arrive. A
//! [`Publisher`] remembers what it sent on each topic and sends only what changed since; what no
//! longer is gets removed. A topic that is wanted for the first time, or again after it was not, gets
//! the whole; so does one whose messages since the last whole would outgrow
//! [`PublishParams::history_messages`]. A writer that keeps that many messages therefore always holds
//! a whole state for those who come late.
//!
//! What is sent on `textured_mesh` can be put together again by [`Mirror`], to the bit where
//! [`PublishParams::format`] is PNG. The same snapshots give the same messages for any thread count.

mod blocks;
mod crop;
mod digest;
mod keyframes;
mod markers;
mod mesh;
pub mod mirror;
mod pieces;
mod scene;
mod sent;
mod viewer;

use std::borrow::Cow;
use std::sync::Arc;

use crate::atlas::{AtlasLayout, AtlasTexture, ChartKey};
use crate::export::{ExportError, PageFormat, TexturedMesh};
use crate::geom::Stamp;
use crate::keyframe::Keyframe;
use crate::mesh::{TriMesh, TriangleId};
use crate::wire::{
    MarkerArray, MeshGeometryStamped, MeshMaterialsStamped, Message, PoseArray, SceneUpdate,
    TexturedMeshBlock, WireHeader,
};

use markers::MarkerFormat;
use scene::SceneFormat;

pub use mesh::{MeshPiece, mesh_pieces};
pub use mirror::{Applied, Mirror, MirrorError};

/// What is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum OutputTopic {
    /// Charts and tiles that changed.
    TexturedMesh,
    /// For rviz2 as it ships.
    Markers,
    /// For Foxglove and Lichtblick.
    Scene,
    /// For mesh_tools: shape.
    MeshGeometry,
    /// For mesh_tools: look.
    MeshMaterials,
    /// Where the kept frames were taken.
    Keyframes,
}

impl OutputTopic {
    /// All topics, in the order in which they are sent.
    pub const ALL: [Self; 6] = [
        Self::TexturedMesh,
        Self::Markers,
        Self::Scene,
        Self::MeshGeometry,
        Self::MeshMaterials,
        Self::Keyframes,
    ];

    /// Its name below `~/`.
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

    /// Its message type, `package/msg/Name`.
    pub fn type_name(self) -> &'static str {
        match self {
            Self::TexturedMesh => TexturedMeshBlock::TYPE_NAME,
            Self::Markers => MarkerArray::TYPE_NAME,
            Self::Scene => SceneUpdate::TYPE_NAME,
            Self::MeshGeometry => MeshGeometryStamped::TYPE_NAME,
            Self::MeshMaterials => MeshMaterialsStamped::TYPE_NAME,
            Self::Keyframes => PoseArray::TYPE_NAME,
        }
    }

    /// The definition of its type with all dependencies, schema encoding `ros2msg`.
    pub fn schema(self) -> &'static str {
        match self {
            Self::TexturedMesh => TexturedMeshBlock::SCHEMA,
            Self::Markers => MarkerArray::SCHEMA,
            Self::Scene => SceneUpdate::SCHEMA,
            Self::MeshGeometry => MeshGeometryStamped::SCHEMA,
            Self::MeshMaterials => MeshMaterialsStamped::SCHEMA,
            Self::Keyframes => PoseArray::SCHEMA,
        }
    }
}

/// One painted state of the scan.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// When the newest data in it was taken.
    pub stamp: Stamp,
    /// The frame of the mesh.
    pub frame_id: &'a str,
    /// Differs from that of any earlier scan.
    pub session: u64,
    /// Grows by each state of the session, from 1.
    pub revision: u64,
    /// The mesh, metres.
    pub mesh: &'a TriMesh,
    /// Where its triangles lie in the atlas.
    pub layout: &'a AtlasLayout,
    /// The atlas.
    pub texture: &'a AtlasTexture,
    /// The frames that paint.
    pub keyframes: &'a [Arc<Keyframe>],
    /// What stands for each of the layout's charts, from who keeps mesh, layout and pages together, and vouches
    /// that they belong so; otherwise it is found out, and they are checked, which takes a look at every
    /// triangle.
    pub chart_keys: Option<&'a [ChartKey]>,
}

impl<'a> Snapshot<'a> {
    fn header(&self) -> WireHeader<'a> {
        WireHeader {
            stamp: self.stamp,
            frame_id: self.frame_id,
        }
    }

    fn content(&self) -> Result<Content<'a>, PublishError> {
        let (mesh, layout, texture) = (self.mesh, self.layout, self.texture);
        let known = self.chart_keys;
        let known = known.filter(|keys| keys.len() == layout.charts.len());
        debug_assert!(
            known.is_none() || TexturedMesh::new(mesh, layout, texture).is_ok(),
            "what was vouched for does not belong together"
        );
        Ok(match known {
            Some(keys) => Content {
                textured: TexturedMesh::vouched(mesh, layout, texture)?,
                keys: Cow::Borrowed(keys),
                is_vouched: true,
            },
            None => Content {
                textured: TexturedMesh::new(mesh, layout, texture)?,
                keys: Cow::Owned(ChartKey::of_all(mesh, layout)),
                is_vouched: false,
            },
        })
    }
}

/// What is shown, with what stands for its charts.
struct Content<'a> {
    textured: TexturedMesh<'a>,
    keys: Cow<'a, [ChartKey]>,
    /// Whether who knew the keys vouches for the rest.
    is_vouched: bool,
}

impl Content<'_> {
    /// Calls `visit` with the triangles of the charts that are wanted, by chart and number or all by number:
    /// where charts have their triangles in a row, as those have who vouch for them, that is the same.
    fn for_each_triangle(
        &self,
        is_wanted: impl Fn(usize) -> bool,
        mut visit: impl FnMut(usize, TriangleId),
    ) {
        let layout = self.textured.layout();
        if self.is_vouched {
            let charts = layout.charts.iter().enumerate();
            for (index, chart) in charts.filter(|(index, _)| is_wanted(*index)) {
                chart
                    .triangles
                    .iter()
                    .for_each(|&triangle| visit(index, triangle));
            }
            return;
        }
        // By `chart_of_triangle`, which is what the exports go by.
        let charts = self
            .textured
            .mesh()
            .triangle_ids()
            .zip(&layout.chart_of_triangle);
        for (triangle, chart) in charts.filter(|(_, chart)| is_wanted(chart.index())) {
            visit(chart.index(), triangle);
        }
    }
}

/// How states become messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishParams {
    /// No message is longer, its 4-byte header included.
    pub max_message_bytes: usize,
    /// Side of the tiles in which texels are compared and sent.
    pub tile_texel: u32,
    /// How `textured_mesh` carries texels; PNG is exact.
    pub format: PageFormat,
    /// How `markers` and `scene` carry their textures.
    pub viewer_format: PageFormat,
    /// Messages of one topic that its writer keeps for those who come late.
    pub history_messages: usize,
}

impl Default for PublishParams {
    fn default() -> Self {
        Self {
            max_message_bytes: 190_000,
            tile_texel: 256,
            format: PageFormat::Png,
            viewer_format: PageFormat::Jpeg { quality: 90 },
            history_messages: 1000,
        }
    }
}

/// Smallest bound on a message's length: room for the fields that do not grow, and a few triangles.
pub const MIN_MESSAGE_BYTES: usize = 8192;

/// Why a state was not published.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// Mesh, layout and texture do not belong together, or a texture did not encode.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// A parameter is out of range.
    #[error("publish: {name} = {value} is outside {range}")]
    Parameter {
        /// Which.
        name: &'static str,
        /// Its value.
        value: usize,
        /// What it may be.
        range: &'static str,
    },
    /// The state is not newer than the one before.
    #[error(
        "revision {revision} of session {session:x} was to be published after revision {published}"
    )]
    NotNewer {
        /// Of this state.
        session: u64,
        /// Of this state.
        revision: u64,
        /// Of the state before.
        published: u64,
    },
    /// What cannot be divided does not fit into a message.
    #[error(
        "{what} needs {needed_bytes} bytes, but a message may have {max_message_bytes} (a long frame_id counts too)"
    )]
    DoesNotFit {
        /// What.
        what: &'static str,
        /// Its length.
        needed_bytes: usize,
        /// The bound.
        max_message_bytes: usize,
    },
    /// More charts or pieces were sent in this session than 32 bits can name.
    #[error("2^32 names of one session are used up; begin a new session")]
    OutOfNames,
}

/// A message to be sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outgoing {
    /// On which topic.
    pub topic: OutputTopic,
    /// CDR with its 4-byte header.
    pub bytes: Vec<u8>,
}

/// Turns states into messages, and remembers what it sent.
#[derive(Debug)]
pub struct Publisher {
    params: PublishParams,
    blocks: blocks::Blocks,
    markers: viewer::Held,
    scene: viewer::Held,
    meshes: mesh::Meshes,
    keyframes: keyframes::Keyframes,
}

impl Publisher {
    /// A publisher that has sent nothing.
    pub fn new(params: PublishParams) -> Self {
        Self {
            params,
            blocks: blocks::Blocks::default(),
            markers: viewer::Held::default(),
            scene: viewer::Held::default(),
            meshes: mesh::Meshes::default(),
            keyframes: keyframes::Keyframes::default(),
        }
    }

    /// How it turns states into messages.
    pub fn params(&self) -> &PublishParams {
        &self.params
    }

    /// The next state goes out whole on `topic`: for a reader who has none of what was sent.
    pub fn forget(&mut self, topic: OutputTopic) {
        match topic {
            OutputTopic::TexturedMesh => self.blocks.forget(),
            OutputTopic::Markers => self.markers.forget(),
            OutputTopic::Scene => self.scene.forget(),
            OutputTopic::MeshGeometry => self.meshes.forget_geometry(),
            OutputTopic::MeshMaterials => self.meshes.forget_materials(),
            OutputTopic::Keyframes => self.keyframes.forget(),
        }
    }

    /// Messages that were sent on `topic` since the last whole state began. More than
    /// [`PublishParams::history_messages`] when even the whole needs more: who comes late then
    /// cannot get it from the writer's history.
    pub fn num_messages_since_whole(&self, topic: OutputTopic) -> usize {
        match topic {
            OutputTopic::TexturedMesh => self.blocks.num_since_whole(),
            OutputTopic::Markers => self.markers.num_since_whole(),
            OutputTopic::Scene => self.scene.num_since_whole(),
            OutputTopic::MeshGeometry => self.meshes.num_geometry_since_whole(),
            OutputTopic::MeshMaterials => self.meshes.num_materials_since_whole(),
            OutputTopic::Keyframes => 1,
        }
    }

    /// Messages in the order to be sent; none on topics where nothing changed. Nothing is computed for
    /// a topic that is not wanted. A topic that is wanted for the first time gets the whole.
    ///
    /// # Errors
    /// [`PublishError`]; what was remembered of the topic that failed is forgotten, and of the others
    /// too, so that the next state goes out whole.
    pub fn publish(
        &mut self,
        snapshot: &Snapshot<'_>,
        wanted: &dyn Fn(OutputTopic) -> bool,
    ) -> Result<Vec<Outgoing>, PublishError> {
        let published = self.try_publish(snapshot, wanted);
        if published.is_err() {
            for topic in OutputTopic::ALL {
                self.forget(topic);
            }
        }
        published
    }

    fn try_publish(
        &mut self,
        snapshot: &Snapshot<'_>,
        wanted: &dyn Fn(OutputTopic) -> bool,
    ) -> Result<Vec<Outgoing>, PublishError> {
        self.params.check()?;
        let wanted_topics = OutputTopic::ALL.map(|topic| (topic, wanted(topic)));
        for (topic, is_wanted) in wanted_topics {
            if !is_wanted {
                self.forget(topic);
            }
        }
        let is_wanted = |topic| wanted_topics.contains(&(topic, true));
        if !wanted_topics.iter().any(|(_, is_wanted)| *is_wanted) {
            return Ok(Vec::new());
        }
        let content = &snapshot.content()?;
        let params = &self.params;
        let mut outgoing = Vec::new();
        let textures = params.viewer_format;
        let mut send = |topic, messages: Vec<Vec<u8>>| {
            let messages = messages.into_iter();
            outgoing.extend(messages.map(|bytes| Outgoing { topic, bytes }));
        };
        if is_wanted(OutputTopic::TexturedMesh) {
            let messages = self.blocks.publish(snapshot, content, params)?;
            send(OutputTopic::TexturedMesh, messages);
        }
        if is_wanted(OutputTopic::Markers) {
            let format = MarkerFormat { snapshot, textures };
            let messages = self.markers.publish(&format, snapshot, content, params)?;
            send(OutputTopic::Markers, messages);
        }
        if is_wanted(OutputTopic::Scene) {
            let format = SceneFormat { snapshot, textures };
            let messages = self.scene.publish(&format, snapshot, content, params)?;
            send(OutputTopic::Scene, messages);
        }
        let [geometry, materials] =
            [OutputTopic::MeshGeometry, OutputTopic::MeshMaterials].map(is_wanted);
        if geometry || materials {
            let (geometry, materials) =
                self.meshes
                    .publish(snapshot, content, params, [geometry, materials])?;
            send(OutputTopic::MeshGeometry, geometry);
            send(OutputTopic::MeshMaterials, materials);
        }
        if is_wanted(OutputTopic::Keyframes) {
            let messages = self.keyframes.publish(snapshot, params)?;
            send(OutputTopic::Keyframes, messages);
        }
        Ok(outgoing)
    }
}

impl PublishParams {
    fn check(&self) -> Result<(), PublishError> {
        let checks = [
            (
                "max_message_bytes",
                self.max_message_bytes,
                MIN_MESSAGE_BYTES..=usize::MAX,
                "8192 and more",
            ),
            (
                "tile_texel",
                self.tile_texel as usize,
                16..=16_384,
                "16 to 16384",
            ),
            (
                "history_messages",
                self.history_messages,
                1..=usize::MAX,
                "1 and more",
            ),
        ];
        for (name, value, valid, range) in checks {
            if !valid.contains(&value) {
                return Err(PublishError::Parameter { name, value, range });
            }
        }
        Ok(())
    }

    /// The message, if it is short enough.
    fn checked(&self, what: &'static str, message: Vec<u8>) -> Result<Vec<u8>, PublishError> {
        if message.len() <= self.max_message_bytes {
            return Ok(message);
        }
        Err(PublishError::DoesNotFit {
            what,
            needed_bytes: message.len(),
            max_message_bytes: self.max_message_bytes,
        })
    }
}

#[cfg(test)]
mod tests;
