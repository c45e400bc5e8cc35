//! The node's services: requests in, answers out, each on a task of its own.

mod mesh;
mod parameter;

use std::future::Future;
use std::sync::Arc;

use byteorder::{BigEndian, LittleEndian};
use ros2_client::qos::QosProfile;
use ros2_client::{Context, Name, Node, Publisher};
use rustdds::cdr_encoding;
use serde::Serialize;
use serde::de::DeserializeOwned;
use smol::LocalExecutor;

use super::clock::RosClock;
use super::control::{Answer, Control};
use super::error::NodeError;
use super::graph::EntityList;
use super::lifecycle::{State, Transition};
use super::names::NameResolver;
use super::server::{RawServer, Request};
use super::service_types::{
    AvailableStates, AvailableTransitions, ChangeState, CurrentState, Done, Empty, FilePath,
    Shorten, StateChanged, StateMessage, TransitionDescription, TransitionEvent, TransitionMessage,
};

/// Makes servers at a node, and tasks that serve them.
pub(super) struct Services<'a> {
    node: &'a mut Node,
    names: &'a NameResolver,
    context: &'a Context,
    entities: &'a EntityList,
    executor: &'a LocalExecutor<'static>,
    control: Arc<Control>,
}

impl<'a> Services<'a> {
    pub(super) fn new(
        node: &'a mut Node,
        names: &'a NameResolver,
        context: &'a Context,
        entities: &'a EntityList,
        executor: &'a LocalExecutor<'static>,
        control: Arc<Control>,
    ) -> Self {
        Self {
            node,
            names,
            context,
            entities,
            executor,
            control,
        }
    }

    /// Offers everything.
    pub(super) fn offer_all(mut self, clock: Arc<RosClock>) -> Result<(), NodeError> {
        self.offer_triggers()?;
        self.offer_files()?;
        self.offer_lifecycle(clock)?;
        self.offer_meshes()?;
        self.offer_parameters()
    }

    /// Serves `name`, of the type `package/srv/Name`, by `answer`: one request after the other, as
    /// bytes. It is given the longest answer that arrives, and answers nothing by `None`.
    fn serve_bytes<F>(
        &mut self,
        name: &'static str,
        type_name: &str,
        answer: impl Fn(Arc<Control>, Vec<u8>, usize) -> F + 'static,
    ) -> Result<(), NodeError>
    where
        F: Future<Output = Option<Vec<u8>>> + 'static,
    {
        let service = self.names.resolve(&format!("~/{name}"))?;
        let server = RawServer::new(self.context, &service, type_name)?;
        let (reader, writer) = server.gids();
        self.entities.add_reader(reader);
        self.entities.add_writer(writer);
        let control = Arc::clone(&self.control);
        let max_bytes = control.shared.config().node.limits.request_bytes;
        let task = async move {
            let answer = |request: Request, longest| {
                let is_too_long = request.bytes.len() > max_bytes;
                if is_too_long {
                    let num_bytes = request.bytes.len();
                    tracing::warn!(
                        "~/{name}: a request of {num_bytes} bytes was refused; limits.request_bytes is {max_bytes}"
                    );
                }
                let taken =
                    (!is_too_long).then(|| answer(Arc::clone(&control), request.bytes, longest));
                async move { taken?.await }
            };
            server.serve(answer).await;
        };
        self.executor.spawn(task).detach();
        Ok(())
    }

    /// Serves `name` by `answer`, with requests and answers as serde has them.
    fn serve<Req, Resp, F>(
        &mut self,
        name: &'static str,
        type_name: &str,
        answer: impl Fn(Arc<Control>, Req) -> F + 'static,
    ) -> Result<(), NodeError>
    where
        Req: DeserializeOwned + 'static,
        Resp: Serialize + Shorten + 'static,
        F: Future<Output = Resp> + 'static,
    {
        self.serve_bytes(name, type_name, move |control, bytes, longest| {
            let request = decoded::<Req>(&bytes);
            if let Err(error) = &request {
                tracing::warn!("~/{name}: a request could not be read: {error}");
            }
            let response = request.ok().map(|request| answer(control, request));
            async move { fitted(name, response?.await, longest) }
        })
    }

    fn offer_triggers(&mut self) -> Result<(), NodeError> {
        let trigger = "std_srvs/srv/Trigger";
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
        let file_path = "veneer/srv/FilePath";
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
            "lifecycle_msgs/srv/ChangeState",
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
        let get_state = "lifecycle_msgs/srv/GetState";
        self.serve("get_state", get_state, |control, _: Empty| async move {
            CurrentState {
                current_state: state_message(control.state()),
            }
        })?;
        self.serve(
            "get_available_states",
            "lifecycle_msgs/srv/GetAvailableStates",
            |_, _: Empty| async move {
                AvailableStates {
                    available_states: State::ALL.map(state_message).to_vec(),
                }
            },
        )?;
        self.serve(
            "get_available_transitions",
            "lifecycle_msgs/srv/GetAvailableTransitions",
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
}

/// What a request holds, behind its encapsulation header.
fn decoded<Req: DeserializeOwned>(bytes: &[u8]) -> Result<Req, String> {
    let read = match bytes {
        [0, 0, _, _, body @ ..] => cdr_encoding::from_bytes::<Req, BigEndian>(body),
        [0, 1, _, _, body @ ..] => cdr_encoding::from_bytes::<Req, LittleEndian>(body),
        _ => return Err("it is not plain CDR".to_owned()),
    };
    read.map(|(request, _)| request)
        .map_err(|error| error.to_string())
}

/// An answer, shortened until it is no longer than `max_bytes`; `None` where it cannot be.
fn fitted<Resp: Serialize + Shorten>(
    name: &str,
    mut response: Resp,
    max_bytes: usize,
) -> Option<Vec<u8>> {
    let mut was_shortened = false;
    loop {
        match encoded(&response) {
            Ok(bytes) if bytes.len() <= max_bytes => {
                if was_shortened {
                    tracing::warn!(
                        "~/{name}: the answer was cut to {max_bytes} bytes; ask for less at a time, by prefix or by name"
                    );
                }
                return Some(bytes);
            }
            Ok(_) => {}
            Err(error) => {
                tracing::error!("~/{name}: the answer cannot be written: {error}");
                return None;
            }
        }
        was_shortened = true;
        if !response.shorten() {
            tracing::error!("~/{name}: the answer does not fit into {max_bytes} bytes");
            return None;
        }
    }
}

fn encoded(response: &impl Serialize) -> Result<Vec<u8>, String> {
    let body = cdr_encoding::to_vec::<_, LittleEndian>(response).map_err(|e| e.to_string())?;
    Ok([&[0, 1, 0, 0], &body[..]].concat())
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
