//! `veneer info`: what is in a bag.

use std::path::PathBuf;

use clap::Args;

use super::print_product;
use super::settings::SettingsArgs;
use crate::bag::BagInfo;

/// Explain a bag: topics, rates, gaps, what veneer would use, and what is missing.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  veneer info scan.mcap
  veneer info scan.mcap --json")]
pub(super) struct InfoArgs {
    /// The recording (.mcap).
    bag: PathBuf,

    /// Print JSON.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    settings: SettingsArgs,
}

pub(super) fn run(args: &InfoArgs) -> anyhow::Result<()> {
    let config = args.settings.resolve()?;
    let info = BagInfo::read(&args.bag, &config.topics)?;
    let text = if args.json {
        serde_json::to_string_pretty(&info)? + "\n"
    } else {
        info.to_string()
    };
    print_product(&text)
}
