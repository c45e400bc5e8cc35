//! Turns the stream of events into posed frames and meshes in one world frame: a state machine
//! without I/O, whose only clock is the stream's.
//!
//! An image goes three steps, in order: it gets its intrinsics, it is paired with its depth image,
//! and it gets the camera's pose at its stamp. In the last step a frame waits for transforms for
//! `wait_for_transform_s` of stream time; frames leave in the order of their stamps, so that a
//! later one waits with it. Meshes wait in the same way for the transform to the world frame.
//!
//! Each message that is pushed is counted as used or refused in the end, see [`IngestReport`].

mod corrections;
mod waiting;

use std::collections::VecDeque;
use std::sync::Arc;

use super::clock::nanos_from_seconds;
use super::event::{Event, Header, MeshUpdate, PoseCorrection, StampedTransform};
use super::info_match::{InfoMatcher, Matched};
use super::mesh_blocks::{MeshBlocks, MeshBlocksError};
use super::mesh_buffer::MeshBuffer;
use super::params::{IngestLimits, IngestParams};
use super::pose_buffer::{LookupError, TransformRefusal, normalized_frame};
use super::pose_lookup::{Attempt, DepthPose, DepthStamps, PoseLookup};
use super::report::{IngestReport, reason_class};
use super::source::TimedEvent;
use super::sync::{Stamped, SyncDrop, SyncOutput, SyncParams, SyncStream, Synchronizer};
use crate::geom::{CameraModel, FrameDepth, PosedFrame, RigidTransform, Stamp};
use crate::mesh::{SoupReport, TriMesh};
use waiting::{Image, NotYet, Pixels, WaitingFrame, WaitingMesh, not_yet, unusable_camera};

/// Mesh updates that may wait for a transform; the oldest must then do with what is known.
const MESH_QUEUE_SIZE: usize = 64;

/// What leaves the assembler.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "frames are the common case, and are moved on at once"
)]
pub enum Assembled {
    /// A frame at a known pose.
    Frame(PosedFrame),
    /// The mesh as it now is, all of it, in the world frame.
    Mesh(Arc<TriMesh>),
    /// Better poses of frames that were given out before, in the world frame.
    Corrections(Vec<PoseCorrection>),
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
    /// The frame of the last colour image.
    seen_camera_frame: Option<Arc<str>>,
    color_infos: InfoMatcher<Image>,
    depth_infos: InfoMatcher<Image>,
    sync: Synchronizer<Image>,
    poses: PoseLookup,
    frames: VecDeque<WaitingFrame>,
    meshes: VecDeque<WaitingMesh>,
    mesh: MeshBuffer,
    /// Of the mesh that was given out last.
    mesh_blocks: Arc<MeshBlocks>,
    corrections: Vec<PoseCorrection>,
    limits: IngestLimits,
    now: Stamp,
    report: IngestReport,
}

impl Assembler {
    /// An assembler for a stream whose events refer to these topics.
    pub fn new(params: &IngestParams, topics: &[String]) -> Self {
        let poses = PoseLookup::new(params);
        let mut report = IngestReport::new(params.limits.report);
        report.world_frame = poses.world().map(ToString::to_string);
        report.pose_source = poses.source_name();
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
            seen_camera_frame: None,
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
            mesh_blocks: Arc::default(),
            corrections: Vec::new(),
            limits: params.limits,
            now: Stamp::default(),
            report,
        }
    }

    /// The counts so far.
    pub fn report(&self) -> &IngestReport {
        &self.report
    }

    /// The blocks of the mesh that was given out last.
    pub fn mesh_blocks(&self) -> &Arc<MeshBlocks> {
        &self.mesh_blocks
    }

    /// Goes on with a mesh in the world frame that an earlier run gave out: blocks that come replace
    /// its blocks.
    ///
    /// # Errors
    /// [`MeshBlocksError`] where `blocks` are those of another mesh.
    pub fn resume_mesh(
        &mut self,
        mesh: Arc<TriMesh>,
        blocks: Arc<MeshBlocks>,
    ) -> Result<(), MeshBlocksError> {
        self.mesh = MeshBuffer::resumed(mesh, &blocks)?;
        self.mesh_blocks = blocks;
        Ok(())
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
            Event::Corrections(header, body, corrections) => {
                self.take_corrections(topic, &header, body, &corrections);
            }
        }
    }

    fn take_image(&mut self, topic: usize, header: Header, pixels: Pixels) {
        if let Err(reason) = pixels.check(self.limits.image_px) {
            self.topic_report(topic)
                .refuse(&reason_class(&reason), header.stamp, &reason);
            return;
        }
        let is_color = matches!(pixels, Pixels::Color(_));
        if is_color {
            self.seen_camera_frame = Some(Arc::from(normalized_frame(&header.frame_id)));
        }
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
        if !self.corrections.is_empty() {
            out.push(Assembled::Corrections(std::mem::take(
                &mut self.corrections,
            )));
        }
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
                Ok(world_from_mesh) => has_changed |= self.apply_mesh(mesh, &world_from_mesh),
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
                Ok((mesh, blocks)) => {
                    self.mesh_blocks = Arc::new(blocks);
                    out.push(Assembled::Mesh(mesh));
                }
                Err(error) => self.assume(&format!("the mesh is not given out: {error}")),
            }
        }
    }

    /// Whether the mesh changed.
    fn apply_mesh(&mut self, mesh: WaitingMesh, world_from_mesh: &RigidTransform) -> bool {
        if let Err(error) = self.mesh.check(&mesh.update, &self.limits) {
            let (stamp, words) = (mesh.header.stamp, error.to_string());
            self.topic_report(mesh.topic)
                .refuse(&reason_class(&words), stamp, &words);
            return false;
        }
        self.mesh.apply(mesh.update, world_from_mesh);
        self.topic_report(mesh.topic).num_used += 1;
        true
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

#[cfg(test)]
mod tests;
