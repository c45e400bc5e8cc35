//! `veneer replay`: a recording becomes a textured mesh, files and a report.

mod record;
mod score;
mod summary;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::Args;

use super::interrupt;
use super::print_product;
use super::progress::TerminalProgress;
use super::settings::SettingsArgs;
use crate::bag::{BagReader, partial_path};
use crate::config::Config;
use crate::export::{self, TexturedMesh};
use crate::pipeline::{self, Progress, Run};
use crate::report::{self, ReportView};

/// Texture a recording: the live pipeline on the bag's clock, as fast as the machine goes.
///
/// Writes scan.glb, scan.obj, scan.ply, atlas/, provenance/, report.html, report.json and
/// hashes.txt. The same bag and parameters give the same bytes (the report's times excepted).
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  veneer replay scan.mcap --out out
  veneer replay scan.mcap --out out --params-file veneer.yaml -p export.glb_images:=jpeg
  veneer replay scan.mcap --out out --mode paper
  veneer replay scan.mcap --out out --init l2avg
  veneer replay scan.mcap --out out -r rgb/image:=/front/image_raw
  veneer replay scan.mcap --out out --record shown.mcap       also what the node would publish")]
pub(super) struct ReplayArgs {
    /// The recording (.mcap).
    bag: PathBuf,

    /// Folder for what is made; created if it is not there.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,

    /// Form of the method, as `-p texinit.mode:=MODE`: ours, chart by chart, or the paper's.
    #[arg(long, value_name = "MODE", value_parser = ["streaming", "paper"])]
    mode: Option<String>,

    /// What paints the texture, as `-p texinit.init:=INIT`: each triangle's best frame, or the
    /// mean over all frames.
    #[arg(long, value_name = "INIT", value_parser = ["assigned", "l2avg"])]
    init: Option<String>,

    /// Write what the node would publish to a bag (.mcap): for rviz2, Foxglove, and programs.
    #[arg(long, value_name = "OUT.mcap")]
    record: Option<PathBuf>,

    /// Print the report's numbers as JSON to standard output.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    settings: SettingsArgs,
}

pub(super) fn run(args: &ReplayArgs, quiet: bool) -> anyhow::Result<()> {
    let begun = Instant::now();
    // The mode resets what belongs to it, so it comes first.
    let flags = [
        ("--mode", "texinit.mode", args.mode.as_deref()),
        ("--init", "texinit.init", args.init.as_deref()),
    ];
    let flags: Vec<_> = flags
        .into_iter()
        .filter_map(|(flag, name, value)| Some((flag, name, value?)))
        .collect();
    let config = args.settings.resolve_with(&flags)?;
    let job = Job {
        begun,
        bag: &args.bag,
        out: &args.out,
        record: args.record.as_deref(),
        json: args.json,
        config: &config,
    };
    job.run(TerminalProgress::new(quiet), quiet)
}

/// A recording to be textured, and where to.
pub(super) struct Job<'a> {
    pub(super) begun: Instant,
    pub(super) bag: &'a Path,
    pub(super) out: &'a Path,
    /// Bag to write what the node would publish to.
    pub(super) record: Option<&'a Path>,
    /// Whether the report's numbers go to standard output.
    pub(super) json: bool,
    pub(super) config: &'a Config,
}

impl Job<'_> {
    pub(super) fn run(&self, progress: TerminalProgress, quiet: bool) -> anyhow::Result<()> {
        let (begun, config) = (self.begun, self.config);
        // An unwritable folder should be known before the work, not after it.
        std::fs::create_dir_all(self.out)
            .with_context(|| format!("cannot create the output folder {}", self.out.display()))?;
        interrupt::remove_when_interrupted({
            let out = self.out.to_owned();
            let recorded = self.record.map(partial_path);
            move || {
                let mut files = export::atomic::partial_files(&out);
                files.extend(recorded.clone());
                files
            }
        });
        // So should an unwritable bag.
        let recording = self.record.map(record::Recording::create).transpose()?;
        let mut bag = BagReader::open(self.bag, &config.topics)?;
        let painted = if config.pipeline.follows_changes() {
            let period_s = config.node.paint_period_s;
            pipeline::run_streamed(&mut bag, &config.pipeline, period_s, &progress)
        } else {
            pipeline::run(&mut bag, &config.pipeline, &progress)
        };
        let mut run = painted.with_context(|| why_not(self.bag, &bag))?;
        let mut report = summary::of_run(&run, self.bag, &bag, config);
        let views = take_views(&mut run);

        progress.begin("write exports", 0);
        let export_begun = Instant::now();
        let textured = TexturedMesh::new(&run.mesh, &run.texinit.layout, &run.texinit.texture)?;
        let exported = export::write_all(&textured, self.out, &config.export)?;
        let export_s = export_begun.elapsed().as_secs_f64();

        progress.begin("score against the known texture", 0);
        let score_begun = Instant::now();
        let synthetic = score::against_truth(self.bag, &run)?;
        let score_s = score_begun.elapsed().as_secs_f64();

        progress.begin("draw the report", 0);
        report.stages.push(report::Stage {
            name: "write exports".to_owned(),
            seconds: export_s,
        });
        if synthetic.is_some() {
            report.stages.push(report::Stage {
                name: "score against the known texture".to_owned(),
                seconds: score_s,
            });
        }
        report.synthetic = synthetic;
        report
            .notes
            .extend(exported.notes.iter().map(|text| report::Note {
                severity: report::Severity::Info,
                text: text.clone(),
            }));
        report.measure(&textured, &views)?;
        if let Some(recording) = recording {
            progress.begin("record what would be published", 0);
            recording.write(&run, report.coverage.keyframe_share, config)?;
        }
        report.peak_memory_bytes = summary::peak_memory_bytes();
        // Until here: the page cannot say how long it took to draw itself.
        report.total_s = begun.elapsed().as_secs_f64();
        let report_files = report::write(&report, Some(&textured), &views, self.out)?;
        export::hashes::write(self.out, &exported.files, &report_files)?;
        progress.finish();

        if self.json {
            print_product(&(serde_json::to_string_pretty(&report)? + "\n"))?;
        } else if !quiet {
            print_product(&closing_lines(
                &report,
                self.out,
                begun.elapsed().as_secs_f64(),
            ))?;
        }
        Ok(())
    }
}

/// What the bag lacks, as the context of whatever failed for it.
fn why_not(path: &Path, bag: &BagReader) -> String {
    let mut text = format!("{} cannot be textured", path.display());
    for missing in &bag.plan().missing {
        text += &format!("; missing {}: {}", missing.role.name(), missing.remedy);
    }
    text
}

fn take_views(run: &mut Run) -> Vec<ReportView> {
    let first = run.keyframes.first().map_or(0, |k| k.stamp.as_nanos());
    std::mem::take(&mut run.held_out)
        .into_iter()
        .map(|view| {
            let seconds = (view.keyframe.stamp.as_nanos() - first) as f64 * 1e-9;
            ReportView {
                name: format!("keyframe {} at {seconds:.1} s", view.keyframe.id.0),
                stamp: view.keyframe.stamp,
                held_out: true,
                photo: view.photo,
                render: view.render,
                mask: view.mask,
                triangle: view.triangle,
            }
        })
        .collect()
}

fn closing_lines(report: &report::Report, out: &Path, total_s: f64) -> String {
    let mut lines = format!(
        "{} triangles, {} keyframes, {} charts on {} page(s) of {}x{}\n",
        report.mesh.num_triangles,
        report.keyframes.len(),
        report.charts.num_charts,
        report.atlas.num_pages,
        report.atlas.page_size_texel[0],
        report.atlas.page_size_texel[1],
    );
    if let Some(score) = &report.synthetic {
        lines += &format!(
            "error against the known texture: {:.2}/255 over {} texels\n",
            score.mean_abs, score.num_texels
        );
    }
    let num_dropped: u64 = report.drops.iter().map(|drop| drop.count).sum();
    if num_dropped > 0 {
        lines += &format!("{num_dropped} messages or frames left out; the report says why\n");
    }
    if report.coverage.keyframe_share + report.coverage.mean_share == 0.0 {
        lines += "warning: no frame sees the mesh; nothing of it was painted\n";
    }
    for loss in &report.source.losses {
        lines += &format!("lost: {loss}\n");
    }
    lines
        + &format!(
            "{total_s:.1} s; open {}\n",
            out.join("report.html").display()
        )
}
