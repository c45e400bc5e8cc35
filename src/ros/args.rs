//! `--ros-args`: what every ROS 2 executable takes, read as rcl reads it.
//!
//! Sections start with `--ros-args` and end with `--` or with the line; outside them nothing is
//! touched. Within: `-r`/`--remap FROM:=TO` (also `__node`, `__name`, `__ns`, and `NODE:FROM:=TO`
//! for one node), `-p`/`--param NAME:=VALUE` (also `NODE:NAME:=VALUE`), `--params-file FILE`,
//! `--log-level LEVEL` or `LOGGER:=LEVEL`, `--enable-rosout-logs` and its kin, `-e`/`--enclave`.
//! Pure: nothing is read from files here.

use std::path::PathBuf;

use super::names::{NameError, NameResolver, NodeIdentity, Remap};

/// Why the arguments were refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ArgsError {
    /// An option that needs a value is the last word.
    #[error("{0} needs a value")]
    MissingValue(String),
    /// A rule or parameter has no `:=`.
    #[error("{option} '{text}' is not {form}")]
    Form {
        /// The option.
        option: String,
        /// Its value.
        text: String,
        /// The form it should have.
        form: &'static str,
    },
    /// Nothing of this name is known.
    #[error(
        "unknown ROS argument '{0}'; known are -r, -p, --params-file, --log-level, -e, --enable-rosout-logs, --disable-rosout-logs (and stdout, external-lib)"
    )]
    Unknown(String),
    /// The level is none.
    #[error("log level '{0}' is none of debug, info, warn, error, fatal")]
    Level(String),
    /// A name is none.
    #[error(transparent)]
    Name(#[from] NameError),
}

/// A parameter as given: for a node, or for all.
#[derive(Clone, Debug, PartialEq, Eq)]
struct NodeParam {
    node: Option<String>,
    name: String,
    value: String,
}

/// A remapping as given: for a node, or for all.
#[derive(Clone, Debug, PartialEq, Eq)]
struct NodeRemap {
    node: Option<String>,
    remap: Remap,
}

/// How much is logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogLevel {
    /// Everything.
    Debug,
    /// What goes on.
    Info,
    /// What may be wrong.
    Warn,
    /// What is wrong.
    Error,
    /// What ends the process.
    Fatal,
}

impl LogLevel {
    fn parse(text: &str) -> Result<Self, ArgsError> {
        match text.to_ascii_lowercase().as_str() {
            "debug" => Ok(Self::Debug),
            "info" => Ok(Self::Info),
            "warn" | "warning" => Ok(Self::Warn),
            "error" => Ok(Self::Error),
            "fatal" => Ok(Self::Fatal),
            _ => Err(ArgsError::Level(text.to_owned())),
        }
    }

    /// The level as a log filter has it; there is none above `error`.
    pub fn filter(self) -> &'static str {
        match self {
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error | Self::Fatal => "error",
        }
    }
}

/// What stood in the sections.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RosArgs {
    node_name: Option<String>,
    namespace: Option<String>,
    remaps: Vec<NodeRemap>,
    params: Vec<NodeParam>,
    /// Parameter files, in order.
    pub params_files: Vec<PathBuf>,
    /// The level for all loggers.
    pub log_level: Option<LogLevel>,
    /// Levels of single loggers, in order.
    pub logger_levels: Vec<(String, LogLevel)>,
    /// Whether log messages go to `/rosout`.
    pub has_rosout: bool,
    /// The security enclave, where one was named.
    pub enclave: Option<String>,
}

impl Default for RosArgs {
    fn default() -> Self {
        Self {
            node_name: None,
            namespace: None,
            remaps: Vec::new(),
            params: Vec::new(),
            params_files: Vec::new(),
            log_level: None,
            logger_levels: Vec::new(),
            has_rosout: true,
            enclave: None,
        }
    }
}

impl RosArgs {
    /// Takes the sections out of a command line; what is left is the program's own.
    ///
    /// # Errors
    /// [`ArgsError`] naming the word that cannot be used.
    pub fn split(
        words: impl IntoIterator<Item = String>,
    ) -> Result<(Self, Vec<String>), ArgsError> {
        let mut args = Self::default();
        let mut own = Vec::new();
        let mut is_inside = false;
        let mut words = words.into_iter();
        while let Some(word) = words.next() {
            match (is_inside, word.as_str()) {
                (_, "--ros-args") => is_inside = true,
                (true, "--") => is_inside = false,
                (false, _) => own.push(word),
                (true, _) => args.take(&word, &mut words)?,
            }
        }
        Ok((args, own))
    }

    fn take(
        &mut self,
        option: &str,
        words: &mut dyn Iterator<Item = String>,
    ) -> Result<(), ArgsError> {
        let mut value = || {
            words
                .next()
                .ok_or_else(|| ArgsError::MissingValue(option.to_owned()))
        };
        match option {
            "-r" | "--remap" => self.remap(option, &value()?),
            "-p" | "--param" => self.param(option, &value()?),
            "--params-file" => {
                self.params_files.push(PathBuf::from(value()?));
                Ok(())
            }
            "--log-level" => self.level(&value()?),
            "-e" | "--enclave" => {
                self.enclave = Some(value()?);
                Ok(())
            }
            "--log-config-file" => value().map(drop),
            "--enable-rosout-logs" => {
                self.has_rosout = true;
                Ok(())
            }
            "--disable-rosout-logs" => {
                self.has_rosout = false;
                Ok(())
            }
            "--enable-stdout-logs"
            | "--disable-stdout-logs"
            | "--enable-external-lib-logs"
            | "--disable-external-lib-logs" => Ok(()),
            // rcl still takes a bare rule, as ROS 1 had it.
            bare if bare.contains(":=") && !bare.starts_with('-') => self.remap("-r", bare),
            unknown => Err(ArgsError::Unknown(unknown.to_owned())),
        }
    }

    fn remap(&mut self, option: &str, text: &str) -> Result<(), ArgsError> {
        let form = |form| ArgsError::Form {
            option: option.to_owned(),
            text: text.to_owned(),
            form,
        };
        let (from, to) = text.split_once(":=").ok_or_else(|| form("FROM:=TO"))?;
        if from.is_empty() || to.is_empty() {
            return Err(form("FROM:=TO"));
        }
        let (node, from) = node_prefix(from);
        match from {
            "__node" | "__name" => self.node_name = Some(to.to_owned()),
            "__ns" if to.starts_with('/') => self.namespace = Some(to.to_owned()),
            "__ns" => return Err(form("__ns:=/NAMESPACE")),
            _ => self.remaps.push(NodeRemap {
                node,
                remap: Remap::new(from, to),
            }),
        }
        Ok(())
    }

    fn param(&mut self, option: &str, text: &str) -> Result<(), ArgsError> {
        let (name, value) = text.split_once(":=").ok_or_else(|| ArgsError::Form {
            option: option.to_owned(),
            text: text.to_owned(),
            form: "NAME:=VALUE",
        })?;
        let (node, name) = node_prefix(name);
        self.params.push(NodeParam {
            node,
            name: name.to_owned(),
            value: unquoted(value).to_owned(),
        });
        Ok(())
    }

    fn level(&mut self, text: &str) -> Result<(), ArgsError> {
        match text.split_once(":=") {
            Some((logger, level)) => {
                let level = LogLevel::parse(level)?;
                self.logger_levels.push((logger.to_owned(), level));
            }
            None => self.log_level = Some(LogLevel::parse(text)?),
        }
        Ok(())
    }

    /// Names as remapped, for a node that calls itself `/default_name`.
    ///
    /// # Errors
    /// [`ArgsError::Name`] for names that ROS refuses.
    pub fn resolver(&self, default_name: &str) -> Result<NameResolver, ArgsError> {
        let node = NodeIdentity::new(
            self.namespace.as_deref().unwrap_or("/"),
            self.node_name.as_deref().unwrap_or(default_name),
        )?;
        let is_ours = |given: &Option<String>| {
            given
                .as_deref()
                .is_none_or(|name| name == default_name || is_node(name, &node))
        };
        let remaps: Vec<_> = self
            .remaps
            .iter()
            .filter(|rule| is_ours(&rule.node))
            .map(|rule| rule.remap.clone())
            .collect();
        Ok(NameResolver::new(node, &remaps)?)
    }

    /// Parameters that are for `node`, in order: name and value.
    pub fn params<'a>(
        &'a self,
        node: &'a NodeIdentity,
    ) -> impl Iterator<Item = (&'a str, &'a str)> {
        self.params
            .iter()
            .filter(|param| param.node.as_deref().is_none_or(|name| is_node(name, node)))
            .map(|param| (param.name.as_str(), param.value.as_str()))
    }
}

fn is_node(name: &str, node: &NodeIdentity) -> bool {
    name == node.base_name() || name == node.fully_qualified()
}

/// `NODE:REST`; topic names may not hold a colon, but `rostopic://` does.
fn node_prefix(text: &str) -> (Option<String>, &str) {
    match text.split_once(':') {
        Some((node, rest)) if !rest.starts_with("//") => (Some(node.to_owned()), rest),
        _ => (None, text),
    }
}

/// Parameter values are YAML there: a quoted one is text.
fn unquoted(value: &str) -> &str {
    let quoted = |q: char| value.strip_prefix(q).and_then(|v| v.strip_suffix(q));
    quoted('"').or_else(|| quoted('\'')).unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(line: &str) -> Result<(RosArgs, Vec<String>), ArgsError> {
        RosArgs::split(line.split_whitespace().map(str::to_owned))
    }

    #[test]
    fn sections_are_taken_out_and_the_rest_is_left() {
        let (args, own) = split(
            "veneer node --ros-args -r rgb/image:=/front -p approx_sync:=false -- --quiet \
             --ros-args --params-file a.yaml --log-level debug --log-level rcl:=WARN",
        )
        .unwrap();
        assert_eq!(own, ["veneer", "node", "--quiet"]);
        assert_eq!(args.params_files, [PathBuf::from("a.yaml")]);
        assert_eq!(args.log_level, Some(LogLevel::Debug));
        assert_eq!(args.logger_levels, [("rcl".to_owned(), LogLevel::Warn)]);
        let names = args.resolver("veneer").unwrap();
        assert_eq!(names.resolve("rgb/image").unwrap(), "/front");
        let params: Vec<_> = args.params(names.node()).collect();
        assert_eq!(params, [("approx_sync", "false")]);
    }

    #[test]
    fn node_and_namespace_are_remapped_before_names_are() {
        let (args, _) =
            split("--ros-args -r __ns:=/robot -r __node:=painter -r mesh:=~/in -r ~/status:=s")
                .unwrap();
        let names = args.resolver("veneer").unwrap();
        assert_eq!(names.node().fully_qualified(), "/robot/painter");
        assert_eq!(names.resolve("mesh").unwrap(), "/robot/painter/in");
        assert_eq!(names.resolve("~/status").unwrap(), "/robot/s");
    }

    #[test]
    fn what_is_for_another_node_is_not_for_this_one() {
        let (args, _) = split(
            "--ros-args -r other:mesh:=/a -r veneer:mesh:=/b -p other:x:=1 -p veneer:y:=2 \
             -p /veneer:z:='3'",
        )
        .unwrap();
        let names = args.resolver("veneer").unwrap();
        assert_eq!(names.resolve("mesh").unwrap(), "/b");
        let params: Vec<_> = args.params(names.node()).collect();
        assert_eq!(params, [("y", "2"), ("z", "3")]);
    }

    #[test]
    fn bare_rules_and_schemes_are_taken_as_rcl_takes_them() {
        let (args, _) = split("--ros-args mesh:=/m -r rostopic://odom:=rostopic:///o").unwrap();
        let names = args.resolver("veneer").unwrap();
        assert_eq!(names.resolve("mesh").unwrap(), "/m");
        assert_eq!(names.resolve("odom").unwrap(), "/o");
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        for (line, words) in [
            ("--ros-args -r", "-r needs a value"),
            ("--ros-args -r mesh", "FROM:=TO"),
            ("--ros-args -r :=/a", "FROM:=TO"),
            ("--ros-args -p mesh=1", "NAME:=VALUE"),
            ("--ros-args --log-level loud", "loud"),
            ("--ros-args --colour", "--colour"),
            ("--ros-args -r __ns:=robot", "__ns:=/NAMESPACE"),
        ] {
            let error = split(line).unwrap_err().to_string();
            assert!(error.contains(words), "{line}: {error}");
        }
        let (args, _) = split("--ros-args -r __node:=a/b").unwrap();
        assert!(args.resolver("veneer").is_err());
    }

    #[test]
    fn without_a_section_nothing_is_touched() {
        let (args, own) = split("veneer replay a.mcap -r rgb/image:=/front -- x").unwrap();
        assert_eq!(args, RosArgs::default());
        assert_eq!(own.len(), 7);
    }
}
