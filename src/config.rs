//! One typed configuration, resolved in one place.
//!
//! Each parameter has one row in [`tree`]: its name, range, unit, description, and the field of
//! [`Config`] that it sets. The default is the field's own default. From these rows come the YAML
//! reader ([`params_file`]), `--param NAME:=VALUE`, `veneer params` and `docs/parameters.md`. A
//! name that no row has, or a value outside its range, is refused; nothing is repaired in silence.

mod export;
pub mod listing;
pub mod node;
pub mod parameter;
pub mod params_file;
mod publish;
mod region;
mod smooth;
mod stream;
mod texinit;
pub mod tree;

pub use node::{NodeLimits, NodeParams, QosOverride, Transport};
pub use parameter::{Parameter, ParameterError};

use crate::bag::TopicRoles;
use crate::export::ExportParams;
use crate::pipeline::PipelineParams;
use crate::publish::PublishParams;

/// Everything that can be set.
#[derive(Clone, Debug, Default)]
pub struct Config {
    /// Which topic of a bag plays which part.
    pub topics: TopicRoles,
    /// From events to a textured mesh.
    pub pipeline: PipelineParams,
    /// What is written.
    pub export: ExportParams,
    /// The live node.
    pub node: NodeParams,
    /// How the result becomes messages.
    pub publish: PublishParams,
}

impl Config {
    /// Sets the parameter `name` from text.
    ///
    /// # Errors
    /// [`ParameterError`] for an unknown name, with the nearest known one, and for a value of the
    /// wrong type or outside its range.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), ParameterError> {
        if let Some(rest) = name.strip_prefix(node::QOS_PREFIX) {
            return node::set_qos(self, rest, value);
        }
        match tree::PARAMETERS.iter().find(|p| p.name == name) {
            Some(parameter) => parameter.set(self, value),
            None => Err(ParameterError::Unknown {
                name: name.to_owned(),
                nearest: parameter::nearest_name(name, tree::PARAMETERS.iter().map(|p| p.name)),
            }),
        }
    }

    /// Lets `topic` play the part that a node's subscription `part` has.
    ///
    /// # Errors
    /// [`ParameterError::Unknown`] when there is no such subscription.
    pub fn remap(&mut self, part: &str, topic: &str) -> Result<(), ParameterError> {
        let part = part.trim_start_matches("~/").trim_start_matches('/');
        let Some((_, field)) = SUBSCRIPTIONS.iter().find(|(name, _)| *name == part) else {
            return Err(ParameterError::Unknown {
                name: part.to_owned(),
                nearest: parameter::nearest_name(part, SUBSCRIPTIONS.iter().map(|(name, _)| *name)),
            });
        };
        *field(&mut self.topics) = Some(topic.to_owned());
        Ok(())
    }
}

type TopicField = fn(&mut TopicRoles) -> &mut Option<String>;

/// The node's subscriptions by the names that remappings use.
const SUBSCRIPTIONS: [(&str, TopicField); 8] = [
    ("rgb/image", |topics| &mut topics.color),
    ("rgb/camera_info", |topics| &mut topics.color_info),
    ("depth/image", |topics| &mut topics.depth),
    ("depth/camera_info", |topics| &mut topics.depth_info),
    ("pose", |topics| &mut topics.pose),
    ("odom", |topics| &mut topics.pose),
    ("mesh", |topics| &mut topics.mesh),
    ("pose_corrections", |topics| &mut topics.corrections),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_default_is_accepted_by_its_own_row() {
        let mut config = Config::default();
        for parameter in tree::PARAMETERS {
            let value = parameter.get(&mut config);
            let again = parameter.set(&mut config, &value);
            assert_eq!(again, Ok(()), "{} = {value}", parameter.name);
            assert_eq!(parameter.get(&mut config), value, "{}", parameter.name);
        }
    }

    #[test]
    fn names_are_unique() {
        let mut names: Vec<_> = tree::PARAMETERS.iter().map(|p| p.name).collect();
        names.sort_unstable();
        let num_names = names.len();
        names.dedup();
        assert_eq!(names.len(), num_names);
    }

    #[test]
    fn a_slip_is_refused_with_the_name_that_was_meant() {
        let mut config = Config::default();
        let error = config.set("keyframe.min_translation", "0.1").unwrap_err();
        assert_eq!(
            error.to_string(),
            "unknown parameter 'keyframe.min_translation'; did you mean \
             'keyframe.min_translation_m'?"
        );
        assert!(config.set("keyframe.budget_mb", "nan").is_err());
        assert!(config.set("keyframe.budget_mb", "-1").is_err());
        assert!(config.set("texinit.mode", "fast").is_err());
    }

    #[test]
    fn parameter_files_reach_the_node_that_they_address() {
        let text = "\
/**:
  ros__parameters:
    keyframe: {budget_mb: 64.0}
other:
  ros__parameters:
    keyframe: {budget_mb: 1.0}
veneer:
  ros__parameters:
    texinit.texels_per_m: 250
    approx_sync: false
";
        let mut config = Config::default();
        params_file::apply(&mut config, text, "/veneer").unwrap();
        assert_eq!(config.pipeline.keyframe.budget_mb, 64.0);
        assert_eq!(config.pipeline.texinit.density.texels_per_m, 250.0);
        assert!(!config.pipeline.ingest.approx_sync);
    }

    #[test]
    fn yaml_of_the_defaults_changes_nothing() {
        let mut config = Config::default();
        let yaml = listing::to_yaml(&mut Config::default());
        params_file::apply(&mut config, &yaml, "/veneer").unwrap();
        assert_eq!(
            listing::to_json(&mut config),
            listing::to_json(&mut Config::default())
        );
    }

    #[test]
    fn files_of_another_shape_are_refused() {
        let mut config = Config::default();
        for text in [
            "",
            "a",
            "veneer: 1",
            "veneer: {ros__parameters: {a: [1]}}",
            "[",
            "x: {ros__parameters: {}}",
        ] {
            assert!(
                params_file::apply(&mut config, text, "/veneer").is_err(),
                "{text}"
            );
        }
    }

    #[test]
    fn subscriptions_are_remapped_by_name() {
        let mut config = Config::default();
        config.remap("rgb/image", "/front/image_raw").unwrap();
        assert_eq!(config.topics.color.as_deref(), Some("/front/image_raw"));
        assert!(config.remap("rgb/imag", "/x").is_err());
    }
}
