//! All parameters as files and pages.

use super::Config;
use super::parameter::Access;
use super::tree::PARAMETERS;

/// Values of `config` as a ROS 2 parameter file.
pub fn to_yaml(config: &mut Config) -> String {
    let mut text = "/**:\n  ros__parameters:\n".to_owned();
    for parameter in PARAMETERS {
        let value = parameter.get(config);
        let quoted = match parameter.access {
            Access::Text(_) | Access::Choice { .. } => format!("\"{value}\""),
            _ => value,
        };
        text += &format!(
            "    # {} ({})\n    {}: {quoted}\n",
            parameter.description,
            parameter.range(),
            parameter.name
        );
    }
    text
}

/// Values of `config` as `docs/parameters.md`.
pub fn to_markdown(config: &mut Config) -> String {
    let mut text = "\
# Parameters

Written by `veneer params --markdown`. Set them with `--param NAME:=VALUE` or in a ROS 2 parameter
file with `--params-file FILE` (`veneer params --yaml` writes one with the defaults). An unknown name
or a value outside its range is refused.

| name | default | range | what it does |
|---|---|---|---|
"
    .to_owned();
    for parameter in PARAMETERS {
        let value = parameter.get(config);
        let shown = if value.is_empty() { "(empty)" } else { &value };
        text += &format!(
            "| `{}` | {shown} | {} | {} |\n",
            parameter.name,
            parameter.range().replace('|', "\\|"),
            parameter.description
        );
    }
    text
}

/// Values of `config` as a table for a terminal.
pub fn to_table(config: &mut Config) -> String {
    let mut text = String::new();
    for parameter in PARAMETERS {
        let value = parameter.get(config);
        text += &format!(
            "{} = {value}  ({})\n    {}\n",
            parameter.name,
            parameter.range(),
            parameter.description
        );
    }
    text
}

/// Values of `config` as a JSON object of strings.
pub fn to_json(config: &mut Config) -> serde_json::Value {
    let entries = PARAMETERS.iter().map(|parameter| {
        let value = parameter.get(config);
        (parameter.name.to_owned(), serde_json::Value::String(value))
    });
    serde_json::Value::Object(entries.collect())
}
