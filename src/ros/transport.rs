//! Serialised messages in and out of DDS, as bytes: nothing is decoded here.
//!
//! Readers hand over each sample as ROS serialises it, with its 4-byte encapsulation header, and
//! with the writer and sequence number that it came with; a gap in a writer's numbers is what was
//! lost on the way. Writers take such bytes. Services are two topics, of requests and of answers.
//! Both are RustDDS' own, made at the participant that ros2-client's node uses, since the node's own
//! decode on the task that receives.

use std::convert::Infallible;
use std::net::Ipv4Addr;

use futures::stream::{Stream, StreamExt};
use ros2_client::Context;
use ros2_client::gid::Gid;
use ros2_client::qos::{Durability, History, QosProfile, Reliability, WhenFull};
use rustdds::bytes::Bytes;
use rustdds::dds::adapters::no_key::{
    Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter,
};
use rustdds::dds::statusevents::{DataWriterStatus, StatusEvented};
use rustdds::rpc::SampleIdentity;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, GUID, QosPolicies, RTPSEntity,
    RepresentationIdentifier, SequenceNumber, Timestamp, Topic, TopicKind, WriteOptions,
    WriteOptionsBuilder, no_key,
};

use super::env::Network;
use super::error::NodeError;
use super::security::Security;

/// Bytes of the encapsulation header.
const HEADER_BYTES: usize = 4;

/// Encodings that can arrive, with the first two bytes of a serialised message. All are taken, so
/// that what cannot be read is refused with the message's own words, and counted.
const ENCODINGS: [(RepresentationIdentifier, [u8; 2]); 10] = [
    (RepresentationIdentifier::CDR_BE, [0, 0]),
    (RepresentationIdentifier::CDR_LE, [0, 1]),
    (RepresentationIdentifier::PL_CDR_BE, [0, 2]),
    (RepresentationIdentifier::PL_CDR_LE, [0, 3]),
    (RepresentationIdentifier::XML, [0, 4]),
    (RepresentationIdentifier::XCDR2_BE, [0, 6]),
    (RepresentationIdentifier::XCDR2_LE, [0, 7]),
    (RepresentationIdentifier::D_CDR2_BE, [0, 8]),
    (RepresentationIdentifier::D_CDR2_LE, [0, 9]),
    (RepresentationIdentifier::PL_XCDR2_LE, [0, 11]),
];
const ENCODING_IDS: [RepresentationIdentifier; ENCODINGS.len()] = {
    let mut ids = [RepresentationIdentifier::CDR_BE; ENCODINGS.len()];
    let mut i = 0;
    while i < ids.len() {
        ids[i] = ENCODINGS[i].0;
        i += 1;
    }
    ids
};

/// Hands over bytes as they are.
#[derive(Clone, Copy, Debug)]
pub(super) struct RawAdapter;

impl DeserializerAdapter<Vec<u8>> for RawAdapter {
    type Error = Infallible;
    type Decoded = Vec<u8>;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &ENCODING_IDS
    }

    fn transform_decoded(decoded: Vec<u8>) -> Vec<u8> {
        decoded
    }
}

impl DefaultDecoder<Vec<u8>> for RawAdapter {
    type Decoder = Self;
    const DECODER: Self = Self;
}

impl Decode<'_, Vec<u8>> for RawAdapter {
    type Error = Infallible;

    fn decode_bytes(
        self,
        body: &[u8],
        encoding: RepresentationIdentifier,
    ) -> Result<Vec<u8>, Infallible> {
        let known = ENCODINGS.iter().find(|(id, _)| *id == encoding);
        let first = known.map_or([0xff, 0xff], |(_, bytes)| *bytes);
        let mut bytes = Vec::with_capacity(HEADER_BYTES + body.len());
        bytes.extend_from_slice(&first);
        bytes.extend_from_slice(&[0, 0]);
        bytes.extend_from_slice(body);
        Ok(bytes)
    }
}

impl SerializerAdapter<Bytes> for RawAdapter {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(message: &Bytes) -> Result<Bytes, Infallible> {
        Ok(message.slice(HEADER_BYTES.min(message.len())..))
    }
}

/// How a topic is read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TopicQos {
    /// Whether what is lost is sent again.
    pub is_reliable: bool,
    /// Whether late joiners get what was published before.
    pub is_latched: bool,
    /// Messages kept, ≥ 1.
    pub depth: usize,
}

impl TopicQos {
    /// What a camera's driver publishes with.
    pub const SENSOR_DATA: Self = Self {
        is_reliable: false,
        is_latched: false,
        depth: 5,
    };

    fn policies(self) -> QosPolicies {
        let profile = QosProfile {
            reliability: if self.is_reliable {
                // A full window is back-pressure that the caller handles, not the DDS thread.
                Reliability::Reliable {
                    when_full: WhenFull::Fail,
                }
            } else {
                Reliability::BestEffort
            },
            durability: if self.is_latched {
                Durability::TransientLocal
            } else {
                Durability::Volatile
            },
            history: History::KeepLast { depth: self.depth },
            ..QosProfile::subscription_default()
        };
        QosPolicies::from(profile)
    }
}

/// A message as it arrived.
#[derive(Clone, Debug)]
pub(super) struct RawSample {
    /// The serialised message with its encapsulation header.
    pub(super) bytes: Vec<u8>,
    /// Who wrote it.
    pub(super) writer: GUID,
    /// Its number among that writer's.
    pub(super) sequence_number: i64,
    /// By what an answer to it is known as such: what the client asked for, else writer and number.
    pub(super) identity: SampleIdentity,
}

/// Makes a participant that keeps to `network` and, where asked for, talks to secured peers only.
pub(super) fn participant(
    network: &Network,
    security: Option<&Security>,
) -> Result<DomainParticipant, NodeError> {
    let mut builder = DomainParticipantBuilder::new(network.domain_id);
    if !network.interfaces.is_empty() {
        let interfaces: Vec<Ipv4Addr> = network.interfaces.clone();
        builder = builder.with_only_networks(interfaces);
    }
    let mut what = "the DDS participant".to_owned();
    if let Some(security) = security {
        builder = secured(builder, security)?;
        what += &format!(" with the keys of {}", security.enclave_folder().display());
    }
    builder
        .build()
        .map_err(|error| NodeError::dds(&what, &error))
}

#[cfg(feature = "security")]
fn secured(
    builder: DomainParticipantBuilder,
    security: &Security,
) -> Result<DomainParticipantBuilder, NodeError> {
    // SROS2's keys have no password.
    let files = rustdds::DomainParticipantSecurityConfigFiles::with_ros_default_names(
        security.enclave_folder(),
        String::new(),
    );
    Ok(builder.builtin_security(files))
}

#[cfg(not(feature = "security"))]
fn secured(
    _: DomainParticipantBuilder,
    security: &Security,
) -> Result<DomainParticipantBuilder, NodeError> {
    let folder = security.enclave_folder().to_owned();
    Err(super::security::SecurityError::NotBuilt { folder }.into())
}

/// A topic as DDS calls it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct DdsTopic {
    pub(super) name: String,
    type_name: String,
}

impl DdsTopic {
    /// Of a ROS topic and its type `package/msg/Name`.
    pub(super) fn message(topic: &str, type_name: &str) -> Self {
        Self {
            name: dds_topic_name(topic),
            type_name: dds_type_name(type_name, "msg", ""),
        }
    }

    /// Of the requests to a service of the type `package/srv/Name`.
    pub(super) fn request(service: &str, type_name: &str) -> Self {
        Self {
            name: format!("rq{service}Request"),
            type_name: dds_type_name(type_name, "srv", "_Request"),
        }
    }

    /// Of a service's answers.
    pub(super) fn reply(service: &str, type_name: &str) -> Self {
        Self {
            name: format!("rr{service}Reply"),
            type_name: dds_type_name(type_name, "srv", "_Response"),
        }
    }

    fn create(&self, context: &Context, policies: &QosPolicies) -> Result<Topic, NodeError> {
        let participant = context.domain_participant();
        let (name, type_name) = (self.name.clone(), self.type_name.clone());
        let topic = participant.create_topic(name, type_name, policies, TopicKind::NoKey);
        topic.map_err(|error| self.failed(&error))
    }

    fn failed(&self, error: &dyn std::fmt::Display) -> NodeError {
        NodeError::dds(&self.name, error)
    }
}

/// `package/kind/Name` as DDS calls it.
fn dds_type_name(type_name: &str, kind: &str, suffix: &str) -> String {
    let mut parts = type_name.split('/');
    let package = parts.next().unwrap_or_default();
    let last = parts.next_back().unwrap_or_default();
    format!("{package}::{kind}::dds_::{last}{suffix}_")
}

/// What DDS calls `package/msg/Name`, if it is a ROS message.
pub(super) fn ros_type_name(dds_name: &str) -> Option<String> {
    let (package, last) = dds_name.split_once("::msg::dds_::")?;
    Some(format!("{package}/msg/{}", last.strip_suffix('_')?))
}

/// A topic's absolute name as DDS calls it.
pub(super) fn dds_topic_name(topic: &str) -> String {
    format!("rt{topic}")
}

/// What DDS calls a ROS topic, if it is one.
pub(super) fn ros_topic_name(dds_name: &str) -> Option<&str> {
    dds_name.strip_prefix("rt").filter(|t| t.starts_with('/'))
}

/// Reads one topic.
pub(super) struct RawReader {
    reader: no_key::SimpleDataReader<Vec<u8>, RawAdapter>,
}

impl RawReader {
    pub(super) fn new(
        context: &Context,
        topic: &DdsTopic,
        qos: TopicQos,
    ) -> Result<Self, NodeError> {
        let policies = qos.policies();
        let dds_topic = topic.create(context, &policies)?;
        let subscriber = context.domain_participant().create_subscriber(&policies);
        let subscriber = subscriber.map_err(|error| topic.failed(&error))?;
        let reader = subscriber.create_simple_datareader_no_key(&dds_topic, Some(policies));
        let reader = reader.map_err(|error| topic.failed(&error))?;
        Ok(Self { reader })
    }

    pub(super) fn gid(&self) -> Gid {
        Gid::from(self.reader.guid())
    }

    /// Samples as they arrive, without end; an error is one sample that DDS could not give out.
    pub(super) fn samples(&self) -> impl Stream<Item = Result<RawSample, String>> + '_ {
        self.reader.as_async_stream().map(|result| {
            result
                .map(|change| RawSample {
                    writer: change.writer_guid,
                    sequence_number: change.sequence_number.into(),
                    identity: identity(
                        change.write_options.related_sample_identity(),
                        change.writer_guid,
                        change.sequence_number,
                    ),
                    bytes: change.into_value(),
                })
                .map_err(|error| error.to_string())
        })
    }
}

/// By what an answer is known to be one to this sample. Fast DDS leaves the number out where it is
/// the sample's own.
fn identity(
    asked: Option<SampleIdentity>,
    writer_guid: GUID,
    sequence_number: SequenceNumber,
) -> SampleIdentity {
    let mut identity = asked.unwrap_or(SampleIdentity {
        writer_guid,
        sequence_number,
    });
    if identity.sequence_number == SequenceNumber::UNKNOWN {
        identity.sequence_number = sequence_number;
    }
    identity
}

/// What became of a message that was to be written.
#[derive(Debug)]
pub(super) enum Written {
    /// It is on its way.
    Sent,
    /// Readers have not yet acknowledged as many as the writer keeps; the message comes back.
    WindowFull(Bytes),
    /// DDS refused it.
    Failed(String),
}

/// Writes one topic.
pub(super) struct RawWriter {
    writer: no_key::DataWriter<Bytes, RawAdapter>,
}

impl RawWriter {
    pub(super) fn new(
        context: &Context,
        topic: &DdsTopic,
        qos: TopicQos,
    ) -> Result<Self, NodeError> {
        let policies = qos.policies();
        let dds_topic = topic.create(context, &policies)?;
        let publisher = context.domain_participant().create_publisher(&policies);
        let publisher = publisher.map_err(|error| topic.failed(&error))?;
        let writer = publisher.create_datawriter_no_key(&dds_topic, Some(policies));
        let writer = writer.map_err(|error| topic.failed(&error))?;
        Ok(Self { writer })
    }

    pub(super) fn gid(&self) -> Gid {
        Gid::from(self.writer.guid())
    }

    /// Readers that the writer has come to know since it was asked last: what is written from now on
    /// reaches them.
    pub(super) fn newly_matched(&self) -> Vec<GUID> {
        let events = std::iter::from_fn(|| self.writer.try_recv_status());
        let matched = events.filter_map(|event| match event {
            DataWriterStatus::PublicationMatched {
                current, reader, ..
            } if current.count_change() > 0 => Some(reader),
            _ => None,
        });
        matched.collect()
    }

    /// Writes a serialised message with its encapsulation header; never blocks.
    pub(super) fn write(&self, message: Bytes) -> Written {
        self.write_with(message, WriteOptions::from(Some(Timestamp::now())))
    }

    /// The same as an answer to the request `identity`, for one reader where it is known.
    pub(super) fn answer(
        &self,
        message: Bytes,
        identity: SampleIdentity,
        reader: Option<GUID>,
    ) -> Written {
        let mut options = WriteOptionsBuilder::new()
            .source_timestamp(Timestamp::now())
            .related_sample_identity(identity);
        if let Some(reader) = reader {
            options = options.to_single_reader(reader);
        }
        self.write_with(message, options.build())
    }

    fn write_with(&self, message: Bytes, options: WriteOptions) -> Written {
        match self.writer.write_with_options(message, options) {
            Ok(_) => Written::Sent,
            Err(rustdds::dds::WriteError::WouldBlock { data }) => Written::WindowFull(data),
            Err(error) => Written::Failed(error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_to_dds_and_back() {
        let topic = DdsTopic::message("/a/b", "sensor_msgs/msg/Image");
        assert_eq!(topic.type_name, "sensor_msgs::msg::dds_::Image_");
        let back = ros_type_name(&topic.type_name);
        assert_eq!(back.unwrap(), "sensor_msgs/msg/Image");
        let request = DdsTopic::request("/a/set", "std_srvs/srv/Trigger");
        assert_eq!(request.name, "rq/a/setRequest");
        assert_eq!(request.type_name, "std_srvs::srv::dds_::Trigger_Request_");
        let reply = DdsTopic::reply("/a/set", "std_srvs/srv/Trigger");
        assert_eq!(reply.name, "rr/a/setReply");
        assert_eq!(reply.type_name, "std_srvs::srv::dds_::Trigger_Response_");
        assert_eq!(ros_type_name("sensor_msgs::srv::dds_::X_"), None);
        assert_eq!(ros_topic_name(&dds_topic_name("/a/b")), Some("/a/b"));
        assert_eq!(ros_topic_name("rq/a/bRequest"), None);
        assert_eq!(ros_topic_name("rtfoo"), None);
    }

    #[test]
    fn bytes_pass_unchanged_with_their_header() {
        let body = [1, 2, 3];
        let received = RawAdapter
            .decode_bytes(&body, RepresentationIdentifier::CDR_BE)
            .unwrap();
        assert_eq!(received, [0, 0, 0, 0, 1, 2, 3]);
        let sent = RawAdapter::to_bytes(&Bytes::from(vec![0, 1, 0, 0, 9])).unwrap();
        assert_eq!(sent[..], [9]);
        let short = RawAdapter::to_bytes(&Bytes::from(vec![0, 1])).unwrap();
        assert!(short.is_empty());
    }
}
