//! The node: everything put together, from start to a clean end.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ros2_client::{Context, Node, NodeName, NodeOptions};
use smol::LocalExecutor;
use smol::channel::Receiver as Stop;

use crate::config::Config;

use super::clock::RosClock;
use super::engine::{Engine, Shared};
use super::env::Network;
use super::error::NodeError;
use super::graph::{self, EntityList};
use super::inbox::Inbox;
use super::inputs::{self, Chooser, Input};
use super::names::NameResolver;
use super::output::{OutputParams, OutputState, Outputs};
use super::receive::Receiving;
use super::{socket_buffer, transport};

/// How often the graph is looked at.
const LOOK_PERIOD: Duration = Duration::from_millis(100);
/// After a change of the graph, how long our list of readers and writers is sent again.
const RESEND: Duration = Duration::from_secs(3);

/// What a node is made of.
#[derive(Clone, Debug)]
pub struct NodeSetup {
    /// All settings.
    pub config: Config,
    /// Its name, and names as remapped.
    pub names: NameResolver,
    /// Whom it can hear.
    pub network: Network,
    /// Whether its log goes to `/rosout`.
    pub has_rosout: bool,
}

/// Runs the node until a word comes on `stop`.
///
/// # Errors
/// [`NodeError`] when it cannot start.
pub fn run(setup: NodeSetup, stop: &Stop<()>) -> Result<(), NodeError> {
    for note in &setup.network.notes {
        tracing::warn!("{note}");
    }
    match socket_buffer::granted_bytes() {
        Ok(granted) => {
            if let Some(remedy) = socket_buffer::remedy(granted) {
                tracing::warn!("{remedy}");
            }
        }
        Err(error) => tracing::warn!("the socket buffer could not be checked: {error}"),
    }
    let running = Running::start(&setup)?;
    let result = running.until(stop);
    tracing::info!("stopped");
    result
}

struct Running {
    // Dropped in this order: what uses the node before the node.
    receiving: Receiving,
    engine: Engine,
    node: Node,
    context: Context,
    shared: Arc<Shared>,
    inputs: Vec<Input>,
    entities: Arc<EntityList>,
    output_state: Arc<OutputState>,
    publishing: std::thread::JoinHandle<()>,
}

impl Running {
    fn start(setup: &NodeSetup) -> Result<Self, NodeError> {
        let (names, config) = (&setup.names, &setup.config);
        let inputs = inputs::inputs(names, config)?;
        let participant = transport::participant(&setup.network)?;
        let context = Context::from_domain_participant(participant)
            .map_err(|e| NodeError::dds("the ROS context", &e))?;
        let name = NodeName::new(names.node().namespace(), names.node().base_name())
            .map_err(|e| NodeError::dds("the node's name", &e))?;
        let options = NodeOptions::new()
            .enable_rosout(setup.has_rosout)
            .start_parameter_services(false);
        let node = context
            .new_node(name, options)
            .map_err(|e| NodeError::dds("the node", &e))?;

        let entities = Arc::new(EntityList::new(&context, &names.node().fully_qualified())?);
        let capacities: Vec<usize> = inputs.iter().map(|input| input.queue_size).collect();
        let inbox = Arc::new(Inbox::new(&capacities, bytes_from_mb(config.node.queue_mb)));
        let clock = Arc::new(RosClock::new(config.node.use_sim_time));
        let shared = Arc::new(Shared::new(config.clone(), Arc::clone(&inbox)));
        let engine = Engine::start(Arc::clone(&shared), &inputs)?;
        let receiving = Receiving::start(
            &context,
            Arc::clone(&entities),
            Arc::clone(&inbox),
            Arc::clone(&clock),
        )?;
        if clock.is_simulated() {
            receiving.subscribe_clock(&names.resolve("/clock")?)?;
        }
        let output_state = Arc::new(OutputState::default());
        let params = OutputParams {
            bytes_per_s: config.node.publish_rate_mb * 1e6,
            depth: config.node.publish_depth,
            publish: crate::publish::PublishParams::default(),
            session: u64::try_from(RosClock::new(false).now().as_nanos()).unwrap_or(0),
        };
        let outputs = Outputs::new(
            &context,
            names,
            &entities,
            params,
            Arc::clone(&output_state),
        )?;
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
        Ok(Self {
            receiving,
            engine,
            node,
            context,
            shared,
            inputs,
            entities,
            output_state,
            publishing,
        })
    }

    fn until(mut self, stop: &Stop<()>) -> Result<(), NodeError> {
        let spinner = self
            .node
            .spinner()
            .map_err(|e| NodeError::dds("the node's spinner", &e))?;
        self.shared.inbox.set_open(true);
        self.output_state.set_active(true);
        {
            let executor = LocalExecutor::new();
            let spinning = executor.spawn(async move {
                if let Err(error) = spinner.spin().await {
                    tracing::error!("the node's spinner ended: {error}");
                }
            });
            let watching = executor.spawn(watch_graph(
                &self.context,
                &self.receiving,
                &self.inputs,
                &self.entities,
            ));
            smol::block_on(executor.run(async {
                // A closed channel is a word to stop as well.
                stop.recv().await.ok();
            }));
            drop((spinning, watching));
        }
        self.stop();
        Ok(())
    }

    fn stop(self) {
        let Self {
            receiving,
            engine,
            node,
            context,
            shared,
            publishing,
            ..
        } = self;
        shared.inbox.set_open(false);
        drop(receiving);
        drop(engine);
        if publishing.join().is_err() {
            tracing::error!("the thread that publishes has panicked");
        }
        drop(node);
        drop(context);
    }
}

/// Subscribes as publishers show up.
async fn watch_graph(
    context: &Context,
    receiving: &Receiving,
    inputs: &[Input],
    entities: &EntityList,
) {
    let mut chooser = Chooser::new(inputs);
    let mut complaints: Vec<String> = Vec::new();
    let mut num_seen = 0;
    let mut changed_at = Instant::now();
    let mut sent_at = None;
    loop {
        let offers = graph::offers(context);
        for choice in chooser.update(Instant::now(), &offers) {
            let topic = &inputs[choice.input].topic;
            match receiving.subscribe(inputs, &choice) {
                Ok(()) => tracing::info!(
                    "reads {topic} as {} ({})",
                    choice.message_type.name(),
                    if choice.qos.is_reliable {
                        "reliable"
                    } else {
                        "best effort"
                    }
                ),
                Err(error) => tracing::error!("{error}"),
            }
            changed_at = Instant::now();
        }
        let now_wrong = inputs::complaints(inputs, &chooser, &offers);
        for words in now_wrong.iter().filter(|words| !complaints.contains(words)) {
            tracing::warn!("{words}");
        }
        complaints = now_wrong;
        if offers.len() != num_seen {
            num_seen = offers.len();
            changed_at = Instant::now();
        }
        let is_fresh = changed_at.elapsed() < RESEND;
        let is_due = sent_at.is_none_or(|at: Instant| at.elapsed() >= RESEND / 6);
        if is_fresh && is_due {
            entities.publish(context);
            sent_at = Some(Instant::now());
        }
        smol::Timer::after(LOOK_PERIOD).await;
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
