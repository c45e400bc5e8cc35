//! The inbox as a source of events: what a bag is to replay, this is to the node. The same
//! decoders turn the same bytes into the same events.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use crate::ingest::{Event, EventSource, Rejection, TimedEvent};
use crate::wire::camera_info::Rectification;
use crate::wire::event::MessageType;
use crate::wire::{EventDecoder, TopicRole};

use super::inbox::{Inbox, Taken, Waiting};
use super::inputs::Input;

/// How long [`EventSource::next_event`] sleeps at a time.
const LONG: Duration = Duration::from_secs(3600);

/// What [`LiveSource::poll`] found.
#[derive(Debug)]
pub enum Polled {
    /// The next event.
    Event(Box<TimedEvent>),
    /// A message that says nothing, or that somebody wants the reader to look elsewhere.
    Nothing,
    /// Nothing came in time.
    Idle,
    /// Nothing will come any more.
    End,
}

/// Decodes what waits in an [`Inbox`], in the order of its arrival, on the thread that asks.
#[derive(Debug)]
pub struct LiveSource {
    inbox: Arc<Inbox>,
    topics: Vec<String>,
    roles: Vec<Vec<TopicRole>>,
    rectification: Rectification,
    mesh_frame: Option<String>,
    /// By topic and type: a topic's type is known when its first message comes.
    decoders: BTreeMap<(usize, MessageType), Vec<EventDecoder>>,
    ready: VecDeque<TimedEvent>,
    scratch: Vec<Result<Event, Rejection>>,
}

impl LiveSource {
    /// A source over the inbox of `inputs`, topic by topic.
    pub fn new(inbox: Arc<Inbox>, inputs: &[Input], mesh_frame: Option<&str>) -> Self {
        Self {
            inbox,
            topics: inputs.iter().map(|input| input.topic.clone()).collect(),
            roles: inputs.iter().map(|input| input.roles.clone()).collect(),
            rectification: Rectification::Raw,
            mesh_frame: mesh_frame.map(str::to_owned),
            decoders: BTreeMap::new(),
            ready: VecDeque::new(),
            scratch: Vec::new(),
        }
    }

    /// The next event, waited for until `timeout`.
    pub fn poll(&mut self, timeout: Duration) -> Polled {
        if let Some(event) = self.ready.pop_front() {
            return Polled::Event(Box::new(event));
        }
        match self.inbox.take(timeout) {
            Taken::Message(message) => {
                self.decode(&message);
                match self.ready.pop_front() {
                    Some(event) => Polled::Event(Box::new(event)),
                    None => Polled::Nothing,
                }
            }
            Taken::Woken => Polled::Nothing,
            Taken::Idle => Polled::Idle,
            Taken::Shut => Polled::End,
        }
    }

    /// Forgets what decoders remember of earlier messages.
    pub fn reset(&mut self) {
        self.decoders.clear();
        self.ready.clear();
    }

    fn decode(&mut self, message: &Waiting) {
        let (topic, message_type) = (message.topic, message.message_type);
        let (Some(name), Some(roles)) = (self.topics.get(topic), self.roles.get(topic)) else {
            return;
        };
        let (rectification, mesh_frame) = (self.rectification, self.mesh_frame.as_deref());
        let decoders = self
            .decoders
            .entry((topic, message_type))
            .or_insert_with(|| {
                let of_role = |role: &TopicRole| {
                    let decoder = EventDecoder::new(name, message_type, *role)?;
                    let decoder = decoder.with_rectification(rectification);
                    Some(decoder.with_mesh_frame(mesh_frame))
                };
                roles.iter().filter_map(of_role).collect()
            });
        for decoder in decoders {
            decoder.decode(message.received, &message.bytes, &mut self.scratch);
            self.ready
                .extend(self.scratch.drain(..).map(|event| TimedEvent {
                    received: message.received,
                    topic,
                    event,
                }));
        }
    }
}

impl EventSource for LiveSource {
    fn topics(&self) -> &[String] {
        &self.topics
    }

    fn next_event(&mut self) -> Option<TimedEvent> {
        loop {
            match self.poll(LONG) {
                Polled::Event(event) => return Some(*event),
                Polled::Nothing | Polled::Idle => {}
                Polled::End => return None,
            }
        }
    }

    fn losses(&self) -> &[String] {
        // What is lost here is counted by topic, in the inbox.
        &[]
    }
}
