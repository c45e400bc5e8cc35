//! What the node would publish, as a bag.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Context;

use crate::bag::{BagWriter, Compression};
use crate::config::Config;
use crate::geom::Stamp;
use crate::pipeline::Run;
use crate::publish::{Publisher, Snapshot};
use crate::wire::status::TopicStatus;
use crate::wire::{Message, Status, WireHeader};

/// Where the node's topics are.
const NAMESPACE: &str = "/veneer";
/// The one session of a recording, and its one state.
const SESSION: u64 = 1;
const REVISION: u64 = 1;
/// The world frame of a mesh that does not say its own.
const DEFAULT_FRAME: &str = "map";

/// A bag that is begun.
pub(super) struct Recording {
    bag: BagWriter<BufWriter<File>>,
}

impl Recording {
    pub(super) fn create(path: &Path) -> anyhow::Result<Self> {
        let bag = BagWriter::create(path, Compression::None)
            .with_context(|| format!("cannot record to {}", path.display()))?;
        Ok(Self { bag })
    }

    /// Writes everything that a subscriber of all topics would get; `coverage` is the share of the
    /// texture that keyframes painted. Messages follow each other by a
    /// nanosecond, so that readers keep their order.
    pub(super) fn write(mut self, run: &Run, coverage: f64, config: &Config) -> anyhow::Result<()> {
        let stamps = run.keyframes.iter().map(|keyframe| keyframe.stamp);
        let stamp = stamps.max().unwrap_or_default();
        let snapshot = Snapshot {
            stamp,
            frame_id: run.ingest.world_frame.as_deref().unwrap_or(DEFAULT_FRAME),
            session: SESSION,
            revision: REVISION,
            mesh: &run.mesh,
            layout: &run.texinit.layout,
            texture: &run.texinit.texture,
            keyframes: &run.keyframes,
            chart_keys: None,
        };
        let mut log_time_nanos = stamp.as_nanos();
        let mut next_log_time = || {
            log_time_nanos += 1;
            Stamp::from_nanos(log_time_nanos)
        };
        for message in Publisher::new(config.publish).publish(&snapshot, &|_| true)? {
            let topic = format!("{NAMESPACE}/{}", message.topic.name());
            let channel =
                self.bag
                    .add_channel(&topic, message.topic.type_name(), message.topic.schema())?;
            self.bag.write(channel, next_log_time(), &message.bytes)?;
        }
        #[expect(clippy::cast_possible_truncation, reason = "the message has a float32")]
        let coverage = coverage as f32;
        let status = Status {
            coverage,
            ..status_of(run, &snapshot)
        };
        let channel = self.bag.add_channel(
            &format!("{NAMESPACE}/status"),
            Status::TYPE_NAME,
            Status::SCHEMA,
        )?;
        self.bag.write(channel, next_log_time(), &status.encode())?;
        self.bag.finish()?;
        Ok(())
    }
}

/// The counts that a replay knows; it has no subscribers, queues or latency.
fn status_of<'a>(run: &'a Run, snapshot: &Snapshot<'a>) -> Status<'a> {
    let count = |num: usize| u32::try_from(num).unwrap_or(u32::MAX);
    let inputs = run.ingest.topics.iter().map(|(topic, report)| TopicStatus {
        topic,
        num_received: report.num_received,
        num_used: report.num_used,
        num_refused: report.num_refused(),
        age_s: -1.0,
        ..TopicStatus::default()
    });
    Status {
        header: WireHeader {
            stamp: snapshot.stamp,
            frame_id: snapshot.frame_id,
        },
        state: "finalized",
        session: snapshot.session,
        revision: snapshot.revision,
        inputs: inputs.collect(),
        num_keyframes: count(run.keyframes.len()),
        keyframe_bytes: keyframe_bytes(run),
        num_vertices: count(run.mesh.num_vertices()),
        num_triangles: count(run.mesh.num_triangles()),
        num_charts: count(run.texinit.layout.charts.len()),
        num_pages: run.texinit.layout.num_pages,
        latency_s: -1.0,
        ..Status::default()
    }
}

fn keyframe_bytes(run: &Run) -> u64 {
    let images = run.keyframes.iter().map(|keyframe| {
        let depth = keyframe.depth.as_ref().map_or(0, |d| d.image.bytes().len());
        (keyframe.color.bytes().len() + depth) as u64
    });
    images.sum()
}
