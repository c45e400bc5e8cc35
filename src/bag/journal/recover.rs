//! Reads a journal as far as it is whole.
//!
//! Steps are taken up to the first place where no record can be; a chunk that is all there but
//! does not hold what it should is stepped over where whole ones follow. Both are told. No more
//! memory is taken than the file has bytes.

use std::path::Path;

use crate::bag::record::op;

use super::index::Index;
use super::step::{self, MAX_CHUNK_BYTES};
use super::{JournalError, JournalFile, ScanState};

/// Opcode and length.
const FRAME_BYTES: usize = 9;
const NUM_FRAME_BYTES: u64 = FRAME_BYTES as u64;

/// What was read.
pub(super) struct Read {
    pub(super) state: ScanState,
    /// Ends where the file is to go on; without any byte where not even the preamble is whole.
    pub(super) index: Index,
    /// Whether there is something behind that.
    pub(super) has_more: bool,
    pub(super) losses: Vec<String>,
}

/// See the module.
pub(super) fn read(file: &mut dyn JournalFile, path: &Path) -> Result<Read, JournalError> {
    let io_error = |error| JournalError::Io {
        path: path.to_owned(),
        action: "read",
        error,
    };
    let num_bytes = file.num_bytes().map_err(io_error)?;
    let preamble = step::preamble();
    let num_preamble_bytes = preamble.len() as u64;
    let mut head = preamble.clone();
    head.truncate(usize::try_from(num_bytes).unwrap_or(usize::MAX));
    file.read_at(0, &mut head).map_err(io_error)?;
    if !preamble.starts_with(&head) {
        let path = path.to_owned();
        return Err(JournalError::NotAJournal { path });
    }
    let mut reader = Reader {
        file,
        num_bytes,
        body: Vec::new(),
        read: Read {
            state: ScanState::default(),
            index: Index::new(num_preamble_bytes, 0),
            has_more: false,
            losses: Vec::new(),
        },
    };
    if num_bytes < num_preamble_bytes {
        reader.read.index.num_bytes = 0;
        reader.lose(path, 0, "the file is cut off before its first record");
    } else {
        reader.run(path).map_err(io_error)?;
    }
    Ok(reader.read)
}

struct Reader<'a> {
    file: &'a mut dyn JournalFile,
    num_bytes: u64,
    body: Vec<u8>,
    read: Read,
}

/// What there is at a place of the file.
enum Place {
    /// A chunk whose body is now in the workspace.
    Chunk,
    /// Nothing more, as it should be.
    End,
    /// No record that could be read; why, in words.
    Broken(String),
}

impl Reader<'_> {
    fn run(&mut self, path: &Path) -> std::io::Result<()> {
        let mut at = self.read.index.num_bytes;
        // What the next step says that it follows; `None` where that cannot be known.
        let mut last_crc = Some(0);
        loop {
            let end = match self.look(at)? {
                Place::Chunk => at + NUM_FRAME_BYTES + self.body.len() as u64,
                Place::End => break,
                Place::Broken(words) => {
                    self.lose(path, at, &words);
                    break;
                }
            };
            let crc = step::said_crc(&self.body);
            match step::read_step(&self.body) {
                Ok(step) if last_crc.is_none_or(|last| last == step.follows_crc) => {
                    self.read.state.apply(&step);
                    // Chunks that were stepped over take room all the same.
                    self.read.index.num_bytes = at;
                    let crc = crc.unwrap_or_default();
                    self.read.index.note(&step, crc, end - at);
                }
                Ok(step) => {
                    let words = format!("step {} does not follow the one before", step.sequence);
                    self.lose(path, at, &words);
                    break;
                }
                Err(error) => self.read.losses.push(format!(
                    "{}: a step of {} bytes at byte {at} is lost: {error}",
                    path.display(),
                    end - at
                )),
            }
            last_crc = crc;
            at = end;
        }
        self.read.has_more = self.read.index.num_bytes < self.num_bytes;
        Ok(())
    }

    /// Reads the record at a place, if one that a journal has is there.
    fn look(&mut self, at: u64) -> std::io::Result<Place> {
        let num_left = self.num_bytes - at;
        if num_left == 0 {
            return Ok(Place::End);
        }
        if num_left < NUM_FRAME_BYTES {
            let words = format!("{num_left} bytes are no record");
            return Ok(Place::Broken(words));
        }
        let mut frame = [0; FRAME_BYTES];
        self.file.read_at(at, &mut frame)?;
        let [opcode, ref length @ ..] = frame;
        let length = u64::from_le_bytes(*length);
        match opcode {
            op::DATA_END => return Ok(Place::End),
            op::CHUNK => {}
            other => {
                let words = format!("a record of kind {other:#04x} is none of a journal's");
                return Ok(Place::Broken(words));
            }
        }
        let num_there = num_left - NUM_FRAME_BYTES;
        if length > num_there {
            let words = format!("a step of {length} bytes is cut off after {num_there}");
            return Ok(Place::Broken(words));
        }
        if length > MAX_CHUNK_BYTES {
            let words = format!("a step says that it has {length} bytes");
            return Ok(Place::Broken(words));
        }
        self.body.resize(usize::try_from(length).unwrap_or(0), 0);
        self.file.read_at(at + NUM_FRAME_BYTES, &mut self.body)?;
        Ok(Place::Chunk)
    }

    /// The rest of the file is given up.
    fn lose(&mut self, path: &Path, at: u64, words: &str) {
        self.read.losses.push(format!(
            "{}: at byte {at} {words}; the last {} bytes are cut off",
            path.display(),
            self.num_bytes - at
        ));
        self.read.has_more = true;
    }
}
