//! What it costs to keep a texture up while a scan changes: paints a bag as it comes, by the bag's
//! time, and prints one row of JSON for each update, then one for painting the whole at the end once.
//!
//! ```text
//! cargo run --release --example stream -- BAG PERIOD_S [--check] [PARAMETER:=VALUE …]
//! ```
//!
//! A row has the update's wall time and that of its stages in milliseconds, and what changed. `--check`
//! compares labels and texels with those of the whole at once after each update, outside of the
//! times. The last row has the wall times of the whole pass, all updates and one painting of the whole
//! mesh, and the seams between triangles of different frames, by chart and of the whole.

#![expect(
    clippy::print_stdout,
    reason = "an example is there to be read at the console"
)]

use std::path::Path;

use anyhow::{Context as _, bail, ensure};
use serde_json::json;
use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::keyframe::Keyframe;
use veneer::pipeline::{NoProgress, StageTime, StreamPainter, Streamed, run, stream};
use veneer::texinit::{Coupling, Observer, Stage, TexInitParams, repaint};

const USAGE: &str = "stream BAG PERIOD_S [--check] [PARAMETER:=VALUE …]";

struct Silent;

impl Observer for Silent {
    fn begin(&self, _stage: Stage, _num_steps: usize) {}
    fn advance(&self, _num_steps: usize) {}
}

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let (Some(bag), Some(period_s)) = (args.next(), args.next()) else {
        bail!(USAGE);
    };
    let (mut config, mut is_checked) = (Config::default(), false);
    for arg in args {
        match arg.split_once(":=") {
            Some((name, value)) => config.set(name, value)?,
            None if arg == "--check" => is_checked = true,
            None => bail!(USAGE),
        }
    }
    let bag = Path::new(&bag);
    let params = &config.pipeline;
    let mut source = BagReader::open(bag, &config.topics)?;
    let (mut total_s, mut num_updates, mut mismatch) = (0.0, 0, None);
    let mut see = |painter: &StreamPainter, streamed: &Streamed| {
        num_updates += 1;
        total_s += seconds(&streamed.stages);
        println!("{}", row(painter, streamed));
        if is_checked && mismatch.is_none() {
            mismatch = difference(painter, streamed, &params.texinit);
        }
    };
    let period_s: f64 = period_s.parse().context(USAGE)?;
    let painter = stream(&mut source, params, period_s, &NoProgress, &mut see)?;
    if let Some(mismatch) = mismatch {
        bail!("after an update, {mismatch}");
    }
    let state = painter.state().context("nothing is painted")?;
    let by_chart = state.assignment().report;
    let (num_bytes, num_charts) = (state.num_bytes(), state.layout().charts.len());
    let used_share = state.used_share();
    drop(painter);

    let mut source = BagReader::open(bag, &config.topics)?;
    let whole = run(&mut source, params, &NoProgress)?;
    let reading = ["read and select frames", "render held-out views"];
    let stages = whole.stages.iter().filter(|s| !reading.contains(&s.name));
    let whole_s: f64 = stages.map(|stage| stage.seconds).sum();
    let of_whole = &whole.texinit.assignment.report;
    ensure!(whole_s > 0.0, "painting the whole took no time");
    let last = json!({
        "num_updates": num_updates,
        "all_updates_s": total_s,
        "whole_once_s": whole_s,
        "ratio": total_s / whole_s,
        "seams_by_chart": [by_chart.num_seams, by_chart.num_inner_edges],
        "seams_of_whole": [of_whole.num_seams, of_whole.num_inner_edges],
        "charts": [num_charts, whole.texinit.layout.charts.len()],
        "used_share": used_share,
        "num_bytes": num_bytes,
        "whole_stages_ms": stages_ms(&whole.stages),
    });
    println!("{last}");
    Ok(())
}

fn seconds(stages: &[StageTime]) -> f64 {
    stages.iter().map(|stage| stage.seconds).sum()
}

fn stages_ms(stages: &[StageTime]) -> serde_json::Value {
    let stages = stages.iter().map(|stage| {
        let milliseconds = (1e4 * stage.seconds).round() / 10.0;
        (stage.name.to_owned(), json!(milliseconds))
    });
    stages.collect::<serde_json::Map<_, _>>().into()
}

fn row(painter: &StreamPainter, streamed: &Streamed) -> serde_json::Value {
    let update = &streamed.update;
    json!({
        "ms": (1e4 * seconds(&streamed.stages)).round() / 10.0,
        "triangles": painter.state().map(|state| state.mesh().num_triangles()),
        "kept": update.mesh.num_kept,
        "moved": update.mesh.num_moved,
        "changed": update.mesh.num_changed,
        "new": update.mesh.num_new,
        "gone": update.mesh.num_gone,
        "keyframes": streamed.capture.keyframes.len(),
        "added": update.num_frames_added,
        "waiting": update.num_frames_waiting,
        "removed": update.num_frames_removed,
        "charts_new": update.new_charts.len(),
        "charts_changed": update.changed_charts.len(),
        "charts_gone": update.gone_charts.len(),
        "pairs": update.num_pairs_scored,
        "painted": update.num_triangles_painted,
        "new_pages": update.has_new_pages,
        "moved_keyframes": update.num_frames_moved,
        "is_idle_step": streamed.is_idle_step,
        "charts_to_refine": painter.num_charts_waiting(),
        "keyframes_to_align": painter.num_poses_waiting(),
        "stages_ms": stages_ms(&streamed.stages),
    })
}

/// Where the state is not that of the whole at once.
fn difference(
    painter: &StreamPainter,
    streamed: &Streamed,
    params: &TexInitParams,
) -> Option<String> {
    let state = painter.state()?;
    let frames = &streamed.keyframes;
    let decode = |keyframe: &Keyframe| painter.decode(keyframe);
    let params = TexInitParams {
        coupling: Coupling::Chart,
        ..params.clone()
    };
    let (mesh, layout) = (state.mesh(), state.layout());
    let whole = match repaint(mesh, layout, frames, &decode, &params, &Silent) {
        Ok(whole) => whole,
        Err(error) => return Some(error.to_string()),
    };
    let labels = whole.assignment.label.iter();
    let numbers = labels.map(|label| label.map(|frame| frames[frame as usize].id.0));
    let num_labels = numbers
        .zip(&state.assignment().label)
        .filter(|(whole, ours)| whole != *ours)
        .count();
    let pages = whole.texture.pages.iter().zip(&state.texture().pages);
    let num_pages = pages.filter(|(whole, ours)| whole != ours).count();
    let is_same =
        num_labels + num_pages == 0 && whole.texture.pages.len() == state.texture().pages.len();
    (!is_same).then(|| format!("{num_labels} labels and {num_pages} pages differ"))
}
