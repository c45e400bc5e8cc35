//! `lifecycle_msgs`: states of a managed node, and the services that change them.

use serde::{Deserialize, Serialize};

use super::{Field, Service, empty_message, plain_message};
use crate::wire::cdr::{CdrReader, CdrWriter};
use crate::wire::error::WireError;
use crate::wire::schema;

/// `lifecycle_msgs/State`: a state by number and name.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct State {
    /// 1 unconfigured, 2 inactive, 3 active, 4 finalized; 10 to 15 on the way.
    pub id: u8,
    /// Its name.
    pub label: String,
}

/// `lifecycle_msgs/Transition`: a transition by number and name.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Transition {
    /// 1 configure, 2 clean up, 3 activate, 4 deactivate, 5 to 7 shut down.
    pub id: u8,
    /// Its name.
    pub label: String,
}

/// `lifecycle_msgs/TransitionDescription`.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TransitionDescription {
    /// The transition.
    pub transition: Transition,
    /// From here.
    pub start_state: State,
    /// To there.
    pub goal_state: State,
}

impl Field for State {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        Ok(Self {
            id: Field::read(reader, name)?,
            label: Field::read(reader, name)?,
        })
    }
    fn write(&self, writer: &mut CdrWriter) {
        self.id.write(writer);
        self.label.write(writer);
    }
}

impl Field for Transition {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        Ok(Self {
            id: Field::read(reader, name)?,
            label: Field::read(reader, name)?,
        })
    }
    fn write(&self, writer: &mut CdrWriter) {
        self.id.write(writer);
        self.label.write(writer);
    }
}

impl Field for TransitionDescription {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        Ok(Self {
            transition: Field::read(reader, name)?,
            start_state: Field::read(reader, name)?,
            goal_state: Field::read(reader, name)?,
        })
    }
    fn write(&self, writer: &mut CdrWriter) {
        self.transition.write(writer);
        self.start_state.write(writer);
        self.goal_state.write(writer);
    }
}

plain_message!(
    /// `lifecycle_msgs/TransitionEvent`: published on `~/transition_event`.
    TransitionEvent,
    "lifecycle_msgs/msg/TransitionEvent",
    schema::TRANSITION_EVENT,
    {
        /// Nanoseconds.
        timestamp: u64,
        /// The transition.
        transition: Transition,
        /// From here.
        start_state: State,
        /// To there.
        goal_state: State
    }
);
plain_message!(
    /// Request of `lifecycle_msgs/ChangeState`.
    ChangeStateRequest,
    "lifecycle_msgs/srv/ChangeState_Request",
    schema::TRANSITION_ONLY,
    {
        /// By number; where that is 0, by name.
        transition: Transition
    }
);
plain_message!(
    /// Response of `lifecycle_msgs/ChangeState`.
    ChangeStateResponse,
    "lifecycle_msgs/srv/ChangeState_Response",
    "bool success\n",
    {
        /// Whether the state changed.
        success: bool
    }
);
empty_message!(
    /// Request of `lifecycle_msgs/GetState`.
    GetStateRequest,
    "lifecycle_msgs/srv/GetState_Request"
);
plain_message!(
    /// Response of `lifecycle_msgs/GetState`.
    GetStateResponse,
    "lifecycle_msgs/srv/GetState_Response",
    schema::STATE_ONLY,
    {
        /// The state.
        current_state: State
    }
);
empty_message!(
    /// Request of `lifecycle_msgs/GetAvailableStates`.
    GetAvailableStatesRequest,
    "lifecycle_msgs/srv/GetAvailableStates_Request"
);
plain_message!(
    /// Response of `lifecycle_msgs/GetAvailableStates`.
    GetAvailableStatesResponse,
    "lifecycle_msgs/srv/GetAvailableStates_Response",
    schema::STATES_ONLY,
    {
        /// All states.
        available_states: Vec<State>
    }
);
empty_message!(
    /// Request of `lifecycle_msgs/GetAvailableTransitions`.
    GetAvailableTransitionsRequest,
    "lifecycle_msgs/srv/GetAvailableTransitions_Request"
);
plain_message!(
    /// Response of `lifecycle_msgs/GetAvailableTransitions`.
    GetAvailableTransitionsResponse,
    "lifecycle_msgs/srv/GetAvailableTransitions_Response",
    schema::TRANSITIONS_ONLY,
    {
        /// What can be done now.
        available_transitions: Vec<TransitionDescription>
    }
);

/// `lifecycle_msgs/ChangeState`.
#[derive(Clone, Copy, Debug)]
pub struct ChangeState;
/// `lifecycle_msgs/GetState`.
#[derive(Clone, Copy, Debug)]
pub struct GetState;
/// `lifecycle_msgs/GetAvailableStates`.
#[derive(Clone, Copy, Debug)]
pub struct GetAvailableStates;
/// `lifecycle_msgs/GetAvailableTransitions`, also served as `get_transition_graph`.
#[derive(Clone, Copy, Debug)]
pub struct GetAvailableTransitions;

impl Service for ChangeState {
    const TYPE_NAME: &'static str = "lifecycle_msgs/srv/ChangeState";
    type Request = ChangeStateRequest;
    type Response<'a> = ChangeStateResponse;
}
impl Service for GetState {
    const TYPE_NAME: &'static str = "lifecycle_msgs/srv/GetState";
    type Request = GetStateRequest;
    type Response<'a> = GetStateResponse;
}
impl Service for GetAvailableStates {
    const TYPE_NAME: &'static str = "lifecycle_msgs/srv/GetAvailableStates";
    type Request = GetAvailableStatesRequest;
    type Response<'a> = GetAvailableStatesResponse;
}
impl Service for GetAvailableTransitions {
    const TYPE_NAME: &'static str = "lifecycle_msgs/srv/GetAvailableTransitions";
    type Request = GetAvailableTransitionsRequest;
    type Response<'a> = GetAvailableTransitionsResponse;
}
