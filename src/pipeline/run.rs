//! One run, from the first event to the textured mesh.

use std::sync::Arc;

use super::clock::StageClock;
use super::held_out::{self, HeldOutParams, HeldOutView};
use super::memory::{MemoryParams, MemoryPlan};
use super::progress::Progress;
use super::refine::{RefineParams, RefineReport};
use super::region::RegionParams;
use super::scan::gather;
use super::stream::UpdateSummary;
use super::stream::idle::{IdleParams, StreamMode};
use super::texture::{Textured, texture_scan};
use crate::ingest::{EventSource, IngestParams, IngestReport};
use crate::keyframe::{Keyframe, KeyframeParams, KeyframeReport};
use crate::mesh::weld::WeldError;
use crate::mesh::{MeshError, TriMesh};
use crate::photometric::PhotometricError;
use crate::texinit::stream::{StreamError, StreamParams};
use crate::texinit::{TexInit, TexInitError, TexInitParams};
use crate::texsmooth::{SmoothError, SmoothReport, TexSmoothParams};

/// Settings of a whole run.
#[derive(Clone, Debug, Default)]
pub struct PipelineParams {
    /// From events to posed frames.
    pub ingest: IngestParams,
    /// Which frames are kept.
    pub keyframe: KeyframeParams,
    /// Vertices closer than this are one, metres; 0 joins those of equal position only.
    pub weld_tolerance_m: f64,
    /// Which part of the world is painted.
    pub region: RegionParams,
    /// Rounds of Loop subdivision after welding; each makes four triangles of one.
    pub num_subdivisions: u32,
    /// From frames and mesh to a texture.
    pub texinit: TexInitParams,
    /// Gains of keyframes and levelled seams.
    pub refine: RefineParams,
    /// From an initial texture to a sharp one.
    pub texsmooth: TexSmoothParams,
    /// Whether [`super::Painter`] paints only what changed since its last capture, and replay is
    /// [`super::run_streamed`].
    pub stream_mode: StreamMode,
    /// How it does that.
    pub stream: StreamParams,
    /// How much is refined at a time while nothing changes.
    pub idle: IdleParams,
    /// A checkpoint of the optimisation to go on from.
    pub smooth_from: Option<Arc<Vec<u8>>>,
    /// What is held back to judge the result.
    pub held_out: HeldOutParams,
    /// The budget over everything that is kept in memory.
    pub memory: MemoryParams,
}

/// Why a run ended without a texture.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// No mesh arrived, or what arrived has no triangle.
    #[error("no mesh to paint: {0}")]
    NoMesh(String),
    /// No frame was kept.
    #[error("no frame to paint from: {0}")]
    NoKeyframe(String),
    /// The mesh could not be welded.
    #[error(transparent)]
    Weld(#[from] WeldError),
    /// The mesh could not be subdivided.
    #[error(transparent)]
    Subdivide(#[from] MeshError),
    /// The texture could not be made.
    #[error(transparent)]
    TexInit(#[from] TexInitError),
    /// The texture could not be kept up.
    #[error(transparent)]
    Stream(#[from] StreamError),
    /// A setting that works on the whole texture at once, where changes are to be followed.
    #[error("{0} works on the whole texture at once and cannot follow changes; switch it off")]
    WholeScanOnly(&'static str),
    /// Gains or seams could not be worked on.
    #[error(transparent)]
    Photometric(#[from] PhotometricError),
    /// The texture could not be refined.
    #[error(transparent)]
    TexSmooth(#[from] SmoothError),
}

/// Wall time of a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageTime {
    /// Its name for people.
    pub name: &'static str,
    /// Wall time in seconds.
    pub seconds: f64,
}

/// What a run made.
#[derive(Debug)]
pub struct Run {
    /// The mesh in the world frame, welded.
    pub mesh: TriMesh,
    /// The keyframes that painted; labels are indices into them, texel sources their ids.
    pub keyframes: Vec<Arc<Keyframe>>,
    /// The texture and how it came about.
    pub texinit: TexInit,
    /// What gains and seam levelling did.
    pub refine: RefineReport,
    /// How the optimisation went; `None` where none was asked for.
    pub texsmooth: Option<SmoothReport>,
    /// Keyframes that were held back, beside the rendering.
    pub held_out: Vec<HeldOutView>,
    /// What ingest received, used and refused.
    pub ingest: IngestReport,
    /// What the keyframe store kept and dropped.
    pub store: KeyframeReport,
    /// From the first message to the last, in the time of the stream, seconds.
    pub duration_s: f64,
    /// How often the mesh changed.
    pub num_mesh_updates: usize,
    /// Vertices that welding merged into others.
    pub num_welded_vertices: usize,
    /// How memory was divided.
    pub memory: MemoryPlan,
    /// What the updates did, where the texture was kept up while the stream went on.
    pub updates: Option<UpdateSummary>,
    /// Wall times, in order.
    pub stages: Vec<StageTime>,
}

/// Runs the whole pipeline over `source`.
///
/// # Errors
/// [`PipelineError`] when the stream held no mesh or no usable frame, with what was refused and
/// why; and when TexInit refuses its parameters. Single bad messages are no error: they are
/// counted in [`Run::ingest`].
pub fn run(
    source: &mut dyn EventSource,
    params: &PipelineParams,
    progress: &dyn Progress,
) -> Result<Run, PipelineError> {
    let clock = StageClock::new(progress);
    let params = &params.memory.applied_to(params);
    let mut scan = gather(source, params, &clock)?;
    let keyframes = std::mem::take(&mut scan.keyframes);
    let (painting, judging) = held_out::split(keyframes, &params.held_out);

    let Textured {
        keyframes,
        mut texinit,
        refine,
        texsmooth,
    } = texture_scan(&scan, &painting, params, &clock)?;
    params.region.keep_own_of(&mut scan.mesh, &mut texinit);

    clock.begin("render held-out views", judging.len());
    let held_out = held_out::render_views(
        &judging,
        &|keyframe| scan.decode(keyframe),
        &scan.mesh,
        &texinit.layout,
        &texinit.texture,
    );

    Ok(Run {
        memory: scan.memory,
        store: scan.store_report().clone(),
        mesh: scan.mesh,
        keyframes,
        texinit,
        refine,
        texsmooth,
        held_out,
        ingest: scan.ingest,
        duration_s: scan.duration_s,
        num_mesh_updates: scan.num_mesh_updates,
        num_welded_vertices: scan.num_welded_vertices,
        updates: None,
        stages: clock.finish(),
    })
}
