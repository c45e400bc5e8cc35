//! ROS 2 messages: CDR bytes to our types and back, one file per message (L6).
//!
//! Every message is a plain struct that borrows its bulk (`&[u8]`) and its strings from the
//! buffer; [`Message::decode`] reads it from a serialised message with its 4-byte encapsulation
//! header (plain CDR, either byte order), [`Message::encode`] writes little endian. Lengths are
//! checked against the bytes left before anything is allocated. Conversions to our types refuse
//! what cannot be used, naming field and value: wire types die at this edge.
//!
//! [`Message::SCHEMA`] is the `ros2msg` definition with its dependencies, as rosbag2 stores it.

pub mod camera_info;
pub mod cdr;
pub mod clock;
pub mod compressed_image;
pub mod diagnostic_array;
pub mod error;
pub mod event;
pub mod geometry;
pub mod header;
pub mod image;
pub mod log;
pub mod marker;
pub mod marker_array;
pub mod mesh_geometry;
pub mod mesh_materials;
pub mod mesh_update;
pub mod nvblox_mesh;
pub mod odometry;
pub mod path;
pub mod pose_array;
pub mod pose_corrections;
pub mod pose_stamped;
pub mod pose_with_covariance_stamped;
pub mod scene_update;
mod schema;
pub mod service;
pub mod shape_mesh;
pub mod status;
pub mod textured_mesh_block;
pub mod tf_message;

pub use camera_info::CameraInfo;
pub use cdr::{CdrReader, CdrWriter};
pub use clock::Clock;
pub use compressed_image::CompressedImage;
pub use diagnostic_array::{DiagnosticArray, DiagnosticStatus};
pub use error::WireError;
pub use event::{EventDecoder, TopicRole};
pub use header::WireHeader;
pub use image::Image;
pub use log::Log;
pub use marker::{Marker, MarkerSet};
pub use marker_array::MarkerArray;
pub use mesh_geometry::MeshGeometryStamped;
pub use mesh_materials::{MeshMaterialsStamped, MeshTexture, MeshVertexColorsStamped};
pub use mesh_update::MeshUpdateMessage;
pub use nvblox_mesh::NvbloxMesh;
pub use odometry::Odometry;
pub use path::Path;
pub use pose_array::PoseArray;
pub use pose_corrections::PoseCorrections;
pub use pose_stamped::PoseStamped;
pub use pose_with_covariance_stamped::PoseWithCovarianceStamped;
pub use scene_update::SceneUpdate;
pub use service::Service;
pub use shape_mesh::ShapeMesh;
pub use status::Status;
pub use textured_mesh_block::TexturedMeshBlock;
pub use tf_message::TfMessage;

/// A ROS 2 message that borrows from the buffer it was read from.
pub trait Message<'a>: Sized {
    /// Its type as rosbag2 names it, `package/msg/Name`.
    const TYPE_NAME: &'static str;
    /// Its definition with all dependencies, schema encoding `ros2msg`.
    const SCHEMA: &'static str;

    /// Reads the fields.
    ///
    /// # Errors
    /// [`WireError`] naming message, field and offset.
    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError>;

    /// Writes the fields.
    fn write(&self, writer: &mut CdrWriter);

    /// From a serialised message. Bytes after the last field are ignored, as ROS does: CDR pads.
    ///
    /// # Errors
    /// [`WireError`] naming message, field and offset.
    fn decode(bytes: &'a [u8]) -> Result<Self, WireError> {
        Self::read(&mut CdrReader::new(Self::TYPE_NAME, bytes)?)
    }

    /// The serialised message, little endian, with its encapsulation header.
    fn encode(&self) -> Vec<u8> {
        let mut writer = CdrWriter::little_endian();
        self.write(&mut writer);
        writer.into_bytes()
    }
}

#[cfg(test)]
mod tests;
