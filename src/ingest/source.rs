//! Where events come from: a bag or a live subscription, one trait for both.

use crate::geom::Stamp;

use super::event::Event;

/// An event, the topic it came on and when it was received (the log time of a bag).
#[derive(Clone, Debug, PartialEq)]
pub struct TimedEvent {
    /// When it was received.
    pub received: Stamp,
    /// Index into [`EventSource::topics`].
    pub topic: usize,
    /// The event, or why its message was refused.
    pub event: Result<Event, Rejection>,
}

/// Why one message was refused; the stream goes on.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{topic} at {stamp}: {reason}")]
pub struct Rejection {
    /// The topic.
    pub topic: String,
    /// The message's own stamp where it could be read, else when it was received.
    pub stamp: Stamp,
    /// What was wrong, naming the field and the value.
    pub reason: String,
}

/// An ordered stream of events; it may be read on another thread than the one that made it.
pub trait EventSource: Send {
    /// Names of the topics that events refer to.
    fn topics(&self) -> &[String];

    /// The next event, or `None` at the end of the stream.
    fn next_event(&mut self) -> Option<TimedEvent>;

    /// What was lost at the level of the whole stream (damage, truncation), in words; complete
    /// after `next_event` returned `None`.
    fn losses(&self) -> &[String];
}
