//! `veneer synth`: a recording of a scene whose texture is known.

use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, ValueEnum};

use super::Usage;
use super::import::BagCompression;
use super::interrupt;
use super::print_product;
use super::progress::TerminalProgress;
use crate::bag::partial_path;
use crate::export::{self, ExportParams, TexturedMesh};
use crate::synth::{
    GroundTruth, SceneName, SynthColorFormat, SynthDepthFormat, SynthError, SynthNoise,
    SynthOptions, synthesize,
};

/// Make a bag of a scene whose texture is known, with as much noise as you like.
///
/// The bag names its scene, so that `veneer replay` scores its result against the true texture.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  veneer synth room -o room.mcap
  veneer synth tabletop -o table.mcap --realistic --grow 10
  veneer synth room -o room.mcap --pose-noise-m 0.01 --truth room_truth")]
pub(super) struct SynthArgs {
    /// The scene.
    #[arg(value_enum)]
    scene: Scene,

    /// The bag to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Frames along the camera's path [default: 120 for the room, 60 for the table-top]
    #[arg(long, value_name = "N")]
    frames: Option<u32>,

    /// Image width in pixels.
    #[arg(long, default_value_t = 640)]
    width: u32,

    /// Image height in pixels.
    #[arg(long, default_value_t = 480)]
    height: u32,

    /// Edge length of the mesh in metres [default: 0.05 for the room, 0.01 for the table-top]
    #[arg(long, value_name = "M")]
    edge_length_m: Option<f64>,

    /// Send the mesh in N updates as the camera reveals the scene; 0: whole, at the start.
    #[arg(long, default_value_t = 0, value_name = "N")]
    grow: u32,

    /// Colour images: PNG without loss, JPEG as cameras send it, or raw rgb8.
    #[arg(long, value_enum, default_value_t = Color::Png)]
    color: Color,

    /// JPEG quality, 1 to 100.
    #[arg(long, default_value_t = 95, value_name = "Q")]
    jpeg_quality: u8,

    /// Depth images.
    #[arg(long, value_enum, default_value_t = Depth::Png)]
    depth: Depth,

    /// Compression of the bag's chunks (images are compressed already, unless raw).
    #[arg(long, value_enum, default_value_t = BagCompression::None)]
    compression: BagCompression,

    /// Also write the scene with its true texture (GLB, OBJ, PLY) into this folder.
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,

    /// Density of the true texture in texels per metre.
    #[arg(long, default_value_t = 300.0, value_name = "N")]
    truth_texels_per_m: f64,

    #[command(flatten)]
    noise: NoiseArgs,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Noise (all off by default)")]
struct NoiseArgs {
    /// All of it, as a good hand-held scan has it; single options below win.
    #[arg(long)]
    realistic: bool,

    /// Standard deviation of the published position, metres.
    #[arg(long, value_name = "M")]
    pose_noise_m: Option<f64>,

    /// Standard deviation of the published orientation, radians.
    #[arg(long, value_name = "RAD")]
    pose_noise_rad: Option<f64>,

    /// Standard deviation of depth over depth squared (structured light: 0.0015), 1/m.
    #[arg(long, value_name = "K")]
    depth_noise: Option<f64>,

    /// Probability that a pixel beside a depth jump has no depth.
    #[arg(long, value_name = "P")]
    depth_dropout: Option<f64>,

    /// Standard deviation of the exposure's slow walk, stops.
    #[arg(long, value_name = "STOPS")]
    exposure_noise: Option<f64>,

    /// Time that the shutter stays open, seconds: moving images smear.
    #[arg(long, value_name = "S")]
    shutter_s: Option<f64>,

    /// Standard deviation of the image's read noise, levels of 255.
    #[arg(long, value_name = "LEVELS")]
    image_noise: Option<f64>,

    /// Standard deviation of mesh vertices, metres.
    #[arg(long, value_name = "M")]
    mesh_noise_m: Option<f64>,

    /// Share of mesh faces left out.
    #[arg(long, value_name = "SHARE")]
    missing_faces: Option<f64>,

    /// How many wall parts appear twice.
    #[arg(long, value_name = "N")]
    double_walls: Option<u32>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Scene {
    /// A furnished living room.
    Room,
    /// A cluttered table-top.
    Tabletop,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Color {
    Jpeg,
    Png,
    Raw,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Depth {
    Png,
    Rvl,
    Raw,
}

/// Distance of a doubled wall where none is given.
const DOUBLE_WALL_OFFSET_M: f64 = 0.03;

impl NoiseArgs {
    fn resolve(&self) -> SynthNoise {
        let base = if self.realistic {
            SynthNoise::realistic()
        } else {
            SynthNoise {
                double_wall_offset_m: DOUBLE_WALL_OFFSET_M,
                ..SynthNoise::default()
            }
        };
        SynthNoise {
            pose_translation_m: self.pose_noise_m.unwrap_or(base.pose_translation_m),
            pose_rotation_rad: self.pose_noise_rad.unwrap_or(base.pose_rotation_rad),
            depth_quadratic_per_m: self.depth_noise.unwrap_or(base.depth_quadratic_per_m),
            depth_dropout: self.depth_dropout.unwrap_or(base.depth_dropout),
            exposure_stops: self.exposure_noise.unwrap_or(base.exposure_stops),
            shutter_s: self.shutter_s.unwrap_or(base.shutter_s),
            image_255: self.image_noise.unwrap_or(base.image_255),
            mesh_vertex_m: self.mesh_noise_m.unwrap_or(base.mesh_vertex_m),
            missing_faces: self.missing_faces.unwrap_or(base.missing_faces),
            double_walls: self.double_walls.unwrap_or(base.double_walls),
            ..base
        }
    }
}

pub(super) fn run(args: &SynthArgs, quiet: bool) -> anyhow::Result<()> {
    let scene = match args.scene {
        Scene::Room => SceneName::Room,
        Scene::Tabletop => SceneName::Tabletop,
    };
    let options = SynthOptions {
        seed: args.seed,
        num_frames: args.frames,
        width: args.width,
        height: args.height,
        mesh_edge_m: args.edge_length_m,
        grow: args.grow,
        color: match args.color {
            Color::Jpeg => SynthColorFormat::Jpeg(args.jpeg_quality),
            Color::Png => SynthColorFormat::Png,
            Color::Raw => SynthColorFormat::Raw,
        },
        depth: match args.depth {
            Depth::Png => SynthDepthFormat::Png,
            Depth::Rvl => SynthDepthFormat::Rvl,
            Depth::Raw => SynthDepthFormat::Raw,
        },
        compression: args.compression.into(),
        noise: args.noise.resolve(),
        ..SynthOptions::default()
    };
    interrupt::remove_when_interrupted({
        let part = partial_path(&args.output);
        let truth = args.truth.clone();
        move || {
            let exports = truth.as_deref().map(export::atomic::partial_files);
            let exports = exports.unwrap_or_default();
            exports.into_iter().chain([part.clone()]).collect()
        }
    });
    let progress = TerminalProgress::new(quiet);
    let mut steps = progress.counter("cast frames");
    let summary = synthesize(scene, &options, &args.output, &mut |done, total| {
        steps.at(done, total);
    })
    .map_err(|error| match error {
        SynthError::Option { .. } | SynthError::Scene(_) => {
            anyhow::Error::new(Usage(error.to_string()))
        }
        other => other.into(),
    })?;
    progress.finish();
    if let Some(dir) = &args.truth {
        write_truth(args, dir)
            .with_context(|| format!("cannot write the true texture to {}", dir.display()))?;
    }
    if !quiet {
        print_product(&format!(
            "{} frames, {} triangles, {} mesh update(s)\nwrote {} ({:.1} MB)\n",
            summary.num_frames,
            summary.num_triangles,
            summary.num_mesh_messages,
            args.output.display(),
            summary.bag.num_bytes as f64 * 1e-6
        ))?;
    }
    Ok(())
}

fn write_truth(args: &SynthArgs, dir: &std::path::Path) -> anyhow::Result<()> {
    let description = crate::bag::metadata(&args.output, crate::synth::METADATA_NAME)?
        .context("the bag just written does not name its scene")?;
    let truth = GroundTruth::from_metadata(&description)?;
    let (mesh, layout, texture) = truth.atlas(args.truth_texels_per_m)?;
    let textured = TexturedMesh::new(&mesh, &layout, &texture)?;
    let params = ExportParams {
        name: "truth".to_owned(),
        provenance: false,
        ..ExportParams::default()
    };
    export::write_all(&textured, dir, &params)?;
    Ok(())
}
