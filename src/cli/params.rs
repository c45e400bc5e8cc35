//! `veneer params`: the parameter tree.

use clap::Args;

use super::print_product;
use crate::config::{Config, listing};

/// List all parameters with defaults, ranges and units.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  veneer params                       a table
  veneer params --yaml > veneer.yaml  a file for --params-file")]
pub(super) struct ParamsArgs {
    /// As a ROS 2 parameter file with the defaults.
    #[arg(long, conflicts_with = "markdown")]
    yaml: bool,

    /// As the Markdown of docs/parameters.md.
    #[arg(long)]
    markdown: bool,
}

pub(super) fn run(args: &ParamsArgs) -> anyhow::Result<()> {
    let mut defaults = Config::default();
    let text = if args.yaml {
        listing::to_yaml(&mut defaults)
    } else if args.markdown {
        listing::to_markdown(&mut defaults)
    } else {
        listing::to_table(&mut defaults)
    };
    print_product(&text)
}
