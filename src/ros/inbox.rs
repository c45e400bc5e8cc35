//! Where serialised messages wait between the task that receives and the thread that decodes.
//!
//! One queue per topic, each bounded by a count, all together by bytes. A full queue drops its
//! oldest message, so that what comes out is the newest; where all together hold too much, the one
//! that holds most drops its oldest (`drop oldest`). Messages come out in the
//! order of their arrival over all topics. Every message is counted: for each topic
//! `num_received = num_taken + num_dropped_full + num_dropped_closed + num_too_long + num_waiting`, and what the
//! sequence numbers of its writers show to be missing is `num_lost`.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::geom::Stamp;
use crate::wire::event::MessageType;

/// Counts of one topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicCounts {
    /// Messages that DDS handed over.
    pub num_received: u64,
    /// Messages that were taken to be decoded.
    pub num_taken: u64,
    /// Messages dropped because the queue was full: the oldest.
    pub num_dropped_full: u64,
    /// Messages dropped because the node was paused or not active.
    pub num_dropped_closed: u64,
    /// Messages refused because they are too long.
    pub num_too_long: u64,
    /// Messages that DDS itself could not give out.
    pub num_unreadable: u64,
    /// Messages that writers numbered and that never came: lost on the way or before they were
    /// read.
    pub num_lost: u64,
    /// Messages that wait now.
    pub num_waiting: usize,
    /// Bytes of all messages received.
    pub num_bytes: u64,
}

/// A message that waits.
#[derive(Clone, Debug, PartialEq)]
pub struct Waiting {
    /// Its topic, as [`Inbox::new`] numbers them.
    pub topic: usize,
    /// Its type.
    pub message_type: MessageType,
    /// When it was received.
    pub received: Stamp,
    /// The serialised message with its encapsulation header.
    pub bytes: Vec<u8>,
}

/// What [`Inbox::take`] found.
#[derive(Clone, Debug, PartialEq)]
pub enum Taken {
    /// The message that came first.
    Message(Waiting),
    /// Nothing came in time.
    Idle,
    /// Somebody wants the reader to look elsewhere.
    Woken,
    /// The inbox was shut; nothing more will come.
    Shut,
}

#[derive(Debug, Default)]
struct Queue {
    capacity: usize,
    num_bytes: usize,
    messages: VecDeque<(u64, Waiting)>,
    counts: TopicCounts,
    /// The highest sequence number of each writer.
    newest: BTreeMap<[u8; 16], i64>,
    last_received: Option<Instant>,
}

#[derive(Debug)]
struct State {
    queues: Vec<Queue>,
    next_number: u64,
    num_bytes: usize,
    is_open: bool,
    is_woken: bool,
    is_shut: bool,
}

/// What peers may at most make an [`Inbox`] hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InboxLimits {
    /// Bytes of all messages that wait.
    pub max_bytes: usize,
    /// Bytes of one message.
    pub max_message_bytes: usize,
    /// Writers whose numbers are remembered for a topic.
    pub max_writers: usize,
}

/// The queues of all topics.
#[derive(Debug)]
pub struct Inbox {
    limits: InboxLimits,
    state: Mutex<State>,
    changed: Condvar,
}

impl Inbox {
    /// Queues of these capacities (messages, ≥ 1) within `limits`. Nothing is let in before
    /// [`Self::set_open`].
    pub fn new(capacities: &[usize], limits: InboxLimits) -> Self {
        let queue = |&capacity: &usize| Queue {
            capacity: capacity.max(1),
            ..Queue::default()
        };
        Self {
            limits,
            state: Mutex::new(State {
                queues: capacities.iter().map(queue).collect(),
                next_number: 0,
                num_bytes: 0,
                is_open: false,
                is_woken: false,
                is_shut: false,
            }),
            changed: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Counts and queues are whole after every step, so a panic elsewhere leaves them usable.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets messages in, or drops them as they come.
    pub fn set_open(&self, is_open: bool) {
        self.lock().is_open = is_open;
    }

    /// Nothing comes any more: readers are told once what waits is taken.
    pub fn shut(&self) {
        self.lock().is_shut = true;
        self.changed.notify_all();
    }

    /// Makes the reader look elsewhere.
    pub fn wake(&self) {
        self.lock().is_woken = true;
        self.changed.notify_all();
    }

    /// Drops all that waits; it is counted as dropped.
    pub fn clear(&self) {
        let mut state = self.lock();
        for queue in &mut state.queues {
            queue.counts.num_dropped_closed += queue.messages.len() as u64;
            queue.messages.clear();
            queue.num_bytes = 0;
        }
        state.num_bytes = 0;
    }

    /// Notes a sample's number, so that gaps are seen.
    pub fn note_sequence(&self, topic: usize, writer: [u8; 16], sequence_number: i64) {
        let mut state = self.lock();
        let Some(queue) = state.queues.get_mut(topic) else {
            return;
        };
        let is_known = queue.newest.contains_key(&writer);
        if !is_known && queue.newest.len() >= self.limits.max_writers {
            return;
        }
        let newest = queue.newest.entry(writer).or_insert(sequence_number);
        let num_missing = sequence_number.saturating_sub(*newest).saturating_sub(1);
        *newest = (*newest).max(sequence_number);
        queue.counts.num_lost += u64::try_from(num_missing).unwrap_or(0);
    }

    /// DDS could not give out a sample.
    pub fn note_unreadable(&self, topic: usize) {
        if let Some(queue) = self.lock().queues.get_mut(topic) {
            queue.counts.num_unreadable += 1;
        }
    }

    /// Takes a message in; the oldest of its topic goes where there is no room.
    pub fn put(&self, message: Waiting) {
        let mut guard = self.lock();
        let state = &mut *guard;
        let is_open = state.is_open && !state.is_shut;
        let Some(queue) = state.queues.get_mut(message.topic) else {
            return;
        };
        queue.counts.num_received += 1;
        queue.counts.num_bytes += message.bytes.len() as u64;
        queue.last_received = Some(Instant::now());
        if !is_open {
            queue.counts.num_dropped_closed += 1;
            return;
        }
        if message.bytes.len() > self.limits.max_message_bytes {
            queue.counts.num_too_long += 1;
            return;
        }
        let topic = message.topic;
        let is_full = queue.messages.len() >= queue.capacity;
        state.num_bytes += message.bytes.len();
        queue.num_bytes += message.bytes.len();
        queue.messages.push_back((state.next_number, message));
        state.next_number += 1;
        if is_full {
            state.drop_oldest(topic);
        }
        while state.num_bytes > self.limits.max_bytes {
            let largest = state.queues.iter().enumerate();
            let largest = largest.max_by_key(|(_, queue)| queue.num_bytes);
            let Some((largest, _)) = largest else {
                break;
            };
            state.drop_oldest(largest);
        }
        drop(guard);
        self.changed.notify_all();
    }

    /// The message that came first, waited for until `timeout`.
    pub fn take(&self, timeout: Duration) -> Taken {
        let deadline = Instant::now() + timeout;
        let mut state = self.lock();
        loop {
            if std::mem::take(&mut state.is_woken) {
                return Taken::Woken;
            }
            if let Some(message) = state.pop_first() {
                return Taken::Message(message);
            }
            if state.is_shut {
                return Taken::Shut;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Taken::Idle;
            }
            let waited = self.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// The counts of every topic.
    pub fn counts(&self) -> Vec<TopicCounts> {
        let counts = |queue: &Queue| TopicCounts {
            num_waiting: queue.messages.len(),
            ..queue.counts.clone()
        };
        self.lock().queues.iter().map(counts).collect()
    }

    /// How long ago each topic's last message came.
    pub fn ages(&self) -> Vec<Option<Duration>> {
        let queues = &self.lock().queues;
        let age = |queue: &Queue| Some(queue.last_received?.elapsed());
        queues.iter().map(age).collect()
    }

    /// Bytes that wait.
    pub fn num_bytes(&self) -> usize {
        self.lock().num_bytes
    }
}

impl State {
    fn pop_first(&mut self) -> Option<Waiting> {
        let first = self
            .queues
            .iter()
            .enumerate()
            .filter_map(|(topic, queue)| Some((queue.messages.front()?.0, topic)))
            .min();
        let (_, topic) = first?;
        let queue = self.queues.get_mut(topic)?;
        let (_, message) = queue.messages.pop_front()?;
        queue.counts.num_taken += 1;
        queue.num_bytes -= message.bytes.len();
        self.num_bytes -= message.bytes.len();
        Some(message)
    }

    fn drop_oldest(&mut self, topic: usize) {
        let Some(queue) = self.queues.get_mut(topic) else {
            return;
        };
        if let Some((_, dropped)) = queue.messages.pop_front() {
            queue.counts.num_dropped_full += 1;
            queue.num_bytes -= dropped.bytes.len();
            self.num_bytes -= dropped.bytes.len();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inbox(capacities: &[usize], max_bytes: usize) -> Inbox {
        let limits = InboxLimits {
            max_bytes,
            max_message_bytes: 1000,
            max_writers: 2,
        };
        Inbox::new(capacities, limits)
    }

    fn message(topic: usize, nanos: i64, num_bytes: usize) -> Waiting {
        Waiting {
            topic,
            message_type: MessageType::Image,
            received: Stamp::from_nanos(nanos),
            bytes: vec![0; num_bytes],
        }
    }

    fn taken(inbox: &Inbox) -> Vec<i64> {
        let mut stamps = Vec::new();
        while let Taken::Message(message) = inbox.take(Duration::ZERO) {
            stamps.push(message.received.as_nanos());
        }
        stamps
    }

    fn adds_up(counts: &TopicCounts) -> bool {
        counts.num_received
            == counts.num_taken
                + counts.num_dropped_full
                + counts.num_dropped_closed
                + counts.num_too_long
                + counts.num_waiting as u64
    }

    #[test]
    fn messages_come_out_in_the_order_of_arrival_over_all_topics() {
        let inbox = inbox(&[4, 4], 1000);
        inbox.set_open(true);
        for (topic, nanos) in [(1, 0), (0, 1), (1, 2), (0, 3)] {
            inbox.put(message(topic, nanos, 1));
        }
        assert_eq!(taken(&inbox), [0, 1, 2, 3]);
        assert_eq!(inbox.num_bytes(), 0);
    }

    #[test]
    fn a_full_queue_drops_its_oldest_and_counts_it() {
        let inbox = inbox(&[2, 2], 1000);
        inbox.set_open(true);
        for nanos in 0..5 {
            inbox.put(message(0, nanos, 10));
        }
        inbox.put(message(1, 9, 10));
        assert_eq!(inbox.counts()[0].num_waiting, 2);
        assert_eq!(taken(&inbox), [3, 4, 9]);
        let counts = inbox.counts();
        assert_eq!((counts[0].num_received, counts[0].num_dropped_full), (5, 3));
        assert!(counts.iter().all(adds_up), "{counts:?}");
    }

    #[test]
    fn bytes_are_bounded_over_all_topics() {
        let inbox = inbox(&[100, 100], 100);
        inbox.set_open(true);
        for nanos in 0..20 {
            inbox.put(message((nanos % 2) as usize, nanos, 30));
            assert!(inbox.num_bytes() <= 100);
        }
        inbox.put(message(0, 99, 1000));
        assert!(inbox.num_bytes() <= 100);
        // What is small does not go for what is large.
        inbox.put(message(0, 100, 90));
        inbox.put(message(1, 101, 20));
        inbox.put(message(1, 102, 20));
        assert_eq!(taken(&inbox), [19, 101, 102]);
        let counts = inbox.counts();
        assert!(counts.iter().all(adds_up), "{counts:?}");
    }

    #[test]
    fn a_closed_inbox_counts_what_it_drops() {
        let inbox = inbox(&[2], 1000);
        inbox.put(message(0, 0, 1));
        inbox.set_open(true);
        inbox.put(message(0, 1, 1));
        inbox.clear();
        assert_eq!(taken(&inbox), [0; 0]);
        let counts = inbox.counts();
        assert_eq!(counts[0].num_dropped_closed, 2);
        assert!(adds_up(&counts[0]));
    }

    #[test]
    fn what_is_too_long_is_refused_and_counted() {
        let inbox = inbox(&[2], 5000);
        inbox.set_open(true);
        inbox.put(message(0, 0, 1000));
        inbox.put(message(0, 1, 1001));
        assert_eq!(taken(&inbox), [0]);
        let counts = inbox.counts();
        assert_eq!(counts[0].num_too_long, 1);
        assert!(adds_up(&counts[0]));
    }

    #[test]
    fn only_so_many_writers_are_watched() {
        let inbox = inbox(&[2], 1000);
        for (writer, number) in [(1, 1), (2, 1), (3, 1), (3, 9), (2, 3)] {
            inbox.note_sequence(0, [writer; 16], number);
        }
        assert_eq!(inbox.counts()[0].num_lost, 1);
    }

    #[test]
    fn gaps_in_a_writers_numbers_are_losses() {
        let inbox = inbox(&[2], 1000);
        let (a, b) = ([1; 16], [2; 16]);
        for (writer, number) in [(a, 7), (a, 8), (b, 1), (a, 12), (a, 11), (b, 2)] {
            inbox.note_sequence(0, writer, number);
        }
        assert_eq!(inbox.counts()[0].num_lost, 3);
    }

    #[test]
    fn readers_are_woken_and_told_of_the_end() {
        let inbox = inbox(&[2], 1000);
        inbox.set_open(true);
        assert_eq!(inbox.take(Duration::ZERO), Taken::Idle);
        inbox.wake();
        assert_eq!(inbox.take(Duration::from_secs(60)), Taken::Woken);
        inbox.put(message(0, 1, 1));
        inbox.shut();
        inbox.put(message(0, 2, 1));
        assert_eq!(taken(&inbox), [1]);
        assert_eq!(inbox.take(Duration::from_secs(60)), Taken::Shut);
    }
}
