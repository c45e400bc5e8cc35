//! A bag file mapped into memory, stretch by stretch, and its index.
//!
//! The whole file is mapped only while it is indexed, when just the frames of its records are
//! touched; later each segment is mapped while its messages are read. So resident memory stays
//! at what is being read, whatever the size of the bag.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use memmap2::{Mmap, MmapOptions};

use crate::wire::event::MessageType;

use super::chunk;
use super::error::BagError;
use super::index::{BagIndex, Place};
use super::peek;
use super::record::{self, MAGIC, MessageHeader, op};
use super::roles::{Peek, TopicPlan, TopicRoles, TopicView, Topics};

/// A mapped bag and its index.
pub(super) struct MappedBag {
    file: File,
    /// Bytes of the file when it was opened.
    pub(super) num_bytes: usize,
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
        let num_bytes = usize::try_from(num_bytes).unwrap_or(usize::MAX);
        if num_bytes == 0 {
            return Err(BagError::NotABag {
                path,
                reason: "the file is empty".into(),
            });
        }
        let whole = map(&file, 0..num_bytes, Touch::AsRead).map_err(io_error)?;
        if !whole.starts_with(MAGIC) {
            let reason = what_it_is(&whole);
            return Err(BagError::NotABag { path, reason });
        }
        let index = BagIndex::build(&whole);
        Ok(Self {
            file,
            num_bytes,
            index,
        })
    }

    /// The stretch of the file that a segment lies in.
    pub(super) fn map(&self, place: &Place) -> std::io::Result<Mmap> {
        let touch = match place {
            // The checksum of a chunk needs all of it.
            Place::Chunk(_) => Touch::Whole,
            Place::Loose(_) => Touch::AsRead,
        };
        map(&self.file, place.range(), touch)
    }

    /// The pairs of the first metadata record of a name.
    fn metadata(&self, name: &str) -> std::io::Result<Option<BTreeMap<String, String>>> {
        for body in &self.index.metadata {
            let record = map(&self.file, body.clone(), Touch::AsRead)?;
            match record::parse_metadata(&record) {
                Some((found, pairs)) if found == name => return Ok(Some(pairs)),
                _ => {}
            }
        }
        Ok(None)
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
            // What cannot be read is told when it is read for its messages.
            let Ok(stretch) = self.map(&segment.place) else {
                continue;
            };
            let data = chunk::unpack(&stretch, &segment.place, &mut workspace);
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

/// When the pages of a mapping are brought in.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Touch {
    /// As they are read.
    AsRead,
    /// All at once.
    Whole,
}

fn map(file: &File, range: Range<usize>, touch: Touch) -> std::io::Result<Mmap> {
    let num_bytes = file.metadata()?.len();
    if range.end as u64 > num_bytes {
        return Err(std::io::Error::other(format!(
            "the file was shortened to {num_bytes} bytes while it was read"
        )));
    }
    let mut options = MmapOptions::new();
    options.offset(range.start as u64).len(range.len());
    if touch == Touch::Whole {
        options.populate();
    }
    #[expect(
        unsafe_code,
        reason = "the mapping is read-only; a bag that another process shortens during a read ends this one with SIGBUS, as for every reader that maps"
    )]
    // SAFETY: as the reason says; nothing in this crate writes to a bag under its final name.
    unsafe {
        options.map(file)
    }
}

/// The pairs of the first metadata record of a name, if the bag has one.
///
/// # Errors
/// [`BagError`] when the file cannot be read or is no bag.
pub fn metadata(path: &Path, name: &str) -> Result<Option<BTreeMap<String, String>>, BagError> {
    let bag = MappedBag::open(path)?;
    bag.metadata(name).map_err(|error| BagError::Io {
        path: path.to_owned(),
        error,
    })
}
