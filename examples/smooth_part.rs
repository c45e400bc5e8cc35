//! What it costs to refine some charts of a texture, a few steps at a time, beside the whole at once.
//!
//! ```text
//! cargo run --release --example smooth_part -- BAG [--near] [--share S] [--piece N]
//!     [PARAMETER:=VALUE …]
//! ```
//!
//! Paints the bag, then refines one copy of the texture whole, for `texsmooth.num_steps`, and one in a
//! share S of its charts (0.05), for that share of the steps, N steps (4) to a call. The charts are
//! taken evenly from all; with `--near` those nearest to one point, as they are where a scan goes on. One
//! row of JSON each: the time before the first step, that of the steps, and how far rendering and photo
//! are apart at first and at last on the charts (mean L1 on the scale of [−1, 1], by the steps' own crops).

#![expect(
    clippy::print_stdout,
    reason = "an example is there to be read at the console"
)]

use std::path::Path;
use std::time::Instant;

use anyhow::{Context as _, bail};
use nalgebra::Point3;
use serde_json::{Value, json};
use veneer::atlas::PlacedChart;
use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::keyframe::{Keyframe, KeyframeParams, KeyframeStore};
use veneer::mesh::TriMesh;
use veneer::pipeline::{NoProgress, Run, run};
use veneer::texsmooth::{
    NoObserver, SmoothFrom, SmoothReport, SmoothScene, Smoothing, TexSmoothParams, smooth,
};

const USAGE: &str = "smooth_part BAG [--near] [--share S] [--piece N] [PARAMETER:=VALUE …]";

struct Options {
    bag: String,
    is_near: bool,
    share: f64,
    piece: usize,
    config: Config,
}

impl Options {
    fn parse() -> anyhow::Result<Self> {
        let mut args = std::env::args().skip(1);
        let mut options = Self {
            bag: args.next().context(USAGE)?,
            is_near: false,
            share: 0.05,
            piece: 4,
            config: Config::default(),
        };
        while let Some(arg) = args.next() {
            match (arg.as_str(), arg.split_once(":=")) {
                (_, Some((name, value))) => options.config.set(name, value)?,
                ("--near", _) => options.is_near = true,
                ("--share", _) => options.share = args.next().context(USAGE)?.parse()?,
                ("--piece", _) => options.piece = args.next().context(USAGE)?.parse()?,
                _ => bail!(USAGE),
            }
        }
        Ok(options)
    }
}

fn main() -> anyhow::Result<()> {
    let options = Options::parse()?;
    let params = &options.config.pipeline.texsmooth;
    let mut painting = options.config.pipeline.clone();
    painting.texsmooth.num_steps = 0;
    let mut source = BagReader::open(Path::new(&options.bag), &options.config.topics)?;
    let painted = run(&mut source, &painting, &NoProgress)?;
    // Photos that were decoded stay decoded.
    let photos = KeyframeStore::new(&KeyframeParams {
        decode_cache_mb: 1e6,
        ..KeyframeParams::default()
    });
    let decode = |keyframe: &Keyframe| photos.decode(keyframe);
    for keyframe in &painted.keyframes {
        decode(keyframe)?;
    }
    let scene = SmoothScene {
        mesh: &painted.mesh,
        layout: &painted.texinit.layout,
        frames: &painted.keyframes,
        decode: &decode,
    };
    println!("{}", whole(&painted, &scene, params)?);
    println!("{}", part(&painted, &scene, params, &options)?);
    Ok(())
}

fn whole(
    painted: &Run,
    scene: &SmoothScene<'_>,
    params: &TexSmoothParams,
) -> anyhow::Result<Value> {
    let mut texture = painted.texinit.texture.clone();
    let begun = Instant::now();
    let report = smooth(
        scene.mesh,
        scene.layout,
        &mut texture,
        scene.frames,
        scene.decode,
        params,
        SmoothFrom::Nothing,
        &NoObserver,
    )?;
    let all_ms = 1e3 * begun.elapsed().as_secs_f64();
    Ok(json!({
        "form": "whole",
        "all_ms": rounded(all_ms),
        "step_ms": rounded(all_ms / report.num_steps as f64),
        "report": row(&report),
    }))
}

fn part(
    painted: &Run,
    scene: &SmoothScene<'_>,
    params: &TexSmoothParams,
    options: &Options,
) -> anyhow::Result<Value> {
    let charts = &scene.layout.charts;
    let may_change = chosen(scene.mesh, charts, options);
    let num_chosen = may_change.iter().filter(|may| **may).count();
    let num_texels = |chart: &PlacedChart| -> u64 {
        let spans = chart.own_spans();
        spans.map(|(_, _, len)| u64::from(len)).sum()
    };
    let own = charts.iter().zip(&may_change).filter(|(_, may)| **may);
    let num_own: u64 = own.map(|(chart, _)| num_texels(chart)).sum();
    let num_all: u64 = charts.iter().map(num_texels).sum();
    let share = num_own as f64 / num_all as f64;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a share of the steps"
    )]
    let num_steps = (share * params.num_steps as f64).ceil() as usize;
    let params = TexSmoothParams {
        num_steps,
        ..params.clone()
    };
    let mut texture = painted.texinit.texture.clone();
    let begun = Instant::now();
    let mut smoothing =
        Smoothing::of_charts(scene, &texture, &may_change, &params, SmoothFrom::Nothing)?;
    let first_ms = 1e3 * begun.elapsed().as_secs_f64();
    let mut piece_ms = Vec::new();
    while !smoothing.is_done() {
        let begun = Instant::now();
        smoothing.advance(scene, &mut texture, options.piece, &NoObserver)?;
        piece_ms.push(1e3 * begun.elapsed().as_secs_f64());
    }
    let report = smoothing.finish(&NoObserver)?;
    let steps_ms: f64 = piece_ms.iter().sum();
    piece_ms.sort_by(f64::total_cmp);
    let (median, most) = (piece_ms.get(piece_ms.len() / 2), piece_ms.last());
    let [median, most] = [median, most].map(|ms| ms.copied().map(rounded));
    Ok(json!({
        "form": "part",
        "charts": [num_chosen, charts.len()],
        "texels": [num_own, num_all],
        "before_the_first_step_ms": rounded(first_ms),
        "steps_ms": rounded(steps_ms),
        "step_ms": rounded(steps_ms / report.num_steps.max(1) as f64),
        "piece_steps": options.piece,
        "piece_ms": {"median": median, "most": most},
        "report": row(&report),
    }))
}

fn chosen(mesh: &TriMesh, charts: &[PlacedChart], options: &Options) -> Vec<bool> {
    let middle = |chart: &PlacedChart| {
        let corners = chart.triangles.iter().map(|t| mesh.corners_m(*t)[0].coords);
        Point3::from(corners.sum::<nalgebra::Vector3<f64>>() / chart.triangles.len() as f64)
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a share of the charts"
    )]
    let num = (options.share * charts.len() as f64).ceil() as usize;
    let mut may_change = vec![false; charts.len()];
    if options.is_near {
        let from = middle(&charts[charts.len() / 2]);
        let mut order: Vec<(f64, usize)> = charts
            .iter()
            .enumerate()
            .map(|(index, chart)| ((middle(chart) - from).norm(), index))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for &(_, index) in order.iter().take(num) {
            may_change[index] = true;
        }
    } else {
        for i in 0..num {
            may_change[i * charts.len() / num] = true;
        }
    }
    may_change
}

fn row(report: &SmoothReport) -> Value {
    let l1 = |at: Option<&(usize, veneer::texsmooth::StepLosses)>| {
        at.map(|(_, losses)| (1e4 * f64::from(losses.l1)).round() / 1e4)
    };
    json!({
        "steps": report.num_steps,
        "empty": report.num_empty,
        "self_partnered": report.num_self_partnered,
        "views": report.num_views,
        "aligned": report.offsets.num_views,
        "texels": report.num_texels,
        "steps_per_texel": (100.0 * report.num_steps_per_texel).round() / 100.0,
        "l1": [l1(report.curve.first()), l1(report.curve.last())],
    })
}

fn rounded(ms: f64) -> f64 {
    (10.0 * ms).round() / 10.0
}
