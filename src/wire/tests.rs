//! What holds for every message: both byte orders read back, and no bytes make a decoder panic.

use nalgebra::Point3;
use proptest::prelude::*;

use super::event::MessageType;
use super::geometry::WirePose;
use super::header::WireHeader;
use super::marker::{self, MarkerTail};
use super::mesh_update::WireMeshBlock;
use super::nvblox_mesh::NvbloxBlock;
use super::pose_corrections::PoseCorrection;
use super::tf_message::TransformStamped;
use super::*;
use crate::geom::{EncodedColor, EncodedDepth, Stamp};
use crate::ingest::{self, CorrectedBody, Event, MeshUpdate};
use crate::mesh::TriMesh;

const HEADER: WireHeader<'static> = WireHeader {
    stamp: Stamp::from_ros(12, 345_678_900),
    frame_id: "map",
};
const POSE: WirePose = WirePose {
    position_m: [1.0, 2.0, 3.0],
    quaternion_xyzw: [0.0, 0.6, 0.0, 0.8],
};

fn triangle() -> TriMesh {
    let corners = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]].map(Point3::from);
    TriMesh::from_soup(corners.to_vec(), vec![[0, 1, 2]])
        .unwrap()
        .0
}

fn image() -> Image<'static> {
    Image {
        header: HEADER,
        height: 1,
        width: 2,
        encoding: "rgb8",
        is_bigendian: false,
        step: 6,
        data: &[1, 2, 3, 4, 5, 6],
    }
}

fn compressed_depth() -> CompressedImage<'static> {
    let depth = EncodedDepth::png_from_u16_mm(2, 1, &[1000, 0]).unwrap();
    CompressedImage::from_depth(HEADER, &depth).unwrap()
}

fn camera_info() -> CameraInfo<'static> {
    let pinhole = crate::geom::PinholeCamera::new([500.0, 500.0, 3.5, 2.5], 8, 6).unwrap();
    CameraInfo::from_camera(HEADER, &crate::geom::CameraModel::ideal(pinhole))
}

fn tf_message() -> TfMessage<'static> {
    let transform = |child_frame_id| TransformStamped {
        header: HEADER,
        child_frame_id,
        transform: POSE,
    };
    TfMessage {
        transforms: vec![transform("a"), transform("camera_optical_frame")],
    }
}

fn odometry() -> Odometry<'static> {
    Odometry {
        header: HEADER,
        child_frame_id: "base_link",
        pose: POSE,
        pose_covariance: std::array::from_fn(|i| i as f64),
        twist: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        twist_covariance: [0.5; 36],
    }
}

fn pose_corrections() -> PoseCorrections<'static> {
    PoseCorrections {
        header: HEADER,
        corrections: vec![PoseCorrection {
            stamp: Stamp::from_ros(11, 1),
            pose: POSE,
        }],
    }
}

fn path() -> Path<'static> {
    Path {
        header: HEADER,
        poses: vec![PoseStamped {
            header: WireHeader {
                stamp: Stamp::from_ros(11, 2),
                frame_id: "",
            },
            pose: POSE,
        }],
    }
}

fn nvblox_mesh() -> NvbloxMesh<'static> {
    NvbloxMesh {
        header: HEADER,
        block_size_m: 0.4,
        block_indices: vec![[1, -2, 3], [0, 0, 7]],
        blocks: vec![
            NvbloxBlock {
                vertices_m: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                normals: vec![[0.0, 0.0, 1.0]; 3],
                colors: vec![[1.0, 0.5, 0.25, 1.0]; 3],
                triangles: vec![0, 1, 2],
            },
            NvbloxBlock::default(),
        ],
        clear: true,
    }
}

fn mesh_update() -> MeshUpdateMessage<'static> {
    MeshUpdateMessage {
        header: HEADER,
        revision: 3,
        clear: false,
        blocks: vec![
            WireMeshBlock {
                key: -5,
                vertices_m: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                triangles: vec![0, 1, 2],
            },
            WireMeshBlock::default(),
        ],
    }
}

fn marker_of(ns: &'static str, id: i32) -> Marker<'static> {
    Marker {
        tail: MarkerTail {
            texture_resource: "embedded://t",
            uv_coordinates: vec![[0.0, 1.0]; 3],
            mesh_data: &[1, 2],
            mesh_use_embedded_materials: true,
            ..MarkerTail::default()
        },
        colors: vec![[0.1, 0.2, 0.3, 0.4]],
        ..Marker::from_mesh(HEADER, ns, id, &triangle())
    }
}

/// One of each, serialised in both byte orders.
fn samples(big_endian: bool) -> Vec<(MessageType, Vec<u8>)> {
    fn bytes<'a, M: Message<'a>>(message: &M, big_endian: bool) -> Vec<u8> {
        let mut writer = if big_endian {
            CdrWriter::big_endian()
        } else {
            CdrWriter::little_endian()
        };
        message.write(&mut writer);
        writer.into_bytes()
    }
    let pose = PoseStamped {
        header: HEADER,
        pose: POSE,
    };
    let with_covariance = PoseWithCovarianceStamped {
        header: HEADER,
        pose: POSE,
        covariance: [0.25; 36],
    };
    let geometry = MeshGeometryStamped::from_mesh(HEADER, &triangle());
    let array = MarkerArray {
        markers: vec![marker_of("x", 1), marker_of("y", 1)],
    };
    vec![
        (MessageType::Image, bytes(&image(), big_endian)),
        (
            MessageType::CompressedImage,
            bytes(&compressed_depth(), big_endian),
        ),
        (MessageType::CameraInfo, bytes(&camera_info(), big_endian)),
        (MessageType::Tf, bytes(&tf_message(), big_endian)),
        (MessageType::PoseStamped, bytes(&pose, big_endian)),
        (
            MessageType::PoseWithCovarianceStamped,
            bytes(&with_covariance, big_endian),
        ),
        (MessageType::Odometry, bytes(&odometry(), big_endian)),
        (
            MessageType::PoseCorrections,
            bytes(&pose_corrections(), big_endian),
        ),
        (MessageType::Path, bytes(&path(), big_endian)),
        (MessageType::MeshUpdate, bytes(&mesh_update(), big_endian)),
        (
            MessageType::MeshGeometryStamped,
            bytes(&geometry, big_endian),
        ),
        (MessageType::NvbloxMesh, bytes(&nvblox_mesh(), big_endian)),
        (
            MessageType::ShapeMesh,
            bytes(&ShapeMesh::from_mesh(&triangle()), big_endian),
        ),
        (MessageType::Marker, bytes(&marker_of("m", 1), big_endian)),
        (MessageType::MarkerArray, bytes(&array, big_endian)),
    ]
}

fn role_of(message_type: MessageType) -> TopicRole {
    match message_type {
        MessageType::Image => TopicRole::Color,
        MessageType::CompressedImage => TopicRole::Depth,
        MessageType::CameraInfo => TopicRole::ColorInfo,
        MessageType::Tf => TopicRole::Transforms,
        MessageType::PoseStamped | MessageType::PoseWithCovarianceStamped => TopicRole::Pose,
        MessageType::Odometry => TopicRole::Odometry,
        MessageType::PoseCorrections | MessageType::Path => TopicRole::Corrections,
        _ => TopicRole::Mesh,
    }
}

fn events(message_type: MessageType, bytes: &[u8]) -> Vec<Result<Event, crate::ingest::Rejection>> {
    let decoder = EventDecoder::new("/topic", message_type, role_of(message_type));
    let mut out = Vec::new();
    decoder
        .unwrap()
        .with_mesh_frame(Some("map"))
        .decode(Stamp::from_nanos(77), bytes, &mut out);
    out
}

#[test]
fn every_message_becomes_the_same_event_in_both_byte_orders() {
    for ((message_type, little), (_, big)) in samples(false).into_iter().zip(samples(true)) {
        let from_little = events(message_type, &little);
        assert!(
            from_little.len() == 1 && from_little[0].is_ok(),
            "{message_type:?}: {from_little:?}"
        );
        assert_eq!(from_little, events(message_type, &big), "{message_type:?}");
    }
}

#[test]
fn corrections_and_paths_say_stamps_and_poses() {
    let pose = POSE.to_transform().unwrap();
    for (event, body, nanosec) in [
        (pose_corrections().to_event(), CorrectedBody::Camera, 1),
        (path().to_event(), CorrectedBody::PoseFrame, 2),
    ] {
        let stamp = Stamp::from_ros(11, nanosec);
        let corrections = vec![ingest::PoseCorrection { stamp, pose }];
        let expected = Event::Corrections(HEADER.to_header(), body, corrections);
        assert_eq!(event.unwrap(), expected);
    }
    let mut bad = path();
    bad.poses[0].pose.quaternion_xyzw = [0.0; 4];
    assert!(bad.to_event().is_err());
}

#[test]
fn fields_read_back_as_written() {
    let bytes = marker_of("m", 1).encode();
    assert_eq!(Marker::decode(&bytes).unwrap(), marker_of("m", 1));
    assert_eq!(Odometry::decode(&odometry().encode()).unwrap(), odometry());
    assert_eq!(
        NvbloxMesh::decode(&nvblox_mesh().encode()).unwrap(),
        nvblox_mesh()
    );
    assert_eq!(
        MeshUpdateMessage::decode(&mesh_update().encode()).unwrap(),
        mesh_update()
    );
    assert_eq!(
        CameraInfo::decode(&camera_info().encode()).unwrap(),
        camera_info()
    );
    assert_eq!(
        TfMessage::decode(&tf_message().encode()).unwrap(),
        tf_message()
    );
    assert_eq!(Image::decode(&image().encode()).unwrap(), image());
}

#[test]
fn every_truncation_is_one_rejection() {
    for (message_type, bytes) in samples(false).into_iter().chain(samples(true)) {
        for length in 0..bytes.len() {
            let out = events(message_type, &bytes[..length]);
            assert_eq!(out.len(), 1, "{message_type:?} {length}");
            assert!(out[0].is_err(), "{message_type:?} {length}: {out:?}");
        }
    }
}

#[test]
fn an_index_out_of_range_is_refused_with_its_numbers() {
    let mut nvblox = nvblox_mesh();
    nvblox.blocks[0].triangles[1] = -7;
    let words = nvblox.to_update().unwrap_err().to_string();
    assert!(words.contains("[1, -2, 3]") && words.contains("-7") && words.contains("3 vertices"));
    let mut update = mesh_update();
    update.blocks[0].triangles = vec![0, 1, 9];
    let words = update.to_update().unwrap_err().to_string();
    assert!(words.contains("block -5") && words.contains('9'), "{words}");
    update.blocks[0].triangles = vec![0, 1];
    assert!(update.to_update().is_err());
    nvblox = nvblox_mesh();
    nvblox.block_indices.pop();
    assert!(
        nvblox
            .to_update()
            .unwrap_err()
            .to_string()
            .contains("1 entries for 2 blocks")
    );
}

#[test]
fn rejections_name_topic_stamp_and_reason() {
    let mut wrong = image();
    wrong.encoding = "rgb16";
    let out = events(MessageType::Image, &wrong.encode());
    let rejection = out[0].as_ref().unwrap_err();
    assert_eq!(rejection.stamp, HEADER.stamp);
    assert_eq!(
        rejection.to_string(),
        "/topic at 12.345678900: image encoding 'rgb16' is not supported"
    );
    let mut bad_pose = tf_message();
    bad_pose.transforms[0].transform.quaternion_xyzw = [0.0; 4];
    let out = events(MessageType::Tf, &bad_pose.encode());
    assert!(matches!(&out[0], Ok(Event::Transforms(valid)) if valid.len() == 1));
    let words = out[1].as_ref().unwrap_err().reason.clone();
    assert!(
        words.contains("map -> a") && words.contains("norm 0"),
        "{words}"
    );
}

#[test]
fn markers_add_replace_and_delete_by_name() {
    let mut set = MarkerSet::default();
    let mut keys = |markers: &[Marker<'_>]| {
        let (updates, refused) = set.apply(markers);
        assert_eq!(refused, []);
        let parts = updates.into_iter().map(|(_, update, _)| match update {
            MeshUpdate::Blocks { clear, blocks } => {
                let blocks = blocks
                    .into_iter()
                    .map(|(key, mesh)| (key.0, mesh.num_triangles()));
                (clear, blocks.collect::<Vec<_>>())
            }
            MeshUpdate::Whole(_) => unreachable!(),
        });
        parts.collect::<Vec<_>>()
    };
    let action = |action, kind, ns, id| Marker {
        action,
        kind,
        ..marker_of(ns, id)
    };
    let add = |ns, id| action(marker::ADD, marker::TRIANGLE_LIST, ns, id);
    assert_eq!(
        keys(&[add("a", 4), add("b", 4), add("a", -1)]),
        [(false, vec![([0, 4, 0], 1), ([1, 4, 0], 1), ([0, -1, 0], 1)])]
    );
    assert_eq!(
        keys(&[action(marker::DELETE, 0, "b", 4)]),
        [(false, vec![([1, 4, 0], 0)])]
    );
    // Unknown names and other kinds change nothing; a kind change removes the triangles.
    assert_eq!(
        keys(&[
            action(marker::DELETE, 0, "zz", 4),
            action(marker::ADD, 0, "q", 1)
        ]),
        []
    );
    assert_eq!(
        keys(&[action(marker::ADD, 0, "a", 4)]),
        [(false, vec![([0, 4, 0], 0)])]
    );
    assert_eq!(
        keys(&[action(marker::DELETE_ALL, 0, "", 0), add("a", 9)]),
        [(true, vec![([0, 9, 0], 1)])]
    );
}

#[test]
fn a_marker_stands_where_its_pose_and_scale_put_it() {
    let mut moved = marker_of("m", 1);
    moved.pose.position_m = [10.0, 0.0, 0.0];
    moved.pose.quaternion_xyzw = [0.0; 4];
    moved.scale = [2.0, 1.0, 1.0];
    let (updates, _) = MarkerSet::default().apply(&[moved.clone()]);
    let MeshUpdate::Blocks { blocks, .. } = &updates[0].1 else {
        unreachable!()
    };
    assert_eq!(blocks[0].1.positions_m()[1], Point3::new(12.0, 0.0, 1.0));
    moved.scale = [0.0; 3];
    let (updates, refused) = MarkerSet::default().apply(&[moved]);
    assert!(updates.is_empty() && refused[0].to_string().contains("scale"));
}

#[test]
fn compressed_depth_formats_old_and_new() {
    let png = EncodedDepth::png_from_u16_mm(2, 1, &[1000, 0]).unwrap();
    let rvl = EncodedDepth::rvl_from_u16_mm(2, 1, &[1000, 0]).unwrap();
    let message = |format: &'static str, config: &[u8], image: &EncodedDepth| CompressedImage {
        header: HEADER,
        format: format.into(),
        data: [config, image.bytes()].concat().into(),
    };
    let config = [7u8; 12];
    for message in [
        message("16UC1; compressedDepth png", &config, &png),
        message("16UC1; compressedDepth", &config, &png),
        message("16UC1", &config, &png),
        message("mono16; compressedDepth png", &config, &png),
        message("16UC1; png compressed ", &[], &png),
        message("16UC1; compressedDepth rvl", &config, &rvl),
    ] {
        let depth = message.to_depth().unwrap().decode().unwrap();
        assert_eq!(depth.depths_m(), [1.0, 0.0], "{}", message.format);
        assert!(message.is_depth() && message.to_color().is_err());
    }
    let mut inverse = [0u8; 12];
    inverse[4..8].copy_from_slice(&2000.0f32.to_le_bytes());
    inverse[8..].copy_from_slice(&(-1000.0f32).to_le_bytes());
    for (format, image) in [
        ("32FC1; compressedDepth png", &png),
        ("32FC1; compressedDepth rvl", &rvl),
    ] {
        let depth = message(format, &inverse, image).to_depth().unwrap();
        assert_eq!(depth.decode().unwrap().depths_m(), [1.0, 0.0]);
        let again = CompressedImage::from_depth(HEADER, &depth).unwrap();
        assert_eq!(again.to_depth().unwrap(), depth);
    }
    assert!(message("32FC1", &[0; 12], &png).to_depth().is_err());
    assert!(
        message("8UC1; compressedDepth png", &config, &png)
            .to_depth()
            .is_err()
    );
    assert!(
        message("16UC1; compressedDepth rvl", &config[..5], &png)
            .to_depth()
            .is_err()
    );
}

#[test]
fn colour_files_go_through_untouched() {
    let image = crate::geom::ColorImage::new(1, 1, vec![[1, 2, 3]]).unwrap();
    let png = EncodedColor::png_from_image(&image).unwrap();
    let message = CompressedImage::from_color(HEADER, &png).unwrap();
    let bytes = message.encode();
    assert_eq!(
        CompressedImage::decode(&bytes).unwrap().to_color().unwrap(),
        png
    );
}

proptest! {
    #[test]
    fn random_bytes_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        // A valid encapsulation header, so that the fields are reached.
        if bytes.len() >= 4 {
            bytes[0] = 0;
            bytes[1] &= 1;
        }
        for (message_type, _) in samples(false) {
            prop_assert!(events(message_type, &bytes).len() <= 100);
        }
    }

    #[test]
    fn mutated_messages_never_panic(
        big_endian in any::<bool>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        for (message_type, mut bytes) in samples(big_endian) {
            for (at, value) in &changes {
                let at = 4 + at.index(bytes.len() - 4);
                bytes[at] = *value;
            }
            for event in events(message_type, &bytes).into_iter().flatten() {
                match event {
                    Event::Color(_, image) => drop(image.decode()),
                    Event::Depth(_, image) => drop(image.decode()),
                    _ => {}
                }
            }
        }
    }
}
