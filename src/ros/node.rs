//! The node: everything put together, from start to a clean end.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ros2_client::{Context, Node, NodeName, NodeOptions};
use rustdds::RTPSEntity;
use rustdds::bytes::Bytes;
use smol::LocalExecutor;
use smol::channel::Receiver as Stop;

use crate::config::Config;
use crate::publish::PublishParams;
use crate::wire::Message;
use crate::wire::log::Log;

use super::clock::RosClock;
use super::control::Control;
use super::engine::{Engine, Shared};
use super::env::Network;
use super::error::NodeError;
use super::graph::{self, EntityList};
use super::http;
use super::inbox::{Inbox, InboxLimits};
use super::inputs::{self, Chooser, Input};
use super::lifecycle::Transition;
use super::monitor::{GraphView, Monitor, Watched};
use super::names::NameResolver;
use super::output::{OutputParams, OutputState, Outputs};
use super::receive::Receiving;
use super::rosout::LogLines;
use super::security::Security;
use super::services::Services;
use super::static_peers::{Announcing, Listener};
use super::transport::{DdsTopic, RawWriter, TopicQos};
use super::{socket_buffer, transport};

/// How often the graph is looked at.
const LOOK_PERIOD: Duration = Duration::from_millis(100);
/// After a change of the graph, how long our list of readers and writers is sent again.
const RESEND: Duration = Duration::from_secs(3);

/// How long the end waits for what is being published.
const PATIENCE: Duration = Duration::from_millis(500);

/// What a node is made of.
#[derive(Clone, Debug)]
pub struct NodeSetup {
    /// All settings.
    pub config: Config,
    /// Its name, and names as remapped.
    pub names: NameResolver,
    /// Whom it can hear.
    pub network: Network,
    /// Who it is among secured peers, where security is asked for.
    pub security: Option<Security>,
    /// What goes to `/rosout`; `None`: nothing.
    pub log_lines: Option<LogLines>,
}

/// Runs the node until a word comes on `stop`.
///
/// # Errors
/// [`NodeError`] when it cannot start.
pub fn run(setup: &NodeSetup, stop: &Stop<()>) -> Result<(), NodeError> {
    Running::start(setup)?.until(setup, stop)
}

struct Running {
    node: Node,
    context: Context,
    control: Arc<Control>,
    receiving: Receiving,
    clock: Arc<RosClock>,
    inputs: Vec<Input>,
    entities: Arc<EntityList>,
    output: Arc<OutputState>,
    publishing: std::thread::JoinHandle<()>,
    announcing: Option<Announcing>,
    /// What the environment asks for and cannot be had.
    notes: Vec<String>,
}

impl Running {
    fn start(setup: &NodeSetup) -> Result<Self, NodeError> {
        let (names, config) = (&setup.names, &setup.config);
        let inputs = inputs::inputs(names, config)?;
        let network = &setup.network;
        let (listener, unknown) = Listener::new(network.domain_id, &network.static_peers)?;
        let notes = [&network.notes[..], &unknown].concat();
        for note in &notes {
            tracing::warn!("{note}");
        }
        let (context, node) = make_node(setup)?;
        let member = context.domain_participant().guid();
        let announcing = listener.map(|l| l.announce(member)).transpose()?;
        let entities = Arc::new(EntityList::new(&context, &names.node().fully_qualified())?);
        let capacities: Vec<usize> = inputs.iter().map(|input| input.queue_size).collect();
        let limits = InboxLimits {
            max_bytes: bytes_from_mb(config.node.queue_mb),
            max_message_bytes: config.node.limits.message_bytes,
            max_writers: config.node.limits.writers,
        };
        let inbox = Arc::new(Inbox::new(&capacities, limits));
        let clock = Arc::new(RosClock::new(config.node.use_sim_time));
        // The time of the start tells one run of the node from another.
        let session = u64::try_from(RosClock::new(false).now().as_nanos()).unwrap_or(0);
        let shared = Arc::new(Shared::new(config.clone(), Arc::clone(&inbox), session));
        let engine = Engine::start(Arc::clone(&shared), &inputs)?;
        if let Some(address) = http::start(&shared)? {
            tracing::info!("serves the scan on http://{address}/scan.glb");
        }
        let receiving = Receiving::start(
            &context,
            Arc::clone(&entities),
            Arc::clone(&inbox),
            Arc::clone(&clock),
        )?;
        if clock.is_simulated() {
            receiving.subscribe_clock(&names.resolve("/clock")?)?;
        }
        let output = Arc::new(OutputState::new(config.node.publish_rate_mb * 1e6));
        let params = OutputParams {
            depth: config.node.publish_depth,
            max_readers: config.node.limits.readers,
            publish: PublishParams {
                history_messages: config.node.publish_depth,
                ..config.publish
            },
        };
        let outputs = Outputs::new(&context, names, &entities, params, Arc::clone(&output))?;
        let publishing = std::thread::Builder::new()
            .name("veneer-publish".to_owned())
            .spawn({
                let shared = Arc::clone(&shared);
                move || outputs.run(&shared.painted)
            })
            .map_err(|source| NodeError::System {
                what: "the thread that publishes",
                source,
            })?;
        let control = Arc::new(Control::new(shared, engine, Arc::clone(&output)));
        Ok(Self {
            node,
            context,
            control,
            receiving,
            clock,
            inputs,
            entities,
            output,
            publishing,
            announcing,
            notes,
        })
    }

    fn until(mut self, setup: &NodeSetup, stop: &Stop<()>) -> Result<(), NodeError> {
        let spinner = self
            .node
            .spinner()
            .map_err(|e| NodeError::dds("the node's spinner", &e))?;
        let executor = LocalExecutor::new();
        let spinning = executor.spawn(async move {
            if let Err(error) = spinner.spin().await {
                tracing::error!("the node's spinner ended: {error}");
            }
        });
        let services = Services::new(
            &mut self.node,
            &setup.names,
            &self.context,
            &self.entities,
            &executor,
            Arc::clone(&self.control),
        );
        services.offer_all(Arc::clone(&self.clock))?;
        let graph_view = Arc::new(GraphView::default());
        let watched = Watched {
            control: Arc::clone(&self.control),
            output: Arc::clone(&self.output),
            graph: Arc::clone(&graph_view),
            clock: Arc::clone(&self.clock),
            inputs: self.inputs.clone(),
            socket_remedy: socket_remedy(),
            notes: self.notes.clone(),
        };
        let monitor = Monitor::new(&self.context, &setup.names, &self.entities, watched)?;
        let monitoring = executor.spawn(monitor.run());
        let logging = match &setup.log_lines {
            Some(lines) => Some(executor.spawn(self.log(setup, lines.clone())?)),
            None => None,
        };
        if setup.config.node.autostart {
            self.control.change(Transition::Configure);
            self.control.change(Transition::Activate);
        }
        let watcher = GraphWatcher {
            context: &self.context,
            receiving: &self.receiving,
            inputs: &self.inputs,
            max_publishers: setup.config.node.limits.publishers,
            entities: &self.entities,
            view: &graph_view,
        };
        smol::block_on(executor.run(async {
            let stopped = async {
                // A closed channel is a word to stop as well.
                stop.recv().await.ok();
            };
            futures::future::select(Box::pin(stopped), Box::pin(watcher.run())).await;
        }));
        drop((spinning, monitoring, logging, executor));
        self.stop(setup);
        Ok(())
    }

    /// Publishes what is said, without end.
    fn log(
        &self,
        setup: &NodeSetup,
        lines: LogLines,
    ) -> Result<impl Future<Output = ()> + 'static, NodeError> {
        let topic = setup.names.resolve("/rosout")?;
        // As rclcpp's: late joiners get the last thousand lines.
        let qos = TopicQos {
            is_reliable: true,
            is_latched: true,
            depth: 1000,
        };
        let writer = RawWriter::new(
            &self.context,
            &DdsTopic::message(&topic, Log::TYPE_NAME),
            qos,
        )?;
        self.entities.add_writer(writer.gid());
        let name = setup.names.node().fully_qualified();
        let name = name.trim_start_matches('/').replace('/', ".");
        let clock = Arc::clone(&self.clock);
        Ok(async move {
            while let Some(line) = lines.next().await {
                let message = line.message(clock.now(), &name).encode();
                // What goes wrong with the log cannot go to the log.
                drop(writer.write(Bytes::from(message)));
            }
        })
    }

    fn stop(self, setup: &NodeSetup) {
        let Self {
            node,
            context,
            control,
            receiving,
            publishing,
            announcing,
            ..
        } = self;
        control.shared.inbox.set_open(false);
        drop(receiving);
        if let Some(path) = &setup.config.node.save_on_shutdown {
            match control.save(path) {
                Ok(done) => tracing::info!("saved {done}"),
                Err(error) => tracing::error!("nothing was saved: {error}"),
            }
        }
        control.shared.shut();
        // It may be making the messages of a large scan, which nobody will get.
        let begun = Instant::now();
        while !publishing.is_finished() && begun.elapsed() < PATIENCE {
            std::thread::sleep(PATIENCE / 100);
        }
        if publishing.is_finished() && publishing.join().is_err() {
            tracing::error!("the thread that publishes has panicked");
        }
        drop(control);
        drop(node);
        drop(context);
        // Its last word is that the participant is gone.
        drop(announcing);
        tracing::info!("stopped");
    }
}

fn make_node(setup: &NodeSetup) -> Result<(Context, Node), NodeError> {
    let participant = transport::participant(&setup.network, setup.security.as_ref())?;
    let context = Context::from_domain_participant(participant)
        .map_err(|e| NodeError::dds("the ROS context", &e))?;
    let identity = setup.names.node();
    let name = NodeName::new(identity.namespace(), identity.base_name())
        .map_err(|e| NodeError::dds("the node's name", &e))?;
    // The library's own parameter services know neither ranges nor descriptions, and its log
    // would come back to ours.
    let options = NodeOptions::new()
        .enable_rosout(false)
        .start_parameter_services(false);
    let node = context
        .new_node(name, options)
        .map_err(|e| NodeError::dds("the node", &e))?;
    Ok((context, node))
}

fn socket_remedy() -> Option<String> {
    match socket_buffer::granted_bytes() {
        Ok(granted) => socket_buffer::remedy(granted),
        Err(error) => Some(format!("the socket buffer could not be checked: {error}")),
    }
}

/// Subscribes as publishers show up.
struct GraphWatcher<'a> {
    context: &'a Context,
    receiving: &'a Receiving,
    inputs: &'a [Input],
    max_publishers: usize,
    entities: &'a EntityList,
    view: &'a GraphView,
}

impl GraphWatcher<'_> {
    async fn run(&self) {
        let mut chooser = Chooser::new(self.inputs);
        let mut num_seen = 0;
        let mut changed_at = Instant::now();
        let mut sent_at = None;
        loop {
            let offers = graph::offers(self.context, self.inputs, self.max_publishers);
            for choice in chooser.update(Instant::now(), &offers) {
                self.subscribe(&choice);
                changed_at = Instant::now();
            }
            if offers.len() != num_seen {
                num_seen = offers.len();
                changed_at = Instant::now();
            }
            let is_fresh = changed_at.elapsed() < RESEND;
            let is_due = sent_at.is_none_or(|at: Instant| at.elapsed() >= RESEND / 6);
            if is_fresh && is_due {
                self.entities.publish(self.context);
                sent_at = Some(Instant::now());
            }
            let mut complaints = inputs::complaints(self.inputs, &chooser, &offers);
            if offers.len() >= self.max_publishers {
                complaints.push(format!(
                    "the inputs have {} publishers or more, and no more are looked at: raise limits.publishers",
                    offers.len()
                ));
            }
            self.view.set(offers, complaints);
            smol::Timer::after(LOOK_PERIOD).await;
        }
    }

    fn subscribe(&self, choice: &inputs::Choice) {
        let topic = &self.inputs[choice.input].topic;
        match self.receiving.subscribe(self.inputs, choice) {
            Ok(()) => {
                let type_name = choice.message_type.name();
                let how = if choice.qos.is_reliable {
                    "reliable"
                } else {
                    "best effort"
                };
                tracing::info!("reads {topic} as {type_name} ({how})");
            }
            Err(error) => tracing::error!("{error}"),
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to int casts saturate, as meant for a limit"
)]
fn bytes_from_mb(mb: f64) -> usize {
    (mb * 1e6) as usize
}
