//! The pipeline while the scan is being made.
//!
//! [`LiveScan`] is the front: it takes events one by one, as [`super::gather()`] does, and never
//! waits for the rest. When keyframes or mesh have changed, a [`Capture`] of what there is (shared
//! pointers, no copies) goes into a slot that holds one: [`Latest`]. [`Painter`] takes from it on
//! a thread of its own and paints the whole with [`super::texture_scan()`], or what changed
//! ([`PipelineParams::follows_changes`]); changes that come meanwhile coalesce, and the latest is
//! painted next. Where none comes, what was painted is refined step by step.
//!
//! Where the whole is painted it depends on the events alone: once the stream has ended and is flushed, it is
//! what [`super::run()`] makes of the same events with no keyframe held back.

mod latest;
mod resume;

use std::sync::Arc;

use super::clock::StageClock;
use super::memory::MemoryPlan;
use super::progress::Progress;
use super::region::RegionParams;
use super::run::{PipelineError, PipelineParams, StageTime};
use super::scan::{Scan, prepared_mesh};
use super::stream::{StreamPainter, Streamed};
use super::texture::{Textured, texture_scan};
use crate::atlas::{AtlasLayout, AtlasTexture, ChartKey};
use crate::geom::Stamp;
use crate::ingest::{Assembled, Assembler, IngestReport, MeshBlocks, TimedEvent};
use crate::keyframe::quality;
use crate::keyframe::{Keyframe, KeyframeParams, KeyframeReport, KeyframeStore};
use crate::mesh::TriMesh;
use crate::texinit::stream::StreamUpdate;

pub use latest::Latest;
pub use resume::EarlierScan;

/// What there is of a scan at one moment.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Counts the changes of keyframes and mesh; never falls.
    pub revision: u64,
    /// When the last event was received.
    pub stamp: Stamp,
    /// The mesh in the world frame, as it arrived.
    pub mesh: Option<Arc<TriMesh>>,
    /// Its blocks; none where it came whole.
    pub mesh_blocks: Arc<MeshBlocks>,
    /// All keyframes, in order.
    pub keyframes: Vec<Arc<Keyframe>>,
    /// What ingest received, used and refused.
    pub ingest: IngestReport,
    /// What the keyframe store kept and dropped.
    pub store: KeyframeReport,
    /// Images and meshes that still wait for something.
    pub num_pending: usize,
    /// From the first message to the last, in the time of the stream, seconds.
    pub duration_s: f64,
    /// How often the mesh changed.
    pub num_mesh_updates: usize,
}

impl Capture {
    /// Whether there is a mesh and a frame to paint it from.
    pub fn is_paintable(&self) -> bool {
        let has_triangles = self.mesh.as_ref().is_some_and(|m| m.num_triangles() > 0);
        has_triangles && !self.keyframes.is_empty()
    }
}

/// Frames and mesh of a scan that goes on.
#[derive(Debug)]
pub struct LiveScan {
    assembler: Assembler,
    store: KeyframeStore,
    mesh: Option<Arc<TriMesh>>,
    mesh_blocks: Arc<MeshBlocks>,
    region: RegionParams,
    num_mesh_updates: usize,
    revision: u64,
    span: Option<(Stamp, Stamp)>,
    /// The frame of what was adopted.
    adopted_frame: Option<String>,
    scratch: Vec<Assembled>,
}

impl LiveScan {
    /// An empty scan of a stream whose events refer to `topics`. Its revisions go on from
    /// `revision`, so that those of a scan after a reset differ from those before.
    pub fn new(params: &PipelineParams, topics: &[String], revision: u64) -> Self {
        let keyframe = params.memory.applied_to(params).keyframe;
        let keyframe = KeyframeParams {
            // The painter decodes, and has the cache.
            decode_cache_mb: 0.0,
            ..params.region.applied_to(&keyframe)
        };
        Self {
            assembler: Assembler::new(&params.ingest, topics),
            store: KeyframeStore::new(&keyframe),
            mesh: None,
            mesh_blocks: Arc::default(),
            region: params.region,
            num_mesh_updates: 0,
            revision,
            span: None,
            adopted_frame: None,
            scratch: Vec::new(),
        }
    }

    /// Takes the next event; whether keyframes or mesh changed by it.
    pub fn push(&mut self, event: TimedEvent) -> bool {
        let received = event.received;
        let (first, last) = self.span.unwrap_or((received, received));
        self.span = Some((first.min(received), last.max(received)));
        let mut assembled = std::mem::take(&mut self.scratch);
        self.assembler.push(event, &mut assembled);
        let blocks = Arc::clone(self.assembler.mesh_blocks());
        self.take(assembled, &blocks)
    }

    /// The stream has paused: what waits for a partner or a pose leaves, or is refused. Whether
    /// keyframes or mesh changed by it.
    pub fn flush(&mut self) -> bool {
        let mut assembled = std::mem::take(&mut self.scratch);
        self.assembler.finish(&mut assembled);
        let blocks = Arc::clone(self.assembler.mesh_blocks());
        self.take(assembled, &blocks)
    }

    /// Takes frames and meshes that were put together elsewhere, in the frame `world_frame`; whether
    /// keyframes or mesh changed by it. What comes later must be in the same frame; blocks of a mesh
    /// that come later replace the whole mesh that was adopted.
    pub fn adopt(&mut self, assembled: Vec<Assembled>, world_frame: Option<String>) -> bool {
        self.adopted_frame = world_frame;
        self.take(assembled, &Arc::default())
    }

    /// Images and meshes that still wait for something.
    pub fn num_pending(&self) -> usize {
        self.assembler.num_pending()
    }

    /// See [`Capture::revision`].
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// What ingest received, used and refused.
    pub fn ingest_report(&self) -> &IngestReport {
        self.assembler.report()
    }

    /// What the keyframe store kept and dropped.
    pub fn keyframe_report(&self) -> &KeyframeReport {
        self.store.report()
    }

    /// What there is now.
    pub fn capture(&self) -> Capture {
        let mut ingest = self.assembler.report().clone();
        ingest.world_frame = ingest.world_frame.or_else(|| self.adopted_frame.clone());
        let newest = self.store.keyframes().last().map(|keyframe| keyframe.stamp);
        Capture {
            revision: self.revision,
            stamp: match self.span {
                Some((_, last)) => last,
                None => newest.unwrap_or_default(),
            },
            mesh: self.mesh.clone(),
            mesh_blocks: Arc::clone(&self.mesh_blocks),
            keyframes: self.store.keyframes().cloned().collect(),
            ingest,
            store: self.store.report().clone(),
            num_pending: self.assembler.num_pending(),
            duration_s: self
                .span
                .map_or(0.0, |(first, last)| last.seconds_since(first)),
            num_mesh_updates: self.num_mesh_updates,
        }
    }

    /// `blocks` are those of a mesh among them.
    fn take(&mut self, mut assembled: Vec<Assembled>, blocks: &Arc<MeshBlocks>) -> bool {
        let before = self.revision;
        for item in assembled.drain(..) {
            match item {
                Assembled::Frame(frame) => {
                    let quality = quality::measure(&frame.color);
                    let num_admitted = self.store.report().num_admitted;
                    // The store counts what it does with each frame.
                    drop(self.store.offer_measured(frame, quality));
                    let is_kept = self.store.report().num_admitted != num_admitted;
                    self.revision += u64::from(is_kept);
                }
                Assembled::Mesh(mesh) => {
                    let (mesh, blocks) = self.region.cut_blocks(mesh, blocks);
                    (self.mesh, self.mesh_blocks) = (Some(mesh), blocks);
                    self.num_mesh_updates += 1;
                    self.revision += 1;
                }
                Assembled::Corrections(corrections) => {
                    let poses: Vec<_> = corrections.iter().map(|c| (c.stamp, c.pose)).collect();
                    let num_moved = self.store.correct_poses(&poses);
                    self.revision += u64::from(num_moved > 0);
                }
            }
        }
        self.scratch = assembled;
        self.revision != before
    }
}

/// A capture and its texture.
#[derive(Debug)]
pub struct Painted {
    /// What was painted.
    pub capture: Capture,
    /// The mesh in the world frame, welded and subdivided; what the texture is for.
    pub mesh: Arc<TriMesh>,
    /// Where its triangles lie.
    pub layout: Arc<AtlasLayout>,
    /// The pages, which may be shared with the painter. Sources name keyframes by their ids.
    pub texture: AtlasTexture,
    /// What stands for the charts of the layout, where that is known.
    pub chart_keys: Option<Vec<ChartKey>>,
    /// The keyframes that painted, their poses corrected where that was asked for.
    pub keyframes: Vec<Arc<Keyframe>>,
    /// What changed since the capture before, where only that was painted.
    pub update: Option<StreamUpdate>,
    /// How memory was divided.
    pub memory: MemoryPlan,
    /// Wall times, in order.
    pub stages: Vec<StageTime>,
}

/// What an idle step came to.
#[derive(Debug)]
pub enum IdleStep {
    /// There was nothing to refine.
    Nothing,
    /// The texture is as it was; there may be more to do.
    Unchanged,
    /// The last capture's texture, refined in part.
    Refined(Box<Painted>),
}

/// Paints captures; keeps decoded images between them.
#[derive(Debug)]
pub struct Painter {
    cache: Option<KeyframeStore>,
    stream: StreamPainter,
}

impl Painter {
    /// A painter with an empty cache of the size that `params` says.
    pub fn new(params: &KeyframeParams) -> Self {
        Self {
            cache: Some(KeyframeStore::new(params)),
            stream: StreamPainter::new(params),
        }
    }

    /// Bytes of decoded images that are kept.
    pub fn num_cached_bytes(&self) -> usize {
        let cache = self.cache.as_ref();
        let of_whole = cache.map_or(0, |store| store.cache_report().num_bytes);
        of_whole + self.stream.num_cached_bytes()
    }

    /// Paints the whole, or where [`PipelineParams::follows_changes`] what changed since the last
    /// capture.
    ///
    /// # Errors
    /// [`PipelineError`] when the capture is not paintable, its mesh cannot be welded, or a stage
    /// refuses its parameters.
    pub fn paint(
        &mut self,
        capture: Capture,
        params: &PipelineParams,
        progress: &dyn Progress,
    ) -> Result<Painted, PipelineError> {
        if params.follows_changes() && capture.is_paintable() {
            return self.paint_changes(capture, params, progress);
        }
        let clock = StageClock::new(progress);
        let params = &params.memory.applied_to(params);
        let Some(mesh) = capture.mesh.as_ref().filter(|m| m.num_triangles() > 0) else {
            return Err(PipelineError::NoMesh("none has arrived".to_owned()));
        };
        if capture.keyframes.is_empty() {
            let words = "none was kept so far".to_owned();
            return Err(PipelineError::NoKeyframe(words));
        }
        clock.begin("weld the mesh", 0);
        let (mesh, num_welded_vertices) = prepared_mesh(mesh, params)?;
        let store = self.cache.take();
        let store = store.unwrap_or_else(|| KeyframeStore::new(&params.keyframe));
        let scan = Scan::new(mesh, &capture, num_welded_vertices, store, params);
        let memory = scan.memory;
        let textured = texture_scan(&scan, &capture.keyframes, params, &clock);
        let (mut mesh, store) = scan.into_parts();
        self.cache = Some(store);
        let Textured {
            keyframes,
            mut texinit,
            ..
        } = textured?;
        params.region.keep_own_of(&mut mesh, &mut texinit);
        Ok(Painted {
            capture,
            mesh: Arc::new(mesh),
            layout: Arc::new(texinit.layout),
            texture: texinit.texture,
            chart_keys: None,
            keyframes,
            update: None,
            memory,
            stages: clock.finish(),
        })
    }

    fn paint_changes(
        &mut self,
        capture: Capture,
        params: &PipelineParams,
        progress: &dyn Progress,
    ) -> Result<Painted, PipelineError> {
        let params = &params.memory.applied_to(params);
        let memory = memory_plan(&capture, params);
        let decode_cache = usize::try_from(memory.decode_cache).unwrap_or(usize::MAX);
        self.stream.set_decode_cache_bytes(decode_cache);
        let streamed = self.stream.paint(capture, params, progress)?;
        self.shown(streamed, memory, params)
    }

    /// Whether [`Self::refine_some`] has something to do.
    pub fn has_idle_work(&self) -> bool {
        self.stream.has_idle_work()
    }

    /// Charts that wait to be refined, and keyframes whose pose does.
    pub fn num_waiting(&self) -> [usize; 2] {
        [
            self.stream.num_charts_waiting(),
            self.stream.num_poses_waiting(),
        ]
    }

    /// All charts of what was painted of changes are to be refined by the optimisation in idle time, by at
    /// least so many steps over the whole; see [`StreamPainter::smooth_all`].
    pub fn smooth_all(&mut self, num_steps: usize, params: &PipelineParams) {
        let params = &params.memory.applied_to(params);
        self.stream.smooth_all(num_steps, params);
    }

    /// The next painting takes that back; see [`StreamPainter::take_back_smooth_all`].
    pub fn take_back_smooth_all(&mut self) {
        self.stream.take_back_smooth_all();
    }

    /// Refines a bounded part of what was painted of changes; see [`StreamPainter::refine_some`].
    ///
    /// # Errors
    /// [`PipelineError`] when a stage refuses its parameters.
    pub fn refine_some(
        &mut self,
        params: &PipelineParams,
        progress: &dyn Progress,
    ) -> Result<IdleStep, PipelineError> {
        let params = &params.memory.applied_to(params);
        if !params.follows_changes() {
            return Ok(IdleStep::Nothing);
        }
        let Some(step) = self.stream.refine_some(params, progress)? else {
            return Ok(IdleStep::Nothing);
        };
        if !step.update.has_changes() {
            return Ok(IdleStep::Unchanged);
        }
        let memory = memory_plan(&step.capture, params);
        let refined = self.shown(step, memory, params)?;
        Ok(IdleStep::Refined(Box::new(refined)))
    }

    /// What is shown of changes, for those who publish it.
    fn shown(
        &self,
        streamed: Streamed,
        memory: MemoryPlan,
        params: &PipelineParams,
    ) -> Result<Painted, PipelineError> {
        let (Some(state), Some(texture)) = (self.stream.state(), self.stream.texture()) else {
            return Err(PipelineError::NoMesh("nothing is painted".to_owned()));
        };
        let (mut mesh, mut layout) = (Arc::clone(state.mesh()), Arc::clone(state.layout()));
        let mut texture = texture.clone();
        let mut chart_keys = Some(state.chart_keys());
        if params.region.region.is_some() {
            let (mesh, layout) = (Arc::make_mut(&mut mesh), Arc::make_mut(&mut layout));
            params.region.keep_own(mesh, layout, &mut texture);
            chart_keys = None;
        }
        Ok(Painted {
            mesh,
            layout,
            texture,
            chart_keys,
            keyframes: streamed.keyframes,
            update: Some(streamed.update),
            memory,
            capture: streamed.capture,
            stages: streamed.stages,
        })
    }
}

/// How the budget is divided for a capture.
pub(super) fn memory_plan(capture: &Capture, params: &PipelineParams) -> MemoryPlan {
    let num_bytes = capture.keyframes.iter().map(|k| k.num_bytes()).sum();
    let num_triangles = capture.mesh.as_ref().map_or(0, |m| m.num_triangles());
    let num_keyframes = capture.keyframes.len();
    params
        .memory
        .plan(params, num_bytes, num_keyframes, num_triangles)
}
