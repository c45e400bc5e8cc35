//! A message of each of our types, its bytes, and what it says.

use serde_json::{Value, json};
use veneer::atlas::TexelRect;
use veneer::geom::Stamp;
use veneer::wire::geometry::WirePose;
use veneer::wire::mesh_update::WireMeshBlock;
use veneer::wire::pose_corrections::PoseCorrection;
use veneer::wire::service::{FilePathRequest, FilePathResponse};
use veneer::wire::status::{OutputStatus, QueueStatus, StageStatus, TopicStatus};
use veneer::wire::textured_mesh_block::{TextureTile, TexturedChart};
use veneer::wire::{
    MeshUpdateMessage, Message, PoseCorrections, Status, TexturedMeshBlock, WireError, WireHeader,
};

const HEADER: WireHeader<'static> = WireHeader {
    stamp: Stamp::from_ros(3, 500_000_000),
    frame_id: "map",
};

/// A message, its bytes, what it says field by field, and a reader of its bytes.
pub(super) struct Sample {
    pub(super) type_name: &'static str,
    pub(super) schema: &'static str,
    pub(super) bytes: Vec<u8>,
    pub(super) says: Value,
    pub(super) decode: fn(&[u8]) -> Result<Vec<u8>, WireError>,
}

pub(super) fn sample<'a, M>(
    message: &M,
    decode: fn(&[u8]) -> Result<Vec<u8>, WireError>,
    says: Value,
) -> Sample
where
    M: Message<'a>,
{
    Sample {
        type_name: M::TYPE_NAME,
        schema: M::SCHEMA,
        bytes: message.encode(),
        says,
        decode,
    }
}

macro_rules! reencode {
    ($message:ident) => {
        |bytes| $message::decode(bytes).map(|message| message.encode())
    };
}
pub(super) use reencode;

fn header_says() -> Value {
    json!({"stamp": {"sec": 3, "nanosec": 500_000_000}, "frame_id": "map"})
}

fn mesh_update() -> Sample {
    let message = MeshUpdateMessage {
        header: HEADER,
        revision: 1 << 40,
        clear: true,
        blocks: vec![
            WireMeshBlock {
                key: -5,
                vertices_m: vec![[0.5, 1.5, 2.5]],
                triangles: vec![7, 8, 9],
            };
            2
        ],
    };
    let block = json!({
        "key": -5, "vertices": [{"x": 0.5, "y": 1.5, "z": 2.5}], "triangles": [7, 8, 9],
    });
    let says = json!({
        "header": header_says(),
        "revision": 1u64 << 40,
        "clear": true,
        "blocks": [block, block],
    });
    sample(&message, reencode!(MeshUpdateMessage), says)
}

fn textured_mesh_block() -> Sample {
    let message = TexturedMeshBlock {
        header: HEADER,
        session: u64::MAX,
        revision: 12,
        base_revision: 11,
        block_index: 1,
        num_blocks: 3,
        page_size_texel: [4096, 1280],
        num_pages: 2,
        removed_chart_ids: vec![4, 5],
        charts: vec![
            TexturedChart {
                id: 6,
                page: 1,
                rect: TexelRect {
                    x: 10,
                    y: 20,
                    width: 30,
                    height: 40,
                },
                vertices_m: vec![[0.25, 0.5, 0.75], [1.25, 1.5, 1.75]],
                uvs: vec![0.125, 0.25, 0.375, 0.5],
                triangles: vec![0, 1, 0],
            };
            2
        ],
        tiles: vec![
            TextureTile {
                page: 1,
                rect: TexelRect {
                    x: 256,
                    y: 512,
                    width: 128,
                    height: 64,
                },
                format: "png",
                data: vec![137; 40].into(),
            };
            2
        ],
    };
    let chart = json!({
        "id": 6, "page": 1, "x": 10, "y": 20, "width": 30, "height": 40,
        "vertices": [{"x": 0.25, "y": 0.5, "z": 0.75}, {"x": 1.25, "y": 1.5, "z": 1.75}],
        "uvs": [0.125, 0.25, 0.375, 0.5],
        "triangles": [0, 1, 0],
    });
    let tile = json!({
        "page": 1, "x": 256, "y": 512, "width": 128, "height": 64,
        "format": "png", "data": vec![137; 40],
    });
    let says = json!({
        "header": header_says(),
        "session": u64::MAX,
        "revision": 12,
        "base_revision": 11,
        "block_index": 1,
        "num_blocks": 3,
        "page_width": 4096,
        "page_height": 1280,
        "num_pages": 2,
        "removed_chart_ids": [4, 5],
        "charts": [chart, chart],
        "tiles": [tile, tile],
    });
    sample(&message, reencode!(TexturedMeshBlock), says)
}

fn status() -> Sample {
    let message = Status {
        header: HEADER,
        state: "active",
        is_paused: true,
        session: 8,
        revision: 9,
        inputs: vec![
            TopicStatus {
                role: "rgb/image",
                topic: "/camera/color",
                type_name: "sensor_msgs/msg/Image",
                num_received: 100,
                num_used: 90,
                num_refused: 4,
                num_dropped: 6,
                rate_hz: 29.5,
                age_s: 0.25,
            };
            2
        ],
        outputs: vec![
            OutputStatus {
                topic: "/veneer/markers",
                num_subscribers: 2,
                num_messages: 50,
                num_bytes: 1 << 33,
                num_superseded: 3,
            };
            2
        ],
        queues: vec![
            QueueStatus {
                name: "frames that wait for a partner",
                length: 1,
                capacity: 8,
                num_dropped: 2,
            };
            2
        ],
        stages: vec![
            StageStatus {
                name: "transfer the colours",
                num_runs: 17,
                last_s: 0.5,
                mean_s: 0.375,
            };
            2
        ],
        sync_error_s: 0.0625,
        num_keyframes: 40,
        keyframe_bytes: 1 << 34,
        num_vertices: 1000,
        num_triangles: 2000,
        num_charts: 30,
        num_pages: 1,
        coverage: 0.875,
        latency_s: 1.5,
        memory_bytes: 1 << 35,
    };
    let input = json!({
        "role": "rgb/image", "topic": "/camera/color", "type": "sensor_msgs/msg/Image",
        "num_received": 100, "num_used": 90, "num_refused": 4, "num_dropped": 6,
        "rate_hz": 29.5, "age_s": 0.25,
    });
    let output = json!({
        "topic": "/veneer/markers", "num_subscribers": 2, "num_messages": 50,
        "num_bytes": 1u64 << 33, "num_superseded": 3,
    });
    let queue = json!({
        "name": "frames that wait for a partner", "length": 1, "capacity": 8, "num_dropped": 2,
    });
    let stage = json!({
        "name": "transfer the colours", "num_runs": 17, "last_s": 0.5, "mean_s": 0.375,
    });
    let says = json!({
        "header": header_says(),
        "state": "active",
        "paused": true,
        "session": 8,
        "revision": 9,
        "inputs": [input, input],
        "outputs": [output, output],
        "queues": [queue, queue],
        "stages": [stage, stage],
        "sync_error_s": 0.0625,
        "num_keyframes": 40,
        "keyframe_bytes": 1u64 << 34,
        "num_vertices": 1000,
        "num_triangles": 2000,
        "num_charts": 30,
        "num_pages": 1,
        "coverage": 0.875,
        "latency_s": 1.5,
        "memory_bytes": 1u64 << 35,
    });
    sample(&message, reencode!(Status), says)
}

fn pose_corrections() -> Sample {
    let message = PoseCorrections {
        header: HEADER,
        corrections: vec![PoseCorrection {
            stamp: Stamp::from_ros(-2, 7),
            pose: WirePose {
                position_m: [1.5, 2.5, 3.5],
                quaternion_xyzw: [0.0, 0.5, -0.5, 0.75],
            },
        }],
    };
    let says = json!({
        "header": header_says(),
        "corrections": [{
            "stamp": {"sec": -2, "nanosec": 7},
            "pose": {
                "position": {"x": 1.5, "y": 2.5, "z": 3.5},
                "orientation": {"x": 0.0, "y": 0.5, "z": -0.5, "w": 0.75},
            },
        }],
    });
    sample(&message, reencode!(PoseCorrections), says)
}

fn file_path() -> [Sample; 2] {
    let request = FilePathRequest {
        file_path: "scans/kitchen.glb".to_owned(),
    };
    let response = FilePathResponse {
        success: true,
        message: "wrote it".to_owned(),
    };
    [
        sample(
            &request,
            reencode!(FilePathRequest),
            json!({"file_path": "scans/kitchen.glb"}),
        ),
        sample(
            &response,
            reencode!(FilePathResponse),
            json!({"success": true, "message": "wrote it"}),
        ),
    ]
}

pub(super) fn samples() -> Vec<Sample> {
    let mut samples = vec![
        mesh_update(),
        textured_mesh_block(),
        status(),
        pose_corrections(),
    ];
    samples.extend(file_path());
    samples
}
