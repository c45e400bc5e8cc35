//! What the node listens to: topics by name, and which of several types or transports by who
//! publishes them.
//!
//! Names are those of `docs/topics.md`, remapped. Where an input can come in several ways (raw or
//! compressed images, six mesh types, two pose types) the graph decides: once a publisher is seen,
//! the others get [`SETTLE`] to show up, then the best is taken and kept. A publisher of a type
//! that veneer does not read is told of, with those that it does. Pure: no DDS.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::config::{Config, Transport};
use crate::ingest::PoseSource;
use crate::wire::TopicRole;
use crate::wire::event::MessageType;

use super::names::{NameError, NameResolver};
use super::transport::TopicQos;

/// How long other publishers of the same input may take to show up after the first.
pub const SETTLE: Duration = Duration::from_millis(400);

/// Messages of a fast small topic that may wait.
const SMALL_QUEUE: usize = 1000;
/// Mesh messages that may wait: each may be a part that no later one repeats.
const MESH_QUEUE: usize = 64;

/// One topic that is listened to, in one or more roles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Input {
    /// Absolute name.
    pub topic: String,
    /// Types that can be read there, best first.
    pub types: Vec<MessageType>,
    /// The parts that it plays.
    pub roles: Vec<TopicRole>,
    /// Inputs of the same group exclude each other; the lower rank wins.
    pub group: usize,
    /// See [`Self::group`].
    pub rank: u32,
    /// Messages that may wait to be decoded.
    pub queue_size: usize,
    /// How it is read where nothing else is said and the publisher offers no more.
    pub qos: TopicQos,
    /// Whether reliability and history are taken from what the publisher offers.
    pub follows_offer: bool,
}

/// A publisher, as discovery tells of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Offer {
    /// The topic's absolute name.
    pub topic: String,
    /// `package/msg/Name`.
    pub type_name: String,
    /// Whether it sends again what is lost.
    pub is_reliable: bool,
    /// Whether it keeps for late joiners.
    pub is_latched: bool,
}

/// Everything to listen to, by configuration.
///
/// # Errors
/// [`NameError`] for remappings to no name.
pub fn inputs(names: &NameResolver, config: &Config) -> Result<Vec<Input>, NameError> {
    let mut list = InputList {
        names,
        config,
        inputs: Vec::new(),
        next_group: 0,
    };
    list.image("rgb/image", TopicRole::Color, config.node.image_transport)?;
    list.image("depth/image", TopicRole::Depth, config.node.depth_transport)?;
    let info = [MessageType::CameraInfo];
    list.add("rgb/camera_info", TopicRole::ColorInfo, &info)?;
    list.add("depth/camera_info", TopicRole::DepthInfo, &info)?;
    let tf = [MessageType::Tf];
    let mut reliable = TopicQos {
        is_reliable: true,
        is_latched: false,
        depth: 100,
    };
    list.add("/tf", TopicRole::Transforms, &tf)?.qos = reliable;
    reliable.is_latched = true;
    list.add("/tf_static", TopicRole::StaticTransforms, &tf)?
        .qos = reliable;
    let source = config.pipeline.ingest.pose_source;
    if matches!(source, PoseSource::Pose | PoseSource::Auto) {
        let types = [
            MessageType::PoseStamped,
            MessageType::PoseWithCovarianceStamped,
        ];
        list.add("pose", TopicRole::Pose, &types)?;
    }
    if matches!(source, PoseSource::Odom | PoseSource::Auto) {
        list.add("odom", TopicRole::Odometry, &[MessageType::Odometry])?;
    }
    let mesh_types = match config.node.mesh_type {
        Some(chosen) => vec![chosen],
        None => vec![
            MessageType::MeshUpdate,
            MessageType::NvbloxMesh,
            MessageType::MeshGeometryStamped,
            MessageType::ShapeMesh,
            MessageType::MarkerArray,
            MessageType::Marker,
        ],
    };
    let mesh = list.add("mesh", TopicRole::Mesh, &mesh_types)?;
    mesh.queue_size = MESH_QUEUE;
    mesh.qos.depth = MESH_QUEUE;
    mesh.follows_offer = true;
    let types = [MessageType::PoseCorrections, MessageType::Path];
    let corrections = list.add("pose_corrections", TopicRole::Corrections, &types)?;
    corrections.queue_size = MESH_QUEUE;
    corrections.qos.depth = MESH_QUEUE;
    corrections.follows_offer = true;
    let mut inputs = list.inputs;
    for input in &mut inputs {
        if let Some(wanted) = config.node.qos_overrides.get(&input.topic) {
            input.qos.is_reliable = wanted.is_reliable.unwrap_or(input.qos.is_reliable);
            input.qos.is_latched = wanted.is_latched.unwrap_or(input.qos.is_latched);
            input.qos.depth = wanted.depth.unwrap_or(input.qos.depth);
            input.follows_offer &= wanted.is_reliable.is_none() && wanted.is_latched.is_none();
        }
    }
    Ok(inputs)
}

struct InputList<'a> {
    names: &'a NameResolver,
    config: &'a Config,
    inputs: Vec<Input>,
    next_group: usize,
}

impl InputList<'_> {
    /// Adds a topic in a group of its own, or a role to a topic that is there.
    fn add(
        &mut self,
        name: &str,
        role: TopicRole,
        types: &[MessageType],
    ) -> Result<&mut Input, NameError> {
        let topic = self.names.resolve(name)?;
        Ok(self.add_resolved(topic, role, types))
    }

    fn add_resolved(
        &mut self,
        topic: String,
        role: TopicRole,
        types: &[MessageType],
    ) -> &mut Input {
        let known = self
            .inputs
            .iter()
            .position(|input| input.topic == topic && input.types == types);
        let at = known.unwrap_or_else(|| {
            let queue_size = match role {
                TopicRole::Color | TopicRole::Depth => self.config.pipeline.ingest.topic_queue_size,
                _ => SMALL_QUEUE,
            };
            self.inputs.push(Input {
                topic,
                types: types.to_vec(),
                roles: Vec::new(),
                group: self.next_group,
                rank: 0,
                queue_size,
                qos: TopicQos {
                    depth: queue_size.clamp(TopicQos::SENSOR_DATA.depth, 100),
                    ..TopicQos::SENSOR_DATA
                },
                follows_offer: false,
            });
            self.next_group += 1;
            self.inputs.len() - 1
        });
        let input = &mut self.inputs[at];
        input.roles.push(role);
        input
    }

    fn image(
        &mut self,
        name: &str,
        role: TopicRole,
        transport: Transport,
    ) -> Result<(), NameError> {
        let suffix = match role {
            TopicRole::Depth => "compressedDepth",
            _ => "compressed",
        };
        let group = self.next_group;
        if transport != Transport::Raw {
            let topic = self.names.resolve_transport(name, suffix)?;
            self.add_resolved(topic, role, &[MessageType::CompressedImage]);
        }
        if transport != Transport::Compressed {
            // The base topic carries compressed images where it was remapped to such a topic.
            let types: &[MessageType] = match transport {
                Transport::Raw => &[MessageType::Image],
                _ => &[MessageType::Image, MessageType::CompressedImage],
            };
            let raw = self.add(name, role, types)?;
            raw.group = group;
            raw.rank = 1;
        }
        self.next_group = group + 1;
        Ok(())
    }
}

/// What to do about an input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Which input.
    pub input: usize,
    /// The type to read it as.
    pub message_type: MessageType,
    /// How to read it.
    pub qos: TopicQos,
}

/// Chooses inputs as publishers show up.
#[derive(Debug)]
pub struct Chooser {
    inputs: Vec<Input>,
    chosen_by_group: BTreeMap<usize, Choice>,
    first_seen_by_group: BTreeMap<usize, Instant>,
}

impl Chooser {
    /// Nothing is chosen yet.
    pub fn new(inputs: &[Input]) -> Self {
        Self {
            inputs: inputs.to_vec(),
            chosen_by_group: BTreeMap::new(),
            first_seen_by_group: BTreeMap::new(),
        }
    }

    /// What is chosen so far.
    pub fn chosen(&self) -> impl Iterator<Item = &Choice> {
        self.chosen_by_group.values()
    }

    /// Takes the publishers that are there now; gives what is newly chosen.
    pub fn update(&mut self, now: Instant, offers: &[Offer]) -> Vec<Choice> {
        let mut new = Vec::new();
        let groups: Vec<usize> = self.inputs.iter().map(|input| input.group).collect();
        for group in groups {
            if self.chosen_by_group.contains_key(&group) {
                continue;
            }
            let Some(choice) = self.choose(group, now, offers) else {
                continue;
            };
            self.chosen_by_group.insert(group, choice.clone());
            new.push(choice);
        }
        new
    }

    fn choose(&mut self, group: usize, now: Instant, offers: &[Offer]) -> Option<Choice> {
        let members = || {
            let all = self.inputs.iter().enumerate();
            all.filter(move |(_, input)| input.group == group)
        };
        let num_ways: usize = members().map(|(_, input)| input.types.len()).sum();
        let follows_offer = members().any(|(_, input)| input.follows_offer);
        if num_ways == 1 && !follows_offer {
            let (at, input) = members().next()?;
            return Some(Choice {
                input: at,
                message_type: *input.types.first()?,
                qos: input.qos,
            });
        }
        let best = members()
            .flat_map(|(at, input)| {
                let offered = offers.iter().filter(|offer| offer.topic == input.topic);
                offered.filter_map(move |offer| {
                    let message_type = MessageType::from_name(&offer.type_name)?;
                    let place = input.types.iter().position(|t| *t == message_type)?;
                    Some(((input.rank, place), at, message_type, offer))
                })
            })
            .min_by_key(|(key, ..)| *key);
        let (_, at, message_type, offer) = best?;
        let first_seen = *self.first_seen_by_group.entry(group).or_insert(now);
        if num_ways > 1 && now.saturating_duration_since(first_seen) < SETTLE {
            return None;
        }
        let input = &self.inputs[at];
        let mut qos = input.qos;
        if input.follows_offer {
            qos.is_reliable = offer.is_reliable;
            qos.is_latched = offer.is_latched && offer.is_reliable;
        }
        Some(Choice {
            input: at,
            message_type,
            qos,
        })
    }
}

/// What is wrong between an input and those who publish it, in words with the remedy.
pub fn complaints(inputs: &[Input], chooser: &Chooser, offers: &[Offer]) -> Vec<String> {
    let mut words = Vec::new();
    for input in inputs {
        for offer in offers.iter().filter(|offer| offer.topic == input.topic) {
            let known = MessageType::from_name(&offer.type_name);
            let is_read_elsewhere = || {
                let mut others = inputs.iter().filter(|other| other.topic == input.topic);
                known.is_some_and(|t| others.any(|other| other.types.contains(&t)))
            };
            if known.is_none_or(|t| !input.types.contains(&t)) && !is_read_elsewhere() {
                let readable: Vec<_> = input.types.iter().map(|t| t.name()).collect();
                words.push(format!(
                    "{} is published as {}, veneer reads {} there: remap to another topic, or set the type",
                    input.topic,
                    offer.type_name,
                    readable.join(" or ")
                ));
            }
        }
    }
    for choice in chooser.chosen() {
        let topic = &inputs[choice.input].topic;
        for offer in offers.iter().filter(|offer| offer.topic == *topic) {
            if choice.qos.is_reliable && !offer.is_reliable {
                words.push(format!(
                    "{topic} is read as reliable but published as best effort, so nothing arrives: set qos_overrides.{topic}.subscription.reliability to best_effort"
                ));
            }
            if choice.qos.is_latched && !offer.is_latched {
                words.push(format!(
                    "{topic} is read as transient_local but published as volatile, so nothing arrives: set qos_overrides.{topic}.subscription.durability to volatile"
                ));
            }
        }
    }
    words.sort();
    words.dedup();
    words
}

#[cfg(test)]
mod tests;
