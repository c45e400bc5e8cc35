//! Requests and responses of the node's services, in the order of their fields.

use ros2_client::Message;
use ros2_client::rcl_interfaces as rcl;
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

/// An answer that may be too long to be carried.
pub(super) trait Shorten {
    /// Leaves something out; `false` where there is nothing to leave out. What is left still says
    /// that it is not all, as far as the type can.
    fn shorten(&mut self) -> bool;
}

macro_rules! never_long {
    ($($name:ident),*) => {$(
        impl Shorten for $name {
            fn shorten(&mut self) -> bool {
                false
            }
        }
    )*};
}
never_long!(
    StateChanged,
    CurrentState,
    AvailableStates,
    AvailableTransitions
);

impl Shorten for Done {
    fn shorten(&mut self) -> bool {
        let half = self.message.len() / 2;
        let end = (0..=half).rfind(|&i| self.message.is_char_boundary(i));
        self.message.truncate(end.unwrap_or(0));
        half > 0
    }
}

/// Cuts a list by a quarter; `false` where it is empty.
fn cut<T>(list: &mut Vec<T>) -> bool {
    let is_empty = list.is_empty();
    list.truncate(list.len() * 3 / 4);
    !is_empty
}

impl Shorten for rcl::ListParametersResponse {
    fn shorten(&mut self) -> bool {
        // The prefixes are kept: each can be asked for.
        cut(&mut self.result.names)
    }
}

/// No values mean that some could not be got.
impl Shorten for rcl::GetParametersResponse {
    fn shorten(&mut self) -> bool {
        !std::mem::take(&mut self.values).is_empty()
    }
}

impl Shorten for rcl::GetParameterTypesResponse {
    fn shorten(&mut self) -> bool {
        !std::mem::take(&mut self.values).is_empty()
    }
}

/// Descriptions go first, then all.
impl Shorten for rcl::DescribeParametersResponse {
    fn shorten(&mut self) -> bool {
        let has_words = self.values.iter().any(|one| !one.description.is_empty());
        if has_words {
            for one in &mut self.values {
                one.description.clear();
            }
            return true;
        }
        !std::mem::take(&mut self.values).is_empty()
    }
}

/// Reasons go; whether each was set stays.
impl Shorten for rcl::SetParametersResponse {
    fn shorten(&mut self) -> bool {
        let has_words = self.results.iter().any(|one| !one.reason.is_empty());
        for one in &mut self.results {
            one.reason.clear();
        }
        has_words
    }
}

impl Shorten for rcl::SetParametersAtomicallyResponse {
    fn shorten(&mut self) -> bool {
        let half = self.result.reason.len() / 2;
        let reason = &self.result.reason;
        let end = (0..=half).rfind(|&i| reason.is_char_boundary(i));
        self.result.reason.truncate(end.unwrap_or(0));
        half > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_shrink_to_nothing_in_finitely_many_steps() {
        let mut done = Done {
            success: true,
            message: "ä".repeat(1000),
        };
        let mut list = rcl::ListParametersResponse {
            result: rcl::ListParametersResult {
                names: vec!["name".to_owned(); 500],
                prefixes: Vec::new(),
            },
        };
        let num_steps = std::iter::repeat_with(|| done.shorten())
            .take_while(|is_shorter| *is_shorter)
            .count();
        assert!(done.message.is_empty() && num_steps < 20);
        let num_steps = std::iter::repeat_with(|| list.shorten())
            .take_while(|is_shorter| *is_shorter)
            .count();
        assert!(list.result.names.is_empty() && num_steps < 50);
    }
}
