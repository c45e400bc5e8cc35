//! The journal of a scan: what survives the end of the process, however it ends.
//!
//! A file of steps ([`step`]), each whole or not there: a keyframe came, went or moved, the mesh
//! changed, a scan began. [`Journal::follow`] appends what the file lacks of a scan and returns
//! when the disk has it; only that counts as acknowledged. [`Journal::resume`] reads the scan
//! back: a tail that a crash or a full disk tore is cut off and told, and everything before it is
//! as it was, to the bit.
//!
//! After a failure the file is taken for what it was at the last success: the tail is cut before
//! anything is appended, and all that it lacks is written anew, since a disk that has refused to
//! sync may have dropped what it had accepted. When more than half of the file is of no use any
//! more, [`Journal::compact`] writes the scan to a file beside it that then takes its name.
//!
//! The file is an MCAP recording (<https://mcap.dev/spec>) of the topics of
//! [`super::scan_writer`], one uncompressed chunk a step, and can be replayed as one.

mod disk;
mod entry;
mod error;
mod index;
mod recover;
mod step;

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use crate::ingest::MeshBlocks;
use crate::keyframe::{Keyframe, KeyframeId};
use crate::mesh::TriMesh;

use index::Index;
use step::{Change, MAX_CHUNK_BYTES, Step};

pub use disk::{JournalDisk, JournalFile, PathDisk};
pub use error::JournalError;

/// A scan as a journal holds it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScanState {
    /// Tells scans of one process apart, whose keyframes have numbers of their own.
    pub epoch: u64,
    /// By number.
    pub keyframes: BTreeMap<KeyframeId, Arc<Keyframe>>,
    /// No keyframe of the scan had this number or a higher one.
    pub next_id: KeyframeId,
    /// The mesh, whole.
    pub mesh: Option<Arc<TriMesh>>,
    /// Its blocks; none where it came whole.
    pub mesh_blocks: Arc<MeshBlocks>,
    /// How often it had changed, which tells one mesh from another.
    pub num_mesh_updates: u64,
    /// The frame of poses and mesh, where it is known.
    pub world_frame: Option<String>,
}

impl ScanState {
    fn apply(&mut self, step: &Step) {
        if !step.world_frame.is_empty() {
            self.world_frame = Some(step.world_frame.clone());
        }
        match &step.change {
            Change::Begin(next_id) => {
                *self = Self {
                    next_id: *next_id,
                    world_frame: self.world_frame.take(),
                    ..Self::default()
                };
            }
            Change::Keyframe(keyframe) => {
                self.next_id = self
                    .next_id
                    .max(KeyframeId(keyframe.id.0.saturating_add(1)));
                self.keyframes.insert(keyframe.id, Arc::clone(keyframe));
            }
            Change::Removed(id) => {
                self.keyframes.remove(id);
            }
            Change::Pose(id, world_from_camera) => {
                if let Some(keyframe) = self.keyframes.get_mut(id) {
                    Arc::make_mut(keyframe).world_from_camera = *world_from_camera;
                }
            }
            Change::Mesh {
                num_updates,
                mesh,
                blocks,
                ..
            } => {
                self.mesh = Some(Arc::clone(mesh));
                self.mesh_blocks = Arc::clone(blocks);
                self.num_mesh_updates = *num_updates;
            }
        }
    }
}

/// What a journal holds and did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JournalReport {
    /// Steps that the disk has, of those that came since the journal was opened.
    pub num_acknowledged: u64,
    /// Keyframes that the disk has.
    pub num_keyframes: usize,
    /// [`ScanState::num_mesh_updates`] of the mesh that the disk has; 0: none.
    pub num_mesh_updates: u64,
    /// Bytes of the file.
    pub num_bytes: u64,
    /// Those of no use any more.
    pub num_dead_bytes: u64,
    /// How often the file was written anew without them.
    pub num_compactions: u64,
    /// How often the disk refused.
    pub num_failures: u64,
}

/// A scan that was read back.
pub struct Resumed {
    /// To go on with.
    pub journal: Journal,
    /// The scan; its epoch is 0.
    pub state: ScanState,
    /// What was not whole, in words: file, place, and what is lost.
    pub losses: Vec<String>,
}

/// What there is under a journal's name.
#[expect(
    clippy::large_enum_variant,
    reason = "one value, taken apart where it is made"
)]
pub enum Found {
    /// No file, or one that was cut off before anything was in it; the words tell of that.
    Nothing(Option<String>),
    /// A scan.
    Scan(Resumed),
}

/// Bytes that are written before the disk is asked to have them.
const SYNC_BYTES: u64 = 8 << 20;

/// Files that waste less are left as they are.
const MIN_COMPACTION_BYTES: u64 = 1 << 20;

/// A journal that is being written.
pub struct Journal {
    disk: Box<dyn JournalDisk>,
    file: Box<dyn JournalFile>,
    /// What the file holds, and what of that the disk has for sure.
    written: Index,
    acknowledged: Index,
    /// Whether there may be bytes behind what was written.
    has_torn_tail: bool,
    /// Whether the file's name may not be on the disk.
    is_name_unsure: bool,
    /// A compaction that failed is not tried again before the file has grown to this.
    compact_from_bytes: u64,
    min_compaction_bytes: u64,
    report: JournalReport,
}

impl Journal {
    /// What the journal of `disk` holds.
    ///
    /// # Errors
    /// [`JournalError`] when the file cannot be read, is held by another process, or is no
    /// journal. A damaged one is no error.
    pub fn resume(mut disk: Box<dyn JournalDisk>) -> Result<Found, JournalError> {
        let opened = disk.open();
        let Some(mut file) = opened.map_err(|e| JournalError::io(&*disk, "open", e))? else {
            return Ok(Found::Nothing(None));
        };
        let read = recover::read(&mut *file, disk.path())?;
        if read.index.num_bytes == 0 {
            return Ok(Found::Nothing(read.losses.into_iter().next()));
        }
        let mut journal = Self {
            disk,
            file,
            acknowledged: read.index.clone(),
            written: read.index,
            has_torn_tail: read.has_more,
            is_name_unsure: false,
            compact_from_bytes: 0,
            min_compaction_bytes: MIN_COMPACTION_BYTES,
            report: JournalReport::default(),
        };
        journal.note_contents();
        Ok(Found::Scan(Resumed {
            journal,
            state: read.state,
            losses: read.losses,
        }))
    }

    /// An empty journal, where [`Self::resume`] found nothing.
    ///
    /// # Errors
    /// [`JournalError`] when the disk refuses, or there is a scan after all.
    pub fn create(mut disk: Box<dyn JournalDisk>) -> Result<Self, JournalError> {
        let opened = disk.open();
        if let Some(mut file) = opened.map_err(|e| JournalError::io(&*disk, "open", e))?
            && recover::read(&mut *file, disk.path())?.index.num_bytes > 0
        {
            let path = disk.path().to_owned();
            return Err(JournalError::IsThere { path });
        }
        let (file, index) = write_anew(&mut *disk, &ScanState::default(), &[])?;
        let mut journal = Self {
            disk,
            file,
            acknowledged: index.clone(),
            written: index,
            has_torn_tail: false,
            is_name_unsure: true,
            compact_from_bytes: 0,
            min_compaction_bytes: MIN_COMPACTION_BYTES,
            report: JournalReport::default(),
        };
        journal.sync_name()?;
        journal.note_contents();
        Ok(journal)
    }

    /// What it holds and did.
    pub fn report(&self) -> &JournalReport {
        &self.report
    }

    /// The numbers of the keyframes that the disk has.
    pub fn acknowledged_ids(&self) -> impl Iterator<Item = KeyframeId> + '_ {
        self.acknowledged.keyframes.keys().copied()
    }

    /// Appends what the journal lacks of `scan`, and returns when the disk has it.
    ///
    /// # Errors
    /// [`JournalError`] when the disk refuses. What was acknowledged before stays; what fitted
    /// may be acknowledged; the next call goes on.
    pub fn follow(&mut self, scan: &ScanState) -> Result<(), JournalError> {
        let appended = self.append_missing(scan);
        // What came before a failure is whole.
        let result = match self.acknowledge() {
            Ok(()) => appended,
            refused => refused,
        };
        self.report.num_failures += u64::from(result.is_err());
        self.note_contents();
        result
    }

    /// Writes the file anew without what is of no use, where that is more than half of it. `scan`
    /// is what the journal followed last.
    ///
    /// # Errors
    /// [`JournalError`] when the disk refuses; the journal is then as it was.
    pub fn compact(&mut self, scan: &ScanState) -> Result<(), JournalError> {
        let num_dead_bytes = self.acknowledged.num_dead_bytes();
        let is_due = 2 * num_dead_bytes > self.acknowledged.num_bytes
            && num_dead_bytes > self.min_compaction_bytes
            && self.acknowledged.num_bytes >= self.compact_from_bytes
            && self.written.num_bytes == self.acknowledged.num_bytes;
        if !is_due {
            return Ok(());
        }
        let scan = ScanState {
            next_id: self.acknowledged.next_id.max(scan.next_id),
            ..scan.clone()
        };
        match write_anew(&mut *self.disk, &scan, &[]) {
            Ok((file, index)) => {
                self.file = file;
                self.written = index.clone();
                self.acknowledged = index;
                self.has_torn_tail = false;
                self.is_name_unsure = true;
                self.compact_from_bytes = 0;
                self.report.num_compactions += 1;
                self.note_contents();
                self.sync_name()
            }
            Err(error) => {
                self.compact_from_bytes = self.acknowledged.num_bytes / 4 * 5;
                self.report.num_failures += 1;
                Err(error)
            }
        }
    }

    /// Completes the file as other readers of MCAP like it. It can be resumed all the same, and
    /// need not be closed.
    ///
    /// # Errors
    /// [`JournalError`] when the disk refuses; all that was acknowledged is there.
    pub fn close(mut self) -> Result<(), JournalError> {
        self.cut_tail()?;
        self.put(&step::ending())?;
        let synced = self.file.sync();
        synced.map_err(|e| JournalError::io(&*self.disk, "sync", e))
    }

    fn append_missing(&mut self, scan: &ScanState) -> Result<(), JournalError> {
        for change in self.written.changes_to(scan) {
            let step = self.written.step(change, scan);
            let (bytes, crc) = step::chunk(&step);
            check_size(&*self.disk, &bytes)?;
            self.cut_tail()?;
            self.put(&bytes)?;
            if matches!(step.change, Change::Begin(_)) {
                self.written.epoch = scan.epoch;
            }
            self.written.note(&step, crc, bytes.len() as u64);
            if self.written.num_bytes - self.acknowledged.num_bytes > SYNC_BYTES {
                self.acknowledge()?;
            }
        }
        // Where nothing is to be written, steps of an attempt that failed would be read back.
        if self.has_torn_tail {
            self.cut_tail()?;
            if let Err(error) = self.file.sync() {
                self.has_torn_tail = true;
                return Err(JournalError::io(&*self.disk, "sync", error));
            }
        }
        Ok(())
    }

    /// Cuts off what a failure has left.
    fn cut_tail(&mut self) -> Result<(), JournalError> {
        if self.has_torn_tail {
            let cut = self.file.truncate(self.written.num_bytes);
            cut.map_err(|e| JournalError::io(&*self.disk, "cut the tail of", e))?;
            self.has_torn_tail = false;
        }
        Ok(())
    }

    /// Writes bytes behind what was written.
    fn put(&mut self, bytes: &[u8]) -> Result<(), JournalError> {
        self.has_torn_tail = true;
        let put = write_all_at(&mut *self.file, self.written.num_bytes, bytes);
        put.map_err(|e| JournalError::io(&*self.disk, "write", e))?;
        self.has_torn_tail = false;
        Ok(())
    }

    /// Returns when the disk has what was written; where it refuses, that was not written.
    fn acknowledge(&mut self) -> Result<(), JournalError> {
        if self.written.num_bytes == self.acknowledged.num_bytes {
            return Ok(());
        }
        let synced = self.sync_name().and_then(|()| {
            let synced = self.file.sync();
            synced.map_err(|e| JournalError::io(&*self.disk, "sync", e))
        });
        if synced.is_err() {
            self.written = self.acknowledged.clone();
            self.has_torn_tail = true;
            return synced;
        }
        self.report.num_acknowledged += self.written.sequence - self.acknowledged.sequence;
        self.acknowledged = self.written.clone();
        Ok(())
    }

    fn sync_name(&mut self) -> Result<(), JournalError> {
        if self.is_name_unsure {
            let synced = self.disk.sync_folder();
            synced.map_err(|e| JournalError::io(&*self.disk, "sync the folder of", e))?;
            self.is_name_unsure = false;
        }
        Ok(())
    }

    fn note_contents(&mut self) {
        let index = &self.acknowledged;
        self.report.num_keyframes = index.keyframes.len();
        self.report.num_mesh_updates = index.mesh.map_or(0, |mesh| mesh.num_updates);
        self.report.num_bytes = index.num_bytes;
        self.report.num_dead_bytes = index.num_dead_bytes();
    }
}

/// Writes a whole scan to `disk`, complete as other readers of MCAP like it; its size in bytes. It
/// can be resumed as a journal.
///
/// # Errors
/// [`JournalError`] when the disk refuses, or a journal is being written there; what was there is
/// then as it was.
pub fn save(mut disk: Box<dyn JournalDisk>, scan: &ScanState) -> Result<u64, JournalError> {
    // A journal that is being written must not lose its name.
    let held = disk.open();
    let held = held.map_err(|e| JournalError::io(&*disk, "open", e))?;
    let (_, index) = write_anew(&mut *disk, scan, &step::ending())?;
    drop(held);
    let synced = disk.sync_folder();
    synced.map_err(|e| JournalError::io(&*disk, "sync the folder of", e))?;
    Ok(index.num_bytes)
}

/// Writes a journal of `scan` beside the one that is there, and puts it in its place.
fn write_anew(
    disk: &mut dyn JournalDisk,
    scan: &ScanState,
    ending: &[u8],
) -> Result<(Box<dyn JournalFile>, Index), JournalError> {
    let created = disk.create_partial();
    let mut file = created.map_err(|e| JournalError::io(disk, "write beside", e))?;
    let written = write_scan(disk, &mut *file, scan).and_then(|index| {
        let renamed = write_all_at(&mut *file, index.num_bytes, ending)
            .and_then(|()| file.sync())
            .and_then(|()| disk.rename_partial());
        renamed.map_err(|e| JournalError::io(disk, "replace", e))?;
        Ok(index)
    });
    match written {
        Ok(index) => Ok((file, index)),
        Err(error) => {
            disk.remove_partial();
            Err(error)
        }
    }
}

fn write_scan(
    disk: &dyn JournalDisk,
    file: &mut dyn JournalFile,
    scan: &ScanState,
) -> Result<Index, JournalError> {
    let mut put = |offset, bytes: &[u8]| {
        let put = write_all_at(file, offset, bytes);
        put.map_err(|e| JournalError::io(disk, "write beside", e))
    };
    let preamble = step::preamble();
    put(0, &preamble)?;
    let mut index = Index::new(preamble.len() as u64, scan.epoch);
    let begin = Change::Begin(scan.next_id);
    for change in [begin].into_iter().chain(index.changes_to(scan)) {
        let step = index.step(change, scan);
        let (bytes, crc) = step::chunk(&step);
        check_size(disk, &bytes)?;
        put(index.num_bytes, &bytes)?;
        index.note(&step, crc, bytes.len() as u64);
    }
    Ok(index)
}

fn check_size(disk: &dyn JournalDisk, chunk: &[u8]) -> Result<(), JournalError> {
    let num_bytes = chunk.len() as u64;
    if num_bytes > MAX_CHUNK_BYTES {
        let path = disk.path().to_owned();
        return Err(JournalError::TooLarge { path, num_bytes });
    }
    Ok(())
}

fn write_all_at(file: &mut dyn JournalFile, mut offset: u64, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match file.write_at(offset, bytes) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(num_written) => {
                bytes = &bytes[num_written..];
                offset += num_written as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
