//! What idle time gains: paints a bag as it comes, by the bag's time, once for each list of settings, and
//! compares renderings with photos that painted nothing.
//!
//! ```text
//! cargo run --release --example stream_quality -- BAG PERIOD_S [--views DIR]
//!     [PARAMETER:=VALUE …] [-- PARAMETER:=VALUE …] …
//! ```
//!
//! One row of JSON for each list: updates and idle steps with their times, and means over the views held
//! back (`eval.held_out_views`) as `veneer eval` has them, all lists in one company. LPIPS needs
//! `VENEER_LPIPS_WEIGHTS`. `--views` writes each photo, and beside it the renderings.

#![expect(
    clippy::print_stdout,
    reason = "an example is there to be read at the console"
)]

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde_json::{Value, json};
use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::geom::ColorImage;
use veneer::metrics::Lpips;
use veneer::metrics::protocol::{MethodScore, MethodView, score_view};
use veneer::pipeline::{NoProgress, Run, run_streamed};
use veneer::texsmooth::align::{AlignForm, AlignParams};

const USAGE: &str =
    "stream_quality BAG PERIOD_S [--views DIR] [PARAMETER:=VALUE …] [-- PARAMETER:=VALUE …] …";

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let (bag, period_s) = args.next().zip(args.next()).context(USAGE)?;
    let period_s: f64 = period_s.parse()?;
    let (mut configs, mut views) = (vec![Config::default()], None);
    while let Some(arg) = args.next() {
        match (arg.as_str(), arg.split_once(":=")) {
            ("--", _) => configs.push(Config::default()),
            ("--views", _) => views = Some(PathBuf::from(args.next().context(USAGE)?)),
            (_, Some((name, value))) => {
                let config = configs.last_mut().context(USAGE)?;
                config.set(name, value)?;
            }
            _ => bail!(USAGE),
        }
    }
    let weights = std::env::var_os("VENEER_LPIPS_WEIGHTS").map(PathBuf::from);
    let lpips = weights.as_deref().map(Lpips::load).transpose()?;
    let mut runs = Vec::with_capacity(configs.len());
    for config in &configs {
        let mut source = BagReader::open(Path::new(&bag), &config.topics)?;
        runs.push(run_streamed(
            &mut source,
            &config.pipeline,
            period_s,
            &NoProgress,
        )?);
    }
    let scores = scored(&runs, lpips.as_ref(), views.as_deref())?;
    for (run, scores) in runs.iter().zip(&scores) {
        println!("{}", row(run, scores));
    }
    Ok(())
}

/// Per run: the scores of the views.
fn scored(
    runs: &[Run],
    lpips: Option<&Lpips>,
    folder: Option<&Path>,
) -> anyhow::Result<Vec<Vec<MethodScore>>> {
    let align = AlignParams {
        form: AlignForm::Reference,
        ..AlignParams::default()
    };
    let num_views = runs.first().map_or(0, |run| run.held_out.len());
    let mut scores = vec![Vec::with_capacity(num_views); runs.len()];
    for index in 0..num_views {
        let held_out = || runs.iter().map(|run| &run.held_out[index]);
        let of_runs: Vec<MethodView> = held_out()
            .map(|view| MethodView {
                render: view.render.clone(),
                mask: view.mask.clone(),
            })
            .collect();
        let photo = &runs[0].held_out[index].photo;
        let seen = score_view(photo, &of_runs, &align, lpips)?;
        for (scores, score) in scores.iter_mut().zip(seen.scores) {
            scores.push(score);
        }
        if let Some(folder) = folder {
            let images: Vec<&ColorImage> = std::iter::once(photo)
                .chain(held_out().map(|view| &view.render))
                .collect();
            write_row(&folder.join(format!("view_{index}.png")), &images)?;
        }
    }
    Ok(scores)
}

fn row(run: &Run, scores: &[MethodScore]) -> Value {
    let mean = |of: &dyn Fn(&MethodScore) -> Option<f64>| {
        let values: Vec<f64> = scores.iter().filter_map(of).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        mean.is_finite().then(|| (1e4 * mean).round() / 1e4)
    };
    let updates = run.updates.clone().unwrap_or_default();
    let rounded = |seconds: f64| (1e3 * seconds).round() / 1e3;
    let stages: Vec<Value> = run
        .stages
        .iter()
        .map(|stage| json!([stage.name, rounded(stage.seconds)]))
        .collect();
    json!({
        "views": scores.len(),
        "ssim": mean(&|score| score.ssim),
        "lpips": mean(&|score| score.lpips),
        "s3": mean(&|score| Some(score.s3)),
        "grad": mean(&|score| Some(score.grad)),
        "psnr_db": mean(&|score| score.psnr_db),
        "updates": updates.num_updates,
        "updates_s": rounded(updates.all_s),
        "idle_steps": updates.num_idle_steps,
        "idle_s": rounded(updates.idle_s),
        "slowest_idle_s": rounded(updates.slowest_idle_s),
        "stages_s": stages,
    })
}

/// Images of one size beside one another.
fn write_row(path: &Path, images: &[&ColorImage]) -> anyhow::Result<()> {
    let (width, height) = images.first().map_or((0, 0), |i| (i.width(), i.height()));
    let rows = (0..height as usize).flat_map(|y| {
        images.iter().flat_map(move |image| {
            let start = y * width as usize;
            image.pixels()[start..start + width as usize].as_flattened()
        })
    });
    let bytes: Vec<u8> = rows.copied().collect();
    let num_images = u32::try_from(images.len())?;
    let file = std::io::BufWriter::new(std::fs::File::create(path)?);
    let mut encoder = png::Encoder::new(file, num_images * width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header()?.write_image_data(&bytes)?;
    Ok(())
}
