//! What a bag holds and where: channels, stretches of messages, metadata.
//!
//! The file is walked record by record from its start; a chunk that the summary lists is stepped
//! over without being touched. So a bag with an index opens at once, one without it is walked
//! whole, messages outside of chunks are found in either, and where the framing is broken the
//! walk goes on at the next chunk that the summary knows, or ends there.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::chunk;
use super::record::{
    self, Broken, Channel, ChunkHeader, ChunkIndex, MAGIC, MessageHeader, RawRecord, Schema, op,
};

/// Records that lie together: a chunk, or a stretch of records outside of chunks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Segment {
    /// Log time of the first message in time, nanoseconds.
    pub(super) start_time: u64,
    /// Log time of the last message in time, nanoseconds.
    pub(super) end_time: u64,
    pub(super) place: Place,
    /// Channels with messages here; `None` = not known yet.
    pub(super) channels: Option<BTreeSet<u16>>,
}

/// Where the records of a segment lie in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// In this chunk record, which may be cut off by the end of the file.
    Chunk(Range<usize>),
    /// Here, as they are.
    Loose(Range<usize>),
}

impl Place {
    pub(super) fn range(&self) -> Range<usize> {
        let (Self::Chunk(range) | Self::Loose(range)) = self;
        range.clone()
    }
}

/// A topic of one type from one publisher.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ChannelInfo {
    pub(super) topic: String,
    /// Type of the messages; empty if the schema is missing.
    pub(super) type_name: String,
    /// `cdr`, or what else.
    pub(super) message_encoding: String,
    /// `ros2msg`, `ros2idl`, or what else.
    pub(super) schema_encoding: String,
}

/// What a bag holds and where.
#[derive(Clone, Debug, Default)]
pub(super) struct BagIndex {
    pub(super) channels: BTreeMap<u16, ChannelInfo>,
    /// In the order of the file.
    pub(super) segments: Vec<Segment>,
    /// Bodies of metadata records.
    pub(super) metadata: Vec<Range<usize>>,
    /// Messages by channel, as the summary counted them.
    pub(super) counts: Option<BTreeMap<u16, u64>>,
    /// Whether the summary was there and intact.
    pub(super) has_summary: bool,
    /// What is missing, in words.
    pub(super) losses: Vec<String>,
    schemas: BTreeMap<u16, Schema>,
    orphans: Vec<Channel>,
}

/// A stretch of loose messages is cut after so many, so that opening one stays cheap …
const MAX_LOOSE_MESSAGES: usize = 1024;
/// … or after so many bytes, so that it takes no more memory than a chunk.
const MAX_LOOSE_BYTES: usize = 4 << 20;

impl BagIndex {
    /// The index of a file that starts with [`MAGIC`].
    pub(super) fn build(bytes: &[u8]) -> Self {
        let mut index = Self::default();
        let chunks = index.read_summary(bytes).unwrap_or_default();
        let data_end = match record::footer(bytes) {
            Some((summary_start, _)) if summary_start > 0 => {
                usize::try_from(summary_start).map_or(bytes.len(), |s| s.min(bytes.len()))
            }
            Some(_) => bytes.len() - MAGIC.len(),
            None => bytes.len(),
        };
        Walk {
            bytes,
            data_end,
            chunks: &chunks,
            loose: None,
            pending_chunk: None,
        }
        .run(&mut index);
        index.look_into_unknown_segments(bytes);
        index.settle_times();
        index
    }

    /// The chunks by their start, if there is a summary and its checksum holds.
    fn read_summary(&mut self, bytes: &[u8]) -> Option<BTreeMap<usize, ChunkIndex>> {
        let (start, crc) = record::footer(bytes)?;
        let start = usize::try_from(start).ok().filter(|&s| s > 0)?;
        // The checksum covers the footer up to itself.
        let covered = bytes.get(start..bytes.len() - MAGIC.len() - 4)?;
        if crc != 0 && crc32fast::hash(covered) != crc {
            self.losses.push(
                "the summary's checksum does not match: it was not used, the bag was walked".into(),
            );
            return None;
        }
        let mut chunks = BTreeMap::new();
        let mut at = start;
        while let Ok(record) = record::record_at(bytes, at, bytes.len() - MAGIC.len()) {
            let body = &bytes[record.body.clone()];
            match record.opcode {
                op::SCHEMA => self.add_schema(body),
                op::CHANNEL => self.add_channel(body),
                op::STATISTICS => self.counts = record::statistics_counts(body),
                op::CHUNK_INDEX => {
                    let chunk = ChunkIndex::parse(body)?;
                    chunks.insert(usize::try_from(chunk.chunk_start).ok()?, chunk);
                }
                op::FOOTER => break,
                _ => {}
            }
            at = record.body.end;
        }
        self.has_summary = true;
        Some(chunks)
    }

    fn add_schema(&mut self, body: &[u8]) {
        let Some(schema) = Schema::parse(body) else {
            return;
        };
        self.schemas.entry(schema.id).or_insert(schema);
        for channel in std::mem::take(&mut self.orphans) {
            self.link(channel);
        }
    }

    fn add_channel(&mut self, body: &[u8]) {
        if let Some(channel) = Channel::parse(body) {
            self.link(channel);
        }
    }

    fn link(&mut self, channel: Channel) {
        let schema = self.schemas.get(&channel.schema_id);
        if schema.is_none() && channel.schema_id != 0 {
            self.orphans.push(channel.clone());
        }
        let info = ChannelInfo {
            topic: channel.topic,
            type_name: schema.map(|s| s.name.clone()).unwrap_or_default(),
            message_encoding: channel.message_encoding,
            schema_encoding: schema.map(|s| s.encoding.clone()).unwrap_or_default(),
        };
        let known = self.channels.entry(channel.id);
        let known = known.or_insert_with(|| info.clone());
        if known.type_name.is_empty() {
            *known = info;
        }
    }

    fn knows(&self, channels: &BTreeSet<u16>) -> bool {
        channels.iter().all(|id| self.channels.contains_key(id))
    }

    /// Without message indexes only the records tell which channels a segment has, and without a
    /// summary which channels there are.
    fn look_into_unknown_segments(&mut self, bytes: &[u8]) {
        let mut segments = std::mem::take(&mut self.segments);
        let mut workspace = Vec::new();
        for segment in &mut segments {
            if let Some(channels) = &segment.channels
                && self.knows(channels)
            {
                continue;
            }
            // Losses are told when the segment is read for its messages.
            let records = &bytes[segment.place.range()];
            let data = chunk::unpack(records, &segment.place, &mut workspace);
            let mut channels = BTreeSet::new();
            for record in data.records() {
                let body = &data.bytes[record.body.clone()];
                match record.opcode {
                    op::SCHEMA => self.add_schema(body),
                    op::CHANNEL => self.add_channel(body),
                    op::MESSAGE => {
                        channels.extend(MessageHeader::parse(body).map(|m| m.channel_id));
                    }
                    _ => {}
                }
            }
            segment.channels = Some(channels);
        }
        self.segments = segments;
    }

    /// Some writers leave a chunk's times 0: it then stands where its neighbours in the file say.
    fn settle_times(&mut self) {
        let mut latest = 0;
        for segment in &mut self.segments {
            if segment.end_time == 0 || segment.end_time < segment.start_time {
                segment.start_time = segment.start_time.max(latest);
                segment.end_time = u64::MAX;
            } else {
                latest = latest.max(segment.start_time);
            }
        }
    }
}

/// The walk over the data section.
struct Walk<'a> {
    bytes: &'a [u8],
    data_end: usize,
    chunks: &'a BTreeMap<usize, ChunkIndex>,
    loose: Option<(Segment, usize)>,
    /// A chunk that no summary lists, while its message indexes come.
    pending_chunk: Option<Segment>,
}

impl Walk<'_> {
    fn run(mut self, index: &mut BagIndex) {
        let mut at = MAGIC.len();
        loop {
            if let Some(listed) = self.chunks.get(&at)
                && let Some(next) = self.listed_chunk(at, listed, index)
            {
                at = next;
                continue;
            }
            let limit = self.next_listed(at).unwrap_or(self.data_end);
            match record::record_at(self.bytes, at, limit) {
                Ok(record) if matches!(record.opcode, op::DATA_END | op::FOOTER) => {
                    self.flush(index);
                    self.note_missing_footer(at, index);
                    return;
                }
                Ok(record) => {
                    self.record(&record, index);
                    at = record.body.end;
                }
                Err(broken) => match self.broken(at, &broken, index) {
                    Some(next) => at = next,
                    None => return,
                },
            }
        }
    }

    fn next_listed(&self, at: usize) -> Option<usize> {
        self.chunks.range(at + 1..).next().map(|(&start, _)| start)
    }

    /// Steps over a chunk of the summary and the message indexes behind it.
    fn listed_chunk(
        &mut self,
        at: usize,
        listed: &ChunkIndex,
        index: &mut BagIndex,
    ) -> Option<usize> {
        let chunk_end = at.checked_add(usize::try_from(listed.chunk_length).ok()?)?;
        let indexes = usize::try_from(listed.message_index_length).ok()?;
        let next = chunk_end.checked_add(indexes)?;
        if chunk_end <= at || next > self.data_end {
            return None;
        }
        self.flush(index);
        // No message indexes: whether it has messages is to be seen.
        let has_indexes = listed.message_index_length > 0;
        index.segments.push(Segment {
            start_time: listed.start_time,
            end_time: listed.end_time,
            place: Place::Chunk(at..chunk_end),
            channels: has_indexes.then(|| listed.channels.iter().copied().collect()),
        });
        Some(next)
    }

    fn record(&mut self, record: &RawRecord, index: &mut BagIndex) {
        let body = &self.bytes[record.body.clone()];
        match record.opcode {
            op::SCHEMA => index.add_schema(body),
            op::CHANNEL => index.add_channel(body),
            op::MESSAGE => self.loose_message(record, index),
            op::CHUNK => {
                self.flush(index);
                self.start_chunk(record.start..record.body.end, body);
            }
            op::MESSAGE_INDEX => {
                if let Some(chunk) = &mut self.pending_chunk {
                    let channels = chunk.channels.get_or_insert_default();
                    channels.extend(record::message_index_channel(body));
                }
            }
            op::METADATA => index.metadata.push(record.body.clone()),
            _ => {}
        }
    }

    fn start_chunk(&mut self, range: Range<usize>, body: &[u8]) {
        if let Some(header) = ChunkHeader::parse(body) {
            self.pending_chunk = Some(Segment {
                start_time: header.start_time,
                end_time: header.end_time,
                place: Place::Chunk(range),
                channels: None,
            });
        }
    }

    fn loose_message(&mut self, record: &RawRecord, index: &mut BagIndex) {
        let Some(message) = MessageHeader::parse(&self.bytes[record.body.clone()]) else {
            return;
        };
        let is_full = |(segment, num_messages): &(Segment, usize)| {
            *num_messages == MAX_LOOSE_MESSAGES || segment.place.range().len() > MAX_LOOSE_BYTES
        };
        if self.loose.as_ref().is_none_or(is_full) {
            self.flush(index);
            let segment = Segment {
                start_time: message.log_time,
                end_time: message.log_time,
                place: Place::Loose(record.start..record.body.end),
                channels: Some(BTreeSet::new()),
            };
            self.loose = Some((segment, 0));
        }
        if let Some((segment, num_messages)) = &mut self.loose {
            segment.start_time = segment.start_time.min(message.log_time);
            segment.end_time = segment.end_time.max(message.log_time);
            if let Place::Loose(range) = &mut segment.place {
                range.end = record.body.end;
            }
            segment
                .channels
                .get_or_insert_default()
                .insert(message.channel_id);
            *num_messages += 1;
        }
    }

    fn flush(&mut self, index: &mut BagIndex) {
        index.segments.extend(self.pending_chunk.take());
        index
            .segments
            .extend(self.loose.take().map(|(segment, _)| segment));
    }

    /// Where to go on after a break in the framing, if anywhere.
    fn broken(&mut self, at: usize, broken: &Broken, index: &mut BagIndex) -> Option<usize> {
        // Some of its message indexes may be behind the break.
        if let Some(chunk) = &mut self.pending_chunk {
            chunk.channels = None;
        }
        // A chunk that is cut off still gives its first messages.
        if let Broken::CutOff {
            opcode: Some(op::CHUNK),
            ..
        } = broken
        {
            self.flush(index);
            let body = &self.bytes[record::body_start(at)..];
            self.start_chunk(at..self.bytes.len(), body);
        }
        self.flush(index);
        let next = self.next_listed(at);
        // The summary starts where the data ends, even if the end was not marked.
        let at_summary = *broken == Broken::End && self.data_end < self.bytes.len();
        if !at_summary {
            index.losses.push(sentence(at, broken, next));
        }
        next
    }

    fn note_missing_footer(&self, at: usize, index: &mut BagIndex) {
        if record::footer(self.bytes).is_none() {
            index.losses.push(format!(
                "the bag's summary is missing or damaged; its data is complete up to byte {at}, no message is lost"
            ));
        }
    }
}

fn sentence(at: usize, broken: &Broken, next: Option<usize>) -> String {
    let what = match broken {
        Broken::End => format!(
            "the bag was not closed: it ends at byte {at} without its end record, what was recorded after that is lost"
        ),
        Broken::CutOff { missing, .. } => format!(
            "the bag is cut off: the record at byte {at} lacks its last {missing} bytes, it and what followed are lost"
        ),
        Broken::NoRecord => {
            format!(
                "the bag is damaged at byte {at}: no record starts there, what followed is lost"
            )
        }
    };
    match next {
        Some(next) => {
            format!("the bag is damaged between bytes {at} and {next}; reading went on after that")
        }
        None => what,
    }
}
