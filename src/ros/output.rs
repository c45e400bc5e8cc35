//! The thread that publishes: what was painted last becomes messages, and they go out at a byte
//! rate, topic by topic in turn.
//!
//! A topic that nobody listens to costs nothing. Each output has its own [`Publisher`] and its own
//! queue, the messages of one revision; while they go out, newer paintings coalesce. A reader that
//! does not acknowledge fills its topic's window of `publish.depth` messages: the topic then waits
//! for it, the others go on, and the memory held is that window. The wait ends when the reader
//! reads, or when its lease ends.
//!
//! Late joiners get the window by `transient_local`: [`Publisher`] sees to it that it holds a whole
//! state. Those who do not ask for what was before (rviz2 does not) get the whole published again.
//! Where even the whole is longer than the window, it is published again for them.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use ros2_client::Context;
use rustdds::GUID;
use rustdds::bytes::Bytes;

use crate::pipeline::Latest;
use crate::publish::{OutputTopic, PublishParams, Publisher};

use super::engine::Painting;
use super::error::NodeError;
use super::graph::{self, EntityList};
use super::names::NameResolver;
use super::pacer::Pacer;
use super::server::MAX_LOCAL_BYTES;
use super::transport::{DdsTopic, RawWriter, TopicQos, Written};

/// How often readers are looked for.
const LOOK_PERIOD: Duration = Duration::from_millis(100);
/// Time in which a reader that we have found has found us: what is sent before is lost on it,
/// unless it asks for what was before.
const MATCH_TIME: Duration = Duration::from_millis(700);
/// How long a topic whose window is full is left alone.
const WINDOW_RETRY: Duration = Duration::from_millis(20);
/// How long this thread works before it looks at what is new.
const SLICE: Duration = Duration::from_millis(50);

/// What went out on a topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OutputCounts {
    /// The topic's absolute name.
    pub topic: String,
    /// Who listens.
    pub num_readers: usize,
    /// Messages handed to DDS.
    pub num_messages: u64,
    /// Their bytes.
    pub num_bytes: u64,
    /// Messages that are made and not yet sent.
    pub num_pending: usize,
    /// Revisions that a newer one replaced before a message of them was made.
    pub num_superseded: u64,
    /// Messages of the last whole state.
    pub num_whole: usize,
    /// Messages that DDS refused.
    pub num_failed: u64,
    /// Since when a reader does not acknowledge, if one does not.
    pub lagging_since: Option<Instant>,
    /// The revision that was handed over last.
    pub revision: Option<u64>,
}

struct Output {
    topic: OutputTopic,
    name: String,
    writer: RawWriter,
    publisher: Publisher,
    pending: VecDeque<Bytes>,
    readers: BTreeMap<GUID, bool>,
    /// The revision whose messages were made last.
    made: Option<u64>,
    needs_whole: bool,
    /// When a reader that came late, and does not ask for what was before, will have found us.
    whole_at: Option<Instant>,
    retry_at: Option<Instant>,
    counts: OutputCounts,
}

/// What the thread that publishes shares with the rest.
#[derive(Debug)]
pub(super) struct OutputState {
    counts: Mutex<BTreeMap<OutputTopic, OutputCounts>>,
    is_active: AtomicBool,
    bytes_per_s: Mutex<f64>,
}

impl OutputState {
    /// Nothing is published yet; then at this rate, all topics together.
    pub(super) fn new(bytes_per_s: f64) -> Self {
        Self {
            counts: Mutex::default(),
            is_active: AtomicBool::new(false),
            bytes_per_s: Mutex::new(bytes_per_s),
        }
    }

    fn rate(&self) -> MutexGuard<'_, f64> {
        self.bytes_per_s
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// From now on another rate.
    pub(super) fn set_rate(&self, bytes_per_s: f64) {
        *self.rate() = bytes_per_s;
    }

    /// The counts of all outputs.
    pub(super) fn counts(&self) -> Vec<OutputCounts> {
        let counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        counts.values().cloned().collect()
    }

    /// Whether anything is published.
    pub(super) fn set_active(&self, is_active: bool) {
        self.is_active.store(is_active, Ordering::Relaxed);
    }
}

/// Settings of the thread that publishes.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutputParams {
    /// Messages that each topic keeps.
    pub(super) depth: usize,
    /// Readers of a topic that are told apart.
    pub(super) max_readers: usize,
    /// How messages are made.
    pub(super) publish: PublishParams,
}

fn params_of(topic: OutputTopic, params: PublishParams) -> PublishParams {
    match topic {
        OutputTopic::MeshGeometry | OutputTopic::MeshMaterials => mesh_params(params),
        _ => params,
    }
}

/// How meshes of mesh_msgs are made: on topics and by services they must be the same, and a
/// service's answers are short.
pub(super) fn mesh_params(params: PublishParams) -> PublishParams {
    PublishParams {
        max_message_bytes: params.max_message_bytes.min(MAX_LOCAL_BYTES),
        ..params
    }
}

/// All outputs.
pub(super) struct Outputs {
    context: Context,
    outputs: Vec<Output>,
    params: OutputParams,
    pacer: Pacer,
    state: Arc<OutputState>,
    current: Option<Arc<Painting>>,
    looked_at: Option<Instant>,
}

impl Outputs {
    pub(super) fn new(
        context: &Context,
        names: &NameResolver,
        entities: &EntityList,
        params: OutputParams,
        state: Arc<OutputState>,
    ) -> Result<Self, NodeError> {
        let qos = TopicQos {
            is_reliable: true,
            is_latched: true,
            depth: params.depth,
        };
        let mut outputs = Vec::new();
        for topic in OutputTopic::ALL {
            let name = names.resolve(&format!("~/{}", topic.name()))?;
            let writer =
                RawWriter::new(context, &DdsTopic::message(&name, topic.type_name()), qos)?;
            entities.add_writer(writer.gid());
            outputs.push(Output {
                topic,
                counts: OutputCounts {
                    topic: name.clone(),
                    ..OutputCounts::default()
                },
                name,
                writer,
                publisher: Publisher::new(params_of(topic, params.publish)),
                pending: VecDeque::new(),
                readers: BTreeMap::new(),
                made: None,
                needs_whole: false,
                whole_at: None,
                retry_at: None,
            });
        }
        let bytes_per_s = *state.rate();
        Ok(Self {
            context: context.clone(),
            outputs,
            params,
            pacer: Pacer::new(bytes_per_s, Instant::now()),
            state,
            current: None,
            looked_at: None,
        })
    }

    /// Publishes what `painted` brings until it is shut.
    pub(super) fn run(mut self, painted: &Latest<Arc<Painting>>) {
        while !painted.is_shut() {
            let has_work = self.outputs.iter().any(|output| !output.pending.is_empty());
            let wait = if has_work {
                Duration::ZERO
            } else {
                LOOK_PERIOD
            };
            if let Some(new) = painted.take(wait) {
                self.note_superseded();
                self.current = Some(new);
            }
            let now = Instant::now();
            if self.looked_at.is_none_or(|at| now - at >= LOOK_PERIOD) {
                self.looked_at = Some(now);
                self.look_for_readers();
            }
            self.pacer.set_rate(*self.state.rate(), now);
            if self.state.is_active.load(Ordering::Relaxed) {
                self.make_messages();
                self.send(now + SLICE);
            } else if has_work {
                std::thread::sleep(SLICE);
            }
            self.report();
        }
    }

    /// The current painting goes; outputs that have not made messages of it never will.
    fn note_superseded(&mut self) {
        let Some(current) = &self.current else {
            return;
        };
        let revision = current.revision;
        for output in &mut self.outputs {
            let is_missed = !output.readers.is_empty() && output.made != Some(revision);
            output.counts.num_superseded += u64::from(is_missed);
        }
    }

    fn look_for_readers(&mut self) {
        for output in &mut self.outputs {
            let readers = graph::readers(&self.context, &output.name, self.params.max_readers);
            let is_new = |reader: &GUID| !output.readers.contains_key(reader);
            let has_new = readers.keys().any(is_new);
            let has_new_volatile = readers
                .iter()
                .any(|(r, is_latched)| !is_latched && is_new(r));
            if has_new_volatile && output.whole_at.is_none() {
                output.whole_at = Some(Instant::now() + MATCH_TIME);
            }
            // What late joiners need may have left the window.
            let num_messages = output.publisher.num_messages_since_whole(output.topic);
            output.needs_whole |= has_new && num_messages > self.params.depth;
            output.readers = readers;
        }
    }

    fn make_messages(&mut self) {
        let Some(painting) = self.current.clone() else {
            return;
        };
        let (revision, snapshot) = (painting.revision, painting.snapshot());
        for output in &mut self.outputs {
            match output.whole_at {
                Some(at) if Instant::now() < at => continue,
                Some(_) => output.needs_whole = true,
                None => {}
            }
            output.whole_at = None;
            let is_due = output.made != Some(revision) || output.needs_whole;
            if output.readers.is_empty() || !output.pending.is_empty() || !is_due {
                continue;
            }
            if output.needs_whole {
                // A publisher that has sent nothing sends the whole, of this revision too.
                output.publisher = Publisher::new(params_of(output.topic, self.params.publish));
                output.needs_whole = false;
            }
            output.made = Some(revision);
            let topic = output.topic;
            match output.publisher.publish(&snapshot, &|t| t == topic) {
                Ok(messages) => {
                    if output.publisher.num_messages_since_whole(topic) == messages.len() {
                        output.counts.num_whole = messages.len();
                    }
                    output
                        .pending
                        .extend(messages.into_iter().map(|m| Bytes::from(m.bytes)));
                }
                Err(error) => {
                    output.counts.num_failed += 1;
                    tracing::error!(topic = output.name, "nothing is published: {error}");
                }
            }
        }
    }

    /// Sends in turn until all is sent or `until`.
    fn send(&mut self, until: Instant) {
        loop {
            let now = Instant::now();
            let is_ready = |output: &Output| {
                !output.pending.is_empty() && output.retry_at.is_none_or(|at| at <= now)
            };
            if now >= until || !self.outputs.iter().any(is_ready) {
                break;
            }
            for output in self.outputs.iter_mut().filter(|output| is_ready(output)) {
                let delay = self.pacer.delay(Instant::now());
                if !delay.is_zero() {
                    std::thread::sleep(delay.min(SLICE));
                    break;
                }
                self.pacer.spend(output.send_one());
            }
        }
        let is_waiting = self.outputs.iter().any(|output| output.retry_at.is_some());
        if is_waiting && Instant::now() < until {
            std::thread::sleep(WINDOW_RETRY);
        }
    }

    fn report(&mut self) {
        let mut counts = self
            .state
            .counts
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        for output in &mut self.outputs {
            output.counts.num_readers = output.readers.len();
            output.counts.num_pending = output.pending.len();
            counts.insert(output.topic, output.counts.clone());
        }
    }
}

impl Output {
    /// Sends the next message; its bytes, 0 where it has to wait.
    fn send_one(&mut self) -> usize {
        let Some(message) = self.pending.pop_front() else {
            return 0;
        };
        let num_bytes = message.len();
        match self.writer.write(message) {
            Written::Sent => {
                self.counts.num_messages += 1;
                self.counts.num_bytes += num_bytes as u64;
                self.retry_at = None;
                self.counts.lagging_since = None;
                if self.pending.is_empty() {
                    self.counts.revision = self.made;
                }
                num_bytes
            }
            Written::WindowFull(message) => {
                self.pending.push_front(message);
                let now = Instant::now();
                self.retry_at = Some(now + WINDOW_RETRY);
                self.counts.lagging_since.get_or_insert(now);
                0
            }
            Written::Failed(reason) => {
                self.counts.num_failed += 1;
                tracing::error!(topic = self.name, "a message was not sent: {reason}");
                0
            }
        }
    }
}
