//! A disk in memory that writes short, fills up, refuses, and loses what was not synced.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use super::super::{JournalDisk, JournalFile};
use super::Random;

/// What goes wrong, in thousandths of the calls.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Faults {
    pub(super) short_write: u32,
    pub(super) full: u32,
    pub(super) sync: u32,
    pub(super) truncate: u32,
    pub(super) rename: u32,
    pub(super) sync_folder: u32,
    /// Bytes that all files together may have; 0: no limit.
    pub(super) capacity: usize,
}

#[derive(Clone, Debug, Default)]
struct Content {
    now: Vec<u8>,
    /// What is there after a crash, unless some of what came later happens to be.
    synced: Vec<u8>,
    /// What was written last at each byte, whatever became of the file's length.
    ghost: Vec<u8>,
    is_locked: bool,
}

#[derive(Debug)]
struct State {
    faults: Faults,
    random: Random,
    files: Vec<Content>,
    /// Numbers of files by name, now and after a crash.
    names: BTreeMap<&'static str, usize>,
    synced_names: BTreeMap<&'static str, usize>,
    num_refused: u64,
}

/// See the module. Clones are the same disk.
#[derive(Clone, Debug)]
pub(super) struct WorseDisk(Arc<Mutex<State>>);

const JOURNAL: &str = "journal";
const PARTIAL: &str = "partial";

impl State {
    fn happens(&mut self, per_mille: u32) -> bool {
        let happens = self.random.below(1000) < u64::from(per_mille);
        self.num_refused += u64::from(happens);
        happens
    }

    fn num_bytes(&self) -> usize {
        self.files.iter().map(|file| file.now.len()).sum()
    }
}

fn refuse_if(refuses: bool, kind: ErrorKind) -> io::Result<()> {
    if refuses { Err(kind.into()) } else { Ok(()) }
}

impl WorseDisk {
    pub(super) fn new(seed: u64) -> Self {
        Self(Arc::new(Mutex::new(State {
            faults: Faults::default(),
            random: Random(seed),
            files: Vec::new(),
            names: BTreeMap::new(),
            synced_names: BTreeMap::new(),
            num_refused: 0,
        })))
    }

    /// A disk on which a journal of these bytes lies.
    pub(super) fn with_journal(bytes: &[u8]) -> Self {
        let disk = Self::new(0);
        let mut state = disk.0.lock().unwrap();
        state.files.push(Content {
            now: bytes.to_vec(),
            synced: bytes.to_vec(),
            ..Content::default()
        });
        state.names.insert(JOURNAL, 0);
        state.synced_names.insert(JOURNAL, 0);
        drop(state);
        disk
    }

    pub(super) fn boxed(&self) -> Box<dyn JournalDisk> {
        Box::new(self.clone())
    }

    pub(super) fn set_faults(&self, faults: Faults) {
        self.0.lock().unwrap().faults = faults;
    }

    pub(super) fn num_refused(&self) -> u64 {
        self.0.lock().unwrap().num_refused
    }

    pub(super) fn journal_bytes(&self) -> Vec<u8> {
        let state = self.0.lock().unwrap();
        let file = state.names.get(JOURNAL);
        file.map_or_else(Vec::new, |&file| state.files[file].now.clone())
    }

    /// The power fails: files are what was synced and, at random, part of what came after; names
    /// are the old or the new ones.
    pub(super) fn crash(&self) {
        let mut state = self.0.lock().unwrap();
        for at in 0..state.files.len() {
            let Content {
                now, synced, ghost, ..
            } = state.files[at].clone();
            let how = state.random.below(5);
            let num_kept = usize::try_from(state.random.below(now.len() as u64 + 1)).unwrap();
            let after = match how {
                0 => synced,
                1 => now,
                // A cut that did not reach the disk, unlike what was written before and after it.
                2 if ghost.len() > now.len() => [&now[..], &ghost[now.len()..]].concat(),
                // The length has grown, the data has not come, or only the start of it.
                _ => {
                    let mut mixed = synced.clone();
                    mixed.resize(now.len().max(synced.len()), 0);
                    let num_kept = num_kept.min(now.len());
                    mixed[..num_kept].copy_from_slice(&now[..num_kept]);
                    mixed
                }
            };
            state.files[at] = Content {
                now: after.clone(),
                synced: after,
                ..Content::default()
            };
        }
        if state.random.below(2) == 0 {
            state.names = state.synced_names.clone();
        }
        state.synced_names = state.names.clone();
    }
}

struct WorseFile {
    disk: WorseDisk,
    file: usize,
}

impl Drop for WorseFile {
    fn drop(&mut self) {
        self.disk.0.lock().unwrap().files[self.file].is_locked = false;
    }
}

impl JournalDisk for WorseDisk {
    fn path(&self) -> &Path {
        Path::new("/disk/journal.mcap")
    }

    fn open(&mut self) -> io::Result<Option<Box<dyn JournalFile>>> {
        let mut state = self.0.lock().unwrap();
        let Some(&file) = state.names.get(JOURNAL) else {
            return Ok(None);
        };
        refuse_if(state.files[file].is_locked, ErrorKind::WouldBlock)?;
        state.files[file].is_locked = true;
        let disk = self.clone();
        Ok(Some(Box::new(WorseFile { disk, file })))
    }

    fn create_partial(&mut self) -> io::Result<Box<dyn JournalFile>> {
        let mut state = self.0.lock().unwrap();
        let full = state.faults.full;
        let is_full = state.happens(full);
        refuse_if(is_full, ErrorKind::StorageFull)?;
        let file = state.files.len();
        state.files.push(Content::default());
        state.names.insert(PARTIAL, file);
        let disk = self.clone();
        Ok(Box::new(WorseFile { disk, file }))
    }

    fn rename_partial(&mut self) -> io::Result<()> {
        let mut state = self.0.lock().unwrap();
        let rename = state.faults.rename;
        let refuses = state.happens(rename);
        refuse_if(refuses, ErrorKind::Other)?;
        let file = state.names.remove(PARTIAL).unwrap();
        if let Some(old) = state.names.insert(JOURNAL, file) {
            // Its blocks are free; after a crash that forgets the rename it is there again.
            state.files[old].now = state.files[old].synced.clone();
        }
        Ok(())
    }

    fn remove_partial(&mut self) {
        let mut state = self.0.lock().unwrap();
        if let Some(file) = state.names.remove(PARTIAL) {
            state.files[file] = Content::default();
        }
    }

    fn sync_folder(&mut self) -> io::Result<()> {
        let mut state = self.0.lock().unwrap();
        let sync_folder = state.faults.sync_folder;
        let refuses = state.happens(sync_folder);
        refuse_if(refuses, ErrorKind::Other)?;
        state.synced_names = state.names.clone();
        let named: Vec<usize> = state.names.values().copied().collect();
        for at in 0..state.files.len() {
            if !named.contains(&at) {
                state.files[at] = Content::default();
            }
        }
        Ok(())
    }
}

impl JournalFile for WorseFile {
    fn num_bytes(&mut self) -> io::Result<u64> {
        Ok(self.disk.0.lock().unwrap().files[self.file].now.len() as u64)
    }

    fn read_at(&mut self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        let state = self.disk.0.lock().unwrap();
        let start = usize::try_from(offset).unwrap();
        let found = state.files[self.file].now.get(start..start + into.len());
        into.copy_from_slice(found.ok_or(ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> io::Result<usize> {
        let mut state = self.disk.0.lock().unwrap();
        let Faults {
            full,
            short_write,
            capacity,
            ..
        } = state.faults;
        let mut num_written = bytes.len();
        if capacity > 0 {
            num_written = num_written.min(capacity.saturating_sub(state.num_bytes()));
        }
        let is_full = state.happens(full) || num_written == 0;
        if is_full || state.random.below(1000) < u64::from(short_write) {
            num_written = usize::try_from(state.random.below(num_written as u64 + 1)).unwrap();
        }
        let start = usize::try_from(offset).unwrap();
        let Content { now, ghost, .. } = &mut state.files[self.file];
        for place in [now, ghost] {
            place.resize(place.len().max(start + num_written), 0);
            place[start..start + num_written].copy_from_slice(&bytes[..num_written]);
        }
        refuse_if(is_full || num_written == 0, ErrorKind::StorageFull)?;
        Ok(num_written)
    }

    fn truncate(&mut self, num_bytes: u64) -> io::Result<()> {
        let mut state = self.disk.0.lock().unwrap();
        let truncate = state.faults.truncate;
        let refuses = state.happens(truncate);
        refuse_if(refuses, ErrorKind::Other)?;
        let now = &mut state.files[self.file].now;
        now.resize(usize::try_from(num_bytes).unwrap(), 0);
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        let mut state = self.disk.0.lock().unwrap();
        let sync = state.faults.sync;
        if state.happens(sync) {
            // As the page cache does it: what could not be written is forgotten, and the next
            // sync has nothing to complain about.
            let file = &mut state.files[self.file];
            file.now = file.synced.clone();
            return Err(ErrorKind::Other.into());
        }
        let file = &mut state.files[self.file];
        file.synced = file.now.clone();
        Ok(())
    }
}

/// Where the journal would lie, for words.
pub(super) fn named() -> PathBuf {
    PathBuf::from("/disk/journal.mcap")
}
