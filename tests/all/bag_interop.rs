//! Bags against two independent Python implementations, both ways: `rosbags` (with ROS Jazzy's
//! own message definitions and their hashes) and `mcap-ros2-support`.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};
use std::process::Command;

use nalgebra::Point3;
use veneer::bag::{BagInfo, BagReader, BagWriter, Compression, TopicRoles};
use veneer::geom::{CameraModel, Distortion, EncodedDepth, PinholeCamera, Stamp};
use veneer::ingest::{Event, EventSource};
use veneer::mesh::TriMesh;
use veneer::wire::diagnostic_array::{self, DiagnosticStatus};
use veneer::wire::geometry::WirePose;
use veneer::wire::mesh_materials::{MeshFaceCluster, MeshMaterial};
use veneer::wire::mesh_update::WireMeshBlock;
use veneer::wire::nvblox_mesh::NvbloxBlock;
use veneer::wire::scene_update::{self, ModelPrimitive, SceneEntity, SceneEntityDeletion};
use veneer::wire::service::lifecycle::{State, Transition, TransitionEvent};
use veneer::wire::tf_message::TransformStamped;
use veneer::wire::{
    CameraInfo, Clock, CompressedImage, DiagnosticArray, Image, Log, Marker, MarkerArray,
    MeshGeometryStamped, MeshMaterialsStamped, MeshTexture, MeshUpdateMessage,
    MeshVertexColorsStamped, Message, NvbloxMesh, Odometry, Path as RosPath, PoseArray,
    PoseStamped, PoseWithCovarianceStamped, SceneUpdate, ShapeMesh, TfMessage, WireHeader,
};

use crate::python;

const HEADER: WireHeader<'static> = WireHeader {
    stamp: Stamp::from_ros(3, 500_000_000),
    frame_id: "cam",
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

/// Topic, type, definition and bytes of one message of each type.
type Sample = (&'static str, &'static str, &'static str, Vec<u8>);

fn sample<'a, M: Message<'a>>(topic: &'static str, message: &M) -> Sample {
    (topic, M::TYPE_NAME, M::SCHEMA, message.encode())
}

fn images() -> Vec<Sample> {
    let pixels: Vec<u8> = (0..24).collect();
    let image = Image {
        header: HEADER,
        height: 2,
        width: 4,
        encoding: "rgb8",
        is_bigendian: false,
        step: 12,
        data: &pixels,
    };
    let depth = EncodedDepth::rvl_from_u16_mm(2, 1, &[1000, 0]).unwrap();
    let camera = CameraModel {
        pinhole: PinholeCamera::new([500.0, 501.0, 1.5, 0.5], 4, 2).unwrap(),
        distortion: Distortion::PlumbBob([0.1, 0.2, 0.3, 0.4, 0.5]),
    };
    vec![
        sample("/color/image_raw", &image),
        sample(
            "/color/camera_info",
            &CameraInfo::from_camera(HEADER, &camera),
        ),
        sample(
            "/depth/image/compressedDepth",
            &CompressedImage::from_depth(HEADER, &depth).unwrap(),
        ),
    ]
}

fn poses() -> Vec<Sample> {
    let with_covariance = PoseWithCovarianceStamped {
        header: HEADER,
        pose: POSE,
        covariance: std::array::from_fn(|i| i as f64),
    };
    let odometry = Odometry {
        header: HEADER,
        child_frame_id: "base",
        pose: POSE,
        pose_covariance: [0.5; 36],
        twist: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        twist_covariance: [0.25; 36],
    };
    let transform = |child_frame_id| TransformStamped {
        header: HEADER,
        child_frame_id,
        transform: POSE,
    };
    let tf = TfMessage {
        transforms: vec![transform("a"), transform("longer_name")],
    };
    vec![
        sample("/tf", &tf),
        sample(
            "/tf_static",
            &TfMessage {
                transforms: Vec::new(),
            },
        ),
        sample(
            "/pose",
            &PoseStamped {
                header: HEADER,
                pose: POSE,
            },
        ),
        sample("/pose_cov", &with_covariance),
        sample("/odom", &odometry),
    ]
}

fn meshes() -> Vec<Sample> {
    let vertices_m = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let update = MeshUpdateMessage {
        header: HEADER,
        revision: 3,
        clear: true,
        blocks: vec![
            WireMeshBlock {
                key: -5,
                vertices_m: vertices_m.clone(),
                triangles: vec![0, 1, 2],
            },
            WireMeshBlock {
                key: 9,
                ..WireMeshBlock::default()
            },
        ],
    };
    let nvblox = NvbloxMesh {
        header: HEADER,
        block_size_m: 0.5,
        block_indices: vec![[1, -2, 3], [0, 0, 0]],
        blocks: vec![
            NvbloxBlock {
                vertices_m,
                normals: vec![[0.0, 0.0, 1.0]; 3],
                colors: vec![[0.5; 4]; 3],
                triangles: vec![0, 1, 2],
            },
            NvbloxBlock::default(),
        ],
        clear: false,
    };
    let marker = Marker::from_mesh(HEADER, "m", 4, &triangle());
    let markers = vec![
        marker.clone(),
        Marker {
            action: 2,
            ..marker.clone()
        },
    ];
    vec![
        sample("/mesh_update", &update),
        sample(
            "/mesh_geometry",
            &MeshGeometryStamped::from_mesh(HEADER, &triangle()),
        ),
        sample("/shape_mesh", &ShapeMesh::from_mesh(&triangle())),
        sample("/marker", &marker),
        sample("/marker_array", &MarkerArray { markers }),
        sample("/nvblox", &nvblox),
    ]
}

/// What veneer publishes, and what only it receives.
fn outputs() -> Vec<Sample> {
    let poses = PoseArray {
        header: HEADER,
        poses: vec![POSE, POSE],
    };
    let path = RosPath {
        header: HEADER,
        poses: vec![PoseStamped {
            header: HEADER,
            pose: POSE,
        }],
    };
    let diagnostics = DiagnosticArray {
        header: HEADER,
        status: vec![
            DiagnosticStatus {
                level: diagnostic_array::WARN,
                name: "veneer: input rates",
                message: "/camera/color/image_raw: 3 Hz, 30 Hz are needed",
                hardware_id: "",
                values: vec![("rgb/image", "3.0"), ("depth/image", "29.9")],
            },
            DiagnosticStatus::default(),
        ],
    };
    let log = Log {
        stamp: HEADER.stamp,
        level: 30,
        name: "veneer",
        text: "no transform from map to cam",
        file: "pose_buffer.rs",
        function: "look_up",
        line: 77,
    };
    let event = TransitionEvent {
        timestamp: 12,
        transition: Transition {
            id: 3,
            label: "activate".to_owned(),
        },
        start_state: State {
            id: 2,
            label: "inactive".to_owned(),
        },
        goal_state: State {
            id: 3,
            label: "active".to_owned(),
        },
    };
    let clock = Clock {
        clock: HEADER.stamp,
    };
    vec![
        sample("/keyframes", &poses),
        sample("/path", &path),
        sample("/diagnostics", &diagnostics),
        sample("/rosout", &log),
        sample("/veneer/transition_event", &event),
        sample("/clock", &clock),
    ]
}

/// How a mesh looks, for mesh_tools and Foxglove.
fn looks() -> Vec<Sample> {
    let materials = MeshMaterialsStamped {
        header: HEADER,
        uuid: "a",
        clusters: vec![MeshFaceCluster {
            face_indices: vec![0, 1],
            label: "wall",
        }],
        materials: vec![MeshMaterial {
            texture_index: 4,
            color: [0.25, 0.5, 0.75, 1.0],
            has_texture: true,
        }],
        cluster_materials: vec![0],
        vertex_tex_coords: vec![[0.0, 0.5], [1.0, 0.25]],
    };
    let colors = MeshVertexColorsStamped {
        header: HEADER,
        uuid: "a",
        vertex_colors: vec![[0.25, 0.5, 0.75, 1.0]; 3],
    };
    let texture = MeshTexture {
        uuid: "a",
        texture_index: 4,
        image: Image {
            header: HEADER,
            height: 1,
            width: 1,
            encoding: "rgb8",
            is_bigendian: false,
            step: 3,
            data: &[1, 2, 3],
        },
    };
    let scene = SceneUpdate {
        deletions: vec![SceneEntityDeletion {
            timestamp: HEADER.stamp,
            kind: scene_update::MATCHING_ID,
            id: "old".into(),
        }],
        entities: vec![SceneEntity {
            timestamp: HEADER.stamp,
            frame_id: "map",
            id: "new".into(),
            lifetime: (1, 2),
            frame_locked: true,
            metadata: vec![("by".into(), "veneer".into())],
            models: vec![ModelPrimitive {
                pose: POSE,
                scale: [1.0, 2.0, 3.0],
                color: [0.1, 0.2, 0.3, 0.4],
                has_color: true,
                url: "http://127.0.0.1/scan.glb",
                media_type: "model/gltf-binary",
                data: vec![1, 2, 3].into(),
            }],
        }],
    };
    vec![
        sample("/mesh_materials", &materials),
        sample("/mesh_colors", &colors),
        sample("/mesh_texture", &texture),
        sample("/scene", &scene),
    ]
}

fn write_bag(path: &Path, compression: Compression) -> usize {
    let samples = [images(), poses(), meshes(), outputs(), looks()].concat();
    let mut bag = BagWriter::create(path, compression).unwrap();
    for (i, (topic, type_name, schema, bytes)) in samples.iter().enumerate() {
        let channel = bag.add_channel(topic, type_name, schema).unwrap();
        let log_time = Stamp::from_nanos(1_000 + i64::try_from(i).unwrap());
        bag.write(channel, log_time, bytes).unwrap();
    }
    bag.finish().unwrap();
    samples.len()
}

/// What a bag says, with each mesh and pose topic in turn in its part.
fn events(path: &Path) -> Vec<(String, Event)> {
    let mesh_topics = [
        "/mesh_update",
        "/mesh_geometry",
        "/shape_mesh",
        "/marker",
        "/marker_array",
        "/nvblox",
    ];
    let pose_topics = ["/pose", "/pose_cov", "/odom"];
    let mut events = Vec::new();
    for (i, mesh) in mesh_topics.into_iter().enumerate() {
        let roles = TopicRoles {
            mesh: Some(mesh.into()),
            mesh_frame: Some("map".into()),
            pose: Some(pose_topics[i % 3].into()),
            ..TopicRoles::default()
        };
        let mut reader = BagReader::open(path, &roles).unwrap();
        while let Some(timed) = reader.next_event() {
            let topic = reader.topics()[timed.topic].clone();
            let event = timed
                .event
                .unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            events.push((topic, event));
        }
        assert_eq!(reader.losses(), [] as [String; 0], "{}", path.display());
    }
    events
}

#[test]
fn bags_pass_through_rosbags_and_mcap_ros2_support_unchanged() {
    let packages = ["rosbags==0.11.9", "mcap-ros2-support==0.6.0", "numpy"];
    let Some(python) = python::venv("bags", &packages) else {
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/bag_interop.py");
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("veneer.mcap");
        let num_messages = write_bag(&path, compression);
        let said = python::run(
            Command::new(&python)
                .arg(&script)
                .args([path.as_path(), folder.path()]),
        );
        assert_eq!(said.unwrap().trim(), format!("{num_messages} messages"));
        let ours = events(&path);
        // For each of six combinations: colour, depth, the one info for both, a TF, a pose, a mesh.
        assert_eq!(ours.len(), 6 * 7);
        let names = [
            "rosbags-little",
            "rosbags-big",
            "rosbags-zstd",
            "mcap-ros2-none.mcap",
            "mcap-ros2-lz4.mcap",
            "mcap-ros2-zstd.mcap",
        ];
        for theirs in names.map(|name| -> PathBuf { folder.path().join(name) }) {
            assert_eq!(events(&theirs), ours, "{}", theirs.display());
            let info = BagInfo::read(&theirs, &TopicRoles::default()).unwrap();
            assert_eq!(info.topics.len(), num_messages);
            assert!(
                info.topics
                    .iter()
                    .all(|t| t.num_messages == 1 && t.num_refused == 0)
            );
        }
    }
}
