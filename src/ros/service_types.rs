//! Requests and responses of the node's services, in the order of their fields.

use ros2_client::Message;
use serde::{Deserialize, Serialize};

macro_rules! messages {
    ($($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:ty),* })*) => {$(
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        pub(super) struct $name { $($(#[$field_doc])* pub(super) $field: $kind),* }
        impl Message for $name {}
    )*};
}

messages! {
    /// A request that asks nothing. ROS sends a byte in its place, which is not read.
    Empty {}
    /// `std_srvs/Trigger`, and `veneer/FilePath`.
    Done {
        success: bool,
        message: String
    }
    /// `veneer/FilePath`.
    FilePath {
        file_path: String
    }
    /// `lifecycle_msgs/State`.
    StateMessage {
        id: u8,
        label: String
    }
    /// `lifecycle_msgs/Transition`.
    TransitionMessage {
        id: u8,
        label: String
    }
    /// `lifecycle_msgs/TransitionDescription`.
    TransitionDescription {
        transition: TransitionMessage,
        start_state: StateMessage,
        goal_state: StateMessage
    }
    /// `lifecycle_msgs/ChangeState`.
    ChangeState {
        transition: TransitionMessage
    }
    /// `lifecycle_msgs/ChangeState`.
    StateChanged {
        success: bool
    }
    /// `lifecycle_msgs/GetState`.
    CurrentState {
        current_state: StateMessage
    }
    /// `lifecycle_msgs/GetAvailableStates`.
    AvailableStates {
        available_states: Vec<StateMessage>
    }
    /// `lifecycle_msgs/GetAvailableTransitions`.
    AvailableTransitions {
        available_transitions: Vec<TransitionDescription>
    }
    /// `lifecycle_msgs/TransitionEvent`.
    TransitionEvent {
        timestamp: u64,
        transition: TransitionMessage,
        start_state: StateMessage,
        goal_state: StateMessage
    }
}
