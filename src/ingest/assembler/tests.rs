use nalgebra::Point3;
use proptest::prelude::*;

use super::*;
use crate::geom::{ColorEncoding, DepthEncoding, PinholeCamera};
use crate::geom::{EncodedColor, EncodedDepth};
use crate::ingest::event::CorrectedBody;
use crate::ingest::params::PoseSource;
use crate::ingest::source::Rejection;

const MS: i64 = 1_000_000;
const TOPICS: [&str; 10] = [
    "color",
    "depth",
    "color_info",
    "depth_info",
    "tf",
    "tf_static",
    "pose",
    "odom",
    "mesh",
    "corrections",
];

/// A stream that is written event by event, stamps in milliseconds.
struct Stream {
    assembler: Assembler,
    out: Vec<Assembled>,
}

fn header(frame: &str, ms: i64) -> Header {
    Header {
        stamp: Stamp::from_nanos(ms * MS),
        frame_id: Arc::from(frame),
    }
}

fn at(x: f64) -> RigidTransform {
    RigidTransform::try_from_quaternion([0.0, 0.0, 0.0, 1.0], [x, 0.0, 0.0]).unwrap()
}

fn camera(width: u32) -> CameraModel {
    let intrinsics = [f64::from(width), f64::from(width), 1.5, 1.5];
    CameraModel::ideal(PinholeCamera::new(intrinsics, width, 4).unwrap())
}

fn color() -> EncodedColor {
    let bytes = vec![100u8; 4 * 4];
    EncodedColor::from_raw(ColorEncoding::Mono8, 4, 4, 4, bytes.into()).unwrap()
}

fn depth() -> EncodedDepth {
    let encoding = DepthEncoding::U16Mm { big_endian: false };
    EncodedDepth::from_raw(encoding, 4, 4, 8, vec![1u8; 32].into()).unwrap()
}

fn triangle() -> TriMesh {
    let positions = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(Point3::from);
    TriMesh::from_soup(positions.to_vec(), vec![[0, 1, 2]])
        .unwrap()
        .0
}

fn edge(parent: &str, child: &str, ms: i64, x: f64) -> StampedTransform {
    StampedTransform {
        header: header(parent, ms),
        child_frame_id: Arc::from(child),
        parent_from_child: at(x),
    }
}

impl Stream {
    fn new(params: &IngestParams) -> Self {
        Self {
            assembler: Assembler::new(params, &TOPICS.map(str::to_owned)),
            out: Vec::new(),
        }
    }

    fn push(&mut self, ms: i64, topic: &str, event: Event) -> &mut Self {
        let topic = TOPICS.iter().position(|name| *name == topic).unwrap();
        let event = TimedEvent {
            received: Stamp::from_nanos(ms * MS),
            topic,
            event: Ok(event),
        };
        self.assembler.push(event, &mut self.out);
        self
    }

    fn color(&mut self, ms: i64) -> &mut Self {
        self.push(ms, "color", Event::Color(header("cam", ms), color()))
    }

    fn depth(&mut self, ms: i64, frame: &str) -> &mut Self {
        self.push(ms, "depth", Event::Depth(header(frame, ms), depth()))
    }

    fn infos(&mut self, ms: i64) -> &mut Self {
        let info = camera(4);
        self.push(ms, "color_info", Event::ColorInfo(header("cam", ms), info));
        self.push(ms, "depth_info", Event::DepthInfo(header("cam", ms), info))
    }

    fn tf(&mut self, parent: &str, child: &str, ms: i64, x: f64) -> &mut Self {
        let transforms = vec![edge(parent, child, ms, x)];
        self.push(ms, "tf", Event::Transforms(transforms))
    }

    fn tf_static(&mut self, parent: &str, child: &str, x: f64) -> &mut Self {
        let transforms = vec![edge(parent, child, 0, x)];
        self.push(0, "tf_static", Event::StaticTransforms(transforms))
    }

    fn mesh(&mut self, frame: &str, ms: i64) -> &mut Self {
        let update = MeshUpdate::Whole(triangle());
        let event = Event::Mesh(header(frame, ms), update, SoupReport::default());
        self.push(ms, "mesh", event)
    }

    /// Stamp in milliseconds, x of the pose, x of depth_from_color where there is depth.
    fn frames(&self) -> Vec<(i64, f64, Option<f64>)> {
        self.out
            .iter()
            .filter_map(|out| match out {
                Assembled::Frame(frame) => Some((
                    frame.stamp.as_nanos() / MS,
                    frame.world_from_camera.translation().x,
                    frame
                        .depth
                        .as_ref()
                        .map(|d| d.depth_from_color.translation().x),
                )),
                Assembled::Mesh(_) | Assembled::Corrections(_) => None,
            })
            .collect()
    }

    fn correct(&mut self, frame: &str, body: CorrectedBody, poses: &[(i64, f64)]) -> &mut Self {
        let corrections = poses.iter().map(|&(ms, x)| PoseCorrection {
            stamp: Stamp::from_nanos(ms * MS),
            pose: at(x),
        });
        let event = Event::Corrections(header(frame, 0), body, corrections.collect());
        self.push(0, "corrections", event)
    }

    /// Stamp in milliseconds and x of every correction that was given out.
    fn corrections(&self) -> Vec<(i64, f64)> {
        let given = self.out.iter().filter_map(|out| match out {
            Assembled::Corrections(corrections) => Some(corrections),
            _ => None,
        });
        let pair = |c: &PoseCorrection| (c.stamp.as_nanos() / MS, c.pose.translation().x);
        given.flatten().map(pair).collect()
    }

    fn finish(&mut self) -> &IngestReport {
        self.assembler.finish(&mut self.out);
        assert_eq!(self.assembler.num_pending(), 0);
        let report = self.assembler.report();
        for (name, topic) in &report.topics {
            let sum = topic.num_used + topic.num_refused();
            assert_eq!(topic.num_received, sum, "{name}: {topic:?}");
        }
        report
    }

    fn refused(&self, topic: &str) -> Vec<&str> {
        let topic = &self.assembler.report().topics[topic];
        topic.refused_by_reason.keys().map(String::as_str).collect()
    }
}

#[test]
fn frames_wait_for_their_transform_and_leave_interpolated() {
    let mut stream = Stream::new(&IngestParams::default());
    stream.mesh("map", 0).tf("map", "cam", 0, 0.0);
    stream.infos(33).color(33).depth(33, "cam");
    assert_eq!(stream.frames(), []);
    stream.tf("map", "cam", 66, 6.6);
    assert_eq!(stream.frames().len(), 1);
    let (stamp, x, depth_x) = stream.frames()[0];
    assert!(stamp == 33 && (x - 3.3).abs() < 1e-12 && depth_x == Some(0.0));
    let report = stream.finish();
    assert_eq!((report.num_frames, report.sync.num_pairs), (1, 1));
    assert_eq!(report.world_frame.as_deref(), Some("map"));
    assert_eq!(report.pose_source, Some("tf"));
}

#[test]
fn a_frame_without_transform_is_refused_after_its_wait_and_holds_up_no_other() {
    let mut stream = Stream::new(&IngestParams::default());
    stream.mesh("map", 0).infos(0);
    stream.color(0).depth(0, "cam");
    for ms in (1_900..=2_200).step_by(100) {
        stream.tf("map", "cam", ms, 1.0);
    }
    stream.infos(2_000).color(2_000).depth(2_000, "cam");
    assert_eq!(stream.frames(), [(2_000, 1.0, Some(0.0))]);
    stream.finish();
    assert_eq!(
        stream.refused("color"),
        ["no pose: before the first transform"]
    );
    assert_eq!(
        stream.refused("depth"),
        ["no pose: before the first transform"]
    );
}

#[test]
fn depth_taken_later_carries_the_motion_between() {
    let mut stream = Stream::new(&IngestParams::default());
    stream.mesh("map", 0).tf_static("cam", "depth_cam", 0.05);
    for ms in (0..200).step_by(20) {
        stream.tf("map", "cam", ms, ms as f64 * 0.001);
    }
    let info = camera(4);
    stream.push(0, "color_info", Event::ColorInfo(header("cam", 0), info));
    stream.push(
        0,
        "depth_info",
        Event::DepthInfo(header("depth_cam", 0), info),
    );
    stream.color(100).depth(110, "depth_cam");
    stream.finish();
    let frames = stream.frames();
    // In 10 ms the camera moved 0.01 m on; the depth camera sits 0.05 m further.
    let expected = -0.05 - 0.01;
    assert!((frames[0].2.unwrap() - expected).abs() < 1e-9, "{frames:?}");
}

#[test]
fn pose_topic_and_odometry_give_poses_too() {
    for source in [PoseSource::Auto, PoseSource::Pose] {
        let mut stream = Stream::new(&IngestParams {
            pose_source: source,
            ..IngestParams::default()
        });
        stream.push(0, "pose", Event::Pose(header("map", 0), at(1.0)));
        stream.infos(50).color(50).depth(50, "cam");
        stream.push(100, "pose", Event::Pose(header("map", 100), at(2.0)));
        let report = stream.finish();
        assert_eq!(report.pose_source, Some("pose"));
        assert_eq!(report.world_frame.as_deref(), Some("map"));
        assert_eq!(stream.frames(), [(50, 1.5, Some(0.0))]);
    }
    let mut stream = Stream::new(&IngestParams {
        pose_source: PoseSource::Odom,
        ..IngestParams::default()
    });
    stream.tf_static("base", "cam", 0.25);
    stream.tf_static("map", "odom", 10.0).mesh("map", 0);
    let odometry = |ms, x| Event::Odometry(edge("odom", "base", ms, x));
    stream.push(0, "odom", odometry(0, 1.0));
    stream.push(100, "odom", odometry(100, 2.0));
    stream.infos(50).color(50).depth(50, "cam");
    stream.finish();
    assert_eq!(stream.frames(), [(50, 11.75, Some(0.0))]);
}

#[test]
fn without_a_mesh_the_world_is_the_root_above_the_camera() {
    let mut stream = Stream::new(&IngestParams::default());
    stream.tf_static("odom", "base", 1.0);
    for ms in [0, 500, 1_000, 1_500] {
        stream.tf("map", "odom", ms, 5.0).tf("base", "cam", ms, 0.5);
        stream.infos(ms).color(ms).depth(ms, "cam");
    }
    // The mesh comes late and in another frame, so it is moved to the world.
    stream.mesh("odom", 1_500);
    let report = stream.finish();
    assert_eq!(report.world_frame.as_deref(), Some("map"));
    assert_eq!(stream.frames().len(), 4);
    assert_eq!(stream.frames()[0].1, 6.5);
    let mesh = stream.out.iter().find_map(|out| match out {
        Assembled::Mesh(mesh) => Some(mesh.clone()),
        _ => None,
    });
    assert_eq!(mesh.unwrap().positions_m()[0].x, 5.0);
}

#[test]
fn colour_alone_serves_when_there_is_no_depth() {
    let mut stream = Stream::new(&IngestParams::default());
    stream.mesh("map", 0).tf_static("map", "cam", 1.0);
    for i in 0..30 {
        stream.infos(i * 33).color(i * 33);
    }
    stream.finish();
    assert_eq!(stream.frames().len(), 30);
    assert_eq!(stream.assembler.report().sync.num_without_depth, 30);
}

#[test]
fn what_is_missing_is_named() {
    // No camera info.
    let mut stream = Stream::new(&IngestParams::default());
    stream.tf_static("map", "cam", 1.0).color(0);
    stream.finish();
    assert_eq!(stream.refused("color"), ["no camera info"]);
    // Camera info of another size.
    let mut stream = Stream::new(&IngestParams::default());
    let info = Event::ColorInfo(header("cam", 0), camera(8));
    stream
        .tf_static("map", "cam", 1.0)
        .push(0, "color_info", info);
    stream.color(0).finish();
    assert_eq!(
        stream.refused("color"),
        ["image is #x# but its camera info is for #x#"]
    );
    // No pose at all.
    let mut stream = Stream::new(&IngestParams::default());
    stream.mesh("map", 0).infos(0).color(0).depth(0, "cam");
    stream.finish();
    assert_eq!(stream.refused("color"), ["no pose: frame unknown"]);
    // Depth that cannot be placed costs only itself.
    let mut stream = Stream::new(&IngestParams::default());
    stream.mesh("map", 0).tf_static("map", "cam", 1.0);
    stream.infos(0).color(0).depth(0, "elsewhere").finish();
    assert_eq!(stream.frames(), [(0, 1.0, None)]);
    assert_eq!(stream.refused("depth"), ["no pose: frame unknown"]);
    // A mesh in a frame of its own.
    let mut stream = Stream::new(&IngestParams {
        map_frame_id: Some("map".to_owned()),
        ..IngestParams::default()
    });
    stream
        .tf_static("map", "cam", 1.0)
        .mesh("island", 0)
        .finish();
    assert_eq!(stream.refused("mesh"), ["no pose: frame unknown"]);
}

#[test]
fn rejected_messages_are_counted_by_reason_and_the_stream_goes_on() {
    let mut stream = Stream::new(&IngestParams::default());
    for i in 0..5 {
        let rejection = Rejection {
            topic: "pose".to_owned(),
            stamp: Stamp::from_nanos(i),
            reason: format!("quaternion has norm 0.{i}"),
        };
        let event = TimedEvent {
            received: Stamp::from_nanos(i),
            topic: 6,
            event: Err(rejection),
        };
        stream.assembler.push(event, &mut stream.out);
    }
    let report = stream.finish();
    let count = &report.topics["pose"].refused_by_reason["quaternion has norm #"];
    assert_eq!((count.num, count.examples.len()), (5, 3));
    assert!(count.examples[2].contains("0.2"), "{count:?}");
}

#[test]
fn a_loop_of_the_recording_starts_over() {
    let mut stream = Stream::new(&IngestParams::default());
    stream.mesh("map", 0);
    for (lap, x) in [(0, 1.0), (1, 2.0)] {
        for i in 0..30 {
            let ms = 10_000 + i * 100;
            stream.tf("map", "cam", ms, x);
            stream.infos(ms).color(ms).depth(ms, "cam");
        }
        assert!(stream.frames().len() > 25 * (lap + 1));
    }
    let report = stream.finish();
    assert_eq!(report.sync.num_clock_set_back, 1);
    let frames = stream.frames();
    let second: Vec<_> = frames[30..].iter().map(|f| f.1).collect();
    assert!(second.iter().all(|&x| x == 2.0), "{second:?}");
}

/// Transforms do not tell of it themselves here: none comes until the clock has come far again.
#[test]
fn a_clock_set_back_leaves_no_transform_and_no_frame_from_before() {
    let mut stream = Stream::new(&IngestParams::default());
    stream.mesh("map", 0);
    let pair = |stream: &mut Stream, ms| {
        stream.infos(ms).color(ms).depth(ms, "cam");
    };
    for ms in (10_000..13_000).step_by(100) {
        stream.tf("map", "cam", ms, 1.0);
        pair(&mut stream, ms);
    }
    // Waits for its transform when the clock is set back.
    for ms in [13_100, 1_000, 1_100, 1_200] {
        pair(&mut stream, ms);
    }
    assert_eq!(stream.assembler.report().sync.num_clock_set_back, 1);
    let num_before = stream.frames().len();
    for ms in [10_500, 10_600, 10_700] {
        pair(&mut stream, ms);
    }
    stream
        .tf("map", "cam", 10_400, 2.0)
        .tf("map", "cam", 10_700, 2.0);
    stream.finish();
    let frames = stream.frames();
    let later: Vec<_> = frames[num_before..].iter().map(|f| (f.0, f.1)).collect();
    assert_eq!(later, [(10_500, 2.0), (10_600, 2.0), (10_700, 2.0)]);
    let refused = &stream.assembler.report().topics["color"].refused_by_reason;
    let before = &refused["clock was set back"].examples;
    assert_eq!(*before, ["13.100000000: clock was set back"]);
    assert_eq!((num_before, refused["no pose: frame unknown"].num), (30, 2));
}

#[test]
fn a_whole_mesh_leaves_no_block() {
    let mut stream = Stream::new(&IngestParams::default());
    let blocks = || MeshUpdate::Blocks {
        clear: false,
        blocks: [3, 5]
            .map(|key| (super::super::event::MeshBlockKey([key, 0, 0]), triangle()))
            .to_vec(),
    };
    let event = Event::Mesh(header("map", 1), blocks(), SoupReport::default());
    stream.push(1, "mesh", event);
    assert_eq!(stream.assembler.mesh_blocks().spans().len(), 2);
    stream.mesh("map", 2);
    assert!(stream.assembler.mesh_blocks().is_whole());
    let event = Event::Mesh(header("map", 3), blocks(), SoupReport::default());
    stream.push(3, "mesh", event);
    assert_eq!(stream.assembler.mesh_blocks().spans().len(), 2);
}

#[test]
fn growing_meshes_are_given_out_whole() {
    let mut stream = Stream::new(&IngestParams::default());
    for key in 0..3 {
        let update = MeshUpdate::Blocks {
            clear: false,
            blocks: vec![(super::super::event::MeshBlockKey([key, 0, 0]), triangle())],
        };
        let event = Event::Mesh(header("map", key), update, SoupReport::default());
        stream.push(key, "mesh", event);
    }
    let sizes: Vec<_> = stream
        .out
        .iter()
        .map(|out| match out {
            Assembled::Mesh(mesh) => mesh.num_triangles(),
            _ => 0,
        })
        .collect();
    assert_eq!(sizes, [1, 2, 3]);
}

#[test]
fn corrections_are_given_out_in_the_world_and_for_the_camera() {
    let mut stream = Stream::new(&IngestParams {
        pose_frame_id: Some("base".to_owned()),
        ..IngestParams::default()
    });
    stream.mesh("map", 0).infos(0).color(0);
    stream
        .tf_static("map", "loops", 10.0)
        .tf_static("base", "cam", 0.5);
    stream.correct("map", CorrectedBody::Camera, &[(5, 1.0), (9, 2.0)]);
    stream.correct("loops", CorrectedBody::Camera, &[(6, 1.0)]);
    stream.correct("loops", CorrectedBody::PoseFrame, &[(7, 1.0)]);
    assert_eq!(
        stream.corrections(),
        [(5, 1.0), (9, 2.0), (6, 11.0), (7, 11.5)]
    );
    stream.correct("nowhere", CorrectedBody::Camera, &[(8, 1.0)]);
    assert_eq!(stream.refused("corrections"), ["no pose: frame unknown"]);
    assert_eq!(stream.corrections().len(), 4);
    let report = &stream.assembler.report().topics["corrections"];
    assert_eq!((report.num_received, report.num_used), (4, 3));
}

#[test]
fn what_is_larger_than_it_may_be_is_refused_and_the_rest_goes_on() {
    let mut params = IngestParams::default();
    params.limits.image_px = 15;
    params.limits.mesh_triangles = 1;
    params.limits.corrections = 1;
    let mut stream = Stream::new(&params);
    stream.mesh("map", 0).infos(0).color(0).depth(0, "cam");
    let blocks = (0..2).map(|key| (super::super::event::MeshBlockKey([key, 0, 0]), triangle()));
    let update = MeshUpdate::Blocks {
        clear: false,
        blocks: blocks.collect(),
    };
    let event = Event::Mesh(header("map", 1), update, SoupReport::default());
    stream.push(1, "mesh", event);
    stream.correct("map", CorrectedBody::Camera, &[(5, 1.0), (9, 2.0)]);
    assert_eq!(
        stream.refused("color"),
        ["image of #x# pixels, limits.image_px is #"]
    );
    assert_eq!(stream.refused("depth").len(), 1);
    assert_eq!(
        stream.refused("mesh"),
        ["the mesh would have # triangles, limits.mesh_triangles is #"]
    );
    assert_eq!(
        stream.refused("corrections"),
        ["corrections of # poses, limits.corrections is #"]
    );
    let meshes = stream
        .out
        .iter()
        .filter(|out| matches!(out, Assembled::Mesh(_)));
    assert_eq!(meshes.count(), 1);
    stream.finish();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_stream_adds_up(
        steps in prop::collection::vec((0u8..10, -200i64..400, 0u8..4), 0..150),
        approx_sync in any::<bool>(),
        pose_queue_size in 0usize..5,
    ) {
        let frame_names = ["map", "cam", "odom", ""];
        let mut stream = Stream::new(&IngestParams {
            approx_sync,
            pose_queue_size,
            ..IngestParams::default()
        });
        let mut now = 0;
        for (kind, step, name) in steps {
            now += step;
            let name = frame_names[usize::from(name)];
            match kind {
                0 => stream.push(now, "color", Event::Color(header(name, now), color())),
                1 => stream.depth(now, name),
                2 => stream.infos(now),
                3 => stream.tf("map", name, now, 1.0),
                4 => stream.tf(name, "cam", now, 1.0),
                5 => stream.tf_static("odom", name, 1.0),
                6 => stream.push(now, "pose", Event::Pose(header(name, now), at(1.0))),
                7 => stream.push(now, "odom", Event::Odometry(edge("odom", name, now, 0.0))),
                8 => stream.correct(name, CorrectedBody::PoseFrame, &[(now, 1.0)]),
                _ => stream.mesh(name, now),
            };
            let report = stream.assembler.report();
            let num_open: u64 = report
                .topics
                .values()
                .map(|t| t.num_received - t.num_used - t.num_refused())
                .sum();
            prop_assert_eq!(num_open, stream.assembler.num_pending() as u64);
        }
        stream.finish();
    }
}
