//! Services of others that the node offers.

use serde_json::json;
use veneer::wire::Message;
use veneer::wire::service::lifecycle::{
    ChangeStateRequest, ChangeStateResponse, GetAvailableStatesResponse,
    GetAvailableTransitionsResponse, GetStateRequest, GetStateResponse, State, Transition,
    TransitionDescription,
};
use veneer::wire::service::{TriggerRequest, TriggerResponse};

use super::samples::{Sample, reencode, sample};

/// Services of others that veneer offers, as their clients see them.
pub(super) fn offered() -> Vec<Sample> {
    let state = |id: u8, label: &str| State {
        id,
        label: label.to_owned(),
    };
    let transition = || Transition {
        id: 3,
        label: "activate".to_owned(),
    };
    let (inactive, active) = (state(2, "inactive"), state(3, "active"));
    let says_transition = json!({"id": 3, "label": "activate"});
    let (says_inactive, says_active) = (
        json!({"id": 2, "label": "inactive"}),
        json!({"id": 3, "label": "active"}),
    );
    let trigger = TriggerResponse {
        success: true,
        message: "resumed".to_owned(),
    };
    let graph = GetAvailableTransitionsResponse {
        available_transitions: vec![TransitionDescription {
            transition: transition(),
            start_state: inactive.clone(),
            goal_state: active.clone(),
        }],
    };
    let says_graph = json!({"available_transitions": [{
        "transition": says_transition, "start_state": says_inactive, "goal_state": says_active,
    }]});
    let states = GetAvailableStatesResponse {
        available_states: vec![inactive, active.clone()],
    };
    vec![
        sample(
            &TriggerRequest::default(),
            reencode!(TriggerRequest),
            json!({}),
        ),
        sample(
            &trigger,
            reencode!(TriggerResponse),
            json!({"success": true, "message": "resumed"}),
        ),
        sample(
            &ChangeStateRequest {
                transition: transition(),
            },
            reencode!(ChangeStateRequest),
            json!({"transition": says_transition}),
        ),
        sample(
            &ChangeStateResponse { success: true },
            reencode!(ChangeStateResponse),
            json!({"success": true}),
        ),
        sample(
            &GetStateRequest::default(),
            reencode!(GetStateRequest),
            json!({}),
        ),
        sample(
            &GetStateResponse {
                current_state: active,
            },
            reencode!(GetStateResponse),
            json!({"current_state": says_active}),
        ),
        sample(
            &states,
            reencode!(GetAvailableStatesResponse),
            json!({"available_states": [says_inactive, says_active]}),
        ),
        sample(
            &graph,
            reencode!(GetAvailableTransitionsResponse),
            says_graph,
        ),
    ]
}
