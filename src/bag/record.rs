//! MCAP records read in place (<https://mcap.dev/spec>).
//!
//! A record is an opcode, a 64-bit length and a body. Nothing is copied or allocated by a length
//! that the bytes do not back; a body that is too short for its fields reads as `None`.

use std::collections::BTreeMap;
use std::ops::Range;

pub(super) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

pub(super) mod op {
    pub(in crate::bag) const HEADER: u8 = 0x01;
    pub(in crate::bag) const FOOTER: u8 = 0x02;
    pub(in crate::bag) const SCHEMA: u8 = 0x03;
    pub(in crate::bag) const CHANNEL: u8 = 0x04;
    pub(in crate::bag) const MESSAGE: u8 = 0x05;
    pub(in crate::bag) const CHUNK: u8 = 0x06;
    pub(in crate::bag) const MESSAGE_INDEX: u8 = 0x07;
    pub(in crate::bag) const CHUNK_INDEX: u8 = 0x08;
    pub(in crate::bag) const STATISTICS: u8 = 0x0b;
    pub(in crate::bag) const METADATA: u8 = 0x0c;
    pub(in crate::bag) const DATA_END: u8 = 0x0f;
}

/// Opcode and length.
const FRAME_BYTES: usize = 9;

/// One record, by its place in the bytes it was read from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct RawRecord {
    pub(super) opcode: u8,
    pub(super) start: usize,
    pub(super) body: Range<usize>,
}

/// Why there is no record where one should start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Broken {
    /// The bytes end exactly before it.
    End,
    /// The bytes end inside it: its frame, or its body of so many bytes.
    CutOff { opcode: Option<u8>, missing: usize },
    /// Opcode 0, which no record has (a tail of zeros after a power cut reads so).
    NoRecord,
}

/// The record that starts at `start` and ends at `end` or before.
pub(super) fn record_at(bytes: &[u8], start: usize, end: usize) -> Result<RawRecord, Broken> {
    let rest = bytes.get(start..end).unwrap_or(&[]);
    let Some((&[opcode, ref length @ ..], body)) = rest.split_first_chunk::<FRAME_BYTES>() else {
        return Err(match rest {
            [] => Broken::End,
            [0, ..] => Broken::NoRecord,
            _ => Broken::CutOff {
                opcode: None,
                missing: FRAME_BYTES - rest.len(),
            },
        });
    };
    if opcode == 0 {
        return Err(Broken::NoRecord);
    }
    let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
    if length > body.len() {
        return Err(Broken::CutOff {
            opcode: Some(opcode),
            missing: length - body.len(),
        });
    }
    let body = start + FRAME_BYTES..start + FRAME_BYTES + length;
    Ok(RawRecord {
        opcode,
        start,
        body,
    })
}

/// Where the body of the record at `start` begins, whether or not it is all there.
pub(super) fn body_start(start: usize) -> usize {
    start + FRAME_BYTES
}

/// Reads the fields of a body in order.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    fn chunk<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.chunk().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.chunk().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.chunk().map(u64::from_le_bytes)
    }

    /// A byte string behind its 32-bit length.
    pub(super) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()? as usize;
        let (head, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(head)
    }

    pub(super) fn string(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }

    /// Key-value pairs behind their length in bytes.
    fn pairs<K: Ord, V>(
        &mut self,
        mut pair: impl FnMut(&mut Self) -> Option<(K, V)>,
    ) -> Option<BTreeMap<K, V>> {
        let mut inner = Self(self.bytes()?);
        let mut map = BTreeMap::new();
        while !inner.0.is_empty() {
            let (key, value) = pair(&mut inner)?;
            map.insert(key, value);
        }
        Some(map)
    }

    fn string_map(&mut self) -> Option<BTreeMap<String, String>> {
        self.pairs(|f| Some((f.string()?.to_owned(), f.string()?.to_owned())))
    }
}

/// A schema: what its messages are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Schema {
    pub(super) id: u16,
    pub(super) name: String,
    pub(super) encoding: String,
}

impl Schema {
    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        Some(Self {
            id: fields.u16()?,
            name: fields.string()?.to_owned(),
            encoding: fields.string()?.to_owned(),
        })
    }
}

/// A channel: a topic of one schema from one publisher.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Channel {
    pub(super) id: u16,
    pub(super) schema_id: u16,
    pub(super) topic: String,
    pub(super) message_encoding: String,
}

impl Channel {
    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        Some(Self {
            id: fields.u16()?,
            schema_id: fields.u16()?,
            topic: fields.string()?.to_owned(),
            message_encoding: fields.string()?.to_owned(),
        })
    }
}

/// A message without its data, which is the rest of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MessageHeader {
    pub(super) channel_id: u16,
    pub(super) log_time: u64,
}

impl MessageHeader {
    pub(super) const NUM_BYTES: usize = 22;

    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let channel_id = fields.u16()?;
        let _sequence = fields.u32()?;
        let log_time = fields.u64()?;
        let _publish_time = fields.u64()?;
        Some(Self {
            channel_id,
            log_time,
        })
    }
}

/// A chunk without its records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ChunkHeader {
    pub(super) start_time: u64,
    pub(super) end_time: u64,
    pub(super) uncompressed_size: u64,
    pub(super) uncompressed_crc: u32,
    pub(super) compression: String,
    pub(super) compressed_size: u64,
    /// Bytes of the body before the records.
    pub(super) num_bytes: usize,
}

impl ChunkHeader {
    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        Some(Self {
            start_time: fields.u64()?,
            end_time: fields.u64()?,
            uncompressed_size: fields.u64()?,
            uncompressed_crc: fields.u32()?,
            compression: fields.string()?.to_owned(),
            compressed_size: fields.u64()?,
            num_bytes: body.len() - fields.0.len(),
        })
    }
}

/// What the summary says of a chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ChunkIndex {
    pub(super) start_time: u64,
    pub(super) end_time: u64,
    pub(super) chunk_start: u64,
    pub(super) chunk_length: u64,
    pub(super) channels: Vec<u16>,
    pub(super) message_index_length: u64,
}

impl ChunkIndex {
    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        Some(Self {
            start_time: fields.u64()?,
            end_time: fields.u64()?,
            chunk_start: fields.u64()?,
            chunk_length: fields.u64()?,
            channels: fields
                .pairs(|f| Some((f.u16()?, f.u64()?)))?
                .into_keys()
                .collect(),
            message_index_length: fields.u64()?,
        })
    }
}

/// The channel of a message index record, if it lists any message.
pub(super) fn message_index_channel(body: &[u8]) -> Option<u16> {
    let mut fields = Fields(body);
    let channel_id = fields.u16()?;
    let entries = fields.bytes()?;
    (!entries.is_empty()).then_some(channel_id)
}

/// Messages by channel, from the statistics record.
pub(super) fn statistics_counts(body: &[u8]) -> Option<BTreeMap<u16, u64>> {
    let mut fields = Fields(body);
    // message, schema, channel, attachment, metadata, chunk counts; start and end time.
    fields.0 = fields.0.get(8 + 2 + 4 * 4 + 8 * 2..)?;
    fields.pairs(|f| Some((f.u16()?, f.u64()?)))
}

/// Name and pairs of a metadata record.
pub(super) fn parse_metadata(body: &[u8]) -> Option<(String, BTreeMap<String, String>)> {
    let mut fields = Fields(body);
    Some((fields.string()?.to_owned(), fields.string_map()?))
}

/// Start and checksum of the summary, if the file ends with a footer.
pub(super) fn footer(bytes: &[u8]) -> Option<(u64, u32)> {
    let without_magic = bytes.strip_suffix(MAGIC)?;
    let start = without_magic.len().checked_sub(FRAME_BYTES + 20)?;
    let record = record_at(bytes, start, without_magic.len()).ok()?;
    if record.opcode != op::FOOTER || record.body.len() != 20 {
        return None;
    }
    let mut fields = Fields(&bytes[record.body]);
    let summary_start = fields.u64()?;
    let _summary_offset_start = fields.u64()?;
    Some((summary_start, fields.u32()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_bytes_make_a_parser_panic(bytes in prop::collection::vec(any::<u8>(), 0..120)) {
            let _ = Schema::parse(&bytes);
            let _ = Channel::parse(&bytes);
            let _ = MessageHeader::parse(&bytes);
            let _ = ChunkHeader::parse(&bytes);
            let _ = ChunkIndex::parse(&bytes);
            let _ = message_index_channel(&bytes);
            let _ = statistics_counts(&bytes);
            let _ = parse_metadata(&bytes);
            let _ = footer(&bytes);
            for start in 0..=bytes.len() {
                if let Ok(record) = record_at(&bytes, start, bytes.len()) {
                    prop_assert!(record.body.end <= bytes.len());
                }
            }
        }
    }
}
