//! Reading a bag: memory-mapped, in the order of log times, only the topics that play a part.
//!
//! Segments are opened when the time comes to their first message and closed after their last,
//! so memory holds the chunks that overlap in time; what lies uncompressed is read in place.
//! Messages of equal time come in the order of their channels' numbers, then of the file.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, VecDeque};
use std::path::Path;

use memmap2::Mmap;

use crate::geom::Stamp;
use crate::ingest::{Event, EventSource, Rejection, TimedEvent};
use crate::wire::EventDecoder;

use super::chunk;
use super::error::BagError;
use super::mapped::MappedBag;
use super::record::{MessageHeader, op};
use super::roles::{TopicPlan, TopicRoles};

/// Decodes the messages of a channel for one part.
struct Route {
    topic: usize,
    decoder: EventDecoder,
}

/// Where the records of an open segment are.
enum Records {
    InFile(Mmap),
    Unpacked(Vec<u8>),
}

/// A segment whose messages are being read.
struct OpenSegment {
    records: Records,
    num_left: usize,
}

/// A message that waits for its time: log time, channel, segment, place of its data.
type Waiting = Reverse<(u64, u16, usize, usize, usize)>;

/// A bag as a source of events.
pub struct BagReader {
    bag: MappedBag,
    plan: TopicPlan,
    topics: Vec<String>,
    routes: BTreeMap<u16, Vec<Route>>,
    /// Segments with messages of our topics, by time.
    order: Vec<usize>,
    next_in_order: usize,
    open: BTreeMap<usize, OpenSegment>,
    spare: Vec<Vec<u8>>,
    waiting: BinaryHeap<Waiting>,
    ready: VecDeque<TimedEvent>,
    scratch: Vec<Result<Event, Rejection>>,
    start: u64,
    losses: Vec<String>,
    damaged: BTreeSet<usize>,
}

impl BagReader {
    /// Opens a bag (a file, or a rosbag2 folder with one) and settles which topic plays which
    /// part. Parts that nobody plays are in [`Self::plan`].
    ///
    /// # Errors
    /// [`BagError`] when the file cannot be read or is no bag, or a topic named in `roles` is not
    /// there.
    pub fn open(path: &Path, roles: &TopicRoles) -> Result<Self, BagError> {
        let bag = MappedBag::open(path)?;
        let plan = bag.plan(roles)?;
        let mut topics = Vec::new();
        let mut routes: BTreeMap<u16, Vec<Route>> = BTreeMap::new();
        for assignment in &plan.assignments {
            let known = topics.iter().position(|t| *t == assignment.topic);
            let topic = known.unwrap_or_else(|| {
                topics.push(assignment.topic.clone());
                topics.len() - 1
            });
            for id in bag.channels_of(&assignment.topic) {
                let decoder =
                    EventDecoder::new(&assignment.topic, assignment.message_type, assignment.role);
                if let Some(decoder) = decoder {
                    let decoder = decoder
                        .with_rectification(assignment.rectification)
                        .with_mesh_frame(roles.mesh_frame.as_deref());
                    routes.entry(id).or_default().push(Route { topic, decoder });
                }
            }
        }
        let segments = &bag.index.segments;
        let is_ours = |i: &usize| {
            let channels = segments[*i].channels.as_ref();
            channels.is_none_or(|c| c.iter().any(|id| routes.contains_key(id)))
        };
        let mut order: Vec<usize> = (0..segments.len()).filter(is_ours).collect();
        order.sort_by_key(|&i| (segments[i].start_time, i));
        let losses = bag.index.losses.clone();
        Ok(Self {
            bag,
            plan,
            topics,
            routes,
            order,
            next_in_order: 0,
            open: BTreeMap::new(),
            spare: Vec::new(),
            waiting: BinaryHeap::new(),
            ready: VecDeque::new(),
            scratch: Vec::new(),
            start: 0,
            losses,
            damaged: BTreeSet::new(),
        })
    }

    /// The parts and who plays them, and what is missing.
    pub fn plan(&self) -> &TopicPlan {
        &self.plan
    }

    /// Bytes of the bag's file.
    pub fn num_bytes(&self) -> usize {
        self.bag.num_bytes
    }

    /// Continues with the first message logged at `stamp` or later, forwards or backwards. Static
    /// transforms logged earlier are not repeated.
    pub fn seek(&mut self, stamp: Stamp) {
        self.start = u64::try_from(stamp.as_nanos()).unwrap_or(0);
        self.next_in_order = 0;
        self.open.clear();
        self.waiting.clear();
        self.ready.clear();
    }

    /// Opens every segment that may hold a message before the first that waits.
    fn open_due_segments(&mut self) {
        while let Some(&segment) = self.order.get(self.next_in_order) {
            let starts = self.bag.index.segments[segment].start_time;
            if let Some(Reverse((time, ..))) = self.waiting.peek()
                && starts > *time
            {
                return;
            }
            self.next_in_order += 1;
            if self.bag.index.segments[segment].end_time >= self.start {
                self.open_segment(segment);
            }
        }
    }

    fn open_segment(&mut self, segment: usize) {
        let mut workspace = self.spare.pop().unwrap_or_default();
        let place = &self.bag.index.segments[segment].place;
        let stretch = match self.bag.map(place) {
            Ok(stretch) => stretch,
            Err(error) => {
                self.tell_loss(segment, format!("byte {}: {error}", place.range().start));
                return;
            }
        };
        let data = chunk::unpack(&stretch, place, &mut workspace);
        let mut num_left = 0;
        for record in data.records().filter(|r| r.opcode == op::MESSAGE) {
            let Some(message) = MessageHeader::parse(&data.bytes[record.body.clone()]) else {
                continue;
            };
            if message.log_time >= self.start && self.routes.contains_key(&message.channel_id) {
                let begin = data.offset + record.body.start + MessageHeader::NUM_BYTES;
                self.waiting.push(Reverse((
                    message.log_time,
                    message.channel_id,
                    segment,
                    begin,
                    data.offset + record.body.end,
                )));
                num_left += 1;
            }
        }
        let (in_workspace, loss) = (data.in_workspace, data.loss);
        if let Some(loss) = loss {
            self.tell_loss(segment, loss);
        }
        if num_left == 0 || !in_workspace {
            self.spare.push(std::mem::take(&mut workspace));
        }
        if num_left > 0 {
            let records = match in_workspace {
                true => Records::Unpacked(workspace),
                false => Records::InFile(stretch),
            };
            self.open.insert(segment, OpenSegment { records, num_left });
        }
    }

    /// Each damaged segment is told of once, however often it is read.
    fn tell_loss(&mut self, segment: usize, loss: String) {
        if self.damaged.insert(segment) {
            self.losses.push(loss);
        }
    }

    /// Decodes the next message for each part its topic plays; `false` at the end.
    fn advance(&mut self) -> bool {
        self.open_due_segments();
        let Some(Reverse((log_time, channel_id, segment, begin, end))) = self.waiting.pop() else {
            return false;
        };
        let received = Stamp::from_nanos(i64::try_from(log_time).unwrap_or(i64::MAX));
        let Some(open) = self.open.get_mut(&segment) else {
            return true;
        };
        let records: &[u8] = match &open.records {
            Records::InFile(stretch) => stretch,
            Records::Unpacked(bytes) => bytes,
        };
        let data = &records[begin..end];
        for route in self.routes.get_mut(&channel_id).into_iter().flatten() {
            route.decoder.decode(received, data, &mut self.scratch);
            self.ready
                .extend(self.scratch.drain(..).map(|event| TimedEvent {
                    received,
                    topic: route.topic,
                    event,
                }));
        }
        open.num_left -= 1;
        if open.num_left == 0 {
            let closed = self.open.remove(&segment).map(|open| open.records);
            if let Some(Records::Unpacked(bytes)) = closed {
                self.spare.push(bytes);
            }
        }
        true
    }
}

impl EventSource for BagReader {
    fn topics(&self) -> &[String] {
        &self.topics
    }

    fn next_event(&mut self) -> Option<TimedEvent> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Some(event);
            }
            if !self.advance() {
                return None;
            }
        }
    }

    fn losses(&self) -> &[String] {
        &self.losses
    }
}
