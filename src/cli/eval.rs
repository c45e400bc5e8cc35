//! `veneer eval`: how near the renderings of textures are to photos that none of them has seen.

mod candidate;
mod methods;
mod published;
mod sheet;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use clap::Args;

use super::progress::TerminalProgress;
use super::settings::SettingsArgs;
use super::{Usage, interrupt, print_product};
use crate::bag::BagReader;
use crate::config::{Config, listing};
use crate::export::{self, write_atomic};
use crate::geom::{ColorImage, PinholeCamera};
use crate::keyframe::Keyframe;
use crate::metrics::protocol::{MethodView, nearest_angle_rad, score_view};
use crate::metrics::{Lpips, lpips};
use crate::pipeline::{Progress, Scan, StageClock, gather};
use crate::report::{EvalMethod, EvalReport, EvalScore, EvalView};
use crate::texsmooth::align::{AlignForm, AlignParams};
use candidate::{Candidate, Textures};
use methods::METHODS;

/// Measure textures on views that they have not seen: SSIM, LPIPS, S3, Grad, PSNR, coverage.
///
/// Every so-many-th keyframe is kept back; each method paints from the others. Renderings at the
/// poses kept back are aligned with the photos, cut to what all methods show, and compared. Writes
/// eval.md, eval.json and views/*.jpg (photo, rendering, differences before and after alignment).
#[derive(Debug, Args)]
#[command(after_help = methods_help())]
pub(super) struct EvalArgs {
    /// The recording (.mcap).
    bag: PathBuf,

    /// Folder for what is measured; created if it is not there.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,

    /// Methods by name, and meshes made elsewhere as NAME=FILE (.obj, .glb, .gltf, .ply).
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    methods: Vec<String>,

    /// All methods of a suite, before those of --methods.
    #[arg(long, value_name = "SUITE", value_parser = ["paper"])]
    suite: Option<String>,

    /// Where the mesh NAME lies: a file with the 4x4 matrix from its frame to the recording's, row
    /// by row, as JSON.
    #[arg(long, value_name = "NAME=FILE")]
    place: Vec<String>,

    /// Every so-many-th keyframe is kept back.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u16).range(2..))]
    hold_out: u16,

    /// Photos wider than this are compared at a whole fraction of their size; 0 for full size.
    #[arg(long, value_name = "PX", default_value_t = 1024)]
    max_width: u32,

    /// How renderings are aligned with photos: as the paper's program does, or by our own form.
    #[arg(long, value_name = "FORM", default_value = "reference", value_parser = ["reference", "refined"])]
    align: String,

    /// Weights of LPIPS (AlexNet, safetensors). Without them LPIPS is left out.
    #[arg(long, value_name = "FILE", env = "VENEER_LPIPS_WEIGHTS")]
    lpips_weights: Option<PathBuf>,

    /// Steps of those methods that optimise; the paper has 4000.
    #[arg(long, value_name = "N")]
    steps: Option<usize>,

    /// Seed of the noise on poses.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,

    /// Write each method's texture, too: textures/NAME/scan.glb.
    #[arg(long)]
    textures: bool,

    /// Print the numbers as JSON to standard output.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    settings: SettingsArgs,
}

fn methods_help() -> String {
    let mut text = "Methods:\n".to_owned();
    for method in METHODS {
        text += &format!("  {:<14} {}\n", method.name, method.description);
    }
    text + "
Examples:
  veneer eval scan.mcap --out eval --methods t-only,l2avg --lpips-weights lpips_alex.safetensors
  veneer eval scan.mcap --out eval --methods t-only,theirs=theirs.obj --place theirs=pose.json
  veneer eval scan.mcap --out eval --suite paper"
}

pub(super) fn run(args: &EvalArgs, quiet: bool) -> anyhow::Result<()> {
    let config = args.settings.resolve()?;
    let mut candidates = candidate::parse(args.suite.is_some(), &args.methods, &args.place)?;
    let lpips = args
        .lpips_weights
        .as_deref()
        .map(lpips::Lpips::load)
        .transpose()?;
    std::fs::create_dir_all(args.out.join("views"))
        .with_context(|| format!("cannot create the output folder {}", args.out.display()))?;
    interrupt::remove_when_interrupted({
        let out = args.out.clone();
        move || {
            let mut files = export::atomic::partial_files(&out);
            files.extend(export::atomic::partial_files(&out.join("views")));
            files
        }
    });
    let progress = TerminalProgress::new(quiet);

    let mut bag = BagReader::open(&args.bag, &config.topics)?;
    let clock = StageClock::new(&progress);
    let scan = gather(&mut bag, &config.pipeline, &clock)
        .with_context(|| format!("{} cannot be evaluated", args.bag.display()))?;
    let split = Split::new(&scan, args)?;
    let mut report = EvalReport {
        generator: format!("veneer {}", env!("CARGO_PKG_VERSION")),
        title: args
            .bag
            .file_stem()
            .map_or_else(|| "scan".to_owned(), |s| s.to_string_lossy().into_owned()),
        notes: notes(args, &split),
        num_training_views: split.training.len(),
        published: if args.suite.is_some() {
            published::rows()
        } else {
            Vec::new()
        },
        parameters: listing::to_json(&mut config.clone()),
        ..EvalReport::default()
    };

    let textures = Textures {
        scan: &scan,
        training: &split.training,
        seed: args.seed,
        num_steps: args.steps,
        out: args.textures.then(|| args.out.join("textures")),
    };
    make_views(
        &mut candidates,
        &textures,
        &split,
        config,
        &progress,
        &mut report,
    )?;
    progress.begin("compare", split.held_out.len() as u64);
    for (index, view) in split.held_out.iter().enumerate() {
        let scored = compare(view, index, &candidates, lpips.as_ref(), args, &split)?;
        report.views.push(scored);
        progress.advance(1);
    }
    report.set_means();
    progress.finish();
    write_report(&report, args, quiet)
}

/// Textures one method after the other and keeps its renderings.
fn make_views(
    candidates: &mut [Candidate],
    textures: &Textures<'_>,
    split: &Split,
    mut config: Config,
    progress: &TerminalProgress,
    report: &mut EvalReport,
) -> anyhow::Result<()> {
    for candidate in candidates {
        progress.begin(&format!("method {}", candidate.name), 0);
        let made = candidate
            .render(textures, &split.held_out, &config, progress)
            .with_context(|| format!("method {}", candidate.name))?;
        // All methods lie on the layout of the first, as far as their settings leave it alone.
        if let Some(density) = made.texels_per_m
            && config.pipeline.texinit.density.texels_per_m == 0.0
        {
            config.pipeline.texinit.density.texels_per_m = density;
        }
        report.methods.push(EvalMethod {
            method: candidate.name.clone(),
            description: candidate.description(),
            num_views: made.num_views,
            seconds: made.seconds,
            ..EvalMethod::default()
        });
    }
    Ok(())
}

/// A photo that no method has seen.
struct HeldOut {
    keyframe: Arc<Keyframe>,
    photo: ColorImage,
    camera: PinholeCamera,
}

struct Split {
    training: Vec<Arc<Keyframe>>,
    held_out: Vec<HeldOut>,
    /// Held-out photos that do not decode.
    num_failed: usize,
}

impl Split {
    fn new(scan: &Scan, args: &EvalArgs) -> anyhow::Result<Self> {
        let every = usize::from(args.hold_out);
        let mut split = Self {
            training: Vec::new(),
            held_out: Vec::new(),
            num_failed: 0,
        };
        for (index, keyframe) in scan.keyframes.iter().enumerate() {
            if !index.is_multiple_of(every) {
                split.training.push(Arc::clone(keyframe));
                continue;
            }
            let held_out = scan.decode(keyframe).ok().and_then(|frame| {
                let width = frame.color.width();
                let factor = match args.max_width {
                    0 => 1,
                    max_width => width.div_ceil(max_width),
                };
                Some(HeldOut {
                    keyframe: Arc::clone(keyframe),
                    photo: frame.color.reduced(factor),
                    camera: frame.color_camera.reduced(factor).ok()?,
                })
            });
            match held_out {
                Some(held_out) => split.held_out.push(held_out),
                None => split.num_failed += 1,
            }
        }
        if split.training.is_empty() || split.held_out.is_empty() {
            anyhow::bail!(
                "{} keyframes do not split into views that paint and every {every}th to judge by",
                scan.keyframes.len()
            );
        }
        Ok(split)
    }
}

fn notes(args: &EvalArgs, split: &Split) -> Vec<String> {
    let mut notes = vec![format!(
        "Every {}th keyframe is held out. Renderings are aligned by whole pixels ({} form), cut to \
         what all methods have in common, and black outside the intersection of their masks. \
         Methods with noise on their poses are a company of their own.",
        args.hold_out, args.align
    )];
    match &args.lpips_weights {
        Some(path) => notes.push(format!(
            "LPIPS 0.1, AlexNet, weights {}.",
            path.file_name().unwrap_or_default().to_string_lossy()
        )),
        None => notes.push(
            "LPIPS was not measured: it needs AlexNet's weights; give --lpips-weights FILE or set \
             VENEER_LPIPS_WEIGHTS."
                .to_owned(),
        ),
    }
    if split.num_failed > 0 {
        notes.push(format!(
            "{} held-out photos do not decode and are left out.",
            split.num_failed
        ));
    }
    notes
}

fn compare(
    view: &HeldOut,
    index: usize,
    candidates: &[Candidate],
    lpips: Option<&Lpips>,
    args: &EvalArgs,
    split: &Split,
) -> anyhow::Result<EvalView> {
    let keyframe = &view.keyframe;
    let name = format!("keyframe {}", keyframe.id.0);
    let poses = split.training.iter().map(|k| &k.world_from_camera);
    let sheet = format!("views/keyframe_{:05}.jpg", keyframe.id.0);
    let mut scored = EvalView {
        keyframe: keyframe.id.0,
        stamp_ns: keyframe.stamp.as_nanos(),
        size_px: [view.photo.width(), view.photo.height()],
        nearest_training_deg: nearest_angle_rad(&keyframe.world_from_camera, poses)
            .map(f64::to_degrees),
        sheet: Some(sheet.clone()),
        scores: vec![EvalScore::default(); candidates.len()],
        name,
    };
    let align = AlignParams {
        form: match args.align.as_str() {
            "refined" => AlignForm::Refined,
            _ => AlignForm::Reference,
        },
        ..AlignParams::default()
    };
    let mut rows: Vec<(usize, sheet::Row)> = Vec::with_capacity(candidates.len());
    for is_disturbed in [false, true] {
        let company: Vec<usize> = (0..candidates.len())
            .filter(|&at| candidates[at].is_disturbed() == is_disturbed)
            .collect();
        if company.is_empty() {
            continue;
        }
        let views = company
            .iter()
            .map(|&at| candidates[at].view(index))
            .collect::<anyhow::Result<Vec<MethodView>>>()?;
        let mut scores = score_view(&view.photo, &views, &align, lpips)
            .with_context(|| format!("{} cannot be compared", scored.name))?;
        let renders = std::mem::take(&mut scores.renders);
        for (in_company, ((&at, method_view), render)) in
            company.iter().zip(views).zip(renders).enumerate()
        {
            let score = EvalScore::new(&candidates[at].name, &scores, in_company)
                .context("a method was not scored")?;
            let row = sheet::Row {
                label: label(&score),
                view: method_view,
                aligned_photo: scores.photo.clone(),
                aligned_render: render,
            };
            scored.scores[at] = score;
            rows.push((at, row));
        }
    }
    rows.sort_by_key(|(at, _)| *at);
    let rows: Vec<sheet::Row> = rows.into_iter().map(|(_, row)| row).collect();
    sheet::write(&args.out.join(sheet), &scored.name, &view.photo, &rows)?;
    Ok(scored)
}

fn label(score: &EvalScore) -> String {
    let measures = &score.measures;
    let number = |name: &str, value: Option<f64>| {
        value.map_or(String::new(), |value| format!("  {name} {value:.3}"))
    };
    let [dx, dy] = score.alignment_px;
    format!(
        "{}{}{}{}{}  offset {dx:.0} {dy:.0}",
        score.method,
        number("SSIM", measures.ssim),
        number("LPIPS", measures.lpips),
        number("S3", measures.s3),
        number("Grad", measures.grad),
    )
}

fn write_report(report: &EvalReport, args: &EvalArgs, quiet: bool) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(report)? + "\n";
    let markdown = report.to_markdown();
    let file = |name: &str| -> PathBuf { args.out.join(name) };
    let write = |path: &Path, text: &str| write_atomic(path, |out| out.write_all(text.as_bytes()));
    write(&file("eval.json"), &json)?;
    write(&file("eval.md"), &markdown)?;
    if args.json {
        print_product(&json)
    } else if quiet {
        Ok(())
    } else {
        print_product(&markdown)
    }
}

/// What the user asked for that makes no sense.
fn usage(text: String) -> anyhow::Error {
    Usage(text).into()
}
