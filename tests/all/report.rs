//! The report of a room, as a browser would open it.

#![expect(
    clippy::unwrap_used,
    reason = "a test fails by panicking, its helpers included"
)]

use std::path::Path;

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use veneer::export::{ExportParams, TexturedMesh, write_all};
use veneer::geom::{PinholeCamera, RigidTransform, Stamp};
use veneer::report::{
    self, Count, DensitySummary, Drop, KeyframeRow, Note, Report, ReportView, Severity,
    SourceSummary, Stage, TopicRow,
};

use crate::textured_room::Room;

/// A camera at `eye` that looks at `target`, z up.
fn look_at(eye: [f64; 3], target: [f64; 3]) -> RigidTransform {
    let eye = Vector3::from(eye);
    let forward = (Vector3::from(target) - eye).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&right);
    let rotation = Rotation3::from_basis_unchecked(&[right, down, forward]);
    let q = UnitQuaternion::from_rotation_matrix(&rotation);
    RigidTransform::try_from_quaternion([q.i, q.j, q.k, q.w], eye.into()).unwrap()
}

fn views(room: &Room) -> Vec<ReportView> {
    let landscape = PinholeCamera::new([420.0, 420.0, 319.5, 239.5], 640, 480).unwrap();
    let portrait = PinholeCamera::new([420.0, 420.0, 179.5, 239.5], 360, 480).unwrap();
    let poses = [
        (landscape, [0.6, 0.5, 1.7], [2.6, 2.6, 0.9]),
        (landscape, [3.5, 0.6, 1.5], [1.2, 2.4, 0.7]),
        (portrait, [3.4, 2.5, 1.6], [1.0, 0.4, 0.8]),
        (portrait, [0.7, 2.4, 1.4], [3.2, 0.8, 0.9]),
    ];
    poses
        .into_iter()
        .enumerate()
        .map(|(index, (camera, eye, target))| {
            let view = room.view(&camera, &look_at(eye, target));
            ReportView {
                name: format!("frame {}", 10 * index + 10),
                stamp: Stamp::from_nanos(333_333_333 * index as i64),
                held_out: true,
                mask: view.triangle.iter().map(|t| *t != u32::MAX).collect(),
                photo: view.photo,
                render: view.render,
                triangle: view.triangle,
            }
        })
        .collect()
}

fn keyframes() -> Vec<KeyframeRow> {
    (0..49)
        .map(|id| {
            let angle = f64::from(id) * 0.128;
            let radius = 1.1 + 0.15 * (3.0 * angle).sin();
            KeyframeRow {
                id,
                time_s: f64::from(id) * 0.61,
                position_m: [
                    2.0 + 1.3 * radius * angle.cos(),
                    1.5 + radius * angle.sin(),
                    1.55,
                ],
                direction: [-angle.cos(), -angle.sin(), -0.2],
                sharpness: 0.3,
                mean_luma: 0.5,
                num_texels: 0,
            }
        })
        .collect()
}

fn sample_report() -> Report {
    let topic =
        |topic: &str, type_name: &str, role: Option<&str>, num_messages, rate_hz| TopicRow {
            topic: topic.to_owned(),
            type_name: type_name.to_owned(),
            role: role.map(str::to_owned),
            num_messages,
            rate_hz: Some(rate_hz),
        };
    let stage = |name: &str, seconds| Stage {
        name: name.to_owned(),
        seconds,
    };
    let drop = |at: &str, reason: &str, count| Drop {
        at: at.to_owned(),
        reason: reason.to_owned(),
        count,
    };
    Report {
        generator: format!("veneer {}", env!("CARGO_PKG_VERSION")),
        title: "formula_room".to_owned(),
        notes: vec![Note {
            severity: Severity::Warning,
            text: "3 colour images had no pose within 20 ms and were left out.".to_owned(),
        }],
        source: SourceSummary {
            path: "formula_room.mcap".to_owned(),
            num_bytes: 123_456_789,
            duration_s: 30.2,
            topics: vec![
                topic(
                    "/camera/color/image_raw/compressed",
                    "sensor_msgs/msg/CompressedImage",
                    Some("colour"),
                    906,
                    30.0,
                ),
                topic(
                    "/camera/depth/image_raw/compressedDepth",
                    "sensor_msgs/msg/CompressedImage",
                    Some("depth"),
                    905,
                    30.0,
                ),
                topic("/tf", "tf2_msgs/msg/TFMessage", Some("pose"), 1812, 60.0),
                topic(
                    "/mesh",
                    "mesh_msgs/msg/MeshGeometryStamped",
                    Some("mesh"),
                    1,
                    0.03,
                ),
                topic("/rosout", "rcl_interfaces/msg/Log", None, 14, 0.5),
            ],
            losses: vec![],
        },
        counts: vec![
            Count::new("messages read", 3638),
            Count::new("posed frames", 902),
            Count::new("keyframes kept", 49),
        ],
        drops: vec![
            drop(
                "/camera/color/image_raw/compressed",
                "no pose within 20 ms",
                3,
            ),
            drop("keyframe", "too near to a kept one", 810),
            drop("keyframe", "blurred", 43),
        ],
        stages: vec![
            stage("read and decode", 1.21),
            stage("keyframes", 2.4),
            stage("charts", 0.62),
            stage("flatten", 1.9),
            stage("pack", 0.08),
            stage("assign", 2.31),
            stage("transfer", 1.12),
            stage("fill", 0.33),
            stage("export", 0.94),
            stage("report", 0.55),
        ],
        total_s: 11.9,
        num_threads: 2,
        peak_memory_bytes: Some(712_000_000),
        keyframes: keyframes(),
        density: Some(DensitySummary {
            p10_px_per_m: 110.0,
            p50_px_per_m: 214.0,
            p90_px_per_m: 390.0,
        }),
        parameters: serde_json::json!({
            "texinit": {"mode": "streaming", "cue_weights": [1e-3, -10.0, -1.0]},
            "keyframe": {"budget_mb": 256},
        }),
        ..Report::default()
    }
}

/// Kept after the test, for a look at it.
#[test]
fn a_room_has_a_report_to_look_at() {
    let room = Room::new();
    let textured = TexturedMesh::new(&room.mesh, &room.layout, &room.texture).unwrap();
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("report_of_a_room");
    write_all(&textured, &out, &ExportParams::default()).unwrap();
    let views = views(&room);
    let mut report = sample_report();
    report.measure(&textured, &views).unwrap();
    report::write(&report, Some(&textured), &views, &out).unwrap();
    // The photos differ from the formula by a vignette and 4 levels of grain.
    for score in &report.views {
        assert!(score.psnr_db.unwrap() > 20.0, "{score:?}");
        assert!(score.ssim.unwrap() > 0.6, "{score:?}");
    }
    let html = std::fs::read_to_string(out.join(report::HTML_NAME)).unwrap();
    for page in 0..2 {
        assert!(html.contains(&format!("href=\"atlas/page_{page}.png\"")));
        assert!(out.join(format!("atlas/page_{page}.png")).exists());
    }
    // Per view two pictures and three diagrams, per page one and four, and the plan.
    assert_eq!(html.matches("<img ").count(), 4 * 5 + 2 * 5 + 1);
    assert!(html.len() < 8_000_000, "{} bytes", html.len());
}
