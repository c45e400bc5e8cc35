//! Which topic plays which part: as the configuration names them, else chosen by type, encoding
//! and name.
//!
//! Colour and depth images share their types, so the first message of each image topic is looked
//! at: its encoding decides. Among several candidates the name decides (`color`, `rgb` before
//! others; `aligned_depth` before `depth`; never `infra`, `mask`, `confidence`, …), and of two
//! transports of one image the compressed one, which is less to read. Camera infos belong to
//! images by ROS's naming: `camera_info` beside the image's base topic.

use std::collections::{BTreeMap, BTreeSet};

use crate::ingest::PoseSource;
use crate::wire::event::MessageType;
use crate::wire::{TopicRole, camera_info::Rectification};

use super::error::BagError;

/// Topics by part, as configured; `None` = choose.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct TopicRoles {
    /// Colour images; a base topic stands for its compressed transport too.
    pub color: Option<String>,
    /// Depth images; a base topic stands for its compressed transport too.
    pub depth: Option<String>,
    /// Intrinsics of the colour camera.
    pub color_info: Option<String>,
    /// Intrinsics of the depth camera.
    pub depth_info: Option<String>,
    /// Poses or odometry, by `pose_source`.
    pub pose: Option<String>,
    /// The mesh.
    pub mesh: Option<String>,
    /// Better poses of frames of the past; not chosen where it is a path, which may be any.
    pub corrections: Option<String>,
    /// Where the camera's pose comes from.
    pub pose_source: PoseSource,
    /// The frame of `shape_msgs/Mesh`, which does not say it.
    pub mesh_frame: Option<String>,
}

/// What the first message of a topic shows.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub(super) struct Peek {
    /// Encoding of an image, format of a compressed one.
    pub(super) encoding: String,
    /// The header's frame.
    pub(super) frame_id: String,
    /// Of a marker topic: whether a triangle list was among the first messages.
    pub(super) has_triangles: bool,
}

/// A topic as the choice sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TopicView {
    pub(super) message_type: MessageType,
    /// Whether any message is there (`false` only if that is certain).
    pub(super) has_messages: bool,
    pub(super) peek: Option<Peek>,
}

/// All topics of types that veneer reads, by name.
pub(super) type Topics = BTreeMap<String, TopicView>;

/// A topic and the part it plays.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicAssignment {
    /// The topic's name.
    pub topic: String,
    /// The part.
    pub role: TopicRole,
    /// The type of its messages.
    pub message_type: MessageType,
    /// For camera infos: which images it stands for.
    pub rectification: Rectification,
}

/// A part that no topic plays, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct MissingRole {
    /// The part.
    pub role: TopicRole,
    /// What is missing and the remedy, in words.
    pub remedy: String,
}

/// The parts and who plays them.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct TopicPlan {
    /// Topics in use, by part, then name. One topic may play two parts (a camera info for colour
    /// and registered depth).
    pub assignments: Vec<TopicAssignment>,
    /// Where the pose comes from; never `Auto`.
    pub pose_source: PoseSource,
    /// Parts that veneer needs and nobody plays. Depth is not among them: it only helps.
    pub missing: Vec<MissingRole>,
}

impl TopicPlan {
    /// The topic that plays a part.
    pub fn topic(&self, role: TopicRole) -> Option<&str> {
        let found = self.assignments.iter().find(|a| a.role == role);
        found.map(|a| a.topic.as_str())
    }

    /// Settles the parts. `moves_camera` tells whether the TF tree moves a frame; it is asked
    /// only when there is something else to choose.
    pub(super) fn resolve(
        roles: &TopicRoles,
        topics: &Topics,
        moves_camera: impl FnOnce(&str) -> bool,
    ) -> Result<Self, BagError> {
        let color = choose_image(topics, TopicRole::Color, roles.color.as_deref())?;
        let depth = choose_image(topics, TopicRole::Depth, roles.depth.as_deref())?;
        let mut plan = Self::default();
        let infos = [
            (TopicRole::ColorInfo, color, roles.color_info.as_deref()),
            (TopicRole::DepthInfo, depth, roles.depth_info.as_deref()),
        ];
        plan.assign(topics, TopicRole::Color, color);
        plan.assign(topics, TopicRole::Depth, depth);
        for (role, image, named) in infos {
            let info = match named {
                Some(name) => Some(named_topic(topics, role, name)?),
                None => image.and_then(|image| info_of(topics, image, color)),
            };
            plan.assign(topics, role, info);
            if let (Some(added), Some(image)) = (plan.assignments.last_mut(), image)
                && added.role == role
            {
                added.rectification = rectification_of(image);
            }
        }
        let camera_frame = color
            .and_then(|c| topics.get(c)?.peek.as_ref())
            .map_or("", |peek| peek.frame_id.as_str());
        plan.resolve_pose(roles, topics, || moves_camera(camera_frame))?;
        let mesh = choose_mesh(topics, roles.mesh.as_deref())?;
        plan.assign(topics, TopicRole::Mesh, mesh);
        let corrections = choose_corrections(topics, roles.corrections.as_deref())?;
        plan.assign(topics, TopicRole::Corrections, corrections);
        plan.note_missing(topics, roles);
        Ok(plan)
    }

    fn assign(&mut self, topics: &Topics, role: TopicRole, topic: Option<&str>) {
        if let Some((name, view)) = topic.and_then(|t| topics.get_key_value(t)) {
            self.assignments.push(TopicAssignment {
                topic: name.clone(),
                role,
                message_type: view.message_type,
                rectification: Rectification::Raw,
            });
        }
    }

    fn resolve_pose(
        &mut self,
        roles: &TopicRoles,
        topics: &Topics,
        moves_camera: impl FnOnce() -> bool,
    ) -> Result<(), BagError> {
        // TF is read whatever the source: it also holds how the cameras sit on the robot.
        for (name, _) in of_role(topics, TopicRole::Transforms) {
            let role = if is_static(name) {
                TopicRole::StaticTransforms
            } else {
                TopicRole::Transforms
            };
            self.assign(topics, role, Some(name));
        }
        let best = |role| best_of(of_role(topics, role).map(|(name, _)| (name, pose_rank(name))));
        let has_tf = of_role(topics, TopicRole::Transforms).next().is_some();
        let (pose, odom) = (best(TopicRole::Pose), best(TopicRole::Odometry));
        let named = roles.pose.as_deref();
        let named_is = |role| named.is_some_and(|n| named_topic(topics, role, n).is_ok());
        self.pose_source = match roles.pose_source {
            PoseSource::Auto if named_is(TopicRole::Pose) => PoseSource::Pose,
            PoseSource::Auto if named_is(TopicRole::Odometry) => PoseSource::Odom,
            PoseSource::Auto if pose.is_none() && odom.is_none() => PoseSource::Tf,
            PoseSource::Auto if has_tf && moves_camera() => PoseSource::Tf,
            PoseSource::Auto if pose.is_some() => PoseSource::Pose,
            PoseSource::Auto => PoseSource::Odom,
            settled => settled,
        };
        let (role, chosen) = match self.pose_source {
            PoseSource::Pose => (TopicRole::Pose, pose),
            PoseSource::Odom => (TopicRole::Odometry, odom),
            _ => return Ok(()),
        };
        let topic = match named {
            Some(name) => Some(named_topic(topics, role, name)?),
            None => chosen,
        };
        self.assign(topics, role, topic);
        Ok(())
    }

    fn note_missing(&mut self, topics: &Topics, roles: &TopicRoles) {
        let mut missing = Vec::new();
        let mut note = |role, remedy: String| missing.push(MissingRole { role, remedy });
        if self.topic(TopicRole::Color).is_none() {
            note(
                TopicRole::Color,
                "no colour images: record the camera's colour topic (sensor_msgs/Image or CompressedImage; rgb8, bgr8, rgba8, bgra8, mono8, bayer, yuy2, nv12, jpeg, png), or name it".into(),
            );
        }
        for (image, info) in [
            (TopicRole::Color, TopicRole::ColorInfo),
            (TopicRole::Depth, TopicRole::DepthInfo),
        ] {
            if let (Some(topic), None) = (self.topic(image), self.topic(info)) {
                let sibling = info_siblings(topic).next().unwrap_or_default();
                note(
                    info,
                    format!("no camera info for {topic}: record {sibling}, or name the topic"),
                );
            }
        }
        if let Some(remedy) = self.missing_pose(topics) {
            note(TopicRole::Transforms, remedy);
        }
        match self.topic(TopicRole::Mesh).map(|t| &topics[t]) {
            None => note(
                TopicRole::Mesh,
                "no mesh: record the mesher's topic (veneer/MeshUpdate, mesh_msgs/MeshGeometryStamped, nvblox_msgs/Mesh, shape_msgs/Mesh, Marker or MarkerArray with TRIANGLE_LIST), or name it".into(),
            ),
            Some(view) if view.message_type == MessageType::ShapeMesh && roles.mesh_frame.is_none() => note(
                TopicRole::Mesh,
                "shape_msgs/Mesh does not say its frame: set mesh_frame".into(),
            ),
            Some(_) => {}
        }
        self.missing = missing;
    }

    fn missing_pose(&self, topics: &Topics) -> Option<String> {
        let (role, remedy) = match self.pose_source {
            PoseSource::Pose => (
                TopicRole::Pose,
                "no pose topic: record a PoseStamped or PoseWithCovarianceStamped of the camera, or choose another pose_source",
            ),
            PoseSource::Odom => (
                TopicRole::Odometry,
                "no odometry: record a nav_msgs/Odometry topic, or choose another pose_source",
            ),
            _ => (
                TopicRole::Transforms,
                "no moving transforms: record /tf (and /tf_static), or a pose or odometry topic",
            ),
        };
        let found = self.topic(role).and_then(|t| topics.get(t));
        let has_messages = found.is_some_and(|view| view.has_messages);
        (!has_messages).then(|| remedy.to_owned())
    }
}

fn of_role(topics: &Topics, role: TopicRole) -> impl Iterator<Item = (&str, &TopicView)> {
    let of_type = topics
        .iter()
        .filter(move |(_, view)| view.message_type.can_be(role) && view.has_messages);
    of_type.map(|(name, view)| (name.as_str(), view))
}

/// The candidate of the highest rank, the first by name among equals; `None` ranks are out.
fn best_of<'a>(candidates: impl Iterator<Item = (&'a str, Option<i32>)>) -> Option<&'a str> {
    let ranked = candidates.filter_map(|(name, rank)| Some((rank?, std::cmp::Reverse(name))));
    ranked.max().map(|(_, name)| name.0)
}

fn named_topic<'a>(topics: &'a Topics, role: TopicRole, name: &str) -> Result<&'a str, BagError> {
    let found = topics.get_key_value(name);
    if let Some((name, view)) = found
        && view.message_type.can_be(role)
    {
        return Ok(name);
    }
    let others: Vec<&str> = of_role(topics, role).map(|(name, _)| name).collect();
    let is = found.map_or("is not in the bag".to_owned(), |(_, view)| {
        format!("is a {}", view.message_type.name())
    });
    let instead = match others.as_slice() {
        [] => "no topic there can".to_owned(),
        names => format!("these can: {}", names.join(", ")),
    };
    Err(BagError::Topic {
        topic: name.to_owned(),
        role: role.name(),
        reason: format!("{is}; {instead}"),
    })
}

fn choose_image<'a>(
    topics: &'a Topics,
    role: TopicRole,
    named: Option<&str>,
) -> Result<Option<&'a str>, BagError> {
    if let Some(name) = named {
        let transport = match role {
            TopicRole::Depth => format!("{name}/compressedDepth"),
            _ => format!("{name}/compressed"),
        };
        if !topics.contains_key(name) && topics.contains_key(&transport) {
            return named_topic(topics, role, &transport).map(Some);
        }
        return named_topic(topics, role, name).map(Some);
    }
    let rank = match role {
        TopicRole::Depth => depth_rank,
        _ => color_rank,
    };
    let candidates = of_role(topics, role).map(|(name, view)| (name, rank(name, view)));
    Ok(best_of(candidates))
}

/// The named topic, else the first of our own type.
fn choose_corrections<'a>(
    topics: &'a Topics,
    named: Option<&str>,
) -> Result<Option<&'a str>, BagError> {
    if let Some(name) = named {
        return named_topic(topics, TopicRole::Corrections, name).map(Some);
    }
    let mut ours = of_role(topics, TopicRole::Corrections)
        .filter(|(_, view)| view.message_type == MessageType::PoseCorrections);
    Ok(ours.next().map(|(name, _)| name))
}

/// What an image holds, by its encoding.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Content {
    Color,
    Grey,
    Depth,
    Grey16,
    Unknown,
}

fn content(name: &str, view: &TopicView) -> Content {
    let format = view.peek.as_ref().map_or("", |peek| peek.encoding.as_str());
    let encoding = format.split(';').next().unwrap_or("").trim();
    let says_depth = format.contains("compressedDepth") || name.ends_with("/compressedDepth");
    match (view.message_type, encoding) {
        (_, "16UC1" | "32FC1") => Content::Depth,
        (_, "mono16") if says_depth => Content::Depth,
        (_, "mono16") => Content::Grey16,
        (MessageType::CompressedImage, _) if says_depth => Content::Depth,
        (_, "mono8" | "8UC1") => Content::Grey,
        (MessageType::CompressedImage, _) => Content::Color,
        (_, raw) if crate::geom::ColorEncoding::from_ros_name(raw).is_some() => Content::Color,
        _ => Content::Unknown,
    }
}

const NOT_A_VIEW: [&str; 13] = [
    "infra",
    "mask",
    "label",
    "segment",
    "semantic",
    "confidence",
    "disparity",
    "debug",
    "overlay",
    "annotated",
    "heatmap",
    "thermal",
    "fisheye",
];

fn color_rank(name: &str, view: &TopicView) -> Option<i32> {
    let mut rank = match content(name, view) {
        Content::Color => 100,
        Content::Grey => 40,
        _ => return None,
    };
    let lower = name.to_lowercase();
    if ["color", "colour", "rgb"]
        .iter()
        .any(|word| lower.contains(word))
    {
        rank += 20;
    }
    if NOT_A_VIEW
        .iter()
        .chain(&["depth"])
        .any(|word| lower.contains(word))
    {
        rank -= 30;
    }
    if lower.split('/').any(|part| part == "right" || part == "ir") {
        rank -= 10;
    }
    Some(2 * rank + i32::from(view.message_type == MessageType::CompressedImage))
}

fn depth_rank(name: &str, view: &TopicView) -> Option<i32> {
    let lower = name.to_lowercase();
    let names_depth = lower.contains("depth");
    let mut rank = match content(name, view) {
        Content::Depth => 100,
        // 16-bit grey is an infrared picture unless the name says otherwise.
        Content::Grey16 if names_depth => 90,
        _ => return None,
    };
    if names_depth {
        rank += 10;
    }
    if ["aligned", "registered", "to_color", "to_rgb"]
        .iter()
        .any(|word| lower.contains(word))
    {
        rank += 20;
    }
    if NOT_A_VIEW.iter().any(|word| lower.contains(word)) {
        rank -= 60;
    }
    Some(2 * rank + i32::from(view.message_type == MessageType::CompressedImage))
}

fn pose_rank(name: &str) -> Option<i32> {
    let lower = name.to_lowercase();
    let goal = ["goal", "target", "initialpose", "marker", "gps"];
    if goal.iter().any(|word| lower.contains(word)) {
        return None;
    }
    let words = ["camera", "pose", "odom", "slam", "vio"];
    let score = words.iter().filter(|word| lower.contains(*word)).count();
    i32::try_from(score).ok()
}

fn choose_mesh<'a>(topics: &'a Topics, named: Option<&str>) -> Result<Option<&'a str>, BagError> {
    if let Some(name) = named {
        return named_topic(topics, TopicRole::Mesh, name).map(Some);
    }
    let rank = |name: &str, view: &TopicView| {
        let by_type = match view.message_type {
            MessageType::MeshUpdate => 60,
            MessageType::NvbloxMesh => 50,
            MessageType::MeshGeometryStamped => 40,
            MessageType::ShapeMesh => 30,
            // Most marker topics are not meshes: one must have shown its triangles.
            _ if view.peek.as_ref().is_some_and(|peek| peek.has_triangles) => 10,
            _ => return None,
        };
        Some(by_type + i32::from(name.to_lowercase().contains("mesh")))
    };
    let candidates = of_role(topics, TopicRole::Mesh).map(|(name, view)| (name, rank(name, view)));
    Ok(best_of(candidates))
}

fn is_static(topic: &str) -> bool {
    topic.ends_with("tf_static")
}

/// The image topic without its transport.
fn base_topic(image: &str) -> &str {
    let suffixes = ["/compressedDepth", "/compressed"];
    let stripped = suffixes.iter().find_map(|s| image.strip_suffix(s));
    stripped.unwrap_or(image)
}

/// Names under which an image's camera info is looked for, best first.
fn info_siblings(image: &str) -> impl Iterator<Item = String> {
    let base = base_topic(image);
    let parent = base.rsplit_once('/').map_or("", |(parent, _)| parent);
    [parent, base]
        .map(|p| format!("{p}/camera_info"))
        .into_iter()
}

fn info_of<'a>(topics: &'a Topics, image: &str, color: Option<&str>) -> Option<&'a str> {
    let infos: BTreeSet<&str> = of_role(topics, TopicRole::ColorInfo)
        .map(|(name, _)| name)
        .collect();
    let sibling = |image| info_siblings(image).find_map(|name| infos.get(name.as_str()).copied());
    if let Some(found) = sibling(image) {
        return Some(found);
    }
    let frame = |name: &str| {
        let peek = topics.get(name)?.peek.as_ref()?;
        Some(peek.frame_id.as_str()).filter(|frame| !frame.is_empty())
    };
    let image_frame = frame(image);
    let same_frame = |name: &&str| image_frame.is_some() && frame(name) == image_frame;
    // Depth registered to colour often comes without an info of its own: colour's is its.
    let of_color =
        color.filter(|&c| c != image && image_frame.is_some() && frame(c) == image_frame);
    if let Some(found) = of_color.and_then(sibling) {
        return Some(found);
    }
    if let Some(found) = infos.iter().copied().find(same_frame) {
        return Some(found);
    }
    // A lone info is the colour camera's, unless its name says that it is another image's.
    let is_of_another = |info: &&str| {
        let others = topics.keys().filter(|name| name.as_str() != image);
        let mut siblings = others.flat_map(|name| info_siblings(name));
        siblings.any(|sibling| sibling == **info)
    };
    let is_lone_color = color == Some(image) && infos.len() == 1;
    let lone = is_lone_color.then(|| infos.first().copied()).flatten();
    lone.filter(|info| !is_of_another(info))
}

fn rectification_of(image: &str) -> Rectification {
    let base = base_topic(image);
    let last = base.rsplit('/').next().unwrap_or(base).to_lowercase();
    if last.contains("rect") && !last.contains("unrect") {
        Rectification::Rectified
    } else {
        Rectification::Raw
    }
}

#[cfg(test)]
mod tests;
