//! Arguments that set parameters, and the topics of a bag.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use super::Usage;
use crate::config::{Config, params_file};

/// The node that sections of a parameter file address.
const NODE_NAME: &str = "/veneer";

#[derive(Debug, Args)]
pub(super) struct SettingsArgs {
    /// ROS 2 parameter file (YAML); may be repeated, later ones win.
    #[arg(long, value_name = "FILE")]
    params_file: Vec<PathBuf>,

    /// One parameter, as in `-p texinit.texels_per_m:=400`; wins over files. See `veneer params`.
    #[arg(short = 'p', long = "param", value_name = "NAME:=VALUE")]
    param: Vec<String>,

    /// Topic to use instead of the one found by type, as in `-r rgb/image:=/front/image_raw`.
    #[arg(short = 'r', long = "remap", value_name = "FROM:=TO")]
    remap: Vec<String>,
}

impl SettingsArgs {
    /// Defaults, then files, then single parameters, then remaps.
    pub(super) fn resolve(&self) -> anyhow::Result<Config> {
        self.resolve_with(&[])
    }

    /// The same with flags that stand for parameters, (flag, parameter, value): they come after
    /// files and before single parameters.
    pub(super) fn resolve_with(&self, flags: &[(&str, &str, &str)]) -> anyhow::Result<Config> {
        self.resolve_over(&[], flags)
    }

    /// The same over other defaults, (parameter, value).
    pub(super) fn resolve_over(
        &self,
        defaults: &[(&str, &str)],
        flags: &[(&str, &str, &str)],
    ) -> anyhow::Result<Config> {
        let mut config = Config::default();
        for (name, value) in defaults {
            config.set(name, value)?;
        }
        for path in &self.params_file {
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            params_file::apply(&mut config, &text, NODE_NAME)
                .map_err(|e| Usage(format!("{}: {e}", path.display())))?;
        }
        for (flag, name, value) in flags {
            config
                .set(name, value)
                .map_err(|e| Usage(format!("{flag} {value}: {e}")))?;
        }
        for setting in &self.param {
            let (name, value) = split_assignment("--param", setting)?;
            config
                .set(name, value)
                .map_err(|e| Usage(format!("--param {setting}: {e}")))?;
        }
        for remap in &self.remap {
            let (from, to) = split_assignment("--remap", remap)?;
            config
                .remap(from, to)
                .map_err(|e| Usage(format!("--remap {remap}: {e}")))?;
        }
        Ok(config)
    }
}

fn split_assignment<'a>(option: &str, text: &'a str) -> Result<(&'a str, &'a str), Usage> {
    text.split_once(":=")
        .ok_or_else(|| Usage(format!("{option} '{text}' is not NAME:=VALUE")))
}
