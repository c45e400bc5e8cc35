//! What is wrong, where, and what to do about it: `/diagnostics`, once a second.
//!
//! Pure: [`findings`] judges an [`Observation`]; collecting and publishing it is the node's. Each
//! finding is about one part of the node; its message names the topic, transform or policy at
//! fault and the remedy, and its values are the numbers behind it.

use std::time::Duration;

use crate::config::Transport;
use crate::geom::Stamp;
use crate::ingest::{IngestReport, PoseSource};
use crate::pipeline::Capture;
use crate::wire::diagnostic_array::{self, DiagnosticStatus};
use crate::wire::{DiagnosticArray, Message, TopicRole, WireHeader};

use super::engine::PaintStatus;
use super::inbox::TopicCounts;
use super::inputs::Input;
use super::journal::{self, JournalStatus};
use super::lifecycle::State;
use super::output::OutputCounts;

/// An input without a message for this long is silent.
const SILENT: Duration = Duration::from_secs(3);
/// A reader that does not acknowledge for this long is told of.
const LAGGING: Duration = Duration::from_secs(2);
/// Longest message, so that one finding fits into any log.
const MAX_MESSAGE_BYTES: usize = 2000;

/// How bad it is, as `diagnostic_msgs/DiagnosticStatus` has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Level {
    /// It works.
    Ok,
    /// It works, but not as it should.
    Warn,
    /// It does not work.
    Error,
}

impl Level {
    fn byte(self) -> u8 {
        match self {
            Self::Ok => diagnostic_array::OK,
            Self::Warn => diagnostic_array::WARN,
            Self::Error => diagnostic_array::ERROR,
        }
    }
}

/// One part of the node and how it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Finding {
    pub(super) level: Level,
    /// Which part.
    pub(super) part: &'static str,
    /// What is wrong and the remedy, or that nothing is.
    pub(super) message: String,
    /// The numbers behind it.
    pub(super) values: Vec<(String, String)>,
}

/// One input over the last period.
#[derive(Clone, Debug)]
pub(super) struct InputObservation<'a> {
    pub(super) input: &'a Input,
    /// Whether it is subscribed to.
    /// Publishers of a type that can be read.
    pub(super) num_publishers: usize,
    /// For how long there has been one of any type.
    pub(super) published_for: Option<Duration>,
    pub(super) counts: TopicCounts,
    /// Messages a second over the last period.
    pub(super) rate_hz: f64,
    /// Since the last message.
    pub(super) age: Option<Duration>,
    /// Messages dropped or lost in the last period.
    pub(super) num_new_drops: u64,
}

/// What is looked at.
pub(super) struct Observation<'a> {
    pub(super) state: State,
    pub(super) is_paused: bool,
    /// `None` where time is simulated and `/clock` was never heard.
    pub(super) now: Option<Stamp>,
    pub(super) inputs: Vec<InputObservation<'a>>,
    pub(super) complaints: &'a [String],
    pub(super) capture: Option<&'a Capture>,
    pub(super) paint: &'a PaintStatus,
    /// Why each change paints the whole, where that was not asked for.
    pub(super) why_whole: Option<&'a str>,
    pub(super) num_captures_replaced: u64,
    pub(super) outputs: &'a [OutputCounts],
    /// Messages that each output keeps.
    pub(super) publish_depth: usize,
    pub(super) pose_source: PoseSource,
    pub(super) transports: [Transport; 2],
    pub(super) memory_bytes: u64,
    pub(super) socket_remedy: Option<&'a str>,
    /// What the environment asks for and cannot be had, in words.
    pub(super) notes: &'a [String],
    /// Bytes that wait to be decoded.
    pub(super) queue_bytes: usize,
    /// `None` where no journal is kept.
    pub(super) journal: Option<&'a JournalStatus>,
}

/// Judges every part.
pub(super) fn findings(seen: &Observation<'_>) -> Vec<Finding> {
    let mut findings = vec![inputs(seen), network(seen)];
    if let Some(capture) = seen.capture {
        findings.push(synchronisation(&capture.ingest));
        findings.push(transforms(&capture.ingest));
        findings.push(keyframes(capture));
    }
    findings.push(painting(seen));
    findings.extend(seen.journal.map(journal::finding));
    findings.push(outputs(seen));
    findings.push(process(seen));
    findings
}

fn finding(
    part: &'static str,
    problems: Vec<(Level, String)>,
    fine: String,
    values: Vec<(String, String)>,
) -> Finding {
    let level = problems.iter().map(|(level, _)| *level).max();
    let mut message = problems
        .into_iter()
        .map(|(_, words)| words)
        .collect::<Vec<_>>()
        .join("; ");
    if message.is_empty() {
        message = fine;
    }
    if message.len() > MAX_MESSAGE_BYTES {
        let end = (0..=MAX_MESSAGE_BYTES).rfind(|&i| message.is_char_boundary(i));
        message.truncate(end.unwrap_or(0));
    }
    Finding {
        level: level.unwrap_or(Level::Ok),
        part,
        message,
        values,
    }
}

fn value(key: impl Into<String>, number: impl std::fmt::Display) -> (String, String) {
    (key.into(), number.to_string())
}

/// Whether the scan cannot be painted without it.
fn is_needed(role: TopicRole, pose_source: PoseSource) -> bool {
    match role {
        TopicRole::Color | TopicRole::ColorInfo | TopicRole::Mesh => true,
        TopicRole::Pose => pose_source == PoseSource::Pose,
        TopicRole::Odometry => pose_source == PoseSource::Odom,
        TopicRole::Transforms => pose_source == PoseSource::Tf,
        TopicRole::Depth
        | TopicRole::DepthInfo
        | TopicRole::StaticTransforms
        | TopicRole::Corrections => false,
    }
}

fn inputs(seen: &Observation<'_>) -> Finding {
    let mut problems = Vec::new();
    let mut values = Vec::new();
    if seen.state != State::Active {
        let words = format!(
            "the node is {}: activate it (~/change_state), or set autostart",
            seen.state.label()
        );
        problems.push((Level::Warn, words));
    } else if seen.is_paused {
        problems.push((Level::Warn, "paused: call ~/resume to go on".to_owned()));
    }
    if seen.now.is_none() {
        let words = "use_sim_time is set, but nobody publishes /clock: start the simulation, play the bag with --clock, or set use_sim_time to false";
        problems.push((Level::Error, words.to_owned()));
    }
    let mut num_groups = seen
        .inputs
        .iter()
        .map(|i| i.input.group)
        .collect::<Vec<_>>();
    num_groups.dedup();
    for group in num_groups {
        let members: Vec<_> = seen
            .inputs
            .iter()
            .filter(|i| i.input.group == group)
            .collect();
        problems.extend(input_problem(&members, seen.pose_source));
    }
    if seen.pose_source == PoseSource::Auto && !has_pose(seen) {
        let names: Vec<_> = pose_topics(seen).collect();
        let words = format!(
            "no camera pose on any of {}: publish one of them, or remap",
            names.join(", ")
        );
        problems.push((Level::Error, words));
    }
    for input in &seen.inputs {
        let counts = &input.counts;
        if counts.num_received + counts.num_lost + counts.num_unreadable == 0 {
            continue;
        }
        let topic = &input.input.topic;
        values.push(value(
            format!("{topic} rate_hz"),
            format!("{:.1}", input.rate_hz),
        ));
        values.push(value(format!("{topic} received"), counts.num_received));
        values.push(value(format!("{topic} taken"), counts.num_taken));
        values.push(value(format!("{topic} lost"), counts.num_lost));
        let num_dropped = counts.num_dropped_full + counts.num_dropped_closed;
        values.push(value(format!("{topic} dropped"), num_dropped));
        if counts.num_too_long > 0 {
            values.push(value(format!("{topic} too long"), counts.num_too_long));
            let words = format!(
                "{topic}: {} messages were refused as too long; raise limits.message_bytes, or publish in smaller parts",
                counts.num_too_long
            );
            problems.push((Level::Warn, words));
        }
        if input.num_new_drops > 0 {
            problems.push((Level::Warn, drop_words(input, seen.socket_remedy)));
        }
    }
    finding(
        "inputs",
        problems,
        "all that is needed arrives".to_owned(),
        values,
    )
}

fn pose_topics<'a>(seen: &'a Observation<'_>) -> impl Iterator<Item = &'a str> {
    let gives_pose = |role: &TopicRole| {
        matches!(
            role,
            TopicRole::Transforms | TopicRole::Pose | TopicRole::Odometry
        )
    };
    seen.inputs
        .iter()
        .filter(move |i| i.input.roles.iter().any(gives_pose))
        .map(|i| i.input.topic.as_str())
}

fn has_pose(seen: &Observation<'_>) -> bool {
    let names: Vec<_> = pose_topics(seen).collect();
    let mut inputs = seen.inputs.iter();
    inputs.any(|i| names.contains(&i.input.topic.as_str()) && i.counts.num_received > 0)
}

/// What is wrong with an input that can come in several ways.
fn input_problem(
    members: &[&InputObservation<'_>],
    pose_source: PoseSource,
) -> Option<(Level, String)> {
    let role = members.first()?.input.roles.iter().copied().min()?;
    let all_roles = members.iter().flat_map(|m| &m.input.roles);
    let needed = all_roles.clone().any(|role| is_needed(*role, pose_source));
    let topics: Vec<_> = members.iter().map(|m| m.input.topic.as_str()).collect();
    let topics = topics.join(" or ");
    let is_heard = members.iter().any(|m| m.counts.num_received > 0);
    let num_publishers: usize = members.iter().map(|m| m.num_publishers).sum();
    let what = role.name();
    if !is_heard && num_publishers == 0 {
        let words = format!("no {what}: nobody publishes {topics}; start the publisher or remap");
        return needed.then_some((Level::Error, words));
    }
    let published_for = members.iter().filter_map(|m| m.published_for).max();
    if !is_heard && published_for.is_none_or(|time| time < SILENT) {
        return None;
    }
    if !is_heard {
        let words = format!(
            "{what}: {topics} has a publisher but nothing arrives; see 'network', and check that the publisher runs"
        );
        return Some((if needed { Level::Error } else { Level::Warn }, words));
    }
    let newest = members.iter().filter_map(|m| m.age).min()?;
    // A mesh or a static transform may rightly come once.
    let is_steady = !matches!(
        role,
        TopicRole::Mesh | TopicRole::StaticTransforms | TopicRole::Corrections
    );
    (is_steady && newest > SILENT).then(|| {
        let words = format!(
            "{what}: {topics} is silent for {:.0} s",
            newest.as_secs_f64()
        );
        (Level::Warn, words)
    })
}

fn drop_words(input: &InputObservation<'_>, socket_remedy: Option<&str>) -> String {
    let (topic, counts) = (&input.input.topic, &input.counts);
    let num = input.num_new_drops;
    if counts.num_lost > 0 {
        let remedy = socket_remedy
            .unwrap_or("use compressed images, or set its qos_overrides reliability to reliable");
        format!("{topic}: {num} messages lost or dropped in the last second; {remedy}")
    } else {
        format!(
            "{topic}: {num} messages dropped in the last second, ingest is too slow; lower the rate or raise topic_queue_size"
        )
    }
}

fn network(seen: &Observation<'_>) -> Finding {
    let mut problems: Vec<_> = seen
        .complaints
        .iter()
        .map(|words| (Level::Error, words.clone()))
        .collect();
    problems.extend(seen.notes.iter().map(|note| (Level::Warn, note.clone())));
    if let Some(remedy) = seen.socket_remedy {
        problems.push((Level::Warn, remedy.to_owned()));
    }
    let values = seen
        .inputs
        .iter()
        .map(|i| value(format!("{} publishers", i.input.topic), i.num_publishers))
        .collect();
    finding(
        "network",
        problems,
        "types and qualities of service fit".to_owned(),
        values,
    )
}

fn synchronisation(ingest: &IngestReport) -> Finding {
    let sync = &ingest.sync;
    let mut problems = Vec::new();
    for (topic, report) in &ingest.topics {
        for (reason, count) in &report.refused_by_reason {
            let example = count.examples.last().map_or("", String::as_str);
            problems.push((
                Level::Warn,
                format!("{topic}: {} refused: {reason} (last: {example})", count.num),
            ));
        }
    }
    if sync.num_clock_set_back > 0 {
        let words = format!("a clock was set back {} times", sync.num_clock_set_back);
        problems.push((Level::Warn, words));
    }
    let values = vec![
        value("pairs", sync.num_pairs),
        value("frames without depth", sync.num_without_depth),
        value("mean interval_s", format!("{:.4}", sync.mean_interval_s)),
        value("max interval_s", format!("{:.4}", sync.max_interval_s)),
        value("frames", ingest.num_frames),
    ];
    finding(
        "synchronisation",
        problems,
        "every message was of use".to_owned(),
        values,
    )
}

fn transforms(ingest: &IngestReport) -> Finding {
    let report = &ingest.transforms;
    let problems = report
        .refused_by_reason
        .iter()
        .map(|(reason, count)| {
            let example = count.examples.last().map_or("", String::as_str);
            let words = format!("{} transforms refused: {reason} ({example})", count.num);
            (Level::Warn, words)
        })
        .collect();
    let values = vec![
        value("transforms", report.num_received),
        value("extrapolated poses", ingest.num_poses_extrapolated),
        value("world frame", ingest.world_frame.as_deref().unwrap_or("")),
        value("pose source", ingest.pose_source.unwrap_or("")),
    ];
    finding(
        "transforms",
        problems,
        "every transform was of use".to_owned(),
        values,
    )
}

fn keyframes(capture: &Capture) -> Finding {
    let store = &capture.store;
    let mut problems = Vec::new();
    let has_frames = capture.ingest.num_frames > 0;
    if has_frames && capture.keyframes.is_empty() {
        let reasons: Vec<_> = store
            .rejected_by_reason
            .iter()
            .map(|(reason, num)| format!("{num} {reason}"))
            .collect();
        problems.push((
            Level::Warn,
            format!(
                "no frame was kept ({}): see the parameters keyframe.* and region.*",
                reasons.join(", ")
            ),
        ));
    }
    let mut values = vec![
        value("keyframes", capture.keyframes.len()),
        value("bytes", store.num_bytes),
        value("offered", store.num_offered),
        value("replaced", store.num_replaced),
        value("evicted", store.num_evicted),
        value("poses corrected", store.num_poses_corrected),
        value(
            "corrections without a keyframe",
            store.num_corrections_unmatched,
        ),
        value("pending", capture.num_pending),
        value("revision", capture.revision),
    ];
    for (reason, num) in &store.rejected_by_reason {
        values.push(value(format!("rejected: {reason}"), num));
    }
    let fine = format!("{} frames kept", capture.keyframes.len());
    finding("keyframes", problems, fine, values)
}

fn painting(seen: &Observation<'_>) -> Finding {
    let paint = seen.paint;
    let mut problems = Vec::new();
    if let Some(error) = &paint.last_error {
        problems.push((Level::Error, format!("the scan is not painted: {error}")));
    }
    let mut values = vec![
        value("paintings", paint.num_painted),
        value("failed", paint.num_failed),
        value("captures coalesced", seen.num_captures_replaced),
        value("charts", paint.num_charts),
        value("pages", paint.num_pages),
        value("coverage", format!("{:.3}", paint.coverage)),
        value("revision painted", paint.revision),
        value("is painting", paint.is_painting),
        value("idle steps", paint.num_idle_steps),
        value("charts to refine", paint.num_charts_waiting),
        value("keyframes to align", paint.num_poses_waiting),
        value("keyframes to paint", paint.num_frames_waiting),
    ];
    for (name, stage) in &paint.stages {
        values.push(value(
            format!("{name} last_s"),
            format!("{:.3}", stage.last_s),
        ));
    }
    let mut fine = match paint.num_painted {
        0 => "nothing was painted yet".to_owned(),
        num => format!("painted {num} times"),
    };
    if let Some(reason) = seen.why_whole {
        fine += &format!("; each change paints the whole: {reason}");
    }
    finding("painting", problems, fine, values)
}

fn outputs(seen: &Observation<'_>) -> Finding {
    let mut problems = Vec::new();
    let mut values = Vec::new();
    for output in seen.outputs {
        if output.num_readers > 0 || output.num_messages > 0 {
            let topic = &output.topic;
            values.push(value(format!("{topic} readers"), output.num_readers));
            values.push(value(format!("{topic} messages"), output.num_messages));
            values.push(value(format!("{topic} bytes"), output.num_bytes));
            values.push(value(format!("{topic} pending"), output.num_pending));
            values.push(value(format!("{topic} superseded"), output.num_superseded));
        }
        if let Some(since) = output.lagging_since
            && since.elapsed() > LAGGING
        {
            let words = format!(
                "{}: a reader has not acknowledged for {:.0} s, newer states wait for it; stop that subscriber or raise publish.depth",
                output.topic,
                since.elapsed().as_secs_f64()
            );
            problems.push((Level::Warn, words));
        }
        if output.num_whole > seen.publish_depth && output.num_readers > 0 {
            let words = format!(
                "{}: a whole scan is {} messages, publish.depth keeps {}, so that who comes late and asks for what was before gets it only with the next state; raise publish.depth",
                output.topic, output.num_whole, seen.publish_depth
            );
            problems.push((Level::Warn, words));
        }
        if output.num_failed > 0 {
            let words = format!("{}: {} messages failed", output.topic, output.num_failed);
            problems.push((Level::Error, words));
        }
    }
    let num_readers: usize = seen.outputs.iter().map(|output| output.num_readers).sum();
    finding(
        "outputs",
        problems,
        format!("{num_readers} readers"),
        values,
    )
}

fn process(seen: &Observation<'_>) -> Finding {
    let plan = &seen.paint.memory;
    let mut problems = Vec::new();
    // What holds the parts does not see the rounding of the system's allocator.
    if plan.budget > 0 && seen.memory_bytes > plan.budget / 10 * 11 {
        let words = format!(
            "{:.0} MB are more than memory.budget_mb ({:.0}): raise it, or lower keyframe.budget_mb or texinit.max_texels",
            seen.memory_bytes as f64 / 1e6,
            plan.budget as f64 / 1e6
        );
        problems.push((Level::Warn, words));
    }
    let values = vec![
        value("memory budget", plan.budget),
        value("memory for images", plan.keyframes),
        value("memory for images with gain", plan.corrected),
        value("memory for the optimisation", plan.smoothing),
        value("memory for kept depths", plan.kept_views),
        value("memory for decoded images", plan.decode_cache),
        value("memory for the atlas", plan.atlas),
        value("memory for mesh and scores", plan.tables),
        value("state", seen.state.label()),
        value("paused", seen.is_paused),
        value("memory_bytes", seen.memory_bytes),
        value("queue_bytes", seen.queue_bytes),
        value("decoded_image_bytes", seen.paint.num_cached_bytes),
        value("image transport", format!("{:?}", seen.transports[0])),
        value("depth transport", format!("{:?}", seen.transports[1])),
    ];
    let megabytes = seen.memory_bytes as f64 / 1e6;
    finding(
        "process",
        problems,
        format!("{megabytes:.0} MB resident"),
        values,
    )
}

/// The findings of `node`, serialised.
pub(super) fn message(stamp: Stamp, node: &str, findings: &[Finding]) -> Vec<u8> {
    let names: Vec<String> = findings
        .iter()
        .map(|finding| format!("{node}: {}", finding.part))
        .collect();
    let status = findings
        .iter()
        .zip(&names)
        .map(|(finding, name)| DiagnosticStatus {
            level: finding.level.byte(),
            name,
            message: &finding.message,
            hardware_id: "veneer",
            values: finding
                .values
                .iter()
                .map(|(key, value)| (key.as_str(), value.as_str()))
                .collect(),
        })
        .collect();
    let header = WireHeader {
        stamp,
        frame_id: "",
    };
    DiagnosticArray { header, status }.encode()
}

#[cfg(test)]
mod tests;
