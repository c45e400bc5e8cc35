//! `~/status`: the numbers of a running node, once a second.

use crate::geom::Stamp;
use crate::mesh::TriMesh;
use crate::wire::status::{OutputStatus, QueueStatus, StageStatus, TopicStatus};
use crate::wire::{Message, Status, WireHeader};

use super::diagnostics::{InputObservation, Observation};
use super::engine::Painting;

/// The status, serialised.
pub(super) fn message(now: Stamp, seen: &Observation<'_>, last: Option<&Painting>) -> Vec<u8> {
    let capture = seen.capture;
    let ingest = capture.map(|capture| &capture.ingest);
    let world = ingest.and_then(|ingest| ingest.world_frame.as_deref());
    let mesh = capture.and_then(|capture| capture.mesh.as_deref());
    let published = seen.outputs.iter().filter_map(|output| output.revision);
    let num_of = |count: fn(&TriMesh) -> usize| mesh.map_or(0, |mesh| small(count(mesh)));
    Status {
        header: WireHeader {
            stamp: now,
            frame_id: world.unwrap_or_default(),
        },
        state: seen.state.label(),
        is_paused: seen.is_paused,
        session: last.map_or(0, |painting| painting.session),
        revision: published.max().unwrap_or(0),
        inputs: seen.inputs.iter().map(|i| input(i, seen)).collect(),
        outputs: outputs(seen),
        queues: queues(seen),
        stages: stages(seen),
        sync_error_s: ingest.map_or(0.0, |ingest| single(ingest.sync.mean_interval_s)),
        num_keyframes: capture.map_or(0, |capture| small(capture.keyframes.len())),
        keyframe_bytes: capture.map_or(0, |capture| capture.store.num_bytes as u64),
        num_vertices: num_of(TriMesh::num_vertices),
        num_triangles: num_of(TriMesh::num_triangles),
        num_charts: small(seen.paint.num_charts),
        num_pages: small(seen.paint.num_pages),
        coverage: seen.paint.coverage,
        latency_s: latency_s(now, last),
        memory_bytes: seen.memory_bytes,
    }
    .encode()
}

/// How old what was painted last is, from the newest frame in it; negative where nothing was.
fn latency_s(now: Stamp, last: Option<&Painting>) -> f32 {
    let newest = last.and_then(|painting| painting.painted.capture.keyframes.last());
    newest.map_or(-1.0, |keyframe| single(now.seconds_since(keyframe.stamp)))
}

fn input<'a>(observed: &InputObservation<'a>, seen: &Observation<'a>) -> TopicStatus<'a> {
    let input = observed.input;
    let counts = &observed.counts;
    let report = seen
        .capture
        .and_then(|capture| capture.ingest.topics.get(&input.topic));
    TopicStatus {
        role: input.roles.first().map_or("", |role| role.name()),
        topic: &input.topic,
        type_name: input.types.first().map_or("", |t| t.name()),
        num_received: counts.num_received,
        num_used: report.map_or(0, |report| report.num_used),
        num_refused: report.map_or(0, |report| report.num_refused())
            + counts.num_unreadable
            + counts.num_too_long,
        num_dropped: counts.num_dropped_full + counts.num_dropped_closed + counts.num_lost,
        rate_hz: single(observed.rate_hz),
        age_s: observed.age.map_or(-1.0, |age| age.as_secs_f32()),
    }
}

fn outputs<'a>(seen: &Observation<'a>) -> Vec<OutputStatus<'a>> {
    seen.outputs
        .iter()
        .map(|output| OutputStatus {
            topic: &output.topic,
            num_subscribers: small(output.num_readers),
            num_messages: output.num_messages,
            num_bytes: output.num_bytes,
            num_superseded: output.num_superseded,
        })
        .collect()
}

fn queues<'a>(seen: &Observation<'a>) -> Vec<QueueStatus<'a>> {
    let inputs = seen.inputs.iter().map(|observed| QueueStatus {
        name: &observed.input.topic,
        length: small(observed.counts.num_waiting),
        capacity: small(observed.input.queue_size),
        num_dropped: observed.counts.num_dropped_full,
    });
    let captures = QueueStatus {
        name: "captures to be painted",
        length: u32::from(seen.paint.is_painting),
        capacity: 1,
        num_dropped: seen.num_captures_replaced,
    };
    let journal = seen.journal.map(|journal| QueueStatus {
        name: "keyframes to be journalled",
        length: small(journal.num_pending()),
        capacity: small(journal.num_keyframes),
        num_dropped: 0,
    });
    let paint = seen.paint;
    let num_keyframes = seen.capture.map_or(0, |capture| capture.keyframes.len());
    let refined = [
        (
            "charts to be refined",
            paint.num_charts_waiting,
            paint.num_charts,
        ),
        (
            "keyframes to be aligned",
            paint.num_poses_waiting,
            num_keyframes,
        ),
    ];
    let refined = refined.map(|(name, length, capacity)| QueueStatus {
        name,
        length: small(length),
        capacity: small(capacity),
        num_dropped: 0,
    });
    let queues = inputs.chain([captures]).chain(refined);
    queues.chain(journal).collect()
}

fn stages<'a>(seen: &Observation<'a>) -> Vec<StageStatus<'a>> {
    seen.paint
        .stages
        .iter()
        .map(|(name, stage)| StageStatus {
            name,
            num_runs: stage.num_runs,
            last_s: single(stage.last_s),
            mean_s: single(stage.sum_s / stage.num_runs.max(1) as f64),
        })
        .collect()
}

fn small(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "single precision is what the message has"
)]
fn single(number: f64) -> f32 {
    number as f32
}
