//! The node's services: requests in, answers out, each on a task of its own.

use std::future::Future;
use std::sync::Arc;
use std::time::{Duration, Instant};

use byteorder::LittleEndian;
use ros2_client::builtin_interfaces::Time;
use ros2_client::parameters::raw;
use ros2_client::qos::{History, QosProfile};
use ros2_client::rcl_interfaces as rcl;
use ros2_client::{
    Context, Message, Name, Node, Publisher, Server, ServiceMapping, ServiceTypeName,
};
use smol::LocalExecutor;

use super::clock::RosClock;
use super::control::{Answer, Control};
use super::error::NodeError;
use super::graph;
use super::lifecycle::{State, Transition};
use super::names::NameResolver;
use super::parameters;
use super::service_types::{
    AvailableStates, AvailableTransitions, ChangeState, CurrentState, Done, Empty, FilePath,
    Shorten, StateChanged, StateMessage, TransitionDescription, TransitionEvent, TransitionMessage,
};

/// Requests that wait; more than a person or a manager sends at once.
const QUEUE_SIZE: usize = 10;
/// Rest after a request that could not be read: a peer that sends nothing else gets no more.
const REST: Duration = Duration::from_millis(20);
/// How long an answer waits for its client to be known.
const CLIENT_WAIT: Duration = Duration::from_secs(1);
/// How often that is looked at.
const CLIENT_POLL: Duration = Duration::from_millis(10);
/// Longest answer, bytes. RustDDS 0.15.1 writes a message that goes in fragments and has inline QoS
/// (as answers do: whose request it was) with a byte too many, and no client can read it; so an
/// answer must go in one datagram of a network with an MTU of 1500.
const MAX_ANSWER_BYTES: usize = 1280;
/// The part of an entity's id that is its participant's.
const GUID_PREFIX_BYTES: usize = 12;

/// Makes servers at a node, and tasks that serve them.
pub(super) struct Services<'a> {
    node: &'a mut Node,
    names: &'a NameResolver,
    context: &'a Context,
    executor: &'a LocalExecutor<'static>,
    control: Arc<Control>,
}

impl<'a> Services<'a> {
    pub(super) fn new(
        node: &'a mut Node,
        names: &'a NameResolver,
        context: &'a Context,
        executor: &'a LocalExecutor<'static>,
        control: Arc<Control>,
    ) -> Self {
        Self {
            node,
            names,
            context,
            executor,
            control,
        }
    }

    /// Offers everything.
    pub(super) fn offer_all(mut self, clock: Arc<RosClock>) -> Result<(), NodeError> {
        self.offer_triggers()?;
        self.offer_files()?;
        self.offer_lifecycle(clock)?;
        self.offer_parameters()
    }

    fn server<Req, Resp>(
        &mut self,
        name: &str,
        package: &str,
        type_name: &str,
    ) -> Result<Server<Req, Resp>, NodeError>
    where
        Req: Message + Clone + 'static,
        Resp: Message + 'static,
    {
        let resolved = self.names.resolve(&format!("~/{name}"))?;
        let failed = |error: &dyn std::fmt::Display| NodeError::dds(&resolved, error);
        let qos = QosProfile::publisher_default().history(History::KeepLast { depth: QUEUE_SIZE });
        let service = Name::parse(&resolved).map_err(|e| failed(&e))?;
        self.node
            .create_server(
                ServiceMapping::Enhanced,
                &service,
                &ServiceTypeName::new(package, type_name),
                qos.clone(),
                qos,
            )
            .map_err(|e| failed(&e))
    }

    /// Serves `name` by `answer`, one request after the other.
    fn serve<Req, Resp, F>(
        &mut self,
        name: &'static str,
        (package, type_name): (&str, &str),
        answer: impl Fn(Arc<Control>, Req) -> F + 'static,
    ) -> Result<(), NodeError>
    where
        Req: Message + Clone + 'static,
        Resp: Message + Shorten + 'static,
        F: Future<Output = Resp> + 'static,
    {
        let server = self.server::<Req, Resp>(name, package, type_name)?;
        let control = Arc::clone(&self.control);
        let context = self.context.clone();
        let replies = format!("rr{}Reply", self.names.resolve(&format!("~/{name}"))?);
        let task = async move {
            loop {
                let (id, request) = match server.async_receive_request().await {
                    Ok(received) => received,
                    Err(error) => {
                        tracing::warn!("~/{name}: a request could not be read: {error}");
                        smol::Timer::after(REST).await;
                        continue;
                    }
                };
                let response = answer(Arc::clone(&control), request).await;
                let Some(response) = fitted(name, response) else {
                    continue;
                };
                wait_for_client(&context, &replies, id.writer_gid.to_bytes16()).await;
                if let Err(error) = server.async_send_response(id, response).await {
                    tracing::warn!("~/{name}: the answer was not sent: {error}");
                }
            }
        };
        self.executor.spawn(task).detach();
        Ok(())
    }

    fn offer_triggers(&mut self) -> Result<(), NodeError> {
        let trigger = ("std_srvs", "Trigger");
        type Act = fn(&Control) -> Answer;
        let acts: [(&'static str, Act); 5] = [
            ("reset", |control| control.reset()),
            ("pause", |control| control.pause(true)),
            ("resume", |control| control.pause(false)),
            ("retexture", |control| control.paint(false)),
            ("refine", |control| control.paint(true)),
        ];
        for (name, act) in acts {
            self.serve(name, trigger, move |control, _: Empty| {
                apart(name, move || act(&control))
            })?;
        }
        Ok(())
    }

    fn offer_files(&mut self) -> Result<(), NodeError> {
        let file_path = ("veneer", "FilePath");
        self.serve("save", file_path, |control, request: FilePath| {
            apart("save", move || control.save(&request.file_path))
        })?;
        self.serve("load", file_path, |control, request: FilePath| {
            apart("load", move || control.load(&request.file_path))
        })
    }

    fn offer_lifecycle(&mut self, clock: Arc<RosClock>) -> Result<(), NodeError> {
        let events = Arc::new(self.transition_events()?);
        self.serve(
            "change_state",
            ("lifecycle_msgs", "ChangeState"),
            move |control, request: ChangeState| {
                let (events, clock) = (Arc::clone(&events), Arc::clone(&clock));
                async move {
                    let TransitionMessage { id, label } = request.transition;
                    let wanted = Transition::requested(control.state(), id, &label);
                    let Some(transition) = wanted else {
                        return StateChanged { success: false };
                    };
                    let changed = smol::unblock(move || control.change(transition)).await;
                    if let Some((start, goal)) = changed {
                        let now = u64::try_from(clock.now().as_nanos()).unwrap_or(0);
                        tell(&events, now, transition, start, goal);
                    }
                    StateChanged {
                        success: changed.is_some(),
                    }
                }
            },
        )?;
        let get_state = ("lifecycle_msgs", "GetState");
        self.serve("get_state", get_state, |control, _: Empty| async move {
            CurrentState {
                current_state: state_message(control.state()),
            }
        })?;
        self.serve(
            "get_available_states",
            ("lifecycle_msgs", "GetAvailableStates"),
            |_, _: Empty| async move {
                AvailableStates {
                    available_states: State::ALL.map(state_message).to_vec(),
                }
            },
        )?;
        self.serve(
            "get_available_transitions",
            ("lifecycle_msgs", "GetAvailableTransitions"),
            |control, _: Empty| async move {
                let state = control.state();
                let available = Transition::available(state).into_iter();
                AvailableTransitions {
                    available_transitions: available.map(|t| description(t, state)).collect(),
                }
            },
        )
    }

    fn transition_events(&mut self) -> Result<Publisher<TransitionEvent>, NodeError> {
        let name = self.names.resolve("~/transition_event")?;
        let failed = |error: &dyn std::fmt::Display| NodeError::dds(&name, error);
        let topic = self
            .node
            .create_topic(
                &Name::parse(&name).map_err(|e| failed(&e))?,
                ros2_client::MessageTypeName::new("lifecycle_msgs", "TransitionEvent"),
                &QosProfile::publisher_default(),
            )
            .map_err(|e| failed(&e))?;
        self.node
            .create_publisher(&topic, None)
            .map_err(|e| failed(&e))
    }

    fn offer_parameters(&mut self) -> Result<(), NodeError> {
        let node_name = self.names.node().fully_qualified();
        let events = Arc::new(self.parameter_events()?);
        let of = |type_name| ("rcl_interfaces", type_name);
        self.serve(
            "get_parameters",
            of("GetParameters"),
            |control, request: rcl::GetParametersRequest| async move {
                let values = parameters::get(&mut control.shared.config(), &request.names);
                rcl::GetParametersResponse { values }
            },
        )?;
        self.serve(
            "get_parameter_types",
            of("GetParameterTypes"),
            |control, request: rcl::GetParameterTypesRequest| async move {
                let values = parameters::types(&mut control.shared.config(), &request.names);
                rcl::GetParameterTypesResponse { values }
            },
        )?;
        self.serve(
            "describe_parameters",
            of("DescribeParameters"),
            |control, request: rcl::DescribeParametersRequest| async move {
                let values = parameters::describe(&mut control.shared.config(), &request.names);
                rcl::DescribeParametersResponse { values }
            },
        )?;
        self.serve(
            "list_parameters",
            of("ListParameters"),
            |_, request: rcl::ListParametersRequest| async move {
                rcl::ListParametersResponse {
                    result: parameters::list(&request.prefixes, request.depth),
                }
            },
        )?;
        let set = move |is_atomic: bool| {
            let (events, node_name) = (Arc::clone(&events), node_name.clone());
            move |control: Arc<Control>, request: rcl::SetParametersRequest| {
                let (events, node_name) = (Arc::clone(&events), node_name.clone());
                async move {
                    let wanted = request.parameter;
                    let work = move || control.set_parameters(&wanted, is_atomic);
                    let (results, changed) = smol::unblock(work).await;
                    tell_changed(&events, node_name, changed);
                    results
                }
            }
        };
        let one_by_one = set(false);
        self.serve(
            "set_parameters",
            of("SetParameters"),
            move |control, request| {
                let results = one_by_one(control, request);
                async move {
                    let results = results.await.into_iter().map(Into::into).collect();
                    rcl::SetParametersResponse { results }
                }
            },
        )?;
        let all_or_none = set(true);
        self.serve(
            "set_parameters_atomically",
            of("SetParametersAtomically"),
            move |control, request| {
                let results = all_or_none(control, request);
                async move {
                    let results = results.await;
                    let failed = results.into_iter().find(Result::is_err);
                    rcl::SetParametersAtomicallyResponse {
                        result: failed.unwrap_or(Ok(())).into(),
                    }
                }
            },
        )
    }

    fn parameter_events(&mut self) -> Result<Publisher<raw::ParameterEvent>, NodeError> {
        let topic = self.context.get_parameter_events_topic();
        self.node
            .create_publisher(&topic, None)
            .map_err(|e| NodeError::dds("/parameter_events", &e))
    }
}

/// Shortens an answer until DDS can carry it; `None` where it cannot be.
fn fitted<Resp: Message + Shorten>(name: &str, mut response: Resp) -> Option<Resp> {
    let mut was_shortened = false;
    loop {
        let size = rustdds::cdr_encoding::to_vec::<_, LittleEndian>(&response).map(|b| b.len());
        if matches!(size, Ok(0..=MAX_ANSWER_BYTES)) {
            if was_shortened {
                tracing::warn!(
                    "~/{name}: the answer was cut to {MAX_ANSWER_BYTES} bytes; ask for less at a time, by prefix or by name"
                );
            }
            return Some(response);
        }
        was_shortened = true;
        if !response.shorten() {
            tracing::error!("~/{name}: the answer does not fit into {MAX_ANSWER_BYTES} bytes");
            return None;
        }
    }
}

/// Waits until the client's own reader is known: a client may ask before it is, and an answer sent
/// to nobody comes only with the next heartbeat, seconds later.
async fn wait_for_client(context: &Context, replies: &str, client: [u8; 16]) {
    let begun = Instant::now();
    while begun.elapsed() < CLIENT_WAIT {
        if graph::is_read_by(context, replies, &client[..GUID_PREFIX_BYTES]) {
            // Discovery knows it now; the writer is told a moment later.
            if begun.elapsed() > CLIENT_POLL {
                smol::Timer::after(CLIENT_POLL).await;
            }
            return;
        }
        smol::Timer::after(CLIENT_POLL).await;
    }
}

/// Does what may take long on a thread of its own.
async fn apart(name: &'static str, work: impl FnOnce() -> Answer + Send + 'static) -> Done {
    let answer = smol::unblock(work).await;
    let (success, message) = match answer {
        Ok(message) => (true, message),
        Err(message) => (false, message),
    };
    if success {
        tracing::info!("~/{name}: {message}");
    } else {
        tracing::warn!("~/{name}: {message}");
    }
    Done { success, message }
}

fn state_message(state: State) -> StateMessage {
    StateMessage {
        id: state.id(),
        label: state.label().to_owned(),
    }
}

fn description(transition: Transition, state: State) -> TransitionDescription {
    let (id, label) = transition.on_the_way();
    TransitionDescription {
        transition: TransitionMessage {
            id: transition.id(state),
            label: transition.label().to_owned(),
        },
        start_state: state_message(state),
        goal_state: StateMessage {
            id,
            label: label.to_owned(),
        },
    }
}

fn tell(
    events: &Publisher<TransitionEvent>,
    timestamp: u64,
    transition: Transition,
    start: State,
    goal: State,
) {
    let event = TransitionEvent {
        timestamp,
        transition: TransitionMessage {
            id: transition.id(start),
            label: transition.label().to_owned(),
        },
        start_state: state_message(start),
        goal_state: state_message(goal),
    };
    if let Err(error) = events.publish(event) {
        tracing::debug!("a transition was not told: {error}");
    }
}

fn tell_changed(
    events: &Publisher<raw::ParameterEvent>,
    node: String,
    changed_parameters: Vec<raw::Parameter>,
) {
    if changed_parameters.is_empty() {
        return;
    }
    let event = raw::ParameterEvent {
        stamp: Time::now(),
        node,
        new_parameters: Vec::new(),
        changed_parameters,
        deleted_parameters: Vec::new(),
    };
    if let Err(error) = events.publish(event) {
        tracing::debug!("a change of parameters was not told: {error}");
    }
}
