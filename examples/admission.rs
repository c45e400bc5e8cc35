//! How long a frame waits until it is a keyframe or refused: plays a recording at a camera's rate, in real
//! time, into the front of the live node while what was kept is painted over and over on other threads.
//!
//! ```text
//! cargo run --release --example admission -- BAG [--hz 30] [--repeat 8] [--seconds 20]
//!     [PARAMETER:=VALUE …]
//! ```
//!
//! Each recorded frame comes `--repeat` times, with new stamps, as a camera shows nearly the same several
//! times: of those at most one is kept. Then the recording begins again, 10 m further along x, with
//! a new mesh beside the one before. A message arrives when it is due, whether ingest is ready or not;
//! from then on it is decoded, paired, posed and judged, as in the node. The first three seconds, in
//! which frames wait for mesh and transforms to come at all, do not count. Prints one row of JSON:
//! percentiles over all frames, and over those that were kept, milliseconds; and of the processor time
//! that the thread took for a frame, which other programs on the machine hardly change. Fails where the
//! 95th percentile is above 50 ms.

#![expect(
    clippy::print_stdout,
    reason = "an example is there to be read at the console"
)]

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail, ensure};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::json;
use veneer::bag::BagReader;
use veneer::bag::roles::TopicAssignment;
use veneer::config::Config;
use veneer::geom::{RigidTransform, Stamp};
use veneer::ingest::event::MeshBlockKey;
use veneer::ingest::{Event, EventSource, Header, MeshUpdate, TimedEvent};
use veneer::pipeline::{Capture, Latest, LiveScan, NoProgress, Painter, PipelineParams};
use veneer::wire::{EventDecoder, TopicRole};

const USAGE: &str = "admission BAG [--hz N] [--repeat N] [--seconds S] [PARAMETER:=VALUE …]";
/// The 95th percentile may be at most this, milliseconds.
const MAX_P95_MS: f64 = 50.0;
/// Frames that come earlier do not count, seconds.
const WARM_UP_S: f64 = 3.0;
/// From one time through the recording to the next, along x, metres.
const STEP_M: f64 = 10.0;
/// Names of mesh blocks of one time through the recording, at most.
const KEYS: i64 = 1 << 32;

struct Args {
    bag: PathBuf,
    hz: f64,
    repeat: usize,
    seconds: f64,
    config: Config,
}

fn args() -> anyhow::Result<Args> {
    let mut words = std::env::args().skip(1);
    let mut args = Args {
        bag: words.next().context(USAGE)?.into(),
        hz: 30.0,
        repeat: 8,
        seconds: 20.0,
        config: Config::default(),
    };
    args.config.set("stream.mode", "changes")?;
    while let Some(word) = words.next() {
        let mut value = || words.next().context(USAGE);
        match word.as_str() {
            "--hz" => args.hz = value()?.parse().context(USAGE)?,
            "--repeat" => args.repeat = value()?.parse().context(USAGE)?,
            "--seconds" => args.seconds = value()?.parse().context(USAGE)?,
            _ => {
                let (name, value) = word.split_once(":=").context(USAGE)?;
                args.config.set(name, value)?;
            }
        }
    }
    ensure!(args.hz > 0.0 && args.repeat > 0, USAGE);
    Ok(args)
}

/// A message of the recording.
struct Recorded {
    /// Of the decoder that reads it.
    channel: usize,
    bytes: Vec<u8>,
}

/// What belongs to one colour image, in the order of the recording.
#[derive(Default)]
struct Moment {
    messages: Vec<Recorded>,
    /// Stamp of the colour image, nanoseconds.
    stamp_ns: i64,
}

struct Channel {
    topic: usize,
    role: TopicRole,
}

struct Recording {
    topics: Vec<String>,
    channels: Vec<Channel>,
    moments: Vec<Moment>,
}

impl Recording {
    /// With what decodes the messages of each channel.
    fn read(args: &Args) -> anyhow::Result<(Self, Vec<EventDecoder>)> {
        let mut reader = BagReader::open(&args.bag, &args.config.topics)?;
        let topics = reader.topics().to_vec();
        let channel = |assignment: &TopicAssignment| {
            let topic = topics.iter().position(|t| *t == assignment.topic)?;
            let (name, role) = (&assignment.topic, assignment.role);
            let decoder = EventDecoder::new(name, assignment.message_type, role)?;
            let decoder = decoder.with_rectification(assignment.rectification);
            Some((Channel { topic, role }, decoder))
        };
        let (channels, decoders): (Vec<_>, Vec<_>) =
            reader.plan().assignments.iter().filter_map(channel).unzip();
        let mut stamps_ns = Vec::new();
        while let Some(event) = reader.next_event() {
            if let Ok(Event::Color(header, _)) = &event.event {
                stamps_ns.push(header.stamp.as_nanos());
            }
        }
        let file = std::fs::read(&args.bag)?;
        let mut messages = mcap::MessageStream::new(&file)?.collect::<Result<Vec<_>, _>>()?;
        messages.sort_by_key(|message| message.log_time);
        // A moment ends before the first message that was logged after its image.
        let mut moments = vec![Moment::default()];
        let mut image_at = None;
        for message in messages {
            let topic = &message.channel.topic;
            let is_later = image_at.is_some_and(|at| message.log_time > at);
            if is_later {
                moments.push(Moment::default());
                image_at = None;
            }
            for (index, channel) in channels.iter().enumerate() {
                if topics[channel.topic] != *topic {
                    continue;
                }
                if channel.role == TopicRole::Color {
                    image_at = Some(message.log_time);
                }
                if let Some(moment) = moments.last_mut() {
                    moment.messages.push(Recorded {
                        channel: index,
                        bytes: message.data.to_vec(),
                    });
                }
            }
        }
        let has_image = |moment: &Moment| {
            let mut messages = moment.messages.iter();
            messages.any(|m| channels[m.channel].role == TopicRole::Color)
        };
        moments.retain(has_image);
        ensure!(
            moments.len() == stamps_ns.len() && !moments.is_empty(),
            "{} moments for {} images",
            moments.len(),
            stamps_ns.len()
        );
        for (moment, stamp_ns) in moments.iter_mut().zip(stamps_ns) {
            moment.stamp_ns = stamp_ns;
        }
        let recording = Self {
            topics,
            channels,
            moments,
        };
        Ok((recording, decoders))
    }
}

/// From the recording to what arrives.
struct Shift {
    nanos: i64,
    world: RigidTransform,
    first_key: i64,
}

impl Shift {
    fn apply(&self, message: &mut Event) {
        let stamp = |stamp: Stamp| Stamp::from_nanos(stamp.as_nanos() + self.nanos);
        let later = |header: &mut Header| header.stamp = stamp(header.stamp);
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
            Event::Odometry(odometry) => {
                later(&mut odometry.header);
                odometry.parent_from_child = self.world * odometry.parent_from_child;
            }
            Event::StaticTransforms(_) | Event::Corrections(..) => {}
            Event::Mesh(header, update, _) => {
                later(header);
                let named = |key: MeshBlockKey| {
                    let [x, y, z] = key.0;
                    MeshBlockKey([x + self.first_key, y, z])
                };
                let blocks = match update {
                    MeshUpdate::Whole(mesh) => vec![(MeshBlockKey([0; 3]), mesh.clone())],
                    MeshUpdate::Blocks { blocks, .. } => std::mem::take(blocks),
                };
                let blocks = blocks.into_iter();
                *update = MeshUpdate::Blocks {
                    clear: false,
                    blocks: blocks
                        .map(|(key, block)| (named(key), block.transformed(&self.world)))
                        .collect(),
                };
            }
        }
    }
}

fn main() -> anyhow::Result<()> {
    let args = args()?;
    let (recording, decoders) = Recording::read(&args)?;
    let (captures, num_paintings) = (Arc::new(Latest::default()), Arc::new(AtomicUsize::new(0)));
    let painting = std::thread::spawn({
        let (captures, num_paintings) = (Arc::clone(&captures), Arc::clone(&num_paintings));
        let params = args.config.pipeline.clone();
        move || paint(&captures, &params, &num_paintings)
    });
    let played = Front::new(&args, &recording, decoders, &captures).play();
    captures.shut();
    let Ok(painted) = painting.join() else {
        bail!("painting panicked");
    };
    painted?;
    let mut played = played?;
    played.all_ms.sort_by(f64::total_cmp);
    played.kept_ms.sort_by(f64::total_cmp);
    played.cpu_ms.sort_by(f64::total_cmp);
    played.kept_cpu_ms.sort_by(f64::total_cmp);
    let percentiles = |sorted: &[f64]| [0.5, 0.95, 0.99, 1.0].map(|share| quantile(sorted, share));
    println!(
        "{}",
        json!({
            "frames": played.all_ms.len(),
            "kept": played.kept_ms.len(),
            "p50_p95_p99_max_ms": percentiles(&played.all_ms),
            "kept_p50_p95_p99_max_ms": percentiles(&played.kept_ms),
            "cpu_p50_p95_p99_max_ms": percentiles(&played.cpu_ms),
            "kept_cpu_p50_p95_p99_max_ms": percentiles(&played.kept_cpu_ms),
            "busy_share": (100.0 * played.busy_s / played.seconds).round() / 100.0,
            "paintings": num_paintings.load(Ordering::Relaxed),
            "threads": rayon::current_num_threads(),
        })
    );
    let p95_ms = quantile(&played.all_ms, 0.95);
    ensure!(
        p95_ms <= MAX_P95_MS,
        "95 % of the frames take up to {p95_ms} ms"
    );
    Ok(())
}

/// Paints the latest capture without a pause.
fn paint(
    captures: &Latest<Capture>,
    params: &PipelineParams,
    num_paintings: &AtomicUsize,
) -> anyhow::Result<()> {
    let mut painter = Painter::new(&params.keyframe);
    while !captures.is_shut() {
        if let Some(capture) = captures.take(Duration::from_millis(100)) {
            painter.paint(capture, params, &NoProgress)?;
            num_paintings.fetch_add(1, Ordering::Relaxed);
        }
    }
    Ok(())
}

#[derive(Default)]
struct Played {
    all_ms: Vec<f64>,
    kept_ms: Vec<f64>,
    /// Processor time by frame that came, and of those at which one was kept.
    cpu_ms: Vec<f64>,
    kept_cpu_ms: Vec<f64>,
    busy_s: f64,
    seconds: f64,
}

/// The thread that ingests.
struct Front<'a> {
    args: &'a Args,
    recording: &'a Recording,
    decoders: Vec<EventDecoder>,
    captures: &'a Latest<Capture>,
    scan: LiveScan,
    /// When frames that are not judged yet arrived.
    arrived: VecDeque<Instant>,
    num_judged: u64,
    num_kept: u64,
    counts_from: Instant,
    played: Played,
}

impl<'a> Front<'a> {
    fn new(
        args: &'a Args,
        recording: &'a Recording,
        decoders: Vec<EventDecoder>,
        captures: &'a Latest<Capture>,
    ) -> Self {
        Self {
            args,
            recording,
            decoders,
            captures,
            scan: LiveScan::new(&args.config.pipeline, &recording.topics, 0),
            arrived: VecDeque::new(),
            num_judged: 0,
            num_kept: 0,
            counts_from: Instant::now() + Duration::from_secs_f64(WARM_UP_S),
            played: Played::default(),
        }
    }

    fn play(mut self) -> anyhow::Result<Played> {
        let (moments, repeat) = (&self.recording.moments, self.args.repeat);
        let first_ns = moments[0].stamp_ns;
        let begun = Instant::now();
        self.counts_from = begun + Duration::from_secs_f64(WARM_UP_S);
        for frame in 0.. {
            let after_s = frame as f64 / self.args.hz;
            if after_s > self.args.seconds {
                break;
            }
            let due = begun + Duration::from_secs_f64(after_s);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            let (work, cpu_ms) = (Instant::now(), thread_cpu_ms()?);
            let num_kept = self.scan.keyframe_report().num_admitted;
            let (round, at) = (
                frame / (repeat * moments.len()),
                frame / repeat % moments.len(),
            );
            #[expect(clippy::cast_possible_truncation, reason = "seconds of a short run")]
            let now_ns = first_ns + (after_s * 1e9) as i64;
            let shift = Shift {
                nanos: now_ns - moments[at].stamp_ns,
                world: RigidTransform::from_parts(
                    UnitQuaternion::identity(),
                    Vector3::new(round as f64 * STEP_M, 0.0, 0.0),
                ),
                first_key: i64::try_from(round)? * KEYS,
            };
            self.arrive(
                &moments[at],
                &shift,
                Stamp::from_nanos(now_ns),
                due,
                frame % repeat == 0,
            )?;
            self.played.busy_s += work.elapsed().as_secs_f64();
            let cpu_ms = thread_cpu_ms()? - cpu_ms;
            if due < self.counts_from {
                continue;
            }
            self.played.cpu_ms.push(cpu_ms);
            if self.scan.keyframe_report().num_admitted > num_kept {
                self.played.kept_cpu_ms.push(cpu_ms);
            }
        }
        self.played.seconds = begun.elapsed().as_secs_f64();
        self.scan.flush();
        self.judge()?;
        ensure!(
            self.arrived.is_empty(),
            "{} frames are lost",
            self.arrived.len()
        );
        Ok(self.played)
    }

    fn arrive(
        &mut self,
        moment: &Moment,
        shift: &Shift,
        received: Stamp,
        due: Instant,
        is_first: bool,
    ) -> anyhow::Result<()> {
        let mut events = Vec::new();
        for message in &moment.messages {
            let channel = &self.recording.channels[message.channel];
            if channel.role == TopicRole::Mesh && !is_first {
                continue;
            }
            if channel.role == TopicRole::Color {
                self.arrived.push_back(due);
            }
            self.decoders[message.channel].decode(received, &message.bytes, &mut events);
            for event in events.drain(..) {
                let mut event = event;
                if let Ok(event) = &mut event {
                    shift.apply(event);
                }
                let event = TimedEvent {
                    received,
                    topic: channel.topic,
                    event,
                };
                if self.scan.push(event) {
                    let capture = self.scan.capture();
                    if capture.is_paintable() {
                        self.captures.put(capture);
                    }
                }
                self.judge()?;
            }
        }
        Ok(())
    }

    /// Notes the time of frames that were judged by now.
    fn judge(&mut self) -> anyhow::Result<()> {
        let report = self.scan.ingest_report();
        let color = self.recording.channels.iter();
        let color = color.filter(|channel| channel.role == TopicRole::Color);
        let refused = color.map(|channel| {
            let report = report.topics.get(&self.recording.topics[channel.topic]);
            report.map_or(0, |report| report.num_refused())
        });
        let num_judged = report.num_frames + refused.sum::<u64>();
        let num_kept = self.scan.keyframe_report().num_admitted;
        // Of several at once it is not known which.
        let is_kept = num_kept > self.num_kept && num_judged == self.num_judged + 1;
        self.num_kept = num_kept;
        for _ in self.num_judged..num_judged {
            let due = self.arrived.pop_front().context("a frame came twice")?;
            if due < self.counts_from {
                continue;
            }
            let ms = 1e3 * due.elapsed().as_secs_f64();
            self.played.all_ms.push(ms);
            if is_kept {
                self.played.kept_ms.push(ms);
            }
        }
        self.num_judged = num_judged;
        Ok(())
    }
}

/// Processor time of this thread, milliseconds.
fn thread_cpu_ms() -> anyhow::Result<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let nanos = text.split_whitespace().next().context("no schedstat")?;
    Ok(nanos.parse::<f64>()? * 1e-6)
}

/// Of ascending numbers, to tenths.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a place among the numbers"
    )]
    let at = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(at).map_or(0.0, |ms| (10.0 * ms).round() / 10.0)
}
