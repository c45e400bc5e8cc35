//! A long run of what the live node does, as fast as the machine goes: one recording over and over, its
//! time going on, through ingest, keyframe store, painter, journal and publisher.
//!
//! ```text
//! cargo run --release --example long_run -- BAG SECONDS [--period S] [--step M] [PARAMETER:=VALUE …]
//! ```
//!
//! The recording comes again, with new stamps, until SECONDS of its time went by; each time the mesh
//! begins anew, so that charts go and pages are compacted. With `--step` it comes each time that many
//! metres further along x, a robot that goes on; else the same place is scanned again, and what was
//! evicted comes back. Painted is as the node does it with `stream.mode:=changes`, every `--period` (5)
//! seconds of the recording's time.
//!
//! Prints one row of JSON for each pass. Fails where a count does not add up, and where the resident
//! memory of the last quarter of the passes is more than 2 % above that of the quarter before.

#![expect(
    clippy::print_stdout,
    reason = "an example is there to be read at the console"
)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, bail, ensure};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};
use veneer::bag::BagReader;
use veneer::bag::journal::{Journal, PathDisk, ScanState};
use veneer::config::Config;
use veneer::geom::{RigidTransform, Stamp};
use veneer::ingest::{Event, EventSource, Header, MeshUpdate, TimedEvent};
use veneer::pipeline::{Capture, LiveScan, NoProgress, Painted, Painter};
use veneer::publish::{Publisher, Snapshot};

const USAGE: &str = "long_run BAG SECONDS [--period S] [--step M] [PARAMETER:=VALUE …]";
/// Between the end of a pass and the beginning of the next, nanoseconds.
const PAUSE_NS: i64 = 1_000_000_000;
/// What the memory of the last passes may be above that of those before.
const MAX_GROWTH: f64 = 1.02;

struct Args {
    bag: PathBuf,
    seconds: f64,
    period_s: f64,
    step_m: f64,
    config: Config,
}

fn args() -> anyhow::Result<Args> {
    let mut words = std::env::args().skip(1);
    let (Some(bag), Some(seconds)) = (words.next(), words.next()) else {
        bail!(USAGE);
    };
    let mut args = Args {
        bag: bag.into(),
        seconds: seconds.parse().context(USAGE)?,
        period_s: 5.0,
        step_m: 0.0,
        config: Config::default(),
    };
    args.config.set("stream.mode", "changes")?;
    while let Some(word) = words.next() {
        let number = |words: &mut dyn Iterator<Item = String>| {
            let word = words.next().context(USAGE)?;
            word.parse().context(USAGE)
        };
        match word.as_str() {
            "--period" => args.period_s = number(&mut words)?,
            "--step" => args.step_m = number(&mut words)?,
            _ => {
                let (name, value) = word.split_once(":=").context(USAGE)?;
                args.config.set(name, value)?;
            }
        }
    }
    Ok(args)
}

fn main() -> anyhow::Result<()> {
    let args = args()?;
    let (first, last) = span(&args)?;
    let pass_ns = last.as_nanos() - first.as_nanos() + PAUSE_NS;
    let mut node = Node::new(&args)?;
    let mut resident_mb = Vec::new();
    let begun = Instant::now();
    for pass in 0.. {
        let shift = Shift {
            nanos: i64::from(pass) * pass_ns,
            world: RigidTransform::from_parts(
                UnitQuaternion::identity(),
                Vector3::new(f64::from(pass) * args.step_m, 0.0, 0.0),
            ),
        };
        let mut source = BagReader::open(&args.bag, &args.config.topics)?;
        let mut is_mesh_new = true;
        while let Some(event) = source.next_event() {
            node.push(shift.event(event, &mut is_mesh_new))?;
        }
        node.check()?;
        let row = node.row(pass, begun.elapsed().as_secs_f64())?;
        println!("{row}");
        resident_mb.push(std::mem::take(&mut node.pass).resident_mb.into_iter());
        if f64::from(pass + 1) * pass_ns as f64 >= args.seconds * 1e9 {
            break;
        }
    }
    let quarter = resident_mb.len() / 4;
    ensure!(quarter > 0, "fewer than four passes say nothing of growth");
    let mean = |passes: Vec<std::vec::IntoIter<f64>>| {
        let samples: Vec<f64> = passes.into_iter().flatten().collect();
        samples.iter().sum::<f64>() / samples.len().max(1) as f64
    };
    let last_mb = mean(resident_mb.split_off(resident_mb.len() - quarter));
    let before_mb = mean(resident_mb.split_off(resident_mb.len() - quarter));
    let growth = last_mb / before_mb;
    println!(
        "{}",
        json!({"before_mb": before_mb, "last_mb": last_mb, "growth": growth})
    );
    ensure!(
        growth <= MAX_GROWTH,
        "resident memory went from {before_mb:.0} MB to {last_mb:.0} MB"
    );
    Ok(())
}

/// When the recording's first and last messages were received.
fn span(args: &Args) -> anyhow::Result<(Stamp, Stamp)> {
    let mut source = BagReader::open(&args.bag, &args.config.topics)?;
    let mut span: Option<(Stamp, Stamp)> = None;
    while let Some(event) = source.next_event() {
        let (first, last) = span.unwrap_or((event.received, event.received));
        span = Some((first.min(event.received), last.max(event.received)));
    }
    span.context("the bag holds nothing that veneer reads")
}

/// From the recording to a pass.
struct Shift {
    nanos: i64,
    world: RigidTransform,
}

impl Shift {
    fn event(&self, mut event: TimedEvent, is_mesh_new: &mut bool) -> TimedEvent {
        event.received = self.stamp(event.received);
        if let Ok(message) = &mut event.event {
            self.message(message, is_mesh_new);
        }
        event
    }

    fn stamp(&self, stamp: Stamp) -> Stamp {
        Stamp::from_nanos(stamp.as_nanos() + self.nanos)
    }

    fn message(&self, message: &mut Event, is_mesh_new: &mut bool) {
        let later = |header: &mut Header| header.stamp = self.stamp(header.stamp);
        match message {
            Event::Color(header, _)
            | Event::Depth(header, _)
            | Event::ColorInfo(header, _)
            | Event::DepthInfo(header, _) => later(header),
            Event::Pose(header, pose) => {
                later(header);
                *pose = self.world * *pose;
            }
            // The camera's pose in the world is one transform in the recordings that are made here.
            Event::Transforms(transforms) => {
                for transform in transforms {
                    later(&mut transform.header);
                    transform.parent_from_child = self.world * transform.parent_from_child;
                }
            }
            Event::StaticTransforms(transforms) => {
                for transform in transforms {
                    later(&mut transform.header);
                }
            }
            Event::Odometry(odometry) => {
                later(&mut odometry.header);
                odometry.parent_from_child = self.world * odometry.parent_from_child;
            }
            Event::Corrections(header, _, corrections) => {
                later(header);
                for correction in corrections {
                    correction.stamp = self.stamp(correction.stamp);
                    correction.pose = self.world * correction.pose;
                }
            }
            Event::Mesh(header, update, _) => {
                later(header);
                match update {
                    MeshUpdate::Whole(mesh) => *mesh = mesh.transformed(&self.world),
                    MeshUpdate::Blocks { clear, blocks } => {
                        *clear |= *is_mesh_new;
                        for (_, block) in blocks {
                            *block = block.transformed(&self.world);
                        }
                    }
                }
                *is_mesh_new = false;
            }
        }
    }
}

/// What a pass did.
#[derive(Default)]
struct Pass {
    /// After each painting.
    resident_mb: Vec<f64>,
    paint_ms: Vec<f64>,
    num_charts_gone: usize,
    num_page_changes: usize,
    num_messages: usize,
    num_message_bytes: usize,
}

/// The parts of the live node, without its threads and without DDS.
struct Node {
    config: Config,
    period_s: f64,
    scan: LiveScan,
    painter: Painter,
    journal: Journal,
    publisher: Publisher,
    /// Holds the journal.
    _folder: tempfile::TempDir,
    num_pushed: u64,
    painted: Option<(Stamp, u64)>,
    num_painted: u64,
    charts: [usize; 2],
    pass: Pass,
}

impl Node {
    fn new(args: &Args) -> anyhow::Result<Self> {
        let config = args.config.clone();
        let topics = BagReader::open(&args.bag, &config.topics)?;
        let folder = tempfile::tempdir()?;
        let disk = PathDisk::new(&folder.path().join("journal.mcap"));
        Ok(Self {
            scan: LiveScan::new(&config.pipeline, topics.topics(), 0),
            painter: Painter::new(&config.pipeline.keyframe),
            journal: Journal::create(Box::new(disk))?,
            publisher: Publisher::new(config.publish),
            _folder: folder,
            period_s: args.period_s,
            num_pushed: 0,
            painted: None,
            num_painted: 0,
            charts: [0; 2],
            pass: Pass::default(),
            config,
        })
    }

    fn push(&mut self, event: TimedEvent) -> anyhow::Result<()> {
        let now = event.received;
        self.num_pushed += 1;
        let has_changed = self.scan.push(event);
        let is_due = match self.painted {
            Some((at, revision)) => {
                revision != self.scan.revision() && now.seconds_since(at) >= self.period_s
            }
            None => has_changed,
        };
        if is_due && self.scan.capture().is_paintable() {
            self.painted = Some((now, self.scan.revision()));
            self.paint()?;
        }
        Ok(())
    }

    fn paint(&mut self) -> anyhow::Result<()> {
        let capture = self.scan.capture();
        let state = scan_state(&capture);
        self.journal.follow(&state)?;
        self.journal.compact(&state)?;
        drop(state);
        let begun = Instant::now();
        let params = &self.config.pipeline;
        let painted = self.painter.paint(capture, params, &NoProgress)?;
        let pass = &mut self.pass;
        pass.paint_ms.push(1e3 * begun.elapsed().as_secs_f64());
        let update = painted.update.as_ref().context("all was painted")?;
        pass.num_charts_gone += update.gone_charts.len();
        pass.num_page_changes += usize::from(update.has_new_pages);
        self.charts = [painted.layout.charts.len(), painted.texture.pages.len()];
        self.num_painted += 1;
        let messages = self
            .publisher
            .publish(&snapshot(&painted, self.num_painted), &|_| true)?;
        pass.num_messages += messages.len();
        pass.num_message_bytes += messages.iter().map(|m| m.bytes.len()).sum::<usize>();
        drop((painted, messages));
        pass.resident_mb.push(resident_mb()?);
        Ok(())
    }

    /// Whether every message and every frame is accounted for.
    fn check(&self) -> anyhow::Result<()> {
        let capture = self.scan.capture();
        let topics = || capture.ingest.topics.values();
        let num_received: u64 = topics().map(|topic| topic.num_received).sum();
        let num_done: u64 = topics().map(|t| t.num_used + t.num_refused()).sum();
        let num_pending = capture.num_pending as u64;
        ensure!(
            num_received == self.num_pushed && num_received == num_done + num_pending,
            "{} messages came, {num_received} are counted, {num_done} used or refused, {num_pending} wait",
            self.num_pushed
        );
        let store = &capture.store;
        let num_rejected: u64 = store.rejected_by_reason.values().sum();
        ensure!(
            store.num_offered == capture.ingest.num_frames
                && store.num_offered == store.num_admitted + num_rejected,
            "of {} frames {} were offered, {} admitted, {num_rejected} rejected",
            capture.ingest.num_frames,
            store.num_offered,
            store.num_admitted
        );
        let num_gone = store.num_replaced + store.num_evicted;
        ensure!(
            capture.keyframes.len() as u64 + num_gone == store.num_admitted,
            "{} keyframes are there; {} were admitted, {num_gone} went",
            capture.keyframes.len(),
            store.num_admitted
        );
        let num_bytes: usize = capture.keyframes.iter().map(|k| k.num_bytes()).sum();
        ensure!(num_bytes == store.num_bytes, "bytes of keyframes");
        Ok(())
    }

    fn row(&self, pass: u32, wall_s: f64) -> anyhow::Result<Value> {
        let capture = self.scan.capture();
        let store = &capture.store;
        let topics = capture.ingest.topics.values();
        let mut refused = BTreeMap::<&str, u64>::new();
        for (reason, count) in topics.flat_map(|topic| &topic.refused_by_reason) {
            *refused.entry(reason).or_default() += count.num;
        }
        let mut paint_ms = self.pass.paint_ms.clone();
        paint_ms.sort_by(f64::total_cmp);
        let at = |share: f64| quantile(&paint_ms, share);
        Ok(json!({
            "pass": pass,
            "scan_s": capture.duration_s.round(),
            "wall_s": wall_s.round(),
            "resident_mb": resident_mb()?.round(),
            "peak_mb": self.pass.resident_mb.iter().copied().fold(0.0, f64::max).round(),
            "keyframes": capture.keyframes.len(),
            "keyframe_mb": (store.num_bytes as f64 / 1e5).round() / 10.0,
            "decoded_mb": (self.painter.num_cached_bytes() as f64 / 1e6).round(),
            "messages": self.num_pushed,
            "refused": refused,
            "offered": store.num_offered,
            "admitted": store.num_admitted,
            "evicted": store.num_evicted,
            "replaced": store.num_replaced,
            "rejected": store.rejected_by_reason,
            "triangles": capture.mesh.as_ref().map_or(0, |mesh| mesh.num_triangles()),
            "charts": self.charts[0],
            "pages": self.charts[1],
            "charts_gone": self.pass.num_charts_gone,
            "page_changes": self.pass.num_page_changes,
            "paintings": paint_ms.len(),
            "paint_ms": [at(0.5), at(0.95), at(1.0)],
            "published": self.pass.num_messages,
            "published_mb": (self.pass.num_message_bytes as f64 / 1e5).round() / 10.0,
            "journal_mb": (self.journal.report().num_bytes as f64 / 1e5).round() / 10.0,
            "compactions": self.journal.report().num_compactions,
        }))
    }
}

fn scan_state(capture: &Capture) -> ScanState {
    let keyframes = capture.keyframes.iter();
    ScanState {
        keyframes: keyframes.map(|k| (k.id, k.clone())).collect(),
        mesh: capture.mesh.clone(),
        mesh_blocks: capture.mesh_blocks.clone(),
        num_mesh_updates: capture.num_mesh_updates as u64,
        world_frame: capture.ingest.world_frame.clone(),
        ..ScanState::default()
    }
}

fn snapshot(painted: &Painted, revision: u64) -> Snapshot<'_> {
    let frame = painted.capture.ingest.world_frame.as_deref();
    Snapshot {
        stamp: painted.capture.stamp,
        frame_id: frame.unwrap_or_default(),
        session: 1,
        revision,
        mesh: &painted.mesh,
        layout: &painted.layout,
        texture: &painted.texture,
        keyframes: &painted.keyframes,
        chart_keys: painted.chart_keys.as_deref(),
    }
}

/// Of ascending numbers, rounded to whole ones.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a place among the numbers"
    )]
    let at = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(at).map_or(0.0, |number| number.round())
}

fn resident_mb() -> anyhow::Result<f64> {
    let status = std::fs::read_to_string(Path::new("/proc/self/status"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next());
    let kilobytes: f64 = kilobytes.context("no VmRSS in /proc")?.parse()?;
    Ok(kilobytes * 1024.0 / 1e6)
}
