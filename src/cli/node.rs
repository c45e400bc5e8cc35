//! `veneer node`: the live ROS 2 node.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use super::Usage;
use crate::config::{Config, ParameterError, params_file};
use crate::ros::rosout::LogLines;
use crate::ros::security::{Asked, Security};
use crate::ros::{Network, NodeSetup, RosArgs, node};

/// What the node calls itself unless it is remapped.
const NODE_NAME: &str = "veneer";

/// Texture a scan while it is being made, as a ROS 2 node. No ROS installation is needed.
///
/// Takes `--ros-args` as every ROS 2 executable does, and ROS_DOMAIN_ID,
/// ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_LOCALHOST_ONLY and ROS_SECURITY_* from the environment.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  veneer node --ros-args -r rgb/image:=/camera/color/image_raw \\
      -r rgb/camera_info:=/camera/color/camera_info -r mesh:=/nvblox_node/mesh
  veneer node --params-file veneer.yaml
  veneer node --ros-args -r __ns:=/robot1 -p use_sim_time:=true --log-level debug
  ROS_DOMAIN_ID=7 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST veneer node")]
pub(super) struct NodeArgs {
    /// ROS 2 parameter file (YAML); may be repeated, later ones win. As after --ros-args.
    #[arg(long, value_name = "FILE")]
    params_file: Vec<PathBuf>,

    /// One parameter, as in `-p texinit.texels_per_m:=400`; wins over files. See `veneer params`.
    #[arg(short = 'p', long = "param", value_name = "NAME:=VALUE")]
    param: Vec<String>,
}

/// The log filter that ROS' arguments ask for. DDS' own log, which is not for users, stays off.
pub(super) fn log_filter(ros_args: Option<&RosArgs>) -> String {
    let default = RosArgs::default();
    let ros_args = ros_args.unwrap_or(&default);
    let level = ros_args.log_level.map_or("info", |level| level.filter());
    let mut filter = format!("{level},rustdds=off,ros2_client=off,polling=off,async_io=off");
    for (logger, level) in &ros_args.logger_levels {
        // Loggers are named as nodes are, targets as modules.
        let target = logger.trim_start_matches('/').replace(['.', '/'], "::");
        filter += &format!(",{target}={}", level.filter());
    }
    filter
}

pub(super) fn run(
    args: &NodeArgs,
    ros_args: Option<&RosArgs>,
    log_lines: Option<LogLines>,
) -> anyhow::Result<()> {
    let default = RosArgs::default();
    let ros_args = ros_args.unwrap_or(&default);
    let usage = |error: &dyn std::fmt::Display| Usage(error.to_string());
    let names = ros_args.resolver(NODE_NAME).map_err(|e| usage(&e))?;
    let mut network = Network::from_process().map_err(|e| usage(&e))?;
    let asked = Security::from_process(ros_args.enclave.as_deref()).map_err(|e| usage(&e))?;
    let security = match asked {
        Asked::Nothing => None,
        Asked::Keys(security) => Some(security),
        Asked::Missing(words) => {
            network.notes.push(words);
            None
        }
    };
    let mut config = Config::default();
    let full_name = names.node().fully_qualified();
    for path in args.params_file.iter().chain(&ros_args.params_files) {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        match params_file::apply(&mut config, &text, &full_name) {
            // A file may be for a whole graph of nodes, of which this is none.
            Err(ParameterError::NotAddressed(reason)) => {
                tracing::warn!("{}: {reason}", path.display());
            }
            result => result.map_err(|e| usage(&format!("{}: {e}", path.display())))?,
        }
    }
    for setting in &args.param {
        let (name, value) = setting
            .split_once(":=")
            .ok_or_else(|| Usage(format!("--param '{setting}' is not NAME:=VALUE")))?;
        config.set(name, value).map_err(|e| usage(&e))?;
    }
    for (name, value) in ros_args.params(names.node()) {
        config
            .set(name, value)
            .map_err(|e| usage(&format!("-p {name}:={value}: {e}")))?;
    }
    let (sender, stop) = smol::channel::bounded(1);
    ctrlc::set_handler(move || {
        // A second signal finds the word already there.
        sender.try_send(()).ok();
    })
    .context("signals cannot be caught")?;
    let setup = NodeSetup {
        config,
        names,
        network,
        security,
        log_lines: log_lines.filter(|_| ros_args.has_rosout),
    };
    node::run(&setup, &stop)?;
    Ok(())
}
