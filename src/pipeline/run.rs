//! One run, from the first event to the textured mesh.

use std::sync::Arc;

use rayon::prelude::*;

use super::clock::StageClock;
use super::held_out::{self, HeldOutParams, HeldOutView};
use super::progress::Progress;
use crate::geom::{ImageError, PosedFrame, Stamp};
use crate::ingest::{Assembled, Assembler, EventSource, IngestParams, IngestReport};
use crate::keyframe::quality;
use crate::keyframe::{FrameQuality, Keyframe, KeyframeParams, KeyframeReport, KeyframeStore};
use crate::mesh::weld::{WeldError, weld};
use crate::mesh::{MeshError, TriMesh, subdivide};
use crate::texinit::{TexInit, TexInitError, TexInitParams, texinit};

/// Settings of a whole run.
#[derive(Clone, Debug, Default)]
pub struct PipelineParams {
    /// From events to posed frames.
    pub ingest: IngestParams,
    /// Which frames are kept.
    pub keyframe: KeyframeParams,
    /// Vertices closer than this are one, metres; 0 joins those of equal position only.
    pub weld_tolerance_m: f64,
    /// Rounds of Loop subdivision after welding; each makes four triangles of one.
    pub num_subdivisions: u32,
    /// From frames and mesh to a texture.
    pub texinit: TexInitParams,
    /// What is held back to judge the result.
    pub held_out: HeldOutParams,
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

    clock.begin("read and select frames", 0);
    let gathered = gather(source, params, &clock);
    let Gathered { store, ingest, .. } = &gathered;
    let mesh = gathered
        .mesh
        .as_ref()
        .filter(|mesh| mesh.num_triangles() > 0)
        .ok_or_else(|| PipelineError::NoMesh(why_nothing(ingest, "mesh")))?;
    let keyframes: Vec<_> = store.keyframes().cloned().collect();
    if keyframes.is_empty() {
        return Err(PipelineError::NoKeyframe(why_nothing(ingest, "frame")));
    }

    clock.begin("weld the mesh", 0);
    let welded = weld(mesh, params.weld_tolerance_m)?;
    let mesh = match params.num_subdivisions {
        0 => welded.mesh,
        num_rounds => subdivide(&welded.mesh, num_rounds)?,
    };
    let (painting, judging) = held_out::split(keyframes, &params.held_out);

    let decode = |keyframe: &Keyframe| store.decode(keyframe);
    let texinit = texinit(&mesh, &painting, &decode, &params.texinit, &clock)?;

    clock.begin("render held-out views", judging.len());
    let held_out =
        held_out::render_views(&judging, &decode, &mesh, &texinit.layout, &texinit.texture);

    Ok(Run {
        mesh,
        keyframes: painting,
        texinit,
        held_out,
        store: store.report().clone(),
        ingest: gathered.ingest,
        duration_s: gathered.duration_s,
        num_mesh_updates: gathered.num_mesh_updates,
        num_welded_vertices: welded.num_merged,
        stages: clock.finish(),
    })
}

struct Gathered {
    store: KeyframeStore,
    mesh: Option<Arc<TriMesh>>,
    num_mesh_updates: usize,
    duration_s: f64,
    ingest: IngestReport,
}

/// Takes every event of the stream; the mesh that arrived last is the one that counts.
fn gather(
    source: &mut dyn EventSource,
    params: &PipelineParams,
    clock: &StageClock<'_>,
) -> Gathered {
    let mut reader = FrameReader {
        assembler: Assembler::new(&params.ingest, source.topics()),
        source,
        clock,
        span: None,
        is_at_end: false,
    };
    let mut store = KeyframeStore::new(&params.keyframe);
    let mut mesh = None;
    let mut num_mesh_updates = 0;
    let mut batch = reader.next_batch();
    while !batch.is_empty() {
        // The store takes frames one by one, in order; meanwhile the next ones are read and judged.
        let ((), next) = rayon::join(
            || {
                for item in batch {
                    match item {
                        // The store counts what it does with each frame.
                        Gained::Frame(frame, quality) => {
                            drop(store.offer_measured(*frame, quality));
                        }
                        Gained::Mesh(update) => {
                            mesh = Some(update);
                            num_mesh_updates += 1;
                        }
                    }
                }
            },
            || reader.next_batch(),
        );
        batch = next;
    }
    Gathered {
        store,
        mesh,
        num_mesh_updates,
        duration_s: reader
            .span
            .map_or(0.0, |(first, last)| last.seconds_since(first)),
        ingest: reader.assembler.report().clone(),
    }
}

/// Frames that are read ahead; raw images are large.
const BATCH_SIZE: usize = 8;

/// What a stretch of the stream brought.
enum Gained {
    Frame(Box<PosedFrame>, Result<FrameQuality, ImageError>),
    Mesh(Arc<TriMesh>),
}

/// Reads the stream batch by batch.
struct FrameReader<'a> {
    assembler: Assembler,
    source: &'a mut dyn EventSource,
    clock: &'a StageClock<'a>,
    span: Option<(Stamp, Stamp)>,
    is_at_end: bool,
}

impl FrameReader<'_> {
    /// What comes next, in order, with every frame's image judged; empty at the end of the stream.
    fn next_batch(&mut self) -> Vec<Gained> {
        let mut assembled = Vec::new();
        while !self.is_at_end && assembled.len() < BATCH_SIZE {
            match self.source.next_event() {
                Some(event) => {
                    let (first, last) = self.span.unwrap_or((event.received, event.received));
                    self.span = Some((first.min(event.received), last.max(event.received)));
                    self.assembler.push(event, &mut assembled);
                }
                None => {
                    self.assembler.finish(&mut assembled);
                    self.is_at_end = true;
                }
            }
            self.clock.advance(1);
        }
        assembled
            .into_par_iter()
            .map(|item| match item {
                Assembled::Frame(frame) => {
                    let quality = quality::measure(&frame.color);
                    Gained::Frame(Box::new(frame), quality)
                }
                Assembled::Mesh(update) => Gained::Mesh(update),
            })
            .collect()
    }
}

/// Says what arrived and what was refused, for an error about what did not.
fn why_nothing(ingest: &IngestReport, wanted: &str) -> String {
    let refusals: Vec<String> = ingest
        .topics
        .iter()
        .flat_map(|(topic, report)| {
            report.refused_by_reason.iter().map(move |(reason, count)| {
                let example = count
                    .examples
                    .first()
                    .map_or(reason.as_str(), |e| e.as_str());
                format!("{topic}: {} refused, as {example}", count.num)
            })
        })
        .collect();
    let received: Vec<String> = ingest
        .topics
        .iter()
        .filter(|(_, report)| report.num_received > 0)
        .map(|(topic, report)| format!("{} on {topic}", report.num_received))
        .collect();
    let received = if received.is_empty() {
        "no message arrived on any topic that veneer reads".to_owned()
    } else {
        format!(
            "no usable {wanted} among the messages received ({})",
            received.join(", ")
        )
    };
    if refusals.is_empty() {
        received
    } else {
        format!("{received}; {}", refusals.join("; "))
    }
}
