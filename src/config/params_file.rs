//! ROS 2 parameter files.
//!
//! `/NODE: { ros__parameters: { a: { b: 1 } } }`, where in the node's name `*` stands for one part
//! and `**` for any number of them. Nested maps and dotted names mean the same.

use serde_yaml_ng::Value;

use super::{Config, ParameterError};

/// Applies every section of `text` that addresses `node_name` (fully qualified, `/veneer`), in
/// the order of the file.
///
/// # Errors
/// [`ParameterError`] for text that is not such a file, and for names and values that the
/// parameter tree refuses.
pub fn apply(config: &mut Config, text: &str, node_name: &str) -> Result<(), ParameterError> {
    let file = |reason: String| ParameterError::File(reason);
    let root: Value = serde_yaml_ng::from_str(text).map_err(|e| file(e.to_string()))?;
    let Value::Mapping(sections) = root else {
        return Err(file(
            "expected `NODE: ros__parameters: …` at the top".to_owned(),
        ));
    };
    let mut num_sections = 0;
    for (key, section) in &sections {
        let name = key.as_str().unwrap_or_default();
        let Some(parameters) = section.get("ros__parameters") else {
            return Err(file(format!("section '{name}' has no ros__parameters")));
        };
        if addresses(name, node_name) {
            num_sections += 1;
            apply_tree(config, "", parameters)?;
        }
    }
    if num_sections == 0 {
        let reason = format!("no section addresses the node '{node_name}'");
        return Err(ParameterError::NotAddressed(reason));
    }
    Ok(())
}

/// Matches name by name: `*` stands for one, `**` for any number.
fn addresses(section: &str, node_name: &str) -> bool {
    let tokens = |name: &str| -> Vec<String> {
        let parts = name.split('/').filter(|part| !part.is_empty());
        parts.map(str::to_owned).collect()
    };
    matches(&tokens(section), &tokens(node_name))
}

fn matches(pattern: &[String], name: &[String]) -> bool {
    match (pattern.split_first(), name.split_first()) {
        (None, None) => true,
        (Some((first, rest)), _) if first == "**" => {
            (0..=name.len()).any(|skipped| matches(rest, &name[skipped..]))
        }
        (Some((first, rest)), Some((token, names))) => {
            (first == "*" || first == token) && matches(rest, names)
        }
        _ => false,
    }
}

fn apply_tree(config: &mut Config, prefix: &str, value: &Value) -> Result<(), ParameterError> {
    match value {
        Value::Mapping(map) => {
            for (key, value) in map {
                let Some(key) = key.as_str() else {
                    return Err(ParameterError::File(format!(
                        "a name under '{prefix}' is not text: {key:?}"
                    )));
                };
                let name = if prefix.is_empty() {
                    key.to_owned()
                } else {
                    format!("{prefix}.{key}")
                };
                apply_tree(config, &name, value)?;
            }
            Ok(())
        }
        Value::Bool(value) => config.set(prefix, &value.to_string()),
        Value::Number(value) => config.set(prefix, &value.to_string()),
        Value::String(value) => config.set(prefix, value),
        Value::Null => config.set(prefix, ""),
        Value::Sequence(_) | Value::Tagged(_) => Err(ParameterError::File(format!(
            "'{prefix}' is a list; no parameter of veneer is"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wildcards_stand_for_parts_of_the_name() {
        for (section, node, expected) in [
            ("/**", "/robot/veneer", true),
            ("**", "/veneer", true),
            ("/*", "/veneer", true),
            ("/*", "/robot/veneer", false),
            ("/*/veneer", "/robot/veneer", true),
            ("/**/veneer", "/veneer", true),
            ("/**/veneer", "/a/b/veneer", true),
            ("/**/veneer", "/a/b/other", false),
            ("/robot/**", "/robot/a/veneer", true),
            ("veneer", "/veneer", true),
            ("veneer", "/robot/veneer", false),
            ("/robot/veneer", "/robot/veneer", true),
        ] {
            assert_eq!(addresses(section, node), expected, "{section} {node}");
        }
    }
}
