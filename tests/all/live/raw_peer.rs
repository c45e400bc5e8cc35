//! A peer in Rust for what no package on PyPI has: transforms, and the messages and services of the
//! mesh packages. Sends and receives bytes.

use std::convert::Infallible;
use std::net::Ipv4Addr;
use std::path::Path;
use std::time::{Duration, Instant};

use rustdds::bytes::Bytes;
use rustdds::policy::{Durability, History};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicyBuilder, RepresentationIdentifier,
    TopicKind, no_key,
};

pub(crate) struct Raw;

impl no_key::SerializerAdapter<Vec<u8>> for Raw {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(message: &Vec<u8>) -> Result<Bytes, Infallible> {
        Ok(Bytes::copy_from_slice(&message[4..]))
    }
}

impl no_key::DeserializerAdapter<Vec<u8>> for Raw {
    type Error = Infallible;
    type Decoded = Vec<u8>;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Vec<u8>) -> Vec<u8> {
        decoded
    }
}

#[derive(Clone)]
pub(crate) struct Bytewise;

impl no_key::DefaultDecoder<Vec<u8>> for Raw {
    type Decoder = Bytewise;
    const DECODER: Bytewise = Bytewise;
}

impl no_key::Decode<'_, Vec<u8>> for Bytewise {
    type Error = Infallible;

    fn decode_bytes(self, body: &[u8], _: RepresentationIdentifier) -> Result<Vec<u8>, Infallible> {
        Ok([&[0, 1, 0, 0], body].concat())
    }
}

/// A client of one service.
pub(crate) struct RawClient {
    requests: no_key::DataWriter<Vec<u8>, Raw>,
    answers: no_key::DataReader<Vec<u8>, Raw>,
}

impl RawClient {
    /// Sends a request; the answer, where one comes within `wait`.
    pub(crate) fn call(&mut self, request: Vec<u8>, wait: Duration) -> Option<Vec<u8>> {
        self.requests.write(request, None).unwrap();
        let deadline = Instant::now() + wait;
        while Instant::now() < deadline {
            if let Some(sample) = self.answers.take_next_sample().unwrap() {
                return Some(sample.into_value());
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        None
    }
}

pub(crate) struct RawPeer {
    participant: DomainParticipant,
    writers: Vec<no_key::DataWriter<Vec<u8>, Raw>>,
}

impl RawPeer {
    pub(crate) fn new(domain: u16) -> Self {
        Self::of(DomainParticipantBuilder::new(domain))
    }

    fn of(builder: DomainParticipantBuilder) -> Self {
        let builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
        Self {
            participant: builder.build().unwrap(),
            writers: Vec::new(),
        }
    }

    /// A client of `service`, of the type `package/srv/Name`, once its server is there.
    pub(crate) fn client(&self, service: &str, type_name: &str) -> RawClient {
        let (package, name) = type_name.split_once("/srv/").unwrap();
        let qos = QosPolicyBuilder::new()
            .reliable(rustdds::Duration::from_millis(500))
            .history(History::KeepLast { depth: 10 })
            .build();
        let topic = |dds_name: String, part: &str| {
            let type_name = format!("{package}::srv::dds_::{name}_{part}_");
            let made = self
                .participant
                .create_topic(dds_name, type_name, &qos, TopicKind::NoKey);
            made.unwrap()
        };
        let requests = topic(format!("rq{service}Request"), "Request");
        let answers = topic(format!("rr{service}Reply"), "Response");
        let publisher = self.participant.create_publisher(&qos).unwrap();
        let subscriber = self.participant.create_subscriber(&qos).unwrap();
        let client = RawClient {
            requests: publisher
                .create_datawriter_no_key(&requests, Some(qos.clone()))
                .unwrap(),
            answers: subscriber
                .create_datareader_no_key(&answers, Some(qos.clone()))
                .unwrap(),
        };
        let deadline = Instant::now() + Duration::from_secs(15);
        let is_served = || {
            let readers = self.participant.discovered_readers();
            let mut topics = readers
                .iter()
                .map(|r| r.subscription_topic_data.topic_name());
            topics.any(|name| *name == format!("rq{service}Request"))
        };
        while !is_served() {
            assert!(Instant::now() < deadline, "nobody serves {service}");
            std::thread::sleep(Duration::from_millis(20));
        }
        std::thread::sleep(Duration::from_millis(300));
        client
    }

    /// Sends all messages of `bag` on `topic`, reliable and latched, once somebody listens to
    /// `to`; how many.
    pub(crate) fn send(&mut self, bag: &Path, topic: &str, to: &str) -> usize {
        let file = std::fs::read(bag).unwrap();
        let messages: Vec<_> = mcap::MessageStream::new(&file)
            .unwrap()
            .map(Result::unwrap)
            .filter(|message| message.channel.topic == topic)
            .collect();
        let type_name = &messages[0].channel.schema.as_ref().unwrap().name;
        let (package, name) = type_name.split_once("/msg/").unwrap();
        let qos = QosPolicyBuilder::new()
            .reliable(rustdds::Duration::from_millis(500))
            .durability(Durability::TransientLocal)
            .history(History::KeepLast { depth: 1000 })
            .build();
        let dds_name = format!("rt{to}");
        let topic = self
            .participant
            .create_topic(
                dds_name.clone(),
                format!("{package}::msg::dds_::{name}_"),
                &qos,
                TopicKind::NoKey,
            )
            .unwrap();
        let publisher = self.participant.create_publisher(&qos).unwrap();
        let writer = publisher
            .create_datawriter_no_key::<Vec<u8>, Raw>(&topic, Some(qos))
            .unwrap();
        let deadline = Instant::now() + Duration::from_secs(15);
        let is_heard = || {
            let readers = self.participant.discovered_readers();
            let mut topics = readers
                .iter()
                .map(|r| r.subscription_topic_data.topic_name());
            topics.any(|name| *name == dds_name)
        };
        while !is_heard() {
            assert!(Instant::now() < deadline, "nobody listens to {to}");
            std::thread::sleep(Duration::from_millis(20));
        }
        std::thread::sleep(Duration::from_millis(300));
        for message in &messages {
            writer.write(message.data.to_vec(), None).unwrap();
        }
        self.writers.push(writer);
        messages.len()
    }
}
