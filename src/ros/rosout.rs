//! The node's log on `/rosout`.
//!
//! [`RosoutLayer`] is a layer of the process' log: it takes what veneer says (not its libraries)
//! and never waits; when more is said than goes out, the rest is counted. The node publishes what
//! waits.

use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use smol::channel::{Receiver, Sender};
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context as LayerContext;

use crate::wire::log::Log;

/// Messages that wait.
const QUEUE_SIZE: usize = 256;
/// Longest text, bytes.
const MAX_TEXT_BYTES: usize = 4000;

/// One thing said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    level: u8,
    text: String,
    file: &'static str,
    target: String,
    line: u32,
}

/// Takes what is said.
#[derive(Debug)]
pub struct RosoutLayer {
    sender: Sender<LogLine>,
    num_dropped: Arc<AtomicU64>,
}

/// Gives out what was said.
#[derive(Clone, Debug)]
pub struct LogLines {
    receiver: Receiver<LogLine>,
    num_dropped: Arc<AtomicU64>,
}

/// A layer, and what it takes.
pub fn layer() -> (RosoutLayer, LogLines) {
    let (sender, receiver) = smol::channel::bounded(QUEUE_SIZE);
    let num_dropped = Arc::new(AtomicU64::new(0));
    let layer = RosoutLayer {
        sender,
        num_dropped: Arc::clone(&num_dropped),
    };
    let lines = LogLines {
        receiver,
        num_dropped,
    };
    (layer, lines)
}

impl LogLines {
    /// The next line; `None` at the end.
    pub(super) async fn next(&self) -> Option<LogLine> {
        self.receiver.recv().await.ok()
    }

    /// Lines that found no room.
    pub fn num_dropped(&self) -> u64 {
        self.num_dropped.load(Ordering::Relaxed)
    }
}

impl LogLine {
    /// As the node `name` says it.
    pub(super) fn message<'a>(&'a self, stamp: crate::geom::Stamp, name: &'a str) -> Log<'a> {
        Log {
            stamp,
            level: self.level,
            name,
            text: &self.text,
            file: self.file,
            function: &self.target,
            line: self.line,
        }
    }
}

/// The numbers of `rcl_interfaces/Log`.
fn ros_level(level: Level) -> u8 {
    match level {
        Level::ERROR => 40,
        Level::WARN => 30,
        Level::INFO => 20,
        Level::DEBUG | Level::TRACE => 10,
    }
}

#[derive(Default)]
struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        let written = if field.name() == "message" {
            write!(self.0, "{value:?}")
        } else {
            write!(self.0, " {}={value:?}", field.name())
        };
        // Writing to a string does not fail.
        written.ok();
    }
}

impl<S: Subscriber> Layer<S> for RosoutLayer {
    fn on_event(&self, event: &Event<'_>, _: LayerContext<'_, S>) {
        let metadata = event.metadata();
        if !metadata.target().starts_with("veneer") {
            return;
        }
        let mut text = Text::default();
        event.record(&mut text);
        let Text(mut text) = text;
        if text.len() > MAX_TEXT_BYTES {
            let end = (0..=MAX_TEXT_BYTES).rfind(|&i| text.is_char_boundary(i));
            text.truncate(end.unwrap_or(0));
        }
        let line = LogLine {
            level: ros_level(*metadata.level()),
            text,
            file: metadata.file().unwrap_or(""),
            target: metadata.target().to_owned(),
            line: metadata.line().unwrap_or(0),
        };
        if self.sender.try_send(line).is_err() {
            self.num_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use tracing_subscriber::layer::SubscriberExt;

    use super::*;

    #[test]
    fn what_veneer_says_is_taken_and_the_rest_is_counted() {
        let (layer, lines) = layer();
        let subscriber = tracing_subscriber::registry().with(layer);
        tracing::subscriber::with_default(subscriber, || {
            tracing::warn!(topic = "/a", "late by {}", 3);
            tracing::error!(target: "rustdds", "not ours");
            for i in 0..1000 {
                tracing::info!("{i}");
            }
        });
        let first = lines.receiver.try_recv().unwrap();
        assert_eq!(first.level, 30);
        assert_eq!(first.text, "late by 3 topic=\"/a\"");
        let num_left = std::iter::from_fn(|| lines.receiver.try_recv().ok()).count();
        assert_eq!(num_left, QUEUE_SIZE - 1);
        assert_eq!(lines.num_dropped(), 1001 - QUEUE_SIZE as u64);
    }
}
