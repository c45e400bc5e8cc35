//! Keeps the scan in a journal, on a thread of its own.
//!
//! Ingest leaves the latest state of the scan in a slot that holds one, and never waits for the
//! disk. The thread brings the journal to the state that it finds there: what a newer state
//! replaced is written with the newer one, or needs not be written any more. Where the disk
//! refuses, that goes on being tried, and diagnostics say why it fails; the memory that waits is
//! the scan's own.

mod status;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::bag::journal::{Found, Journal, JournalDisk, JournalError, PathDisk, ScanState};
use crate::ingest::MeshBlocks;
use crate::mesh::TriMesh;
use crate::pipeline::{Capture, EarlierScan, Latest};

pub(super) use status::{JournalStatus, finding};

/// How long the thread sleeps at a time.
const POLL: Duration = Duration::from_millis(100);
/// A disk that has refused is asked again after this.
const RETRY: Duration = Duration::from_secs(1);
/// How long a start waits for the process before to let go of the journal.
const HANDOVER: Duration = Duration::from_secs(3);
/// How long the end waits for the disk.
const PATIENCE: Duration = Duration::from_millis(800);

/// What ingest, the thread and diagnostics share.
#[derive(Debug)]
pub(super) struct JournalSlot {
    /// Where the journal is; `None`: none is kept.
    path: Option<PathBuf>,
    states: Latest<ScanState>,
    status: Mutex<JournalStatus>,
}

impl JournalSlot {
    pub(super) fn new(path: Option<&str>) -> Self {
        let path = path.map(PathBuf::from);
        let status = JournalStatus::new(path.as_deref());
        Self {
            path,
            states: Latest::default(),
            status: Mutex::new(status),
        }
    }

    /// What the journal is up to; `None` where none is kept.
    pub(super) fn status(&self) -> Option<JournalStatus> {
        self.path.as_ref()?;
        let mut status = self.lock().clone();
        status.num_coalesced = self.states.num_replaced();
        Some(status)
    }

    fn lock(&self) -> MutexGuard<'_, JournalStatus> {
        // The status is whole after every step, so a panic elsewhere leaves it usable.
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Leaves what there is of the scan; `epoch` counts the scans that were forgotten.
    pub(super) fn put(&self, capture: &Capture, epoch: u64) {
        if self.path.is_none() {
            return;
        }
        let state = scan_state(capture, epoch);
        self.lock().num_keyframes = state.keyframes.len();
        self.states.put(state);
    }
}

/// The thread, which ends when this is dropped.
pub(super) struct JournalThread {
    slot: Arc<JournalSlot>,
    thread: Option<JoinHandle<()>>,
}

impl JournalThread {
    /// Starts the thread; with what an earlier run left in the journal. `mesh_period` is the least
    /// time between two meshes in it.
    pub(super) fn start(
        slot: Arc<JournalSlot>,
        mesh_period: Duration,
    ) -> (Self, Option<EarlierScan>) {
        let Some(path) = slot.path.clone() else {
            return (Self { slot, thread: None }, None);
        };
        let (writer, earlier) = match resume(&path) {
            Ok(Found::Scan(resumed)) => {
                let state = resumed.state;
                let mut status = slot.lock();
                status.num_resumed = state.keyframes.len();
                status.losses = resumed.losses;
                status.report = resumed.journal.report().clone();
                tracing::info!(
                    "goes on with {} keyframes of {}",
                    state.keyframes.len(),
                    path.display()
                );
                (Writer::Open(Box::new(resumed.journal)), Some(state))
            }
            Ok(Found::Nothing(loss)) => {
                slot.lock().losses.extend(loss);
                (Writer::Missing(path), None)
            }
            // What is there must not be written over by a scan that does not go on with it.
            Err(error) => {
                slot.lock().give_up(&error);
                tracing::error!("no journal is kept: {error}; {}", error.remedy());
                return (Self { slot, thread: None }, None);
            }
        };
        for loss in &slot.lock().losses {
            tracing::warn!("{loss}");
        }
        let keeper = Keeper {
            slot: Arc::clone(&slot),
            writer,
            mesh: earlier
                .as_ref()
                .map_or_else(PacedMesh::default, PacedMesh::of),
            mesh_period,
            target: ScanState::default(),
            retry_at: None,
        };
        let spawned = std::thread::Builder::new()
            .name("veneer-journal".to_owned())
            .spawn(move || keeper.run());
        let thread = match spawned {
            Ok(thread) => Some(thread),
            Err(error) => {
                slot.lock().problem = Some(format!("no thread for the journal: {error}"));
                None
            }
        };
        (Self { slot, thread }, earlier.map(earlier_scan))
    }
}

impl Drop for JournalThread {
    fn drop(&mut self) {
        self.slot.states.end();
        let Some(thread) = self.thread.take() else {
            return;
        };
        let begun = Instant::now();
        while !thread.is_finished() && begun.elapsed() < PATIENCE {
            std::thread::sleep(PATIENCE / 100);
        }
        if !thread.is_finished() {
            tracing::warn!("the disk is slow: the journal ends with what it has acknowledged");
        } else if thread.join().is_err() {
            tracing::error!("the thread that keeps the journal has panicked");
        }
    }
}

/// A capture as a journal holds it.
pub(super) fn scan_state(capture: &Capture, epoch: u64) -> ScanState {
    let keyframes = capture.keyframes.iter();
    ScanState {
        epoch,
        keyframes: keyframes.map(|k| (k.id, Arc::clone(k))).collect(),
        mesh: capture.mesh.clone(),
        mesh_blocks: Arc::clone(&capture.mesh_blocks),
        num_mesh_updates: capture.num_mesh_updates as u64,
        world_frame: capture.ingest.world_frame.clone(),
        ..ScanState::default()
    }
}

/// What a journal held, to be gone on with.
pub(super) fn earlier_scan(state: ScanState) -> EarlierScan {
    EarlierScan {
        keyframes: state.keyframes.into_values().collect(),
        next_id: state.next_id,
        mesh: state.mesh,
        mesh_blocks: state.mesh_blocks,
        num_mesh_updates: usize::try_from(state.num_mesh_updates).unwrap_or(usize::MAX),
        world_frame: state.world_frame,
    }
}

fn disk(path: &Path) -> Box<dyn JournalDisk> {
    Box::new(PathDisk::new(path))
}

/// Reads the journal; waits a while for a process that is about to end.
fn resume(path: &Path) -> Result<Found, JournalError> {
    let begun = Instant::now();
    loop {
        match Journal::resume(disk(path)) {
            Err(error) if error.is_held() && begun.elapsed() < HANDOVER => {
                std::thread::sleep(HANDOVER / 30);
            }
            result => return result,
        }
    }
}

enum Writer {
    /// There is none yet at this path.
    Missing(PathBuf),
    Open(Box<Journal>),
}

/// The mesh that the journal has or is to have: of those that come, not more than one in a period.
#[derive(Default)]
struct PacedMesh {
    epoch: u64,
    num_updates: u64,
    mesh: Option<Arc<TriMesh>>,
    blocks: Arc<MeshBlocks>,
    taken_at: Option<Instant>,
}

impl PacedMesh {
    fn of(state: &ScanState) -> Self {
        Self {
            epoch: state.epoch,
            num_updates: state.num_mesh_updates,
            mesh: state.mesh.clone(),
            blocks: Arc::clone(&state.mesh_blocks),
            taken_at: None,
        }
    }

    /// Takes the mesh of `state`, or gives it the one taken before where that is too young.
    /// Whether it was given that.
    fn pace(&mut self, state: &mut ScanState, period: Duration) -> bool {
        let is_same_scan = self.epoch == state.epoch;
        if is_same_scan && self.num_updates == state.num_mesh_updates {
            return false;
        }
        if is_same_scan && self.taken_at.is_some_and(|at| at.elapsed() < period) {
            state.mesh = self.mesh.clone();
            state.mesh_blocks = Arc::clone(&self.blocks);
            state.num_mesh_updates = self.num_updates;
            return true;
        }
        *self = Self {
            taken_at: Some(Instant::now()),
            ..Self::of(state)
        };
        false
    }
}

/// The thread's own.
struct Keeper {
    slot: Arc<JournalSlot>,
    writer: Writer,
    mesh: PacedMesh,
    mesh_period: Duration,
    /// What the journal is to hold.
    target: ScanState,
    /// When what it lacks is written, if it lacks something.
    retry_at: Option<Instant>,
}

impl Keeper {
    fn run(mut self) {
        loop {
            let newer = self.slot.states.take(POLL);
            let is_last = self.slot.states.has_ended();
            if let Some(newer) = newer {
                self.target = newer;
                // Where the disk has refused, a newer state is no reason to ask it sooner.
                self.retry_at.get_or_insert_with(Instant::now);
            }
            if is_last {
                self.mesh_period = Duration::ZERO;
            }
            if self
                .retry_at
                .is_some_and(|at| is_last || at <= Instant::now())
            {
                self.keep();
            }
            if is_last {
                break;
            }
        }
        if let Writer::Open(journal) = self.writer
            && let Err(error) = journal.close()
        {
            tracing::warn!("the journal was not closed, which costs nothing: {error}");
        }
    }

    /// Brings the journal to what it is to hold.
    fn keep(&mut self) {
        let mut target = self.target.clone();
        let is_mesh_late = self.mesh.pace(&mut target, self.mesh_period);
        let result = self.write(&target);
        self.retry_at = match &result {
            Err(_) => Some(Instant::now() + RETRY),
            Ok(()) if is_mesh_late => Some(Instant::now() + POLL),
            Ok(()) => None,
        };
        let mut status = self.slot.lock();
        if let Writer::Open(journal) = &self.writer {
            status.report = journal.report().clone();
        }
        status.note(result);
    }

    fn write(&mut self, target: &ScanState) -> Result<(), JournalError> {
        let journal = match &mut self.writer {
            Writer::Open(journal) => journal,
            Writer::Missing(path) => {
                let journal = Box::new(Journal::create(disk(path))?);
                self.writer = Writer::Open(journal);
                return self.write(target);
            }
        };
        journal.follow(target)?;
        journal.compact(target)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{
        CameraModel, ColorImage, EncodedColor, PinholeCamera, RigidTransform, Stamp,
    };
    use crate::ingest::MeshBlockSpan;
    use crate::ingest::event::MeshBlockKey;
    use crate::keyframe::{FrameQuality, Keyframe, KeyframeId};
    use crate::pipeline::{LiveScan, PipelineParams};

    fn keyframe(id: u32) -> Arc<Keyframe> {
        let image = ColorImage::new(2, 2, vec![[9, 8, 7]; 4]).unwrap();
        let pinhole = PinholeCamera::new([2.0, 2.0, 0.5, 0.5], 2, 2).unwrap();
        Arc::new(Keyframe {
            id: KeyframeId(id),
            stamp: Stamp::from_nanos(i64::from(id)),
            world_from_camera: RigidTransform::identity(),
            color: EncodedColor::png_from_image(&image).unwrap(),
            color_camera: CameraModel::ideal(pinhole),
            depth: None,
            quality: FrameQuality::default(),
        })
    }

    fn triangle(height_m: f64) -> Arc<TriMesh> {
        let positions = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let positions = positions.map(|[x, y]| nalgebra::Point3::new(x, y, height_m));
        let (mesh, _) = TriMesh::from_soup(positions.to_vec(), vec![[0, 1, 2]]).unwrap();
        Arc::new(mesh)
    }

    fn blocks(mesh: &TriMesh, key: usize) -> Arc<MeshBlocks> {
        let span = MeshBlockSpan {
            key: MeshBlockKey([key.try_into().unwrap(), 0, 0]),
            num_vertices: 3,
            num_triangles: 1,
        };
        Arc::new(MeshBlocks::new(vec![span], mesh).unwrap())
    }

    fn capture(num_keyframes: u32, num_mesh_updates: usize) -> Capture {
        let mut scan = LiveScan::new(&PipelineParams::default(), &[], 0);
        let mesh = triangle(num_mesh_updates as f64);
        scan.resume(EarlierScan {
            keyframes: (0..num_keyframes).map(keyframe).collect(),
            mesh_blocks: blocks(&mesh, num_mesh_updates),
            mesh: Some(mesh),
            num_mesh_updates,
            ..EarlierScan::default()
        })
        .unwrap();
        scan.capture()
    }

    #[track_caller]
    fn wait_until(slot: &JournalSlot, what: &str, is_so: impl Fn(&JournalStatus) -> bool) {
        let begun = Instant::now();
        while !is_so(&slot.status().unwrap()) {
            let status = slot.status().unwrap();
            assert!(
                begun.elapsed() < Duration::from_secs(20),
                "not {what}: {status:?}"
            );
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    #[test]
    fn a_disk_that_comes_back_gets_all_that_it_missed() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("scans");
        let path = folder.join("journal.mcap");
        let slot = Arc::new(JournalSlot::new(path.to_str()));
        let (thread, earlier) = JournalThread::start(Arc::clone(&slot), Duration::ZERO);
        assert!(earlier.is_none());
        for num_keyframes in 1..=5 {
            slot.put(&capture(num_keyframes, 1), 0);
        }
        // The disk may have been asked before all five had come.
        wait_until(&slot, "refused", |status| {
            let problem = status.problem.as_ref();
            problem.is_some_and(|words| words.contains("of 5 keyframes"))
        });
        let told = finding(&slot.status().unwrap());
        for words in [
            folder.to_str().unwrap(),
            "0 of 5 keyframes are safe",
            "make the folder",
        ] {
            assert!(told.message.contains(words), "'{words}': {}", told.message);
        }
        std::fs::create_dir(&folder).unwrap();
        wait_until(&slot, "caught up", |status| {
            status.problem.is_none() && status.report.num_keyframes == 5
        });
        drop(thread);

        let again = Arc::new(JournalSlot::new(path.to_str()));
        let (thread, earlier) = JournalThread::start(Arc::clone(&again), Duration::ZERO);
        let earlier = earlier.unwrap();
        assert_eq!(earlier.keyframes, (0..5).map(keyframe).collect::<Vec<_>>());
        assert_eq!(earlier.mesh.as_deref(), Some(&*triangle(1.0)));
        assert_eq!(again.status().unwrap().num_resumed, 5);
        drop(thread);
    }

    #[test]
    fn meshes_are_paced_and_the_last_one_is_kept_at_the_end() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.mcap");
        let slot = Arc::new(JournalSlot::new(path.to_str()));
        let (thread, _) = JournalThread::start(Arc::clone(&slot), Duration::from_secs(3600));
        slot.put(&capture(1, 1), 0);
        wait_until(&slot, "written", |status| {
            status.report.num_mesh_updates == 1
        });
        slot.put(&capture(2, 9), 0);
        // Keyframes do not wait for the mesh.
        wait_until(&slot, "written", |status| status.report.num_keyframes == 2);
        assert_eq!(slot.status().unwrap().report.num_mesh_updates, 1);
        drop(thread);
        let (thread, earlier) = JournalThread::start(slot_of(&path), Duration::ZERO);
        let earlier = earlier.unwrap();
        assert_eq!(earlier.num_mesh_updates, 9);
        assert_eq!(earlier.mesh.as_deref(), Some(&*triangle(9.0)));
        assert_eq!(earlier.mesh_blocks, blocks(&triangle(9.0), 9));
        drop(thread);
    }

    fn slot_of(path: &Path) -> Arc<JournalSlot> {
        Arc::new(JournalSlot::new(path.to_str()))
    }

    #[test]
    fn what_cannot_be_gone_on_with_is_not_written_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.mcap");
        std::fs::write(&path, b"a letter").unwrap();
        let slot = slot_of(&path);
        let (thread, earlier) = JournalThread::start(Arc::clone(&slot), Duration::ZERO);
        assert!(earlier.is_none());
        slot.put(&capture(1, 1), 0);
        let told = finding(&slot.status().unwrap());
        assert!(
            told.message.contains("no journal is kept"),
            "{}",
            told.message
        );
        drop(thread);
        assert_eq!(std::fs::read(&path).unwrap(), b"a letter");
    }
}
