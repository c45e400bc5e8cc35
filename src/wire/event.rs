//! From a serialised message on a topic of known role to [`Event`]s: what a bag and a live
//! subscription share.

use std::sync::Arc;

use crate::geom::Stamp;
use crate::ingest::{Event, Header, MeshUpdate, Rejection};
use crate::mesh::SoupReport;

use super::camera_info::Rectification;
use super::cdr::CdrReader;
use super::error::WireError;
use super::header::WireHeader;
use super::{
    CameraInfo, CompressedImage, Image, Marker, MarkerArray, MarkerSet, MeshGeometryStamped,
    MeshUpdateMessage, Message, NvbloxMesh, Odometry, Path, PoseCorrections, PoseStamped,
    PoseWithCovarianceStamped, ShapeMesh, TfMessage,
};

/// The part a topic plays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TopicRole {
    /// Colour images.
    Color,
    /// Depth images.
    Depth,
    /// Intrinsics of the colour camera.
    ColorInfo,
    /// Intrinsics of the depth camera.
    DepthInfo,
    /// Moving transforms.
    Transforms,
    /// Transforms that hold forever.
    StaticTransforms,
    /// Poses of the camera.
    Pose,
    /// Odometry.
    Odometry,
    /// The mesh.
    Mesh,
    /// Better poses of frames of the past.
    Corrections,
}

impl TopicRole {
    /// The role in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Color => "colour images",
            Self::Depth => "depth images",
            Self::ColorInfo => "colour camera info",
            Self::DepthInfo => "depth camera info",
            Self::Transforms => "moving transforms",
            Self::StaticTransforms => "static transforms",
            Self::Pose => "camera pose",
            Self::Odometry => "odometry",
            Self::Mesh => "mesh",
            Self::Corrections => "pose corrections",
        }
    }
}

/// The message types that veneer reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MessageType {
    /// `sensor_msgs/msg/Image`.
    Image,
    /// `sensor_msgs/msg/CompressedImage`.
    CompressedImage,
    /// `sensor_msgs/msg/CameraInfo`.
    CameraInfo,
    /// `tf2_msgs/msg/TFMessage`.
    Tf,
    /// `geometry_msgs/msg/PoseStamped`.
    PoseStamped,
    /// `geometry_msgs/msg/PoseWithCovarianceStamped`.
    PoseWithCovarianceStamped,
    /// `nav_msgs/msg/Odometry`.
    Odometry,
    /// `veneer/msg/PoseCorrections`.
    PoseCorrections,
    /// `nav_msgs/msg/Path`.
    Path,
    /// `veneer/msg/MeshUpdate`.
    MeshUpdate,
    /// `mesh_msgs/msg/MeshGeometryStamped`.
    MeshGeometryStamped,
    /// `nvblox_msgs/msg/Mesh`.
    NvbloxMesh,
    /// `shape_msgs/msg/Mesh`.
    ShapeMesh,
    /// `visualization_msgs/msg/Marker`.
    Marker,
    /// `visualization_msgs/msg/MarkerArray`.
    MarkerArray,
}

impl MessageType {
    const ALL: [Self; 15] = [
        Self::Image,
        Self::CompressedImage,
        Self::CameraInfo,
        Self::Tf,
        Self::PoseStamped,
        Self::PoseWithCovarianceStamped,
        Self::Odometry,
        Self::PoseCorrections,
        Self::Path,
        Self::MeshUpdate,
        Self::MeshGeometryStamped,
        Self::NvbloxMesh,
        Self::ShapeMesh,
        Self::Marker,
        Self::MarkerArray,
    ];

    /// The type of this name, `package/msg/Name` (or `package/Name`, as some writers have it).
    pub fn from_name(name: &str) -> Option<Self> {
        let same = |full: &str| full == name || full.replacen("/msg/", "/", 1) == name;
        Self::ALL.into_iter().find(|t| same(t.name()))
    }

    /// Its name, `package/msg/Name`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Image => Image::TYPE_NAME,
            Self::CompressedImage => CompressedImage::TYPE_NAME,
            Self::CameraInfo => CameraInfo::TYPE_NAME,
            Self::Tf => TfMessage::TYPE_NAME,
            Self::PoseStamped => PoseStamped::TYPE_NAME,
            Self::PoseWithCovarianceStamped => PoseWithCovarianceStamped::TYPE_NAME,
            Self::Odometry => Odometry::TYPE_NAME,
            Self::PoseCorrections => PoseCorrections::TYPE_NAME,
            Self::Path => Path::TYPE_NAME,
            Self::MeshUpdate => MeshUpdateMessage::TYPE_NAME,
            Self::MeshGeometryStamped => MeshGeometryStamped::TYPE_NAME,
            Self::NvbloxMesh => NvbloxMesh::TYPE_NAME,
            Self::ShapeMesh => ShapeMesh::TYPE_NAME,
            Self::Marker => Marker::TYPE_NAME,
            Self::MarkerArray => MarkerArray::TYPE_NAME,
        }
    }

    /// Whether a topic of this type can play a role.
    pub fn can_be(self, role: TopicRole) -> bool {
        match role {
            TopicRole::Color | TopicRole::Depth => {
                matches!(self, Self::Image | Self::CompressedImage)
            }
            TopicRole::ColorInfo | TopicRole::DepthInfo => self == Self::CameraInfo,
            TopicRole::Transforms | TopicRole::StaticTransforms => self == Self::Tf,
            TopicRole::Pose => matches!(self, Self::PoseStamped | Self::PoseWithCovarianceStamped),
            TopicRole::Odometry => self == Self::Odometry,
            TopicRole::Corrections => matches!(self, Self::PoseCorrections | Self::Path),
            TopicRole::Mesh => self >= Self::MeshUpdate,
        }
    }
}

/// Decodes the messages of one topic in one role. It has memory only for markers, which are
/// named once and replaced by name later.
#[derive(Clone, Debug)]
pub struct EventDecoder {
    topic: String,
    message_type: MessageType,
    role: TopicRole,
    rectification: Rectification,
    mesh_frame: Option<Arc<str>>,
    markers: MarkerSet,
}

impl EventDecoder {
    /// A decoder for `topic`; `None` when its type cannot play the role.
    pub fn new(topic: &str, message_type: MessageType, role: TopicRole) -> Option<Self> {
        message_type.can_be(role).then(|| Self {
            topic: topic.to_owned(),
            message_type,
            role,
            rectification: Rectification::Raw,
            mesh_frame: None,
            markers: MarkerSet::default(),
        })
    }

    /// Which images a camera info is for.
    #[must_use]
    pub fn with_rectification(mut self, rectification: Rectification) -> Self {
        self.rectification = rectification;
        self
    }

    /// The frame of meshes whose message has no header.
    #[must_use]
    pub fn with_mesh_frame(mut self, mesh_frame: Option<&str>) -> Self {
        self.mesh_frame = mesh_frame.map(Arc::from);
        self
    }

    /// The role it decodes for.
    pub fn role(&self) -> TopicRole {
        self.role
    }

    /// Appends what the message says: usually one event, none or several for markers and for
    /// transforms of which some are refused.
    pub fn decode(
        &mut self,
        received: Stamp,
        bytes: &[u8],
        out: &mut Vec<Result<Event, Rejection>>,
    ) {
        let first = out.len();
        if let Err(error) = self.try_decode(received, bytes, out) {
            // What the message said before the error is dropped with it: all or nothing.
            out.truncate(first);
            let stamp = self.own_stamp(bytes).unwrap_or(received);
            out.push(Err(self.rejection(stamp, &error)));
        }
    }

    fn rejection(&self, stamp: Stamp, error: &WireError) -> Rejection {
        Rejection {
            topic: self.topic.clone(),
            stamp,
            reason: error.to_string(),
        }
    }

    /// The stamp of the message's header, if it starts with one that can be read.
    fn own_stamp(&self, bytes: &[u8]) -> Option<Stamp> {
        let mut reader = CdrReader::new("header", bytes).ok()?;
        match self.message_type {
            MessageType::ShapeMesh => return None,
            MessageType::Tf | MessageType::MarkerArray => {
                reader.sequence_len("length", 1).ok().filter(|&n| n > 0)?;
            }
            _ => {}
        }
        Some(WireHeader::read(&mut reader).ok()?.stamp)
    }

    fn try_decode(
        &mut self,
        received: Stamp,
        bytes: &[u8],
        out: &mut Vec<Result<Event, Rejection>>,
    ) -> Result<(), WireError> {
        let event = match self.message_type {
            MessageType::Image => {
                let image = Image::decode(bytes)?;
                let header = image.header.to_header();
                match self.role {
                    TopicRole::Depth => Event::Depth(header, image.to_depth()?),
                    _ => Event::Color(header, image.to_color()?),
                }
            }
            MessageType::CompressedImage => {
                let image = CompressedImage::decode(bytes)?;
                let header = image.header.to_header();
                match self.role {
                    TopicRole::Depth => Event::Depth(header, image.to_depth()?),
                    _ => Event::Color(header, image.to_color()?),
                }
            }
            MessageType::CameraInfo => {
                let info = CameraInfo::decode(bytes)?;
                let header = info.header.to_header();
                let camera = info.to_camera(self.rectification)?;
                match self.role {
                    TopicRole::DepthInfo => Event::DepthInfo(header, camera),
                    _ => Event::ColorInfo(header, camera),
                }
            }
            MessageType::PoseStamped => {
                let message = PoseStamped::decode(bytes)?;
                pose_event(&message.header, message.pose)?
            }
            MessageType::PoseWithCovarianceStamped => {
                let message = PoseWithCovarianceStamped::decode(bytes)?;
                pose_event(&message.header, message.pose)?
            }
            MessageType::Odometry => Event::Odometry(Odometry::decode(bytes)?.to_transform()?),
            MessageType::PoseCorrections => PoseCorrections::decode(bytes)?.to_event()?,
            MessageType::Path => Path::decode(bytes)?.to_event()?,
            MessageType::Tf => return self.transforms(received, bytes, out),
            MessageType::Marker => {
                return self.marker_events(received, &[Marker::decode(bytes)?], out);
            }
            MessageType::MarkerArray => {
                let array = MarkerArray::decode(bytes)?;
                return self.marker_events(received, &array.markers, out);
            }
            mesh => self.mesh_event(mesh, received, bytes)?,
        };
        out.push(Ok(event));
        Ok(())
    }

    fn mesh_event(
        &self,
        message_type: MessageType,
        received: Stamp,
        bytes: &[u8],
    ) -> Result<Event, WireError> {
        let event = |header: Header, (update, report): (MeshUpdate, SoupReport)| {
            Event::Mesh(header, update, report)
        };
        Ok(match message_type {
            MessageType::MeshGeometryStamped => {
                let mesh = MeshGeometryStamped::decode(bytes)?;
                event(mesh.header.to_header(), mesh.to_update()?)
            }
            MessageType::NvbloxMesh => {
                let mesh = NvbloxMesh::decode(bytes)?;
                event(mesh.header.to_header(), mesh.to_update()?)
            }
            MessageType::ShapeMesh => {
                let frame_id = self.mesh_frame.clone().ok_or_else(|| WireError::Field {
                    field: "mesh_frame",
                    reason: "is not set, and shape_msgs/Mesh does not say its frame".into(),
                })?;
                let header = Header {
                    stamp: received,
                    frame_id,
                };
                event(header, ShapeMesh::decode(bytes)?.to_update()?)
            }
            _ => {
                let mesh = MeshUpdateMessage::decode(bytes)?;
                event(mesh.header.to_header(), mesh.to_update()?)
            }
        })
    }

    fn transforms(
        &self,
        received: Stamp,
        bytes: &[u8],
        out: &mut Vec<Result<Event, Rejection>>,
    ) -> Result<(), WireError> {
        let message = TfMessage::decode(bytes)?;
        let stamp = message
            .transforms
            .first()
            .map_or(received, |t| t.header.stamp);
        let (valid, refused) = message.to_transforms();
        if !valid.is_empty() {
            out.push(Ok(match self.role {
                TopicRole::StaticTransforms => Event::StaticTransforms(valid),
                _ => Event::Transforms(valid),
            }));
        }
        out.extend(refused.iter().map(|e| Err(self.rejection(stamp, e))));
        Ok(())
    }

    fn marker_events(
        &mut self,
        received: Stamp,
        markers: &[Marker<'_>],
        out: &mut Vec<Result<Event, Rejection>>,
    ) -> Result<(), WireError> {
        let stamp = markers.first().map_or(received, |m| m.header.stamp);
        let (updates, refused) = self.markers.apply(markers);
        let events = updates.into_iter();
        out.extend(events.map(|(header, update, report)| Ok(Event::Mesh(header, update, report))));
        out.extend(refused.iter().map(|e| Err(self.rejection(stamp, e))));
        Ok(())
    }
}

fn pose_event(
    header: &WireHeader<'_>,
    pose: super::geometry::WirePose,
) -> Result<Event, WireError> {
    let transform = pose.to_transform().map_err(|error| WireError::Frame {
        field: "pose".into(),
        error,
    })?;
    Ok(Event::Pose(header.to_header(), transform))
}
