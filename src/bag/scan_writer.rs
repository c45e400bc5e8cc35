//! A posed RGB-D scan as a bag: the topics that veneer expects, with the names of a usual driver.
//!
//! | topic | type |
//! |---|---|
//! | `/camera/color/image_raw/compressed` (raw: `/camera/color/image_raw`) | `CompressedImage` (`Image`) |
//! | `/camera/depth/image_raw/compressedDepth` (raw: `/camera/depth/image_raw`) | `CompressedImage` (`Image`) |
//! | `/camera/color/camera_info`, `/camera/depth/camera_info` | `CameraInfo` |
//! | `/tf`, `/tf_static` | `TFMessage`: world → colour camera → depth camera |
//! | `/camera/pose` | `PoseStamped`: the colour camera's optical frame in the world |
//! | `/mesh` | `MeshGeometryStamped` when whole (64-bit), `veneer/MeshUpdate` in blocks (32-bit) |
//!
//! Each message is logged at its stamp. A topic exists from its first message on.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::Arc;

use crate::geom::{CameraModel, EncodedColor, EncodedDepth, RigidTransform, Stamp};
use crate::ingest::MeshUpdate;
use crate::wire::geometry::WirePose;
use crate::wire::tf_message::TransformStamped;
use crate::wire::{
    CameraInfo, CompressedImage, Image, MeshGeometryStamped, MeshUpdateMessage, Message,
    PoseStamped, TfMessage, WireHeader,
};

use super::{BagError, BagSummary, BagWriter, ChannelId, Compression};

/// Names of topics and frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScanTopics {
    /// Colour images; compressed ones go to `COLOR/compressed`.
    pub color: String,
    /// Depth images; compressed ones go to `DEPTH/compressedDepth`.
    pub depth: String,
    /// Intrinsics of the colour camera.
    pub color_info: String,
    /// Intrinsics of the depth camera.
    pub depth_info: String,
    /// Poses of the colour camera.
    pub pose: String,
    /// The mesh.
    pub mesh: String,
    /// Frame of the mesh and of the poses.
    pub world_frame: String,
    /// Optical frame of the colour camera.
    pub color_frame: String,
    /// Optical frame of the depth camera.
    pub depth_frame: String,
}

impl Default for ScanTopics {
    fn default() -> Self {
        Self {
            color: "/camera/color/image_raw".to_owned(),
            depth: "/camera/depth/image_raw".to_owned(),
            color_info: "/camera/color/camera_info".to_owned(),
            depth_info: "/camera/depth/camera_info".to_owned(),
            pose: "/camera/pose".to_owned(),
            mesh: "/mesh".to_owned(),
            world_frame: "map".to_owned(),
            color_frame: "camera_color_optical_frame".to_owned(),
            depth_frame: "camera_depth_optical_frame".to_owned(),
        }
    }
}

/// Writes a scan. The order of the calls is the order in the file; stamps should not go back by
/// more than a frame, or readers of the raw file see the jump.
pub struct ScanWriter {
    bag: BagWriter<BufWriter<File>>,
    topics: Arc<ScanTopics>,
    channels: BTreeMap<String, ChannelId>,
    has_depth_frame: bool,
    mesh_revision: u64,
}

impl ScanWriter {
    /// Starts the bag `path`, which appears when [`Self::finish`] has succeeded.
    ///
    /// # Errors
    /// [`BagError`] when the file cannot be created.
    pub fn create(
        path: &Path,
        topics: &ScanTopics,
        compression: Compression,
    ) -> Result<Self, BagError> {
        Ok(Self {
            bag: BagWriter::create(path, compression)?,
            topics: Arc::new(topics.clone()),
            channels: BTreeMap::new(),
            // Without a frame of its own, depth needs no transform.
            has_depth_frame: topics.depth_frame == topics.color_frame,
            mesh_revision: 0,
        })
    }

    /// Intrinsics of the colour camera.
    ///
    /// # Errors
    /// [`BagError`], as every method here.
    pub fn color_info(&mut self, stamp: Stamp, camera: &CameraModel) -> Result<(), BagError> {
        let topics = Arc::clone(&self.topics);
        let message = CameraInfo::from_camera(header(stamp, &topics.color_frame), camera);
        self.write(&topics.color_info, stamp, &message)
    }

    /// Intrinsics of the depth camera.
    ///
    /// # Errors
    /// [`BagError`].
    pub fn depth_info(&mut self, stamp: Stamp, camera: &CameraModel) -> Result<(), BagError> {
        let topics = Arc::clone(&self.topics);
        let message = CameraInfo::from_camera(header(stamp, &topics.depth_frame), camera);
        self.write(&topics.depth_info, stamp, &message)
    }

    /// A colour image, its bytes unchanged.
    ///
    /// # Errors
    /// [`BagError`].
    pub fn color(&mut self, stamp: Stamp, image: &EncodedColor) -> Result<(), BagError> {
        let topics = Arc::clone(&self.topics);
        let header = header(stamp, &topics.color_frame);
        if let Some(message) = CompressedImage::from_color(header, image) {
            self.write(&format!("{}/compressed", topics.color), stamp, &message)?;
        }
        if let Some(message) = Image::from_color(header, image) {
            self.write(&topics.color, stamp, &message)?;
        }
        Ok(())
    }

    /// A depth image, its bytes unchanged. Before the first, the depth camera is declared to be
    /// where the colour camera is, unless [`Self::static_transform`] has said where.
    ///
    /// # Errors
    /// [`BagError`].
    pub fn depth(&mut self, stamp: Stamp, image: &EncodedDepth) -> Result<(), BagError> {
        let topics = Arc::clone(&self.topics);
        if !self.has_depth_frame {
            let identity = RigidTransform::identity();
            self.static_transform(stamp, &topics.color_frame, &topics.depth_frame, &identity)?;
        }
        let header = header(stamp, &topics.depth_frame);
        if let Some(message) = CompressedImage::from_depth(header, image) {
            self.write(
                &format!("{}/compressedDepth", topics.depth),
                stamp,
                &message,
            )?;
        }
        if let Some(message) = Image::from_depth(header, image) {
            self.write(&topics.depth, stamp, &message)?;
        }
        Ok(())
    }

    /// Pose of the colour camera, as a transform and as a pose.
    ///
    /// # Errors
    /// [`BagError`].
    pub fn pose(
        &mut self,
        stamp: Stamp,
        world_from_camera: &RigidTransform,
    ) -> Result<(), BagError> {
        let topics = Arc::clone(&self.topics);
        let (world, camera) = (&topics.world_frame, &topics.color_frame);
        let transforms = transform(stamp, world, camera, world_from_camera);
        self.write("/tf", stamp, &transforms)?;
        let pose = PoseStamped {
            header: header(stamp, world),
            pose: WirePose::from(world_from_camera),
        };
        self.write(&topics.pose, stamp, &pose)
    }

    /// A transform that holds for the whole scan.
    ///
    /// # Errors
    /// [`BagError`].
    pub fn static_transform(
        &mut self,
        stamp: Stamp,
        parent_frame: &str,
        child_frame: &str,
        parent_from_child: &RigidTransform,
    ) -> Result<(), BagError> {
        self.has_depth_frame |= child_frame == self.topics.depth_frame;
        let transforms = transform(stamp, parent_frame, child_frame, parent_from_child);
        self.write("/tf_static", stamp, &transforms)
    }

    /// Where the depth camera is at `stamp`, below the colour camera; for scans in which that
    /// changes from frame to frame.
    ///
    /// # Errors
    /// [`BagError`].
    pub fn moving_depth_frame(
        &mut self,
        stamp: Stamp,
        color_from_depth: &RigidTransform,
    ) -> Result<(), BagError> {
        self.has_depth_frame = true;
        let topics = Arc::clone(&self.topics);
        let (color, depth) = (&topics.color_frame, &topics.depth_frame);
        let transforms = transform(stamp, color, depth, color_from_depth);
        self.write("/tf", stamp, &transforms)
    }

    /// The mesh, or a change of it, in the world frame. The first call settles the topic's type:
    /// after blocks, a whole mesh goes as the one block that replaces them all.
    ///
    /// # Errors
    /// [`BagError`]; [`BagError::Topic`] for blocks after a whole mesh, whose type has none.
    pub fn mesh(&mut self, stamp: Stamp, update: &MeshUpdate) -> Result<(), BagError> {
        let topics = Arc::clone(&self.topics);
        let header = header(stamp, &topics.world_frame);
        let is_new = !self.channels.contains_key(&topics.mesh);
        match update {
            MeshUpdate::Whole(mesh) if is_new || self.mesh_revision == 0 => {
                let message = MeshGeometryStamped::from_mesh(header, mesh);
                self.write(&topics.mesh, stamp, &message)
            }
            _ if is_new || self.mesh_revision > 0 => {
                self.mesh_revision += 1;
                let message = MeshUpdateMessage::from_update(header, self.mesh_revision, update);
                self.write(&topics.mesh, stamp, &message)
            }
            _ => Err(BagError::Topic {
                topic: topics.mesh.clone(),
                role: "mesh",
                reason: "it began with a whole mesh, so it cannot go on in blocks".to_owned(),
            }),
        }
    }

    /// A metadata record of the bag: what made the scan, and how.
    ///
    /// # Errors
    /// [`BagError`].
    pub fn metadata(
        &mut self,
        name: &str,
        entries: BTreeMap<String, String>,
    ) -> Result<(), BagError> {
        self.bag.write_metadata(name, entries)
    }

    /// Writes what a bag ends with, and gives it its name.
    ///
    /// # Errors
    /// [`BagError`] when the disk is full, or the name is taken by a folder.
    pub fn finish(self) -> Result<BagSummary, BagError> {
        self.bag.finish()
    }

    fn write<'m, M: Message<'m>>(
        &mut self,
        topic: &str,
        stamp: Stamp,
        message: &M,
    ) -> Result<(), BagError> {
        let channel = match self.channels.entry(topic.to_owned()) {
            Entry::Occupied(known) => *known.get(),
            Entry::Vacant(new) => {
                let channel = self.bag.add_channel(topic, M::TYPE_NAME, M::SCHEMA)?;
                *new.insert(channel)
            }
        };
        self.bag.write(channel, stamp, &message.encode())
    }
}

fn header(stamp: Stamp, frame_id: &str) -> WireHeader<'_> {
    WireHeader { stamp, frame_id }
}

fn transform<'a>(
    stamp: Stamp,
    parent_frame: &'a str,
    child_frame: &'a str,
    parent_from_child: &RigidTransform,
) -> TfMessage<'a> {
    TfMessage {
        transforms: vec![TransformStamped {
            header: header(stamp, parent_frame),
            child_frame_id: child_frame,
            transform: WirePose::from(parent_from_child),
        }],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{ColorImage, DepthEncoding, PinholeCamera};
    use crate::ingest::event::MeshBlockKey;
    use crate::mesh::TriMesh;
    use nalgebra::Point3;

    fn triangle() -> TriMesh {
        let positions_m = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.1, 1.0]];
        let positions_m = positions_m.map(Point3::from).to_vec();
        TriMesh::from_soup(positions_m, vec![[0, 1, 2]]).unwrap().0
    }

    fn images(is_raw: bool) -> (EncodedColor, EncodedDepth) {
        let image = ColorImage::new(4, 2, vec![[1, 2, 3]; 8]).unwrap();
        if !is_raw {
            return (
                EncodedColor::png_from_image(&image).unwrap(),
                EncodedDepth::png_from_u16_mm(4, 2, &[1500; 8]).unwrap(),
            );
        }
        let bytes = image.pixels().as_flattened().into();
        let rgb8 = crate::geom::ColorEncoding::Rgb8;
        let u16_mm = DepthEncoding::U16Mm { big_endian: false };
        (
            EncodedColor::from_raw(rgb8, 4, 2, 12, bytes).unwrap(),
            EncodedDepth::from_raw(u16_mm, 4, 2, 8, vec![7; 16].into()).unwrap(),
        )
    }

    /// A bag of one frame and a mesh in blocks; `extrinsics` are said before the depth.
    fn write_scan(path: &Path, is_raw: bool, extrinsics: Option<&RigidTransform>) -> BagSummary {
        let topics = ScanTopics::default();
        let mut writer = ScanWriter::create(path, &topics, Compression::Lz4).unwrap();
        let pinhole = PinholeCamera::new([5.0, 5.0, 1.5, 0.5], 4, 2).unwrap();
        let camera = CameraModel::ideal(pinhole);
        let stamp = Stamp::from_ros(7, 5);
        let (color, depth) = images(is_raw);
        if let Some(extrinsics) = extrinsics {
            let (parent, child) = (&topics.color_frame, &topics.depth_frame);
            writer
                .static_transform(stamp, parent, child, extrinsics)
                .unwrap();
        }
        let world_from_camera =
            RigidTransform::try_from_quaternion([0.0, 0.6, 0.0, 0.8], [1.0, 2.0, 3.0]).unwrap();
        writer.pose(stamp, &world_from_camera).unwrap();
        writer.color_info(stamp, &camera).unwrap();
        writer.color(stamp, &color).unwrap();
        for _ in 0..2 {
            writer.depth_info(stamp, &camera).unwrap();
            writer.depth(stamp, &depth).unwrap();
            let update = MeshUpdate::Blocks {
                clear: false,
                blocks: vec![(MeshBlockKey([3, 0, 0]), triangle())],
            };
            writer.mesh(stamp, &update).unwrap();
        }
        let maker = BTreeMap::from([("seed".to_owned(), "1".to_owned())]);
        writer.metadata("veneer.test", maker).unwrap();
        writer.finish().unwrap()
    }

    /// Topic, type and bytes of every message, read by the `mcap` crate alone.
    fn messages(path: &Path) -> Vec<(String, String, Vec<u8>)> {
        let file = std::fs::read(path).unwrap();
        mcap::MessageStream::new(&file)
            .unwrap()
            .map(|message| {
                let message = message.unwrap();
                assert_eq!(message.log_time, 7_000_000_005);
                let schema = message.channel.schema.as_ref().unwrap();
                assert_eq!(schema.encoding, "ros2msg");
                assert_eq!(message.channel.message_encoding, "cdr");
                let topic = message.channel.topic.clone();
                (topic, schema.name.clone(), message.data.into_owned())
            })
            .collect()
    }

    #[test]
    fn topics_and_types_are_those_of_a_driver() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        for (is_raw, image_type) in [
            (false, "sensor_msgs/msg/CompressedImage"),
            (true, "sensor_msgs/msg/Image"),
        ] {
            let summary = write_scan(&path, is_raw, None);
            assert_eq!(summary.num_bytes, std::fs::metadata(&path).unwrap().len());
            let image_topics = if is_raw {
                ["/camera/color/image_raw", "/camera/depth/image_raw"]
            } else {
                [
                    "/camera/color/image_raw/compressed",
                    "/camera/depth/image_raw/compressedDepth",
                ]
            };
            let expected = [
                (image_topics[0], image_type, 1),
                (image_topics[1], image_type, 2),
                ("/camera/color/camera_info", "sensor_msgs/msg/CameraInfo", 1),
                ("/camera/depth/camera_info", "sensor_msgs/msg/CameraInfo", 2),
                ("/tf", "tf2_msgs/msg/TFMessage", 1),
                ("/tf_static", "tf2_msgs/msg/TFMessage", 1),
                ("/camera/pose", "geometry_msgs/msg/PoseStamped", 1),
                ("/mesh", "veneer/msg/MeshUpdate", 2),
            ];
            let found = messages(&path);
            assert_eq!(summary.num_messages.len(), expected.len());
            for (topic, type_name, num_messages) in expected {
                assert_eq!(summary.num_messages.get(topic), Some(&num_messages));
                let types: Vec<_> = found.iter().filter(|(t, ..)| t == topic).collect();
                assert_eq!(types.len() as u64, num_messages, "{topic}");
                assert!(types.iter().all(|(_, name, _)| name == type_name));
            }
        }
    }

    #[test]
    fn images_and_mesh_arrive_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        write_scan(&path, false, None);
        let (color, depth) = images(false);
        let found = messages(&path);
        let bytes = |wanted: &str| {
            let (.., bytes) = found.iter().rfind(|(topic, ..)| topic == wanted).unwrap();
            bytes.as_slice()
        };
        let message = CompressedImage::decode(bytes("/camera/color/image_raw/compressed")).unwrap();
        assert_eq!(message.header.frame_id, "camera_color_optical_frame");
        assert_eq!(message.header.stamp, Stamp::from_ros(7, 5));
        assert_eq!(message.to_color().unwrap(), color);
        let topic = "/camera/depth/image_raw/compressedDepth";
        let message = CompressedImage::decode(bytes(topic)).unwrap();
        assert_eq!(message.header.frame_id, "camera_depth_optical_frame");
        assert_eq!(message.to_depth().unwrap(), depth);
        let message = MeshUpdateMessage::decode(bytes("/mesh")).unwrap();
        assert_eq!((message.header.frame_id, message.revision), ("map", 2));
        let (update, _) = message.to_update().unwrap();
        let MeshUpdate::Blocks { clear, blocks } = update else {
            panic!("blocks expected");
        };
        assert!(!clear);
        assert_eq!(blocks[0].0, MeshBlockKey([3, 0, 0]));
        // The message holds 32-bit floats.
        let expected = f64::from(0.1f32);
        assert_eq!(blocks[0].1.positions_m()[2].y, expected);
    }

    #[test]
    fn a_mesh_topic_keeps_its_type() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        let whole = MeshUpdate::Whole(triangle());
        let blocks = MeshUpdate::Blocks {
            clear: false,
            blocks: vec![(MeshBlockKey([3, 0, 0]), triangle())],
        };
        let stamp = Stamp::from_ros(7, 5);
        let open = || ScanWriter::create(&path, &ScanTopics::default(), Compression::None).unwrap();
        let mut writer = open();
        writer.mesh(stamp, &whole).unwrap();
        let refused = writer.mesh(stamp, &blocks);
        assert!(matches!(refused, Err(BagError::Topic { role: "mesh", .. })));
        writer.mesh(stamp, &whole).unwrap();
        writer.finish().unwrap();
        let types: Vec<_> = messages(&path)
            .into_iter()
            .map(|(_, name, _)| name)
            .collect();
        assert_eq!(types, ["mesh_msgs/msg/MeshGeometryStamped"; 2]);
        let mut writer = open();
        writer.mesh(stamp, &blocks).unwrap();
        writer.mesh(stamp, &whole).unwrap();
        writer.finish().unwrap();
        let found = messages(&path);
        let (_, type_name, bytes) = &found[1];
        assert_eq!(type_name, "veneer/msg/MeshUpdate");
        let (update, _) = MeshUpdateMessage::decode(bytes)
            .unwrap()
            .to_update()
            .unwrap();
        let MeshUpdate::Blocks {
            clear: true,
            blocks,
        } = update
        else {
            panic!("{update:?} does not replace the blocks");
        };
        assert_eq!(blocks.len(), 1);
    }

    #[test]
    fn the_depth_camera_is_where_it_is_said_to_be() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        let extrinsics =
            RigidTransform::try_from_quaternion([0.0, 0.0, 0.0, 1.0], [0.02, 0.0, 0.0]).unwrap();
        for said in [None, Some(&extrinsics)] {
            write_scan(&path, false, said);
            let found = messages(&path);
            let statics: Vec<_> = found.iter().filter(|(t, ..)| t == "/tf_static").collect();
            let [(.., bytes)] = statics.as_slice() else {
                panic!("{} static transforms", statics.len());
            };
            let message = TfMessage::decode(bytes).unwrap();
            let (transforms, _) = message.to_transforms();
            assert_eq!(
                &*transforms[0].header.frame_id,
                "camera_color_optical_frame"
            );
            assert_eq!(&*transforms[0].child_frame_id, "camera_depth_optical_frame");
            let expected = said.copied().unwrap_or_else(RigidTransform::identity);
            assert_eq!(transforms[0].parent_from_child, expected);
        }
    }
}
