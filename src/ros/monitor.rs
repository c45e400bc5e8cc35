//! Looks at the running node once a second, and tells what it saw.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use ros2_client::Context;
use rustdds::bytes::Bytes;

use crate::wire::event::MessageType;
use crate::wire::{DiagnosticArray, Message, Status};

use super::clock::RosClock;
use super::control::Control;
use super::diagnostics::{self, Finding, InputObservation, Level, Observation};
use super::error::NodeError;
use super::graph::EntityList;
use super::inbox::TopicCounts;
use super::inputs::{Input, Offer};
use super::names::NameResolver;
use super::output::OutputState;
use super::status;
use super::transport::{DdsTopic, RawWriter, TopicQos, Written};

/// How often it is looked whether somebody came to listen.
const NEWCOMER_PERIOD: Duration = Duration::from_millis(100);
/// Newcomers are not told again what is older; rates are over no less.
const STALE_AFTER: Duration = Duration::from_millis(250);

/// What the watcher of the graph leaves for the monitor.
#[derive(Debug, Default)]
pub(super) struct GraphView {
    state: Mutex<(Vec<Offer>, Vec<String>)>,
}

impl GraphView {
    pub(super) fn set(&self, offers: Vec<Offer>, complaints: Vec<String>) {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) = (offers, complaints);
    }

    fn get(&self) -> (Vec<Offer>, Vec<String>) {
        let state = self.state.lock();
        state.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// What is looked at and written to.
pub(super) struct Monitor {
    control: Arc<Control>,
    output: Arc<OutputState>,
    graph: Arc<GraphView>,
    clock: Arc<RosClock>,
    inputs: Vec<Input>,
    socket_remedy: Option<String>,
    notes: Vec<String>,
    node_name: String,
    diagnostics: Telling,
    status: Telling,
    previous: Vec<TopicCounts>,
    previous_at: Instant,
    /// By part: what was seen last, and what the log has.
    seen: BTreeMap<&'static str, String>,
    told: BTreeMap<&'static str, String>,
    /// Since when a topic has publishers.
    published_since: BTreeMap<String, Instant>,
}

/// One of the two topics.
struct Telling {
    writer: RawWriter,
    topic: String,
    /// What was told last.
    last: Bytes,
}

impl Telling {
    fn new(
        context: &Context,
        entities: &EntityList,
        topic: String,
        type_name: &str,
    ) -> Result<Self, NodeError> {
        let qos = TopicQos {
            is_reliable: true,
            is_latched: false,
            depth: 10,
        };
        let writer = RawWriter::new(context, &DdsTopic::message(&topic, type_name), qos)?;
        entities.add_writer(writer.gid());
        Ok(Self {
            writer,
            topic,
            last: Bytes::new(),
        })
    }

    fn tell(&mut self, message: Bytes) {
        if let Written::Failed(reason) = self.writer.write(message.clone()) {
            tracing::debug!("{} was not sent: {reason}", self.topic);
        }
        self.last = message;
    }

    /// Whether somebody began to listen since this was asked last.
    fn has_newcomers(&mut self) -> bool {
        !self.writer.newly_matched().is_empty()
    }

    fn tell_again(&mut self) {
        if !self.last.is_empty() {
            self.tell(self.last.clone());
        }
    }
}

/// What a [`Monitor`] looks at.
pub(super) struct Watched {
    pub(super) control: Arc<Control>,
    pub(super) output: Arc<OutputState>,
    pub(super) graph: Arc<GraphView>,
    pub(super) clock: Arc<RosClock>,
    pub(super) inputs: Vec<Input>,
    pub(super) socket_remedy: Option<String>,
    /// What the environment asks for and cannot be had.
    pub(super) notes: Vec<String>,
}

impl Monitor {
    pub(super) fn new(
        context: &Context,
        names: &NameResolver,
        entities: &EntityList,
        watched: Watched,
    ) -> Result<Self, NodeError> {
        let telling = |topic: &str, type_name| {
            Telling::new(context, entities, names.resolve(topic)?, type_name)
        };
        let diagnostics = telling("/diagnostics", DiagnosticArray::TYPE_NAME)?;
        let status = telling("~/status", Status::TYPE_NAME)?;
        let Watched {
            control,
            output,
            graph,
            clock,
            inputs,
            socket_remedy,
            notes,
        } = watched;
        Ok(Self {
            control,
            output,
            graph,
            clock,
            inputs,
            socket_remedy,
            notes,
            node_name: names.node().fully_qualified(),
            diagnostics,
            status,
            previous: Vec::new(),
            previous_at: Instant::now(),
            seen: BTreeMap::new(),
            told: BTreeMap::new(),
            published_since: BTreeMap::new(),
        })
    }

    /// Tells once in a period, and who comes in between, without end.
    pub(super) async fn run(mut self) {
        loop {
            self.tell();
            let (told_at, num_resets) = (Instant::now(), self.control.shared.num_resets());
            let period_s = self.control.shared.config().node.diagnostics_period_s;
            let due = told_at + Duration::from_secs_f64(period_s);
            loop {
                let left = due.saturating_duration_since(Instant::now());
                if left.is_zero() || self.control.shared.num_resets() != num_resets {
                    break;
                }
                smol::Timer::after(left.min(NEWCOMER_PERIOD)).await;
                let tellings = [&mut self.diagnostics, &mut self.status];
                let mut awaited = tellings.map(|telling| (telling.has_newcomers(), telling));
                let is_any_awaited = awaited.iter().any(|(is_awaited, _)| *is_awaited);
                if is_any_awaited && told_at.elapsed() >= STALE_AFTER {
                    break;
                }
                for (_, telling) in awaited.iter_mut().filter(|(is_awaited, _)| *is_awaited) {
                    telling.tell_again();
                }
            }
        }
    }

    fn tell(&mut self) {
        let (findings, status) = self.look();
        for finding in &findings {
            self.log(finding);
        }
        let message = diagnostics::message(self.clock.now(), &self.node_name, &findings);
        self.diagnostics.tell(Bytes::from(message));
        self.status.tell(Bytes::from(status));
    }

    /// The log has a problem once, not every second, and only when it was there twice in a row;
    /// numbers in it may change.
    fn log(&mut self, finding: &Finding) {
        let class: String = finding
            .message
            .chars()
            .filter(|c| !c.is_ascii_digit())
            .collect();
        let before = self.seen.insert(finding.part, class.clone());
        if before.as_ref() != Some(&class) || self.told.get(finding.part) == Some(&class) {
            return;
        }
        let was_told = self.told.insert(finding.part, class).is_some();
        match finding.level {
            Level::Error => tracing::error!("{}: {}", finding.part, finding.message),
            Level::Warn => tracing::warn!("{}: {}", finding.part, finding.message),
            Level::Ok if was_told => tracing::info!("{}: {}", finding.part, finding.message),
            Level::Ok => {}
        }
    }

    /// For how long each input has had publishers.
    fn published_since(&mut self, offers: &[Offer]) -> Vec<Option<Duration>> {
        let is_offered = |topic: &String| offers.iter().any(|offer| offer.topic == *topic);
        self.published_since.retain(|topic, _| is_offered(topic));
        let mut ages = Vec::new();
        for input in &self.inputs {
            ages.push(is_offered(&input.topic).then(|| {
                let since = self.published_since.entry(input.topic.clone());
                since.or_insert_with(Instant::now).elapsed()
            }));
        }
        ages
    }

    /// What is wrong, and the serialised status.
    fn look(&mut self) -> (Vec<Finding>, Vec<u8>) {
        let control = Arc::clone(&self.control);
        let shared = &control.shared;
        let config = shared.config();
        let (offers, complaints) = self.graph.get();
        let counts = shared.inbox.counts();
        let ages = shared.inbox.ages();
        let now = Instant::now();
        let elapsed_s = now
            .saturating_duration_since(self.previous_at)
            .as_secs_f64();
        let published_since = self.published_since(&offers);
        let inputs = self
            .inputs
            .iter()
            .enumerate()
            .zip(counts.iter().zip(&ages))
            .map(|((at, input), (counts, age))| {
                let before = self.previous.get(at).cloned().unwrap_or_default();
                let num_new = counts.num_received - before.num_received;
                let readable = |offer: &&Offer| {
                    let known = MessageType::from_name(&offer.type_name);
                    offer.topic == input.topic && known.is_some_and(|t| input.types.contains(&t))
                };
                InputObservation {
                    input,
                    num_publishers: offers.iter().filter(readable).count(),
                    published_for: published_since.get(at).copied().flatten(),
                    rate_hz: num_new as f64 / elapsed_s.max(1e-3),
                    age: *age,
                    num_new_drops: num_drops(counts) - num_drops(&before),
                    counts: counts.clone(),
                }
            })
            .collect();
        let capture = shared.view();
        let paint = shared.paint_status();
        let outputs = self.output.counts();
        let journal = shared.journal.status();
        let why_whole = shared.why_whole();
        let seen = Observation {
            state: control.state(),
            is_paused: control.is_paused(),
            now: self.clock.is_running().then(|| self.clock.now()),
            inputs,
            complaints: &complaints,
            capture: capture.as_ref(),
            paint: &paint,
            why_whole: why_whole.as_deref(),
            num_captures_replaced: shared.num_captures_replaced(),
            outputs: &outputs,
            publish_depth: config.node.publish_depth,
            pose_source: config.pipeline.ingest.pose_source,
            transports: [config.node.image_transport, config.node.depth_transport],
            memory_bytes: resident_bytes().unwrap_or(0),
            socket_remedy: self.socket_remedy.as_deref(),
            notes: &self.notes,
            queue_bytes: shared.inbox.num_bytes(),
            journal: journal.as_ref(),
        };
        let findings = diagnostics::findings(&seen);
        let last = shared.last_painted();
        let status = status::message(self.clock.now(), &seen, last.as_deref());
        self.previous = counts;
        self.previous_at = now;
        (findings, status)
    }
}

/// What went without being asked to: a pause drops on purpose.
fn num_drops(counts: &TopicCounts) -> u64 {
    counts.num_dropped_full + counts.num_lost + counts.num_unreadable
}

/// Memory that the process holds, where the system tells.
fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
}
