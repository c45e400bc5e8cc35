//! The command line: one file per subcommand. Only here are a source and a sink chosen (L8).

mod bake;
mod eval;
mod import;
mod info;
mod interrupt;
mod node;
mod params;
mod progress;
mod replay;
mod settings;
mod synth;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::builder::RangedI64ValueParser;
use clap::{Parser, Subcommand};

use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::ros::{RosArgs, rosout};

const EXAMPLES: &str = "\
Examples:
  veneer node --ros-args -r mesh:=/nvblox_node/mesh
                                         texture a scan while it is being made
  veneer replay scan.mcap --out out      texture a recording; open out/report.html
  veneer bake scan.mcap --out out        the same as well as can be, however long it takes
  veneer eval scan.mcap --out eval       how near its renderings are to photos kept back
  veneer info scan.mcap                  what is in it, and what is missing
  veneer import capture DIR -o scan.mcap make a recording from a data set
  veneer synth room -o room.mcap         make a recording whose texture is known

Exit codes: 0 done, 1 failed, 2 wrong usage.";

/// Paints a sharp texture onto a scan's mesh.
#[derive(Debug, Parser)]
#[command(name = "veneer", version, about, after_help = EXAMPLES)]
struct Cli {
    /// Print nothing but errors.
    #[arg(short, long, global = true)]
    quiet: bool,

    /// Worker threads; 0 takes one per core. The result does not depend on it.
    #[arg(long, global = true, default_value_t = 0, value_name = "N", value_parser = num_threads())]
    threads: u16,

    /// Log filter, as in `veneer=debug` (RUST_LOG syntax) [default: warn; node: info].
    #[arg(long, global = true, value_name = "FILTER")]
    log_level: Option<String>,

    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Node(node::NodeArgs),
    Replay(replay::ReplayArgs),
    Bake(bake::BakeArgs),
    Eval(eval::EvalArgs),
    Import(import::ImportArgs),
    Synth(synth::SynthArgs),
    Info(info::InfoArgs),
    Params(params::ParamsArgs),
}

/// A slip of the finger should not exhaust the system's threads.
fn num_threads() -> RangedI64ValueParser<u16> {
    clap::value_parser!(u16).range(..=1024)
}

/// What the process was asked to do was impossible to understand, as opposed to having failed.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Usage(String);

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let (ros_args, own) = match split_ros_args(std::env::args_os().collect()) {
        Ok(split) => split,
        Err(error) => {
            print_error(&error.into());
            return ExitCode::from(2);
        }
    };
    let cli = match Cli::try_parse_from(own) {
        Ok(cli) => cli,
        Err(error) => return usage_exit(&error),
    };
    match run(&cli, ros_args.as_ref()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            print_error(&error);
            let is_usage = error.downcast_ref::<Usage>().is_some();
            ExitCode::from(if is_usage { 2 } else { 1 })
        }
    }
}

/// ROS' arguments stand among the others, in sections of their own; `None` where there is none.
fn split_ros_args(args: Vec<OsString>) -> Result<(Option<RosArgs>, Vec<OsString>), Usage> {
    if !args.iter().any(|arg| arg == "--ros-args") {
        return Ok((None, args));
    }
    let words: Vec<String> = args
        .into_iter()
        .map(|arg| {
            arg.into_string()
                .map_err(|arg| Usage(format!("argument {} is not UTF-8", arg.display())))
        })
        .collect::<Result<_, _>>()?;
    let (ros_args, own) = RosArgs::split(words).map_err(|error| Usage(error.to_string()))?;
    Ok((
        Some(ros_args),
        own.into_iter().map(OsString::from).collect(),
    ))
}

/// clap's own exit codes are the house's: 0 for help and version, 2 for wrong usage.
fn usage_exit(error: &clap::Error) -> ExitCode {
    // Nothing is left to do where the terminal is gone.
    error.print().ok();
    ExitCode::from(if error.use_stderr() { 2 } else { 0 })
}

fn run(cli: &Cli, ros_args: Option<&RosArgs>) -> anyhow::Result<()> {
    let is_node = matches!(cli.command, Command::Node(_));
    if ros_args.is_some() && !is_node {
        return Err(Usage("only `veneer node` takes --ros-args".to_owned()).into());
    }
    let level = match &cli.log_level {
        Some(level) => level.clone(),
        None if is_node => node::log_filter(ros_args),
        None => "warn".to_owned(),
    };
    let filter = tracing_subscriber::EnvFilter::try_new(&level)
        .map_err(|e| Usage(format!("--log-level '{level}': {e}")))?;
    let (rosout, log_lines) = is_node.then(rosout::layer).unzip();
    tracing_subscriber::registry()
        .with(filter)
        .with(tracing_subscriber::fmt::layer().with_writer(std::io::stderr))
        .with(rosout)
        .init();
    rayon::ThreadPoolBuilder::new()
        .num_threads(cli.threads.into())
        .build_global()?;
    match &cli.command {
        Command::Node(args) => node::run(args, ros_args, log_lines),
        Command::Replay(args) => replay::run(args, cli.quiet),
        Command::Bake(args) => bake::run(args, cli.quiet),
        Command::Eval(args) => eval::run(args, cli.quiet),
        Command::Import(args) => import::run(args, cli.quiet),
        Command::Synth(args) => synth::run(args, cli.quiet),
        Command::Info(args) => info::run(args),
        Command::Params(args) => params::run(args),
    }
}

#[expect(clippy::print_stderr, reason = "the command's error channel")]
fn print_error(error: &anyhow::Error) {
    eprintln!("error: {error}");
    let mut previous = error.to_string();
    for cause in error.chain().skip(1) {
        let text = cause.to_string();
        // Transparent wrappers repeat the words of what they wrap.
        if !previous.contains(&text) {
            eprintln!("  because: {text}");
        }
        previous = text;
    }
}

/// Writes a product to standard output; a closed pipe is no failure.
fn print_product(text: &str) -> anyhow::Result<()> {
    use std::io::Write;
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}
