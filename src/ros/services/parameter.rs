//! `~/get_parameters` and the others of rcl_interfaces: the configuration as parameters.

use std::sync::Arc;

use ros2_client::Publisher;
use ros2_client::builtin_interfaces::Time;
use ros2_client::parameters::raw;
use ros2_client::rcl_interfaces as rcl;

use super::super::control::Control;
use super::super::error::NodeError;
use super::super::parameters;
use super::Services;

impl Services<'_> {
    pub(super) fn offer_parameters(&mut self) -> Result<(), NodeError> {
        let node_name = self.names.node().fully_qualified();
        let events = Arc::new(self.parameter_events()?);
        let of = |name: &str| format!("rcl_interfaces/srv/{name}");
        self.serve(
            "get_parameters",
            &of("GetParameters"),
            |control, request: rcl::GetParametersRequest| async move {
                let values = parameters::get(&mut control.shared.config(), &request.names);
                rcl::GetParametersResponse { values }
            },
        )?;
        self.serve(
            "get_parameter_types",
            &of("GetParameterTypes"),
            |control, request: rcl::GetParameterTypesRequest| async move {
                let values = parameters::types(&mut control.shared.config(), &request.names);
                rcl::GetParameterTypesResponse { values }
            },
        )?;
        self.serve(
            "describe_parameters",
            &of("DescribeParameters"),
            |control, request: rcl::DescribeParametersRequest| async move {
                let values = parameters::describe(&mut control.shared.config(), &request.names);
                rcl::DescribeParametersResponse { values }
            },
        )?;
        self.serve(
            "list_parameters",
            &of("ListParameters"),
            |control, request: rcl::ListParametersRequest| async move {
                let config = control.shared.config();
                rcl::ListParametersResponse {
                    result: parameters::list(&config, &request.prefixes, request.depth),
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
            &of("SetParameters"),
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
            &of("SetParametersAtomically"),
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
