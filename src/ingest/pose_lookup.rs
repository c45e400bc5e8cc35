//! The camera's pose in the world at a stamp, from whichever source gives it.

use std::sync::Arc;

use super::event::CorrectedBody;
use super::params::{IngestParams, PoseSource};
use super::pose_buffer::{LookupError, PoseTrack, TransformTree};
use crate::geom::{RigidTransform, Stamp};

/// Sources in the order in which [`PoseSource::Auto`] tries them.
const SOURCES: [PoseSource; 3] = [PoseSource::Tf, PoseSource::Pose, PoseSource::Odom];

/// All transforms and poses of the stream, and the frames that are looked up in them.
#[derive(Debug)]
pub(super) struct PoseLookup {
    pub(super) tree: TransformTree,
    pub(super) pose: PoseTrack,
    pub(super) odometry: PoseTrack,
    /// Never [`PoseSource::Auto`].
    source: Option<PoseSource>,
    world: Option<Arc<str>>,
    pose_frame: Option<Arc<str>>,
}

/// How much a lookup may still hope for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Attempt {
    /// More transforms may come.
    MayWait,
    /// Nothing better will come; stamps may lie outside the transforms by the tolerance, seconds.
    Last { tolerance_s: f64 },
}

impl Attempt {
    pub(super) fn tolerance_s(self) -> f64 {
        match self {
            Self::MayWait => 0.0,
            Self::Last { tolerance_s } => tolerance_s,
        }
    }

    fn is_last(self) -> bool {
        matches!(self, Self::Last { .. })
    }
}

impl PoseLookup {
    pub(super) fn new(params: &IngestParams) -> Self {
        let frame = |name: &Option<String>| {
            name.as_deref()
                .map(super::pose_buffer::normalized_frame)
                .filter(|name| !name.is_empty())
                .map(Arc::from)
        };
        Self {
            tree: TransformTree::new(params),
            pose: PoseTrack::new(params),
            odometry: PoseTrack::new(params),
            source: Some(params.pose_source).filter(|&source| source != PoseSource::Auto),
            world: frame(&params.map_frame_id),
            pose_frame: frame(&params.pose_frame_id),
        }
    }

    pub(super) fn world(&self) -> Option<&Arc<str>> {
        self.world.as_ref()
    }

    /// The world frame becomes `frame` unless it is settled already or `frame` has no name.
    pub(super) fn settle_world(&mut self, frame: &str) {
        let frame = super::pose_buffer::normalized_frame(frame);
        if self.world.is_none() && !frame.is_empty() {
            self.world = Some(Arc::from(frame));
        }
    }

    pub(super) fn source_name(&self) -> Option<&'static str> {
        match self.source? {
            PoseSource::Auto => None,
            PoseSource::Tf => Some("tf"),
            PoseSource::Pose => Some("pose"),
            PoseSource::Odom => Some("odom"),
        }
    }

    pub(super) fn forget_after(&mut self, stamp: Stamp) {
        self.tree.forget_after(stamp);
        self.pose.forget_after(stamp);
        self.odometry.forget_after(stamp);
    }

    /// The camera's pose. The last attempt settles the source and the world frame if the stream
    /// has not.
    pub(super) fn world_from_camera(
        &mut self,
        camera: &str,
        stamp: Stamp,
        attempt: Attempt,
    ) -> Result<RigidTransform, LookupError> {
        if let Some(source) = self.source {
            return self.pose_by(source, camera, stamp, attempt);
        }
        let mut first_error = None;
        for source in SOURCES {
            match self.pose_by(source, camera, stamp, attempt) {
                Ok(pose) => {
                    self.source = Some(source);
                    return Ok(pose);
                }
                // Poses of a topic may come before the transforms that would take precedence.
                Err(error) if !attempt.is_last() => return Err(error),
                Err(error) => {
                    let is_silent = match source {
                        PoseSource::Pose => self.pose.is_empty(),
                        PoseSource::Odom => self.odometry.is_empty(),
                        PoseSource::Auto | PoseSource::Tf => false,
                    };
                    if !is_silent || first_error.is_none() {
                        first_error = Some(error);
                    }
                }
            }
        }
        Err(first_error.unwrap_or_else(|| unknown(camera)))
    }

    fn pose_by(
        &mut self,
        source: PoseSource,
        camera: &str,
        stamp: Stamp,
        attempt: Attempt,
    ) -> Result<RigidTransform, LookupError> {
        let tolerance_s = attempt.tolerance_s();
        let (parent, parent_from_camera) = match source {
            PoseSource::Auto | PoseSource::Tf => {
                if !self.tree.has_parent(camera) {
                    return self.pose_of_root(camera, stamp, attempt);
                }
                (Arc::from(camera), RigidTransform::identity())
            }
            PoseSource::Pose => {
                let (parent, parent_from_child) = self.pose.at(stamp, tolerance_s)?;
                let child = self.pose_frame.as_deref().unwrap_or(camera);
                let child_from_camera = self.tree.lookup(child, camera, stamp, tolerance_s)?;
                (parent, parent_from_child * child_from_camera)
            }
            PoseSource::Odom => {
                let (parent, parent_from_child) = self.odometry.at(stamp, tolerance_s)?;
                let child = self.odometry.child().map_or(camera, |child| child);
                let child_from_camera = self.tree.lookup(child, camera, stamp, tolerance_s)?;
                (parent, parent_from_child * child_from_camera)
            }
        };
        let world_from_parent = self.world_from(&parent, stamp, attempt)?;
        Ok(world_from_parent * parent_from_camera)
    }

    /// A camera without a parent has a pose only where it is the world itself.
    fn pose_of_root(
        &self,
        camera: &str,
        stamp: Stamp,
        attempt: Attempt,
    ) -> Result<RigidTransform, LookupError> {
        match &self.world {
            Some(world) => self
                .tree
                .lookup(world, camera, stamp, attempt.tolerance_s()),
            None => Err(unknown(camera)),
        }
    }

    fn world_from(
        &mut self,
        frame: &str,
        stamp: Stamp,
        attempt: Attempt,
    ) -> Result<RigidTransform, LookupError> {
        // A pose without a frame name can only mean the world.
        if frame.is_empty() {
            return Ok(RigidTransform::identity());
        }
        if self.world.is_none() {
            if !attempt.is_last() {
                return Err(LookupError::Disconnected {
                    source_frame: frame.to_owned(),
                    source_root: frame.to_owned(),
                    target_frame: "world".to_owned(),
                    target_root: "not settled yet".to_owned(),
                });
            }
            let root = self.tree.root_of(frame, stamp)?;
            self.world = Some(root);
        }
        let world = self.world.as_deref().unwrap_or(frame);
        self.tree.lookup(world, frame, stamp, attempt.tolerance_s())
    }

    /// `world_from_mesh`; a stamp of zero asks for the latest, as it does in ROS.
    pub(super) fn world_from_mesh(
        &mut self,
        mesh_frame: &str,
        stamp: Stamp,
        attempt: Attempt,
    ) -> Result<RigidTransform, LookupError> {
        if stamp == Stamp::default() {
            let latest = Attempt::Last {
                tolerance_s: f64::INFINITY,
            };
            return self.world_from(mesh_frame, Stamp::from_nanos(i64::MAX), latest);
        }
        self.world_from(mesh_frame, stamp, attempt)
    }

    /// The camera's pose in the world by a correction of a body's pose in `frame`.
    pub(super) fn world_from_corrected(
        &mut self,
        frame: &str,
        body: CorrectedBody,
        camera: &str,
        stamp: Stamp,
        frame_from_body: RigidTransform,
        tolerance_s: f64,
    ) -> Result<RigidTransform, LookupError> {
        let world_from_frame = self.world_from(frame, stamp, Attempt::Last { tolerance_s })?;
        let body_from_camera = match (body, &self.pose_frame) {
            (CorrectedBody::PoseFrame, Some(child)) => {
                self.tree.lookup(child, camera, stamp, tolerance_s)?
            }
            _ => RigidTransform::identity(),
        };
        Ok(world_from_frame * frame_from_body * body_from_camera)
    }

    /// Where the colour camera is in the depth camera's frame, both on the same body, with the
    /// body's motion from the colour image to the depth image.
    pub(super) fn depth_from_color(
        &mut self,
        depth_frame: &str,
        camera: &str,
        stamps: DepthStamps,
        world_from_camera: &RigidTransform,
        attempt: Attempt,
    ) -> Result<DepthPose, LookupError> {
        let depth_from_camera = if depth_frame == stamps.color_frame {
            RigidTransform::identity()
        } else {
            let tolerance_s = attempt.tolerance_s();
            self.tree
                .lookup(depth_frame, camera, stamps.depth, tolerance_s)?
        };
        if stamps.depth == stamps.color {
            return Ok(DepthPose {
                depth_from_color: depth_from_camera,
                has_motion: true,
            });
        }
        match self.world_from_camera(camera, stamps.depth, attempt) {
            Ok(world_from_camera_at_depth) => Ok(DepthPose {
                depth_from_color: depth_from_camera
                    * world_from_camera_at_depth.inverse()
                    * *world_from_camera,
                has_motion: true,
            }),
            Err(error) if !attempt.is_last() && error.may_resolve() => Err(error),
            Err(_) => Ok(DepthPose {
                depth_from_color: depth_from_camera,
                has_motion: false,
            }),
        }
    }
}

/// When and in which frame the two images of a pair were taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthStamps<'a> {
    pub(super) color_frame: &'a str,
    pub(super) color: Stamp,
    pub(super) depth: Stamp,
}

/// Where a depth image was taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthPose {
    pub(super) depth_from_color: RigidTransform,
    /// Whether the motion between the images is in it.
    pub(super) has_motion: bool,
}

fn unknown(frame: &str) -> LookupError {
    LookupError::UnknownFrame {
        frame: frame.to_owned(),
    }
}
