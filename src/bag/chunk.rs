//! The records of a segment, unpacked.
//!
//! A chunk that is cut off or whose compressed stream breaks gives the records before the break.
//! One whose checksum does not match gives nothing: where the damage is cannot be told, and a
//! wrong pose is worse than none.

use std::io::Read;

use super::index::Place;
use super::record::{self, Broken, ChunkHeader, RawRecord, op};

/// The records of a segment.
pub(super) struct Unpacked<'a> {
    pub(super) bytes: &'a [u8],
    /// Whether `bytes` are in the workspace rather than in the file.
    pub(super) in_workspace: bool,
    /// Offset of `bytes` in the segment's stretch of the file, or in the workspace.
    pub(super) offset: usize,
    /// What is missing, in words.
    pub(super) loss: Option<String>,
}

impl Unpacked<'_> {
    fn nothing(loss: String) -> Self {
        Self {
            bytes: &[],
            in_workspace: false,
            offset: 0,
            loss: Some(loss),
        }
    }

    /// The records, up to the first that is not whole.
    pub(super) fn records(&self) -> impl Iterator<Item = RawRecord> + '_ {
        let mut at = 0;
        std::iter::from_fn(move || {
            let record = record::record_at(self.bytes, at, self.bytes.len()).ok()?;
            at = record.body.end;
            Some(record)
        })
    }
}

/// Larger chunks are refused: no writer makes them, and memory has an end.
const MAX_CHUNK_BYTES: u64 = 4 << 30;

/// The records of a segment whose stretch of the file is `stretch`: there where they lie
/// uncompressed, else in `workspace`.
pub(super) fn unpack<'a>(
    stretch: &'a [u8],
    place: &Place,
    workspace: &'a mut Vec<u8>,
) -> Unpacked<'a> {
    let start = match place {
        Place::Loose(_) => {
            return Unpacked {
                bytes: stretch,
                in_workspace: false,
                offset: 0,
                loss: None,
            };
        }
        Place::Chunk(range) => range.start,
    };
    let body = match record::record_at(stretch, 0, stretch.len()) {
        Ok(record) if record.opcode == op::CHUNK => &stretch[record.body],
        Err(Broken::CutOff {
            opcode: Some(op::CHUNK),
            ..
        }) => &stretch[record::body_start(0)..],
        _ => &[],
    };
    let Some(header) = ChunkHeader::parse(body) else {
        return Unpacked::nothing(format!(
            "there is no chunk at byte {start}: its messages are lost"
        ));
    };
    let offset = record::body_start(0) + header.num_bytes;
    let stored = &body[header.num_bytes..];
    let stored_size = usize::try_from(header.compressed_size).unwrap_or(usize::MAX);
    let is_cut_off = stored_size > stored.len();
    let stored = &stored[..stored_size.min(stored.len())];
    if header.uncompressed_size > MAX_CHUNK_BYTES {
        return Unpacked::nothing(format!(
            "the chunk at byte {start} says it unpacks to {} bytes: its messages are lost",
            header.uncompressed_size
        ));
    }
    let read = match header.compression.as_str() {
        // `rosbags` writes no name, others this one.
        "" | "none" => {
            return checked(stored, false, offset, &header, start, is_cut_off, None);
        }
        "zstd" => zstd::Decoder::with_buffer(stored)
            .and_then(|decoder| read_up_to(decoder, header.uncompressed_size, workspace)),
        "lz4" => lz4::Decoder::new(stored)
            .and_then(|decoder| read_up_to(decoder, header.uncompressed_size, workspace)),
        other => {
            return Unpacked::nothing(format!(
                "the chunk at byte {start} is compressed with '{other}', which is not read (none, lz4, zstd are): its messages are lost"
            ));
        }
    };
    checked(workspace, true, 0, &header, start, is_cut_off, read.err())
}

/// Fills `out` with up to `limit` bytes; what came before an error stays in it.
fn read_up_to(reader: impl Read, limit: u64, out: &mut Vec<u8>) -> std::io::Result<()> {
    out.clear();
    // Memory for what a header merely claims is taken as the stream proves it.
    let claimed = usize::try_from(limit).unwrap_or(usize::MAX);
    out.reserve(claimed.min(64 << 20));
    reader.take(limit).read_to_end(out).map(drop)
}

fn checked<'a>(
    bytes: &'a [u8],
    in_workspace: bool,
    offset: usize,
    header: &ChunkHeader,
    start: usize,
    is_cut_off: bool,
    error: Option<std::io::Error>,
) -> Unpacked<'a> {
    let expected = header.uncompressed_size;
    let is_short = (bytes.len() as u64) < expected;
    let loss = if is_cut_off || is_short || error.is_some() {
        let why = error.map(|e| format!(" ({e})")).unwrap_or_default();
        Some(format!(
            "the chunk at byte {start} gives {} of its {expected} bytes{why}: the rest of its messages is lost",
            bytes.len()
        ))
    } else if header.uncompressed_crc != 0 && crc32fast::hash(bytes) != header.uncompressed_crc {
        return Unpacked::nothing(format!(
            "the checksum of the chunk at byte {start} does not match: its messages from {} to {} are lost",
            seconds(header.start_time),
            seconds(header.end_time)
        ));
    } else {
        None
    };
    Unpacked {
        bytes,
        in_workspace,
        offset,
        loss,
    }
}

fn seconds(nanos: u64) -> crate::geom::Stamp {
    crate::geom::Stamp::from_nanos(i64::try_from(nanos).unwrap_or(i64::MAX))
}
