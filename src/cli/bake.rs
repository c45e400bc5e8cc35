//! `veneer bake`: the best texture that can be made of a recording, however long it takes.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use clap::Args;

use super::progress::TerminalProgress;
use super::replay::Job;
use super::settings::SettingsArgs;

/// Steps of a bake where none are asked for: those of the paper.
const NUM_STEPS: &str = "4000";
/// Steps between previews, where there is a file for them.
const PREVIEW_INTERVAL: usize = 100;
/// Steps between checkpoints, where there is a file for them.
const CHECKPOINT_INTERVAL: usize = 500;

/// Texture a recording as well as can be: TexInit, fast refinement, and all steps of TexSmooth.
///
/// Writes what `veneer replay` writes. The same bag and parameters give the same bytes, unless a
/// time budget cuts the optimisation short.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  veneer bake scan.mcap --out out
  veneer bake scan.mcap --out out --preview out/preview.jpg
  veneer bake scan.mcap --out out --checkpoint bake.ckpt      write the state every 500 steps
  veneer bake scan.mcap --out out --checkpoint bake.ckpt --resume bake.ckpt
  veneer bake scan.mcap --out out --steps 1000 --time-budget 300")]
pub(super) struct BakeArgs {
    /// The recording (.mcap).
    bag: PathBuf,

    /// Folder for what is made; created if it is not there.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,

    /// Steps of the optimisation, as `-p texsmooth.iterations:=N`; 0 leaves it out [default: 4000].
    #[arg(long, value_name = "N")]
    steps: Option<usize>,

    /// Seconds after which no step begins, as `-p texsmooth.time_budget_s:=S`.
    #[arg(long, value_name = "S")]
    time_budget: Option<f64>,

    /// Picture (JPEG) of a photo beside its rendering, written anew every 100 steps.
    #[arg(long, value_name = "FILE")]
    preview: Option<PathBuf>,

    /// State of the optimisation, written anew every 500 steps and at the end.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,

    /// Go on from a checkpoint of the same bag and parameters; more steps may be asked for.
    #[arg(long, value_name = "FILE")]
    resume: Option<PathBuf>,

    /// Print the report's numbers as JSON to standard output.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    settings: SettingsArgs,
}

pub(super) fn run(args: &BakeArgs, quiet: bool) -> anyhow::Result<()> {
    let begun = Instant::now();
    let steps = args.steps.map(|steps| steps.to_string());
    let budget = args.time_budget.map(|seconds| seconds.to_string());
    let flags: Vec<_> = [
        ("--steps", "texsmooth.iterations", steps.as_deref()),
        (
            "--time-budget",
            "texsmooth.time_budget_s",
            budget.as_deref(),
        ),
    ]
    .into_iter()
    .filter_map(|(flag, name, value)| Some((flag, name, value?)))
    .collect();
    let defaults = [
        ("photometric.gain", "true"),
        ("photometric.pose", "true"),
        ("photometric.global_seams", "true"),
        ("photometric.local_seams", "true"),
        ("texsmooth.iterations", NUM_STEPS),
    ];
    let mut config = args.settings.resolve_over(&defaults, &flags)?;
    let smooth = &mut config.pipeline.texsmooth;
    if args.preview.is_some() && smooth.preview_interval == 0 {
        smooth.preview_interval = PREVIEW_INTERVAL;
    }
    if args.checkpoint.is_some() && smooth.checkpoint_interval == 0 {
        smooth.checkpoint_interval = CHECKPOINT_INTERVAL;
    }
    if let Some(path) = &args.resume {
        let bytes = std::fs::read(path)
            .with_context(|| format!("cannot read the checkpoint {}", path.display()))?;
        config.pipeline.smooth_from = Some(Arc::new(bytes));
    }
    let progress =
        TerminalProgress::new(quiet).with_files(args.preview.clone(), args.checkpoint.clone());
    Job {
        begun,
        bag: &args.bag,
        out: &args.out,
        record: None,
        json: args.json,
        config: &config,
    }
    .run(progress, quiet)
}
