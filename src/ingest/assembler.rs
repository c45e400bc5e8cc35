//! Turns the stream of events into posed frames and meshes in one world frame: a state machine
//! without I/O, whose only clock is the stream's.
//!
//! An image goes three steps, in order: it gets its intrinsics, it is paired with its depth image,
//! and it gets the camera's pose at its stamp. In the last step a frame waits for transforms for
//! `wait_for_transform_s` of stream time; frames leave in the order of their stamps, so that a
//! later one waits with it. Meshes wait in the same way for the transform to the world frame.
//!
//! Each message that is pushed is counted as used or refused in the end, see [`IngestReport`].

use std::collections::VecDeque;
use std::sync::Arc;

use super::clock::nanos_from_seconds;
use super::event::{Event, Header, MeshUpdate, StampedTransform};
use super::info_match::{InfoMatcher, Matched};
use super::mesh_buffer::MeshBuffer;
use super::params::IngestParams;
use super::pose_buffer::{LookupError, TransformRefusal, normalized_frame};
use super::pose_lookup::{Attempt, DepthPose, DepthStamps, PoseLookup};
use super::report::{IngestReport, reason_class};
use super::source::TimedEvent;
use super::sync::{Stamped, SyncDrop, SyncOutput, SyncParams, SyncStream, Synchronizer};
use crate::geom::{
    CameraModel, EncodedColor, EncodedDepth, FrameDepth, PosedFrame, RigidTransform, Stamp,
};
use crate::mesh::{SoupReport, TriMesh};

/// Mesh updates that may wait for a transform; the oldest must then do with what is known.
const MESH_QUEUE_SIZE: usize = 64;

/// What leaves the assembler.
#[derive(Clone, Debug, PartialEq)]
pub enum Assembled {
    /// A frame at a known pose.
    Frame(PosedFrame),
    /// The mesh as it now is, all of it, in the world frame.
    Mesh(Arc<TriMesh>),
}

#[derive(Debug)]
enum Pixels {
    Color(EncodedColor),
    Depth(EncodedDepth),
}

#[derive(Debug)]
struct Image {
    topic: usize,
    frame_id: Arc<str>,
    pixels: Pixels,
    camera: Option<CameraModel>,
}

#[derive(Debug)]
struct WaitingFrame {
    since: Stamp,
    color: Stamped<Image>,
    depth: Option<Stamped<Image>>,
}

#[derive(Debug)]
struct WaitingMesh {
    since: Stamp,
    topic: usize,
    header: Header,
    update: MeshUpdate,
}

/// Why a frame does not leave now.
enum NotYet {
    Wait,
    Refuse { class: String, text: String },
}

/// The ingest stage.
#[derive(Debug)]
pub struct Assembler {
    topics: Vec<String>,
    wait_ns: u64,
    max_extrapolation_s: f64,
    jump_back_ns: u64,
    pose_queue_size: usize,
    camera_frame: Option<Arc<str>>,
    color_infos: InfoMatcher<Image>,
    depth_infos: InfoMatcher<Image>,
    sync: Synchronizer<Image>,
    poses: PoseLookup,
    frames: VecDeque<WaitingFrame>,
    meshes: VecDeque<WaitingMesh>,
    mesh: MeshBuffer,
    now: Stamp,
    report: IngestReport,
}

impl Assembler {
    /// An assembler for a stream whose events refer to these topics.
    pub fn new(params: &IngestParams, topics: &[String]) -> Self {
        let poses = PoseLookup::new(params);
        let mut report = IngestReport {
            world_frame: poses.world().map(ToString::to_string),
            pose_source: poses.source_name(),
            ..IngestReport::default()
        };
        for topic in topics {
            report.topic(topic);
        }
        Self {
            topics: topics.to_vec(),
            wait_ns: nanos_from_seconds(params.wait_for_transform_s),
            max_extrapolation_s: params.max_extrapolation_s,
            jump_back_ns: nanos_from_seconds(params.clock_jump_back_s),
            pose_queue_size: params.pose_queue_size.max(1),
            camera_frame: params
                .camera_frame_id
                .as_deref()
                .map(|name| Arc::from(normalized_frame(name))),
            color_infos: InfoMatcher::new(params.sync_queue_size),
            depth_infos: InfoMatcher::new(params.sync_queue_size),
            sync: Synchronizer::new(&SyncParams {
                max_interval_s: if params.approx_sync {
                    params.approx_sync_max_interval_s
                } else {
                    0.0
                },
                queue_size: params.sync_queue_size,
                clock_jump_back_s: params.clock_jump_back_s,
            }),
            poses,
            frames: VecDeque::new(),
            meshes: VecDeque::new(),
            mesh: MeshBuffer::default(),
            now: Stamp::default(),
            report,
        }
    }

    /// The counts so far.
    pub fn report(&self) -> &IngestReport {
        &self.report
    }

    /// Images and meshes that still wait for something.
    pub fn num_pending(&self) -> usize {
        let num_frame_images: usize = self
            .frames
            .iter()
            .map(|frame| 1 + usize::from(frame.depth.is_some()))
            .sum();
        self.color_infos.num_pending()
            + self.depth_infos.num_pending()
            + self.sync.num_pending()
            + num_frame_images
            + self.meshes.len()
    }

    /// Takes the next event; what became complete by it is appended to `out`.
    pub fn push(&mut self, event: TimedEvent, out: &mut Vec<Assembled>) {
        self.now = event.received;
        let topic = event.topic;
        self.topic_report(topic).num_received += 1;
        match event.event {
            Ok(event) => self.take(topic, event),
            Err(rejection) => {
                let class = reason_class(&rejection.reason);
                self.topic_report(topic)
                    .refuse(&class, rejection.stamp, &rejection.reason);
            }
        }
        self.give_out(false, out);
    }

    /// Ends the stream: whatever still waits leaves or is refused.
    pub fn finish(&mut self, out: &mut Vec<Assembled>) {
        let mut matched = Vec::new();
        self.color_infos.flush(&mut matched);
        self.depth_infos.flush(&mut matched);
        self.synchronize(matched);
        let mut synced = Vec::new();
        self.sync.finish(&mut synced);
        self.take_synced(synced, self.now);
        self.give_out(true, out);
    }

    fn take(&mut self, topic: usize, event: Event) {
        match event {
            Event::Color(header, color) => {
                self.take_image(topic, header, Pixels::Color(color));
            }
            Event::Depth(header, depth) => {
                self.take_image(topic, header, Pixels::Depth(depth));
            }
            Event::ColorInfo(header, camera) => {
                self.topic_report(topic).num_used += 1;
                let mut matched = Vec::new();
                self.color_infos
                    .push_info(header.stamp, camera, &mut matched);
                self.synchronize(matched);
            }
            Event::DepthInfo(header, camera) => {
                self.topic_report(topic).num_used += 1;
                let mut matched = Vec::new();
                self.depth_infos
                    .push_info(header.stamp, camera, &mut matched);
                self.synchronize(matched);
            }
            Event::Transforms(transforms) => self.take_transforms(topic, &transforms, false),
            Event::StaticTransforms(transforms) => self.take_transforms(topic, &transforms, true),
            Event::Pose(header, pose) => {
                let result = self.poses.pose.insert(&header, None, pose);
                self.count_pose(topic, &header, result);
            }
            Event::Odometry(StampedTransform {
                header,
                child_frame_id,
                parent_from_child,
            }) => {
                let odometry = &mut self.poses.odometry;
                let result = odometry.insert(&header, Some(&child_frame_id), parent_from_child);
                self.count_pose(topic, &header, result);
            }
            Event::Mesh(header, update, soup) => self.take_mesh(topic, header, update, soup),
        }
    }

    fn take_image(&mut self, topic: usize, header: Header, pixels: Pixels) {
        let is_color = matches!(pixels, Pixels::Color(_));
        let image = Stamped {
            stamp: header.stamp,
            payload: Image {
                topic,
                frame_id: Arc::from(normalized_frame(&header.frame_id)),
                pixels,
                camera: None,
            },
        };
        let infos = if is_color {
            &mut self.color_infos
        } else {
            &mut self.depth_infos
        };
        let mut matched = Vec::new();
        infos.push_image(image, &mut matched);
        self.synchronize(matched);
    }

    fn take_transforms(&mut self, topic: usize, transforms: &[StampedTransform], is_static: bool) {
        let mut last_refusal = None;
        let mut num_stored = 0u64;
        for transform in transforms {
            self.report.transforms.num_received += 1;
            match self.poses.tree.insert(transform, is_static) {
                Ok(()) => num_stored += 1,
                Err(refusal) => {
                    let stamp = transform.header.stamp;
                    let text = format!(
                        "'{}' in '{}'",
                        transform.child_frame_id, transform.header.frame_id
                    );
                    self.report
                        .transforms
                        .refuse(refusal.as_str(), stamp, &text);
                    last_refusal = Some((refusal, stamp, text));
                }
            }
        }
        self.report.transforms.num_used += num_stored;
        match last_refusal {
            Some((refusal, stamp, text)) if num_stored == 0 => {
                self.topic_report(topic)
                    .refuse(refusal.as_str(), stamp, &text);
            }
            _ => self.topic_report(topic).num_used += 1,
        }
    }

    fn count_pose(&mut self, topic: usize, header: &Header, result: Result<(), TransformRefusal>) {
        match result {
            Ok(()) => self.topic_report(topic).num_used += 1,
            Err(refusal) => {
                self.topic_report(topic)
                    .refuse(refusal.as_str(), header.stamp, refusal.as_str());
            }
        }
    }

    fn take_mesh(&mut self, topic: usize, header: Header, update: MeshUpdate, soup: SoupReport) {
        self.report.num_non_finite_vertices += soup.num_non_finite_vertices as u64;
        self.report.num_dropped_triangles += soup.num_dropped_triangles as u64;
        self.poses.settle_world(&header.frame_id);
        if header.frame_id.is_empty() {
            self.assume("a mesh without a frame name is in the world frame");
        }
        self.meshes.push_back(WaitingMesh {
            since: self.now,
            topic,
            header,
            update,
        });
    }

    /// Second step: images whose intrinsics are settled are paired.
    fn synchronize(&mut self, matched: Vec<Matched<Image>>) {
        for matched in matched {
            let image = match matched {
                Matched::Known {
                    mut image,
                    camera,
                    is_exact,
                } => {
                    self.report.sync.num_info_of_other_stamp += u64::from(!is_exact);
                    image.payload.camera = Some(camera);
                    image
                }
                Matched::Unknown(image) => image,
            };
            let stream = match image.payload.pixels {
                Pixels::Color(_) => SyncStream::Color,
                Pixels::Depth(_) => SyncStream::Depth,
            };
            if stream == SyncStream::Color
                && let Some(reason) = unusable_camera(&image.payload)
            {
                self.topic_report(image.payload.topic).refuse(
                    &reason_class(&reason),
                    image.stamp,
                    &reason,
                );
                continue;
            }
            let stamp = image.stamp;
            let mut synced = Vec::new();
            self.sync.push(stream, image, &mut synced);
            self.take_synced(synced, stamp);
        }
    }

    fn take_synced(&mut self, synced: Vec<SyncOutput<Image>>, newest: Stamp) {
        for output in synced {
            match output {
                SyncOutput::Frame { color, depth } => {
                    match &depth {
                        Some(depth) => {
                            let interval_s = color.stamp.seconds_since(depth.stamp).abs();
                            self.report.count_pair(interval_s);
                        }
                        None => self.report.sync.num_without_depth += 1,
                    }
                    self.frames.push_back(WaitingFrame {
                        since: self.now,
                        color,
                        depth,
                    });
                }
                SyncOutput::Dropped { image, reason, .. } => {
                    self.refuse_image(&image, reason.as_str(), reason.as_str());
                }
                SyncOutput::ClockSetBack => self.start_over(newest),
            }
        }
    }

    /// The clock was set back to `stamp`: what is of the time before it must not mix with what
    /// comes.
    fn start_over(&mut self, stamp: Stamp) {
        self.report.sync.num_clock_set_back += 1;
        for frame in std::mem::take(&mut self.frames) {
            let reason = SyncDrop::ClockSetBack.as_str();
            self.refuse_frame(&frame, reason, reason);
        }
        let jump_back_ns = i64::try_from(self.jump_back_ns).unwrap_or(i64::MAX);
        self.poses.forget_after(Stamp::from_nanos(
            stamp.as_nanos().saturating_add(jump_back_ns),
        ));
    }

    /// Third step: meshes and frames whose transforms are known leave.
    fn give_out(&mut self, is_end: bool, out: &mut Vec<Assembled>) {
        self.give_out_mesh(is_end, out);
        while let Some(frame) = self.frames.front() {
            let is_overdue = is_end
                || self.frames.len() > self.pose_queue_size
                || self.now.seconds_since(frame.since) * 1e9 >= self.wait_ns as f64;
            let Some(frame) = self.frames.pop_front() else {
                break;
            };
            match self.posed(&frame, is_overdue) {
                Ok(posed) => {
                    self.report.num_frames += 1;
                    self.topic_report(frame.color.payload.topic).num_used += 1;
                    out.push(Assembled::Frame(posed));
                }
                Err(NotYet::Wait) => {
                    self.frames.push_front(frame);
                    break;
                }
                Err(NotYet::Refuse { class, text }) => self.refuse_frame(&frame, &class, &text),
            }
        }
        self.report.world_frame = self.poses.world().map(ToString::to_string);
        self.report.pose_source = self.poses.source_name();
    }

    fn give_out_mesh(&mut self, is_end: bool, out: &mut Vec<Assembled>) {
        let mut has_changed = false;
        while let Some(mesh) = self.meshes.pop_front() {
            let is_overdue = is_end
                || self.meshes.len() >= MESH_QUEUE_SIZE
                || self.now.seconds_since(mesh.since) * 1e9 >= self.wait_ns as f64;
            let frame = normalized_frame(&mesh.header.frame_id).to_owned();
            match self.try_lookup(is_overdue, |poses, attempt| {
                poses.world_from_mesh(&frame, mesh.header.stamp, attempt)
            }) {
                Ok(world_from_mesh) => {
                    self.mesh.apply(mesh.update, &world_from_mesh);
                    self.topic_report(mesh.topic).num_used += 1;
                    has_changed = true;
                }
                Err(error) if !is_overdue && error.may_resolve() => {
                    self.meshes.push_front(mesh);
                    break;
                }
                Err(error) => {
                    let stamp = mesh.header.stamp;
                    self.topic_report(mesh.topic)
                        .refuse(error.class(), stamp, &error.to_string());
                }
            }
        }
        if has_changed {
            match self.mesh.assembled() {
                Ok(mesh) => out.push(Assembled::Mesh(mesh)),
                Err(error) => self.assume(&format!("the mesh is not given out: {error}")),
            }
        }
    }

    /// Looks up exactly first; with tolerance once nothing better will come.
    fn try_lookup<T>(
        &mut self,
        is_overdue: bool,
        mut lookup: impl FnMut(&mut PoseLookup, Attempt) -> Result<T, LookupError>,
    ) -> Result<T, LookupError> {
        match lookup(&mut self.poses, Attempt::MayWait) {
            Err(error) if is_overdue || !error.may_resolve() => {
                let last = Attempt::Last {
                    tolerance_s: self.max_extrapolation_s,
                };
                let result = lookup(&mut self.poses, last);
                self.report.num_poses_extrapolated +=
                    u64::from(result.is_ok() && error.is_outside());
                result
            }
            result => result,
        }
    }

    fn posed(&mut self, frame: &WaitingFrame, is_overdue: bool) -> Result<PosedFrame, NotYet> {
        let color = &frame.color;
        let camera_frame = self
            .camera_frame
            .clone()
            .unwrap_or_else(|| color.payload.frame_id.clone());
        let world_from_camera = self
            .try_lookup(is_overdue, |poses, attempt| {
                poses.world_from_camera(&camera_frame, color.stamp, attempt)
            })
            .map_err(|error| not_yet(is_overdue, &error))?;
        let Image {
            pixels: Pixels::Color(image),
            camera: Some(color_camera),
            ..
        } = &color.payload
        else {
            // Unreachable by construction: only colour images with intrinsics are synchronised.
            return Err(NotYet::Refuse {
                class: "no camera info".to_owned(),
                text: "no camera info".to_owned(),
            });
        };
        let depth = match &frame.depth {
            Some(depth) => {
                self.posed_depth(frame, depth, &camera_frame, &world_from_camera, is_overdue)?
            }
            None => None,
        };
        Ok(PosedFrame {
            stamp: color.stamp,
            world_from_camera,
            color: image.clone(),
            color_camera: *color_camera,
            depth,
        })
    }

    /// The depth half of a frame. A depth image that cannot be used is refused; the colour image
    /// goes on without it.
    fn posed_depth(
        &mut self,
        frame: &WaitingFrame,
        depth: &Stamped<Image>,
        camera_frame: &Arc<str>,
        world_from_camera: &RigidTransform,
        is_overdue: bool,
    ) -> Result<Option<FrameDepth>, NotYet> {
        let color = &frame.color;
        let stamps = DepthStamps {
            color_frame: &color.payload.frame_id,
            color: color.stamp,
            depth: depth.stamp,
        };
        let depth_frame = &depth.payload.frame_id;
        let pose = match self.try_lookup(is_overdue, |poses, attempt| {
            poses.depth_from_color(
                depth_frame,
                camera_frame,
                stamps,
                world_from_camera,
                attempt,
            )
        }) {
            Ok(pose) => pose,
            Err(error) if !is_overdue && error.may_resolve() => return Err(NotYet::Wait),
            Err(error) => {
                self.refuse_image(depth, error.class(), &error.to_string());
                return Ok(None);
            }
        };
        match self.depth_half(color, depth, pose) {
            Ok(half) => {
                self.topic_report(depth.payload.topic).num_used += 1;
                Ok(Some(half))
            }
            Err(reason) => {
                self.refuse_image(depth, &reason_class(&reason), &reason);
                Ok(None)
            }
        }
    }

    fn depth_half(
        &mut self,
        color: &Stamped<Image>,
        depth: &Stamped<Image>,
        pose: DepthPose,
    ) -> Result<FrameDepth, String> {
        let Pixels::Depth(image) = &depth.payload.pixels else {
            return Err("not a depth image".to_owned());
        };
        let camera = match (depth.payload.camera, color.payload.camera) {
            (Some(_), _) if let Some(reason) = unusable_camera(&depth.payload) => {
                return Err(reason);
            }
            (Some(camera), _) => camera,
            (None, Some(color_camera)) if depth.payload.frame_id == color.payload.frame_id => {
                self.assume(
                    "depth without camera info has the frame of the colour camera, so it is registered to it",
                );
                let pinhole = color_camera.pinhole.resized(image.width(), image.height());
                CameraModel {
                    pinhole: pinhole.map_err(|error| error.to_string())?,
                    ..color_camera
                }
            }
            (None, _) => return Err("no camera info".to_owned()),
        };
        self.report.sync.num_depth_at_color_pose += u64::from(!pose.has_motion);
        Ok(FrameDepth {
            image: image.clone(),
            camera,
            depth_from_color: pose.depth_from_color,
        })
    }

    fn refuse_frame(&mut self, frame: &WaitingFrame, class: &str, text: &str) {
        self.refuse_image(&frame.color, class, text);
        if let Some(depth) = &frame.depth {
            self.refuse_image(depth, class, text);
        }
    }

    fn refuse_image(&mut self, image: &Stamped<Image>, class: &str, text: &str) {
        self.topic_report(image.payload.topic)
            .refuse(class, image.stamp, text);
    }

    fn topic_report(&mut self, topic: usize) -> &mut super::report::TopicReport {
        let name = self.topics.get(topic).map_or("unnamed topic", |name| name);
        self.report.topic(name)
    }

    fn assume(&mut self, text: &str) {
        if !self.report.assumptions.contains(text) {
            self.report.assumptions.insert(text.to_owned());
        }
    }
}

fn not_yet(is_overdue: bool, error: &LookupError) -> NotYet {
    if !is_overdue && error.may_resolve() {
        return NotYet::Wait;
    }
    NotYet::Refuse {
        class: error.class().to_owned(),
        text: error.to_string(),
    }
}

/// Why an image's intrinsics cannot be used.
fn unusable_camera(image: &Image) -> Option<String> {
    let (width, height) = match &image.pixels {
        Pixels::Color(color) => (color.width(), color.height()),
        Pixels::Depth(depth) => (depth.width(), depth.height()),
    };
    let Some(camera) = image.camera else {
        return Some("no camera info".to_owned());
    };
    let pinhole = camera.pinhole;
    let is_same = (pinhole.width(), pinhole.height()) == (width, height);
    (!is_same).then(|| {
        format!(
            "image is {width}x{height} but its camera info is for {}x{}",
            pinhole.width(),
            pinhole.height()
        )
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use proptest::prelude::*;

    use super::*;
    use crate::geom::{ColorEncoding, DepthEncoding, PinholeCamera};
    use crate::ingest::params::PoseSource;
    use crate::ingest::source::Rejection;

    const MS: i64 = 1_000_000;
    const TOPICS: [&str; 9] = [
        "color",
        "depth",
        "color_info",
        "depth_info",
        "tf",
        "tf_static",
        "pose",
        "odom",
        "mesh",
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
                    Assembled::Mesh(_) => None,
                })
                .collect()
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
            Assembled::Frame(_) => None,
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
                Assembled::Frame(_) => 0,
            })
            .collect();
        assert_eq!(sizes, [1, 2, 3]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn any_stream_adds_up(
            steps in prop::collection::vec((0u8..9, -200i64..400, 0u8..4), 0..150),
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
}
