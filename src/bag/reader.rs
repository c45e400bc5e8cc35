//! Reading a bag: memory-mapped, in the order of log times, only the topics that play a part.
//!
//! Segments are opened when the time comes to their first message and closed after their last,
//! so memory holds the chunks that overlap in time; what lies uncompressed is read in place.
//! Messages of equal time come in the order of their channels' numbers, then of the file.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, VecDeque};
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use memmap2::Mmap;

use crate::geom::Stamp;
use crate::ingest::{Event, EventSource, Rejection, TimedEvent};
use crate::wire::EventDecoder;
use crate::wire::event::MessageType;

use super::chunk;
use super::error::BagError;
use super::index::BagIndex;
use super::peek;
use super::record::{self, MAGIC, MessageHeader, op};
use super::roles::{Peek, TopicPlan, TopicRoles, TopicView, Topics};

/// A mapped bag and its index.
pub(super) struct MappedBag {
    pub(super) map: Mmap,
    pub(super) index: BagIndex,
}

impl MappedBag {
    pub(super) fn open(path: &Path) -> Result<Self, BagError> {
        let path = bag_file(path)?;
        let io_error = |error| BagError::Io {
            path: path.clone(),
            error,
        };
        let file = File::open(&path).map_err(io_error)?;
        let num_bytes = file.metadata().map_err(io_error)?.len();
        if num_bytes == 0 {
            return Err(BagError::NotABag {
                path,
                reason: "the file is empty".into(),
            });
        }
        #[expect(
            unsafe_code,
            reason = "the mapping is read-only; a bag that another process shortens while it is read ends this one with SIGBUS, as for every reader that maps"
        )]
        // SAFETY: see above; nothing in this crate writes to a bag under its final name.
        let map = unsafe { Mmap::map(&file) }.map_err(io_error)?;
        if !map.starts_with(MAGIC) {
            let reason = what_it_is(&map);
            return Err(BagError::NotABag { path, reason });
        }
        let index = BagIndex::build(&map);
        Ok(Self { map, index })
    }

    /// Calls `visit` with channel and data of messages of `wanted` channels, segment by segment
    /// in the order of the file, until it says to stop wanting a channel by returning `false` and
    /// none is left.
    pub(super) fn scan(&self, wanted: &BTreeSet<u16>, mut visit: impl FnMut(u16, &[u8]) -> bool) {
        let mut wanted = wanted.clone();
        let mut workspace = Vec::new();
        for segment in &self.index.segments {
            if wanted.is_empty() {
                return;
            }
            let channels = segment.channels.as_ref();
            if channels.is_some_and(|c| c.is_disjoint(&wanted)) {
                continue;
            }
            let data = chunk::unpack(&self.map, &segment.place, &mut workspace);
            for record in data.records().filter(|r| r.opcode == op::MESSAGE) {
                let body = &data.bytes[record.body];
                let Some(message) = MessageHeader::parse(body) else {
                    continue;
                };
                if wanted.contains(&message.channel_id)
                    && !visit(message.channel_id, &body[MessageHeader::NUM_BYTES..])
                {
                    wanted.remove(&message.channel_id);
                }
            }
        }
    }

    /// The channels of a topic that veneer can read.
    pub(super) fn channels_of(&self, topic: &str) -> BTreeSet<u16> {
        let channels = self.index.channels.iter();
        channels
            .filter(|(_, c)| c.topic == topic && c.message_encoding == "cdr")
            .map(|(&id, _)| id)
            .collect()
    }

    /// All topics of types that veneer reads, with a look at the first messages of those whose
    /// type does not settle their part.
    pub(super) fn topics(&self) -> Topics {
        let mut topics = Topics::new();
        let mut to_peek = BTreeMap::new();
        let mut seen = BTreeSet::new();
        for segment in &self.index.segments {
            seen.extend(segment.channels.iter().flatten().copied());
        }
        for (&id, channel) in &self.index.channels {
            let message_type = MessageType::from_name(&channel.type_name);
            let Some(message_type) = message_type.filter(|_| channel.message_encoding == "cdr")
            else {
                continue;
            };
            let view = topics.entry(channel.topic.clone());
            let view = view.or_insert(TopicView {
                message_type,
                has_messages: false,
                peek: None,
            });
            view.has_messages |= seen.contains(&id);
            if peek::needs_peek(message_type) && view.message_type == message_type {
                to_peek.insert(id, (channel.topic.clone(), message_type));
            }
        }
        let mut peeks: BTreeMap<String, (Peek, usize)> = BTreeMap::new();
        self.scan(&to_peek.keys().copied().collect(), |id, data| {
            let (topic, message_type) = &to_peek[&id];
            let (peek, num_seen) = peeks.entry(topic.clone()).or_default();
            *num_seen += 1;
            peek::peek(*message_type, data, peek) && *num_seen < peek::MAX_PEEKS
        });
        for (topic, (peek, _)) in peeks {
            if let Some(view) = topics.get_mut(&topic) {
                view.peek = Some(peek);
            }
        }
        topics
    }

    /// The parts and who plays them.
    pub(super) fn plan(&self, roles: &TopicRoles) -> Result<TopicPlan, BagError> {
        let topics = self.topics();
        TopicPlan::resolve(roles, &topics, |frame| peek::moves(self, &topics, frame))
    }
}

/// The bag file of a path: itself, or the one `.mcap` in a rosbag2 folder.
fn bag_file(path: &Path) -> Result<PathBuf, BagError> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let io_error = |error| BagError::Io {
        path: path.to_owned(),
        error,
    };
    let mut bags = Vec::new();
    for entry in std::fs::read_dir(path).map_err(io_error)? {
        let file = entry.map_err(io_error)?.path();
        if file.extension().is_some_and(|e| e == "mcap") {
            bags.push(file);
        }
    }
    bags.sort();
    match bags.as_slice() {
        [one] => Ok(one.clone()),
        [] => Err(BagError::NotABag {
            path: path.to_owned(),
            reason:
                "the folder has no .mcap file (a sqlite3 bag is converted by `ros2 bag convert`)"
                    .into(),
        }),
        several => Err(BagError::NotABag {
            path: path.to_owned(),
            reason: format!(
                "the folder has {} .mcap files, a split bag: join it with `mcap merge`, or name one",
                several.len()
            ),
        }),
    }
}

fn what_it_is(bytes: &[u8]) -> String {
    if bytes.starts_with(b"SQLite format 3") {
        "a sqlite3 bag: convert it to MCAP with `ros2 bag convert`".into()
    } else if bytes.starts_with(b"#ROSBAG") {
        "a ROS 1 bag: convert it with `rosbags-convert` or `mcap convert`".into()
    } else {
        let start: Vec<u8> = bytes.iter().copied().take(8).collect();
        format!("not an MCAP file: it starts with {start:02x?}")
    }
}

/// Decodes the messages of a channel for one part.
struct Route {
    topic: usize,
    decoder: EventDecoder,
}

/// A segment whose messages are being read.
struct OpenSegment {
    /// Unpacked records; `None` = they lie in the file.
    unpacked: Option<Vec<u8>>,
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
    num_damaged_told: BTreeSet<usize>,
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
            num_damaged_told: BTreeSet::new(),
        })
    }

    /// The parts and who plays them, and what is missing.
    pub fn plan(&self) -> &TopicPlan {
        &self.plan
    }

    /// Bytes of the bag's file.
    pub fn num_bytes(&self) -> usize {
        self.bag.map.len()
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
        let data = chunk::unpack(&self.bag.map, place, &mut workspace);
        if let Some(loss) = &data.loss
            && self.num_damaged_told.insert(segment)
        {
            self.losses.push(loss.clone());
        }
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
        let in_workspace = data.in_workspace;
        if num_left == 0 {
            self.spare.push(workspace);
            return;
        }
        let unpacked = in_workspace.then_some(workspace);
        self.open
            .insert(segment, OpenSegment { unpacked, num_left });
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
        let file: &[u8] = &self.bag.map;
        let data = &open.unpacked.as_deref().unwrap_or(file)[begin..end];
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
            let closed = self.open.remove(&segment);
            self.spare.extend(closed.and_then(|open| open.unpacked));
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

/// The pairs of the first metadata record of a name, if the bag has one.
///
/// # Errors
/// [`BagError`] when the file cannot be read or is no bag.
pub fn metadata(path: &Path, name: &str) -> Result<Option<BTreeMap<String, String>>, BagError> {
    let bag = MappedBag::open(path)?;
    let mut records = bag.index.metadata.iter();
    let parsed = |body: &Range<usize>| record::parse_metadata(&bag.map[body.clone()]);
    let found = records.find_map(|body| parsed(body).filter(|(n, _)| n == name));
    Ok(found.map(|(_, pairs)| pairs))
}
