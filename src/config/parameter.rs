//! A parameter: name, range, unit, description, and the field that it sets.

use super::Config;

/// Why a setting was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParameterError {
    /// No parameter has this name.
    #[error("unknown parameter '{name}'{}", suggestion(nearest))]
    Unknown {
        /// The name as given.
        name: String,
        /// The known name nearest to it, where one is near.
        nearest: Option<&'static str>,
    },
    /// The value is of the wrong type.
    #[error("parameter '{name}' takes {expected}, not '{value}'")]
    Type {
        /// Which parameter.
        name: &'static str,
        /// What it takes.
        expected: String,
        /// The value as given.
        value: String,
    },
    /// The value is outside the range.
    #[error("parameter '{name}' = {value} is outside {range}")]
    Range {
        /// Which parameter.
        name: &'static str,
        /// The value as given.
        value: String,
        /// The range in words.
        range: String,
    },
    /// The file is not YAML of the shape that ROS uses.
    #[error("parameter file: {0}")]
    File(String),
    /// The file is one, but for other nodes.
    #[error("parameter file: {0}")]
    NotAddressed(String),
}

fn suggestion(nearest: &Option<&'static str>) -> String {
    match nearest {
        Some(name) => format!("; did you mean '{name}'?"),
        None => "; `veneer params` lists all".to_owned(),
    }
}

type Field<T> = fn(&mut Config) -> &mut T;

/// The field that a parameter sets, with the values that it accepts.
#[derive(Clone, Copy)]
pub enum Access {
    /// A real number within bounds.
    Float(Field<f64>, f64, f64),
    /// A single-precision real number within bounds.
    Float32(Field<f32>, f32, f32),
    /// A whole number within bounds.
    Int(Field<u32>, u32, u32),
    /// A count within bounds.
    Count(Field<usize>, usize, usize),
    /// A switch.
    Bool(Field<bool>),
    /// A name; empty means unset.
    Text(Field<Option<String>>),
    /// One of a few words.
    Choice {
        /// The words.
        words: &'static [&'static str],
        /// Takes one of the words; never called with another.
        set: fn(&mut Config, &str),
        /// The word that stands for the current value.
        get: fn(&Config) -> &'static str,
    },
    /// Anything else.
    Custom {
        /// What it accepts, in words.
        range: &'static str,
        /// Takes the text, or returns `None` when it does not accept it.
        set: fn(&mut Config, &str) -> Option<()>,
        /// The current value.
        get: fn(&Config) -> String,
    },
}

/// One row of the parameter tree.
#[derive(Clone, Copy)]
pub struct Parameter {
    /// Dotted name as in ROS.
    pub name: &'static str,
    /// Unit, or empty.
    pub unit: &'static str,
    /// What it does, in one line.
    pub description: &'static str,
    /// The field.
    pub access: Access,
}

impl Parameter {
    /// Sets the field from text.
    ///
    /// # Errors
    /// [`ParameterError`] for a value of the wrong type or outside the range.
    pub fn set(&self, config: &mut Config, value: &str) -> Result<(), ParameterError> {
        let value = value.trim();
        match self.access {
            Access::Float(field, min, max) => {
                *field(config) = self.number(value, min, max)?;
            }
            Access::Float32(field, min, max) => {
                *field(config) = self.number(value, min, max)?;
            }
            Access::Int(field, min, max) => {
                *field(config) = self.number(value, min, max)?;
            }
            Access::Count(field, min, max) => {
                *field(config) = self.number(value, min, max)?;
            }
            Access::Bool(field) => {
                *field(config) = match value {
                    "true" | "True" | "yes" | "on" => true,
                    "false" | "False" | "no" | "off" => false,
                    _ => return Err(self.wrong_type(value)),
                };
            }
            Access::Text(field) => {
                *field(config) = (!value.is_empty()).then(|| value.to_owned());
            }
            Access::Choice { words, set, .. } => {
                if !words.contains(&value) {
                    return Err(self.wrong_type(value));
                }
                set(config, value);
            }
            Access::Custom { set, .. } => {
                set(config, value).ok_or_else(|| self.wrong_type(value))?;
            }
        }
        Ok(())
    }

    /// The current value as text that [`Self::set`] accepts.
    pub fn get(&self, config: &mut Config) -> String {
        match self.access {
            Access::Float(field, ..) => field(config).to_string(),
            Access::Float32(field, ..) => field(config).to_string(),
            Access::Int(field, ..) => field(config).to_string(),
            Access::Count(field, ..) => field(config).to_string(),
            Access::Bool(field) => field(config).to_string(),
            Access::Text(field) => field(config).clone().unwrap_or_default(),
            Access::Choice { get, .. } => get(config).to_owned(),
            Access::Custom { get, .. } => get(config),
        }
    }

    /// What it accepts, in words: `0.5 ..= 2 m`, `true | false`.
    pub fn range(&self) -> String {
        let (range, has_unit) = match self.access {
            Access::Float(_, min, max) => (format!("{min} ..= {max}"), true),
            Access::Float32(_, min, max) => (format!("{min} ..= {max}"), true),
            Access::Int(_, min, max) => (format!("{min} ..= {max}"), true),
            Access::Count(_, min, max) => (format!("{min} ..= {max}"), true),
            Access::Bool(_) => ("true | false".to_owned(), false),
            Access::Text(_) => ("a name, or empty".to_owned(), false),
            Access::Choice { words, .. } => (words.join(" | "), false),
            Access::Custom { range, .. } => (range.to_owned(), true),
        };
        if has_unit && !self.unit.is_empty() {
            format!("{range} {}", self.unit)
        } else {
            range
        }
    }

    fn number<T>(&self, text: &str, min: T, max: T) -> Result<T, ParameterError>
    where
        T: std::str::FromStr + PartialOrd + Copy,
    {
        let value: T = text.parse().map_err(|_| self.wrong_type(text))?;
        // Written so that NaN is outside.
        if value >= min && value <= max {
            Ok(value)
        } else {
            Err(ParameterError::Range {
                name: self.name,
                value: text.to_owned(),
                range: self.range(),
            })
        }
    }

    fn wrong_type(&self, value: &str) -> ParameterError {
        let kind = match self.access {
            Access::Float(..) | Access::Float32(..) => "a number in ",
            Access::Int(..) | Access::Count(..) => "a whole number in ",
            _ => "",
        };
        ParameterError::Type {
            name: self.name,
            expected: format!("{kind}{}", self.range()),
            value: value.to_owned(),
        }
    }
}

/// The known name nearest to `name`, where one is near enough to be a slip.
pub(super) fn nearest_name(
    name: &str,
    known: impl Iterator<Item = &'static str>,
) -> Option<&'static str> {
    let leaf = |n: &str| n.rsplit('.').next().unwrap_or(n).to_owned();
    known
        .map(|candidate| {
            let whole = strsim::jaro_winkler(name, candidate);
            let by_leaf = strsim::jaro_winkler(&leaf(name), &leaf(candidate));
            (whole.max(by_leaf - 0.02), candidate)
        })
        .filter(|(similarity, _)| *similarity > 0.82)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}
