//! Who publishes and who listens, as DDS discovery has it, and what we tell others of ourselves.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use ros2_client::Context;
use ros2_client::entities_info::{NodeEntitiesInfo, ParticipantEntitiesInfo};
use ros2_client::gid::Gid;
use rustdds::no_key::DataWriter;
use rustdds::policy::{Durability, Reliability};
use rustdds::{CDRSerializerAdapter, GUID, Timestamp, TopicKind};

use super::error::NodeError;
use super::inputs::{Input, Offer};
use super::transport::{dds_topic_name, ros_topic_name, ros_type_name};

/// Who publishes on the topics of `inputs`, `max` of them at most.
pub(super) fn offers(context: &Context, inputs: &[Input], max: usize) -> Vec<Offer> {
    let participant = context.domain_participant();
    let writers = participant.discovered_writers();
    let offer = |data: &rustdds::discovery::DiscoveredWriterData| {
        let topic = &data.publication_topic_data;
        let name = ros_topic_name(&topic.topic_name)?;
        inputs.iter().find(|input| input.topic == name)?;
        Some(Offer {
            topic: name.to_owned(),
            type_name: ros_type_name(&topic.type_name)?,
            is_reliable: matches!(topic.reliability, Some(Reliability::Reliable { .. })),
            is_latched: topic.durability.is_some_and(|d| d != Durability::Volatile),
        })
    };
    let mut offers: Vec<_> = writers.iter().filter_map(offer).take(max).collect();
    offers.sort_by(|a, b| (&a.topic, &a.type_name).cmp(&(&b.topic, &b.type_name)));
    offers
}

/// Who listens to a topic, `max` of them at most, and whether each asks for what was published before
/// it came.
pub(super) fn readers(context: &Context, topic: &str, max: usize) -> BTreeMap<GUID, bool> {
    let name = dds_topic_name(topic);
    let participant = context.domain_participant();
    let readers = participant.discovered_readers();
    readers
        .iter()
        .filter(|data| *data.subscription_topic_data.topic_name() == name)
        .map(|data| {
            let reader = &data.subscription_topic_data;
            let durability = reader.qos().durability();
            let is_latched = durability.is_some_and(|d| d != Durability::Volatile);
            (reader.key(), is_latched)
        })
        .take(max)
        .collect()
}

/// Who waits for a service's answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Client {
    /// What it reads them with.
    pub(super) reader: GUID,
    /// Whether it is reached over this host's loopback alone.
    pub(super) is_local: bool,
}

/// The readers of a topic, by DDS' name, in the participant that `member` belongs to.
pub(super) fn clients(context: &Context, dds_topic: &str, member: GUID) -> Vec<Client> {
    let readers = context.domain_participant().discovered_readers();
    let of_member = readers.iter().filter(|data| {
        let topic = &data.subscription_topic_data;
        topic.topic_name() == dds_topic && topic.key().prefix == member.prefix
    });
    of_member
        .map(|data| {
            let reader = &data.reader_proxy;
            // Fast DDS names shared memory too, which ours does not speak.
            let mut reached_over = reader.unicast_locator_list.iter().filter(|l| l.is_udp());
            let is_reached = reached_over.clone().next().is_some();
            Client {
                reader: reader.remote_reader_guid,
                is_local: is_reached && reached_over.all(|l| l.is_loopback()),
            }
        })
        .collect()
}

/// Tells ROS' tools which of the participant's readers and writers are the node's.
///
/// ros2-client tells of those that it made; ours it does not know. Both are sent with the
/// participant's id, and tools keep what came last, so ours is sent again whenever a participant
/// appears.
pub(super) struct EntityList {
    writer: DataWriter<ParticipantEntitiesInfo, CDRSerializerAdapter<ParticipantEntitiesInfo>>,
    node_name: String,
    gids: Mutex<Gids>,
}

#[derive(Default)]
struct Gids {
    readers: Vec<Gid>,
    writers: Vec<Gid>,
}

impl EntityList {
    pub(super) fn new(context: &Context, node_name: &str) -> Result<Self, NodeError> {
        use ros2_client::builtin_topics::ros_discovery;
        let failed =
            |error: &dyn std::fmt::Display| NodeError::dds(ros_discovery::TOPIC_NAME, error);
        let participant = context.domain_participant();
        let topic = participant
            .create_topic(
                ros_discovery::TOPIC_NAME.to_owned(),
                ros_discovery::TYPE_NAME.to_owned(),
                &ros_discovery::QOS_PUB,
                TopicKind::NoKey,
            )
            .map_err(|e| failed(&e))?;
        let publisher = participant
            .create_publisher(&ros_discovery::QOS_PUB)
            .map_err(|e| failed(&e))?;
        let writer = publisher
            .create_datawriter_no_key(&topic, None)
            .map_err(|e| failed(&e))?;
        Ok(Self {
            writer,
            node_name: node_name.to_owned(),
            gids: Mutex::default(),
        })
    }

    pub(super) fn add_reader(&self, gid: Gid) {
        let mut gids = self.gids.lock().unwrap_or_else(PoisonError::into_inner);
        gids.readers.push(gid);
    }

    pub(super) fn add_writer(&self, gid: Gid) {
        let mut gids = self.gids.lock().unwrap_or_else(PoisonError::into_inner);
        gids.writers.push(gid);
    }

    /// Sends the whole list.
    pub(super) fn publish(&self, context: &Context) {
        let known = context.participant_entities_info();
        let gids = self.gids.lock().unwrap_or_else(PoisonError::into_inner);
        let nodes: Vec<NodeEntitiesInfo> = known
            .nodes()
            .iter()
            .cloned()
            .map(|mut node| {
                if node.fully_qualified_name() == self.node_name {
                    gids.readers.iter().for_each(|gid| node.add_reader(*gid));
                    gids.writers.iter().for_each(|gid| node.add_writer(*gid));
                }
                node
            })
            .collect();
        drop(gids);
        let list = ParticipantEntitiesInfo::new(known.gid(), nodes);
        if let Err(error) = self.writer.write(list, Some(Timestamp::now())) {
            tracing::debug!("the list of readers and writers was not sent: {error}");
        }
    }
}
