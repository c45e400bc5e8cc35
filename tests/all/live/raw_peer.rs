//! A peer in Rust for what no package on PyPI has: transforms and meshes of the mesh packages.
//! Sends a bag's messages byte for byte.

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

pub(crate) struct RawPeer {
    participant: DomainParticipant,
    writers: Vec<no_key::DataWriter<Vec<u8>, Raw>>,
}

impl RawPeer {
    pub(crate) fn new(domain: u16) -> Self {
        let builder = DomainParticipantBuilder::new(domain);
        let builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
        Self {
            participant: builder.build().unwrap(),
            writers: Vec::new(),
        }
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
