//! The configuration as ROS parameters: one row of the tree is one parameter, with its range and
//! its description. Pure: the services that carry these answers are in `services`.
//!
//! What changes how the scan is painted, paced or saved can be set while the node runs; what
//! decides how it listens is fixed at start and says so (`read_only`).

use std::collections::BTreeSet;

use ros2_client::parameters::raw;
use ros2_client::rcl_interfaces::ListParametersResult;

use crate::config::parameter::{Access, Parameter};
use crate::config::{Config, tree};

/// Families and names that can be set while the node runs.
const LIVE: [&str; 11] = [
    "texinit.",
    "texsmooth.",
    "photometric.",
    "mesh.",
    "export.",
    "save.",
    "idle_flush",
    "paint_period",
    "refine_iterations",
    "publish.rate_mb",
    "diagnostics.period",
];
/// Families whose change makes the present texture another one.
const PAINTING: [&str; 4] = ["texinit.", "texsmooth.", "photometric.", "mesh."];

fn is_of(name: &str, families: &[&str]) -> bool {
    families.iter().any(|family| {
        if family.ends_with('.') {
            name.starts_with(family)
        } else {
            name == *family
        }
    })
}

/// Whether a parameter can be set while the node runs.
pub fn is_live(name: &str) -> bool {
    is_of(name, &LIVE)
}

/// Whether setting it makes the present texture another one.
pub fn repaints(name: &str) -> bool {
    is_of(name, &PAINTING)
}

fn row(name: &str) -> Option<&'static Parameter> {
    tree::PARAMETERS.iter().find(|row| row.name == name)
}

fn empty_value() -> raw::ParameterValue {
    raw::ParameterValue {
        ptype: raw::ParameterType::NOT_SET,
        boolean_value: false,
        int_value: 0,
        double_value: 0.0,
        string_value: String::new(),
        byte_array: Vec::new(),
        bool_array: Vec::new(),
        int_array: Vec::new(),
        double_array: Vec::new(),
        string_array: Vec::new(),
    }
}

fn value_of(row: &Parameter, config: &mut Config) -> raw::ParameterValue {
    let text = row.get(config);
    let mut value = empty_value();
    match row.access {
        Access::Bool(_) => {
            value.ptype = raw::ParameterType::BOOL;
            value.boolean_value = text == "true";
        }
        Access::Float(..) | Access::Float32(..) => {
            value.ptype = raw::ParameterType::DOUBLE;
            value.double_value = text.parse().unwrap_or_default();
        }
        Access::Int(..) | Access::Count(..) => {
            value.ptype = raw::ParameterType::INTEGER;
            value.int_value = text.parse().unwrap_or_default();
        }
        Access::Text(_) | Access::Choice { .. } => {
            value.ptype = raw::ParameterType::STRING;
            value.string_value = text;
        }
        Access::Custom { .. } => {
            if let Ok(number) = text.parse() {
                value.ptype = raw::ParameterType::INTEGER;
                value.int_value = number;
            } else if let Ok(number) = text.parse() {
                value.ptype = raw::ParameterType::DOUBLE;
                value.double_value = number;
            } else {
                value.ptype = raw::ParameterType::STRING;
                value.string_value = text;
            }
        }
    }
    value
}

/// Whether a request names no more than it may: a peer's list must not make the node work for long.
fn is_short(config: &Config, names: &[String]) -> bool {
    names.len() <= config.node.limits.request_names
}

/// The values of `names`; where one is unknown, or there are too many, ROS gives none at all.
pub fn get(config: &mut Config, names: &[String]) -> Vec<raw::ParameterValue> {
    let mut values = Vec::new();
    if !is_short(config, names) {
        return values;
    }
    for name in names {
        match row(name) {
            Some(row) => values.push(value_of(row, config)),
            None => return Vec::new(),
        }
    }
    values
}

/// The types of `names`, 0 for an unknown one; none where there are too many.
pub fn types(config: &mut Config, names: &[String]) -> Vec<u8> {
    if !is_short(config, names) {
        return Vec::new();
    }
    let of = |name: &String| row(name).map_or(0, |row| value_of(row, config).ptype);
    names.iter().map(of).collect()
}

/// What `names` are; nothing where there are too many.
pub fn describe(config: &mut Config, names: &[String]) -> Vec<raw::ParameterDescriptor> {
    if !is_short(config, names) {
        return Vec::new();
    }
    let mut of = |name: &String| describe_one(config, name);
    names.iter().map(&mut of).collect()
}

fn describe_one(config: &mut Config, name: &str) -> raw::ParameterDescriptor {
    let mut descriptor = raw::ParameterDescriptor {
        name: name.to_owned(),
        r#type: raw::ParameterType::NOT_SET,
        description: String::new(),
        additional_constraints: String::new(),
        read_only: false,
        dynamic_typing: false,
        floating_point_range: Vec::new(),
        integer_range: Vec::new(),
    };
    let Some(row) = row(name) else {
        return descriptor;
    };
    descriptor.r#type = value_of(row, config).ptype;
    row.description.clone_into(&mut descriptor.description);
    descriptor.read_only = !is_live(name);
    let float_range = |from_value: f64, to_value: f64| {
        vec![raw::FloatingPointRange {
            from_value,
            to_value,
            step: 0.0,
        }]
    };
    let whole = |number: usize| i64::try_from(number).unwrap_or(i64::MAX);
    let integer_range = |from_value: i64, to_value: i64| {
        vec![raw::IntegerRange {
            from_value,
            to_value,
            step: 1,
        }]
    };
    match row.access {
        Access::Float(_, min, max) => descriptor.floating_point_range = float_range(min, max),
        Access::Float32(_, min, max) => {
            descriptor.floating_point_range = float_range(min.into(), max.into());
        }
        Access::Int(_, min, max) => {
            descriptor.integer_range = integer_range(min.into(), max.into());
        }
        Access::Count(_, min, max) => {
            descriptor.integer_range = integer_range(whole(min), whole(max));
        }
        Access::Custom { .. } => {
            descriptor.dynamic_typing = true;
            descriptor.additional_constraints = row.range();
        }
        Access::Bool(_) | Access::Text(_) | Access::Choice { .. } => {
            descriptor.additional_constraints = row.range();
        }
    }
    if !row.unit.is_empty() {
        descriptor.description += &format!(" Unit: {}.", row.unit);
    }
    descriptor
}

/// The names below `prefixes`, at most `depth` parts deep; 0 means all. None where there are too many
/// prefixes.
pub fn list(config: &Config, prefixes: &[String], depth: u64) -> ListParametersResult {
    if !is_short(config, prefixes) {
        return ListParametersResult {
            names: Vec::new(),
            prefixes: Vec::new(),
        };
    }
    let is_shallow = |rest: &str| depth == 0 || (rest.matches('.').count() as u64) < depth;
    let is_wanted = |name: &str| {
        prefixes.is_empty() && is_shallow(name)
            || prefixes.iter().any(|prefix| {
                let rest = name.strip_prefix(prefix.as_str());
                rest.is_some_and(|rest| {
                    rest.is_empty() || rest.strip_prefix('.').is_some_and(is_shallow)
                })
            })
    };
    let names: Vec<String> = tree::PARAMETERS
        .iter()
        .map(|row| row.name)
        .filter(|name| is_wanted(name))
        .map(str::to_owned)
        .collect();
    let families: BTreeSet<String> = names
        .iter()
        .filter_map(|name| Some(name.rsplit_once('.')?.0.to_owned()))
        .collect();
    ListParametersResult {
        names,
        prefixes: families.into_iter().collect(),
    }
}

/// Sets one parameter of a running node.
///
/// # Errors
/// Why not, in words.
pub fn set(config: &mut Config, parameter: &raw::Parameter) -> Result<(), String> {
    let name = &parameter.name;
    let value = &parameter.value;
    let text = match value.ptype {
        raw::ParameterType::BOOL => value.boolean_value.to_string(),
        raw::ParameterType::INTEGER => value.int_value.to_string(),
        raw::ParameterType::DOUBLE => value.double_value.to_string(),
        raw::ParameterType::STRING => value.string_value.clone(),
        raw::ParameterType::NOT_SET => {
            return Err(format!("'{name}' cannot be deleted: it is the node's own"));
        }
        _ => return Err(format!("'{name}' takes no list")),
    };
    let mut changed = config.clone();
    changed
        .set(name, &text)
        .map_err(|error| error.to_string())?;
    if !is_live(name) {
        let (before, after) = (value_text(config, name), value_text(&mut changed, name));
        return if before == after {
            Ok(())
        } else {
            Err(format!(
                "'{name}' is fixed while the node runs (it is {before}): set it at start, with -p {name}:={text} or in the parameter file"
            ))
        };
    }
    *config = changed;
    Ok(())
}

fn value_text(config: &mut Config, name: &str) -> String {
    row(name).map_or_else(String::new, |row| row.get(config))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameter(name: &str, fill: impl FnOnce(&mut raw::ParameterValue)) -> raw::Parameter {
        let mut value = empty_value();
        fill(&mut value);
        raw::Parameter {
            name: name.to_owned(),
            value,
        }
    }

    fn double(name: &str, number: f64) -> raw::Parameter {
        parameter(name, |value| {
            value.ptype = raw::ParameterType::DOUBLE;
            value.double_value = number;
        })
    }

    #[test]
    fn every_parameter_is_listed_described_and_has_a_value() {
        let mut config = Config::default();
        let listed = list(&config, &[], 0).names;
        assert_eq!(listed.len(), tree::PARAMETERS.len());
        let values = get(&mut config, &listed);
        let described = describe(&mut config, &listed);
        for ((name, value), descriptor) in listed.iter().zip(&values).zip(&described) {
            assert_ne!(value.ptype, raw::ParameterType::NOT_SET, "{name}");
            assert_eq!(value.ptype, descriptor.r#type, "{name}");
            assert!(!descriptor.description.is_empty(), "{name}");
        }
    }

    #[test]
    fn what_can_be_set_while_running_exists() {
        for family in LIVE.iter().chain(&PAINTING) {
            let mut names = tree::PARAMETERS.iter().map(|row| row.name);
            assert!(names.any(|name| is_of(name, &[family])), "{family}");
        }
    }

    #[test]
    fn lists_go_by_prefix_and_depth() {
        let config = Config::default();
        let one = list(&config, &["texinit.chart".to_owned()], 0);
        assert!(one.names.iter().all(|n| n.starts_with("texinit.chart.")));
        assert_eq!(one.prefixes, ["texinit.chart"]);
        let top = list(&config, &[], 1).names;
        assert!(top.contains(&"approx_sync".to_owned()));
        assert!(top.iter().all(|name| !name.contains('.')));
        assert!(list(&config, &["texin".to_owned()], 0).names.is_empty());
        assert_eq!(
            list(&config, &["approx_sync".to_owned()], 0).names,
            ["approx_sync"]
        );
    }

    #[test]
    fn ranges_hold_and_are_told() {
        let mut config = Config::default();
        set(&mut config, &double("photometric.max_turn_rad", 0.25)).unwrap();
        assert_eq!(config.pipeline.refine.pose.max_turn_rad, 0.25);
        let words = set(&mut config, &double("photometric.max_turn_rad", 7.0)).unwrap_err();
        assert!(words.contains("0 ..= 0.5"), "{words}");
        assert_eq!(config.pipeline.refine.pose.max_turn_rad, 0.25);
        let words = set(&mut config, &double("photometric.max_turn", 0.1)).unwrap_err();
        assert!(words.contains("photometric.max_turn_rad"), "{words}");
        let names = ["photometric.max_turn_rad".to_owned()];
        let range = &describe(&mut config, &names)[0].floating_point_range[0];
        assert_eq!((range.from_value, range.to_value), (0.0, 0.5));
    }

    #[test]
    fn what_is_fixed_at_start_says_so() {
        let mut config = Config::default();
        let words = set(&mut config, &double("keyframe.budget_mb", 100.0)).unwrap_err();
        assert!(words.contains("fixed while the node runs"), "{words}");
        set(&mut config, &double("keyframe.budget_mb", 512.0)).unwrap();
        assert!(describe(&mut config, &["keyframe.budget_mb".to_owned()])[0].read_only);
        let unset = parameter("texinit.gutters", |_| {});
        assert!(set(&mut config, &unset).is_err());
    }

    #[test]
    fn a_request_of_too_many_names_gets_nothing() {
        let mut config = Config::default();
        config.set("limits.request_names", "2").unwrap();
        let names = vec!["approx_sync".to_owned(); 3];
        assert!(get(&mut config, &names).is_empty());
        assert!(types(&mut config, &names).is_empty());
        assert!(describe(&mut config, &names).is_empty());
        assert!(list(&config, &names, 0).names.is_empty());
        assert_eq!(get(&mut config, &names[..2]).len(), 2);
        assert_eq!(list(&config, &names[..2], 0).names, ["approx_sync"]);
    }

    #[test]
    fn an_unknown_name_gives_no_values() {
        let mut config = Config::default();
        let names = ["approx_sync".to_owned(), "nothing".to_owned()];
        assert!(get(&mut config, &names).is_empty());
        assert_eq!(types(&mut config, &names), [raw::ParameterType::BOOL, 0]);
    }
}
