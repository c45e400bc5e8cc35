//! The threads that ingest and paint, and the orders that they take.
//!
//! Ingest decodes what waits in the inbox and selects keyframes; it never waits for painting.
//! Painting takes the latest capture, at most one in `paint_period`, and hands on what it made; while
//! none comes it refines that.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::config::Config;
use crate::ingest::{EventSource, TimedEvent};
use crate::pipeline::{Capture, EarlierScan, Latest, LiveScan, MemoryPlan, Painted};
use crate::publish::Snapshot;

use super::error::NodeError;
use super::files::Session;
use super::inbox::Inbox;
use super::inputs::Input;
use super::journal::{JournalSlot, JournalThread};
use super::source::{LiveSource, Polled};
use painting::paint;

mod coverage;
mod painting;

/// How long ingest sleeps at a time.
const POLL: Duration = Duration::from_millis(100);
/// How often diagnostics get a new view of the scan.
const VIEW_PERIOD: Duration = Duration::from_millis(250);

/// An order to ingest, done between two messages.
pub(super) enum Order {
    /// Forget the scan.
    Reset(Sender<()>),
    /// Give up on what waits for a partner or a pose, and tell what there is.
    Capture(Sender<Capture>),
    /// Go on from a session, after forgetting the scan.
    Load(Box<Session>, Sender<()>),
}

/// How long a stage takes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct StageStatus {
    /// How often it ran.
    pub(super) num_runs: u64,
    /// The last run, seconds.
    pub(super) last_s: f64,
    /// All runs, seconds.
    pub(super) sum_s: f64,
}

/// What painting did.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PaintStatus {
    /// Paintings made.
    pub(super) num_painted: u64,
    /// Paintings that failed.
    pub(super) num_failed: u64,
    /// Why the last one failed.
    pub(super) last_error: Option<String>,
    /// Whether a painting is being made.
    pub(super) is_painting: bool,
    /// By stage, in seconds.
    pub(super) stages: BTreeMap<&'static str, StageStatus>,
    /// Share of the mesh's triangles that a keyframe painted, 0 to 1.
    pub(super) coverage: f32,
    /// Charts of the atlas.
    pub(super) num_charts: usize,
    /// Pages of the atlas.
    pub(super) num_pages: usize,
    /// The revision painted last.
    pub(super) revision: u64,
    /// Bytes of decoded images that are kept between paintings.
    pub(super) num_cached_bytes: usize,
    /// How memory is divided.
    pub(super) memory: MemoryPlan,
    /// Steps that refined while nothing new came.
    pub(super) num_idle_steps: u64,
    /// Charts that wait for that.
    pub(super) num_charts_waiting: usize,
    /// Keyframes whose pose waits to be measured.
    pub(super) num_poses_waiting: usize,
    /// Keyframes that the last painting left for another.
    pub(super) num_frames_waiting: usize,
}

/// A painting as it is published.
#[derive(Debug)]
pub(super) struct Painting {
    /// Differs from that of any scan before a reset.
    pub(super) session: u64,
    /// Counts the paintings of the session, from 1.
    pub(super) revision: u64,
    pub(super) painted: Painted,
}

impl Painting {
    /// What is published of it.
    pub(super) fn snapshot(&self) -> Snapshot<'_> {
        let painted = &self.painted;
        let frame = painted.capture.ingest.world_frame.as_deref();
        Snapshot {
            stamp: painted.capture.stamp,
            frame_id: frame.unwrap_or_default(),
            session: self.session,
            revision: self.revision,
            mesh: &painted.mesh,
            layout: &painted.layout,
            texture: &painted.texture,
            keyframes: &painted.keyframes,
            chart_keys: painted.chart_keys.as_deref(),
        }
    }
}

/// What all threads share.
pub(super) struct Shared {
    config: RwLock<Config>,
    pub(super) inbox: Arc<Inbox>,
    captures: Latest<Capture>,
    pub(super) painted: Latest<Arc<Painting>>,
    last_painted: Mutex<Option<Arc<Painting>>>,
    view: Mutex<Option<Capture>>,
    paint_status: Mutex<PaintStatus>,
    /// Set to paint the latest capture again though nothing changed.
    retexture: AtomicBool,
    /// Set while a painting is to be refined by the optimisation, once.
    refine: AtomicBool,
    num_resets: AtomicU64,
    first_session: u64,
    pub(super) journal: Arc<JournalSlot>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Values are replaced whole, so a panic elsewhere leaves them usable.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// `session` differs from that of any run of the node before.
    pub(super) fn new(config: Config, inbox: Arc<Inbox>, session: u64) -> Self {
        let journal = JournalSlot::new(config.node.journal_path.as_deref());
        Self {
            config: RwLock::new(config),
            inbox,
            captures: Latest::default(),
            painted: Latest::default(),
            last_painted: Mutex::default(),
            view: Mutex::default(),
            paint_status: Mutex::default(),
            retexture: AtomicBool::new(false),
            refine: AtomicBool::new(false),
            num_resets: AtomicU64::new(0),
            first_session: session,
            journal: Arc::new(journal),
        }
    }

    /// The configuration as it is now.
    pub(super) fn config(&self) -> Config {
        let config = self.config.read().unwrap_or_else(PoisonError::into_inner);
        config.clone()
    }

    /// Why each change paints the whole, where that was not asked for.
    pub(super) fn why_whole(&self) -> Option<String> {
        self.config().pipeline.for_live().1
    }

    /// From now on another configuration.
    pub(super) fn set_config(&self, config: Config) {
        *self.config.write().unwrap_or_else(PoisonError::into_inner) = config;
    }

    /// What the scan was like a moment ago.
    pub(super) fn view(&self) -> Option<Capture> {
        lock(&self.view).clone()
    }

    /// What was painted last.
    pub(super) fn last_painted(&self) -> Option<Arc<Painting>> {
        lock(&self.last_painted).clone()
    }

    pub(super) fn paint_status(&self) -> PaintStatus {
        lock(&self.paint_status).clone()
    }

    /// Captures that a newer one replaced before they were painted.
    pub(super) fn num_captures_replaced(&self) -> u64 {
        self.captures.num_replaced()
    }

    /// How often the scan was forgotten.
    pub(super) fn num_resets(&self) -> u64 {
        self.num_resets.load(Ordering::Relaxed)
    }

    /// Paints `capture` again, refined by the optimisation or not.
    pub(super) fn paint_again(&self, capture: Capture, is_refined: bool) {
        self.refine.store(is_refined, Ordering::Relaxed);
        self.retexture.store(true, Ordering::Relaxed);
        self.captures.put(capture);
    }

    /// Lets all threads go.
    pub(super) fn shut(&self) {
        self.inbox.shut();
        self.captures.shut();
        self.painted.shut();
    }
}

/// The two threads.
pub(super) struct Engine {
    orders: Sender<Order>,
    shared: Arc<Shared>,
    ingest: Option<JoinHandle<()>>,
}

impl Engine {
    pub(super) fn start(shared: Arc<Shared>, inputs: &[Input]) -> Result<Self, NodeError> {
        let (orders, receiver) = channel();
        let config = shared.config();
        let mesh_frame = config.topics.mesh_frame.as_deref();
        let source = LiveSource::new(Arc::clone(&shared.inbox), inputs, mesh_frame);
        let spawn = |name: &str, run: Box<dyn FnOnce() + Send>| {
            std::thread::Builder::new()
                .name(name.to_owned())
                .spawn(run)
                .map_err(|source| NodeError::System {
                    what: "a thread",
                    source,
                })
        };
        let ingest = spawn("veneer-ingest", {
            let shared = Arc::clone(&shared);
            Box::new(move || ingest(&shared, source, &receiver))
        })?;
        // Not joined: a painting may take minutes, and the process should not wait for it to end.
        spawn("veneer-paint", {
            let shared = Arc::clone(&shared);
            Box::new(move || paint(&shared))
        })?;
        Ok(Self {
            orders,
            shared,
            ingest: Some(ingest),
        })
    }

    fn order(&self, order: Order) {
        // Where ingest has ended, the answer's channel closes, which tells the one who asks.
        if self.orders.send(order).is_ok() {
            self.shared.inbox.wake();
        }
    }

    /// Forgets the scan; `None` when ingest has ended.
    pub(super) fn reset(&self) -> Option<()> {
        let (done, wait) = channel();
        self.order(Order::Reset(done));
        wait.recv().ok()
    }

    /// What there is now, all that waited taken in; `None` when ingest has ended.
    pub(super) fn capture(&self) -> Option<Capture> {
        let (done, wait) = channel();
        self.order(Order::Capture(done));
        wait.recv().ok()
    }

    /// Replaces the scan by a session; `None` when ingest has ended.
    pub(super) fn load(&self, session: Session) -> Option<()> {
        let (done, wait) = channel();
        self.order(Order::Load(Box::new(session), done));
        wait.recv().ok()
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.shared.shut();
        if let Some(thread) = self.ingest.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that ingests has panicked");
        }
    }
}

struct Ingest<'a> {
    shared: &'a Shared,
    source: LiveSource,
    scan: LiveScan,
    last_event: Option<Instant>,
    viewed: Option<Instant>,
}

fn ingest(shared: &Shared, source: LiveSource, orders: &Receiver<Order>) {
    let config = shared.config();
    let scan = LiveScan::new(&config.pipeline, source.topics(), 0);
    let mut ingest = Ingest {
        shared,
        source,
        scan,
        last_event: None,
        viewed: None,
    };
    let mesh_period = Duration::from_secs_f64(config.node.journal_mesh_period_s);
    let (_journal, earlier) = JournalThread::start(Arc::clone(&shared.journal), mesh_period);
    if let Some(earlier) = earlier {
        ingest.resume(earlier);
        ingest.hand_on();
    }
    loop {
        match ingest.source.poll(POLL) {
            Polled::Event(event) => ingest.push(*event),
            Polled::Nothing => {}
            Polled::Idle => ingest.flush_when_silent(),
            Polled::End => break,
        }
        while let Ok(order) = orders.try_recv() {
            ingest.obey(order);
        }
        ingest.show();
    }
}

impl Ingest<'_> {
    fn push(&mut self, event: TimedEvent) {
        self.last_event = Some(Instant::now());
        if self.scan.push(event) {
            self.hand_on();
        }
    }

    fn hand_on(&self) {
        let capture = self.scan.capture();
        self.shared.journal.put(&capture, self.shared.num_resets());
        if capture.is_paintable() {
            self.shared.captures.put(capture);
        }
    }

    fn flush_when_silent(&mut self) {
        let silence = Duration::from_secs_f64(self.shared.config().node.idle_flush_s);
        if self.scan.num_pending() > 0 && self.last_event.is_some_and(|at| at.elapsed() > silence) {
            self.flush();
        }
    }

    fn flush(&mut self) {
        if self.scan.flush() {
            self.hand_on();
        }
    }

    fn obey(&mut self, order: Order) {
        // Whoever asked may have gone meanwhile; the order is carried out all the same.
        match order {
            Order::Reset(done) => {
                self.shared.inbox.clear();
                self.reset();
                done.send(()).ok();
            }
            Order::Capture(done) => {
                self.flush();
                done.send(self.scan.capture()).ok();
            }
            Order::Load(session, done) => {
                self.reset();
                match *session {
                    Session::Exact(scan) => self.resume(scan),
                    Session::Recorded {
                        assembled,
                        world_frame,
                    } => {
                        self.scan.adopt(assembled, world_frame);
                    }
                }
                self.hand_on();
                done.send(()).ok();
            }
        }
        self.viewed = None;
    }

    fn resume(&mut self, earlier: EarlierScan) {
        // What is read from a file was checked there.
        if let Err(error) = self.scan.resume(earlier) {
            tracing::error!("the earlier scan is not gone on with: {error}");
        }
    }

    fn reset(&mut self) {
        let params = self.shared.config().pipeline;
        self.source.reset();
        let revision = self.scan.revision() + 1;
        self.scan = LiveScan::new(&params, self.source.topics(), revision);
        self.last_event = None;
        *lock(&self.shared.last_painted) = None;
        self.shared.num_resets.fetch_add(1, Ordering::Relaxed);
        self.hand_on();
    }

    /// Lets diagnostics see the scan.
    fn show(&mut self) {
        let now = Instant::now();
        if self.viewed.is_none_or(|at| now - at >= VIEW_PERIOD) {
            self.viewed = Some(now);
            *lock(&self.shared.view) = Some(self.scan.capture());
        }
    }
}
