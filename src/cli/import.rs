//! `veneer import`: a data set becomes a bag.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, ValueEnum};

use super::Usage;
use super::interrupt;
use super::print_product;
use super::progress::TerminalProgress;
use crate::bag::{Compression, partial_path};
use crate::import::{
    DepthOutput, ImportError, ImportFormat, ImportOptions, ImportSummary, WorldUp, import,
};

/// Make a bag from a data set or a phone capture.
#[derive(Debug, Args)]
#[command(after_help = "\
Formats:
  capture    cameras.json, intrinsics.json, frames/, mesh.ply
  tum        TUM RGB-D: rgb.txt, depth.txt, groundtruth.txt
  7scenes    frame-NNNNNN.{color.png,depth.png,pose.txt}
  3dscanner  3D Scanner App: frame_NNNNN.{jpg,json}, depth_NNNNN.png, export.obj

Examples:
  veneer import capture ../shared/data/apt0_structure -o apt0.mcap
  veneer import tum rgbd_dataset_freiburg1_desk -o desk.mcap --mesh desk.ply
  veneer import 3dscanner my_scan -o my_scan.mcap --grow 20")]
pub(super) struct ImportArgs {
    /// The layout of the data set.
    format: String,

    /// Its folder.
    src: PathBuf,

    /// The bag to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// The mesh (.ply or .obj) in the folder, or a path [default: the format's own]
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,

    /// `capture`: use the refined intrinsics, depth scale and mesh.
    #[arg(long)]
    refined: bool,

    /// `tum`, `7scenes`: intrinsics in pixels instead of the data set's usual ones.
    #[arg(long, value_name = "FX,FY,CX,CY", value_parser = four_numbers)]
    intrinsics: Option<[f64; 4]>,

    /// How depth is stored: compressedDepth PNG, or raw 16UC1.
    #[arg(long, value_enum, default_value_t = Depth::Png)]
    depth: Depth,

    /// Leave out depth below this ARKit confidence (0 low, 1 medium, 2 high).
    #[arg(long, default_value_t = 1, value_name = "0..2")]
    min_confidence: u8,

    /// Write the mesh as N updates, in the order in which the camera saw it.
    #[arg(long, value_name = "N")]
    grow: Option<NonZeroU32>,

    /// `tum`: how far apart the stamps of colour, depth and pose may be.
    #[arg(long, default_value_t = 0.02, value_name = "SECONDS")]
    max_time_difference: f64,

    /// Which way is up in the data set, where the bag has z: x, y, z, -x, -y, -z; `auto` finds it
    /// from how the cameras are held and from level faces, `keep` turns nothing.
    #[arg(
        long,
        default_value = "auto",
        value_name = "AXIS",
        allow_hyphen_values = true
    )]
    up: WorldUp,

    /// Compression of the bag's chunks (images are compressed already).
    #[arg(long, value_enum, default_value_t = BagCompression::None)]
    compression: BagCompression,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Depth {
    Png,
    Raw,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum BagCompression {
    None,
    Lz4,
    Zstd,
}

impl From<BagCompression> for Compression {
    fn from(choice: BagCompression) -> Self {
        match choice {
            BagCompression::None => Self::None,
            BagCompression::Lz4 => Self::Lz4,
            BagCompression::Zstd => Self::Zstd,
        }
    }
}

pub(super) fn run(args: &ImportArgs, quiet: bool) -> anyhow::Result<()> {
    let format = ImportFormat::from_str(&args.format).map_err(|e| Usage(e.to_string()))?;
    let options = ImportOptions {
        mesh: args.mesh.clone(),
        refined: args.refined,
        intrinsics_px: args.intrinsics,
        depth_output: match args.depth {
            Depth::Png => DepthOutput::Png16,
            Depth::Raw => DepthOutput::Raw,
        },
        min_confidence: args.min_confidence,
        grow: args.grow,
        max_time_difference_s: args.max_time_difference,
        compression: args.compression.into(),
        up: args.up,
        ..ImportOptions::default()
    };
    interrupt::remove_when_interrupted({
        let part = partial_path(&args.output);
        move || vec![part.clone()]
    });
    let progress = TerminalProgress::new(quiet);
    let mut steps = progress.counter("import frames");
    let summary = import(
        format,
        &args.src,
        &args.output,
        &options,
        &mut |done, total| {
            steps.at(done, total);
        },
    )
    .map_err(|error| match error {
        ImportError::Option { reason } => anyhow::Error::new(Usage(reason)),
        other => other.into(),
    })?;
    progress.finish();
    if !quiet {
        print_product(&closing_lines(&summary, args))?;
    }
    Ok(())
}

/// Four numbers between commas.
fn four_numbers(text: &str) -> Result<[f64; 4], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse().map_err(|e| format!("'{part}': {e}")))
        .collect::<Result<_, _>>()?;
    numbers
        .try_into()
        .map_err(|all: Vec<f64>| format!("{} numbers, not 4", all.len()))
}

fn closing_lines(summary: &ImportSummary, args: &ImportArgs) -> String {
    let mut lines = format!(
        "{} frames ({} with depth) over {:.1} s\n",
        summary.num_frames,
        summary.num_depth_images,
        summary.last.seconds_since(summary.first)
    );
    if let Some(mesh) = &summary.mesh {
        lines += &format!(
            "mesh {}: {} triangles in {} message(s)\n",
            mesh.name, mesh.num_triangles, mesh.num_updates
        );
    }
    for note in &summary.notes {
        lines += &format!("note: {note}\n");
    }
    for refusal in &summary.refusals {
        lines += &format!("left out: {refusal}\n");
    }
    lines
        + &format!(
            "wrote {} ({:.1} MB)\n",
            args.output.display(),
            summary.bag.num_bytes as f64 * 1e-6
        )
}
