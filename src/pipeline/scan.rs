//! What a source brought, whole: the mesh to paint and the frames to paint it from.
//!
//! Gathered once, it can be textured many times: nothing here depends on how it is painted.

use std::sync::Arc;

use rayon::prelude::*;

use super::clock::StageClock;
use super::live::Capture;
use super::memory::MemoryPlan;
use super::run::{PipelineError, PipelineParams};
use crate::geom::{ImageError, PosedFrame, Stamp};
use crate::ingest::{Assembled, Assembler, EventSource, IngestReport, PoseCorrection};
use crate::keyframe::quality;
use crate::keyframe::{DecodedFrame, FrameQuality, Keyframe, KeyframeReport, KeyframeStore};
use crate::mesh::weld::weld;
use crate::mesh::{TriMesh, subdivide};

/// A mesh and the keyframes that see it.
#[derive(Debug)]
pub struct Scan {
    /// The mesh in the world frame, welded and subdivided.
    pub mesh: TriMesh,
    /// All keyframes, in order.
    pub keyframes: Vec<Arc<Keyframe>>,
    /// What ingest received, used and refused.
    pub ingest: IngestReport,
    /// From the first message to the last, in the time of the stream, seconds.
    pub duration_s: f64,
    /// How often the mesh changed.
    pub num_mesh_updates: usize,
    /// Vertices that welding merged into others.
    pub num_welded_vertices: usize,
    /// How memory is divided.
    pub memory: MemoryPlan,
    store: KeyframeStore,
}

impl Scan {
    /// A capture of a scan that goes on, with its mesh prepared; `store` decodes its keyframes.
    pub(super) fn new(
        mesh: TriMesh,
        capture: &Capture,
        num_welded_vertices: usize,
        mut store: KeyframeStore,
        params: &PipelineParams,
    ) -> Self {
        Self {
            memory: divide_memory(&mut store, &capture.keyframes, &mesh, params),
            mesh,
            keyframes: capture.keyframes.clone(),
            ingest: capture.ingest.clone(),
            duration_s: capture.duration_s,
            num_mesh_updates: capture.num_mesh_updates,
            num_welded_vertices,
            store,
        }
    }

    /// The mesh, and what decodes the keyframes.
    pub(super) fn into_parts(self) -> (TriMesh, KeyframeStore) {
        (self.mesh, self.store)
    }

    /// A keyframe's images, from the store's cache where it has them. The cache goes by id, so
    /// that a copy of a keyframe with another pose decodes alike.
    ///
    /// # Errors
    /// [`ImageError`] when an image does not decode.
    pub fn decode(&self, keyframe: &Keyframe) -> Result<Arc<DecodedFrame>, ImageError> {
        self.store.decode(keyframe)
    }

    /// What the keyframe store kept and dropped.
    pub fn store_report(&self) -> &KeyframeReport {
        self.store.report()
    }
}

/// Takes every event of the stream: frames go to the keyframe store; the mesh that arrived last is
/// the one that counts, and is welded and subdivided.
///
/// # Errors
/// [`PipelineError`] when the stream held no mesh or no usable frame, with what was refused and
/// why, and when the mesh cannot be welded or subdivided.
pub fn gather(
    source: &mut dyn EventSource,
    params: &PipelineParams,
    clock: &StageClock<'_>,
) -> Result<Scan, PipelineError> {
    clock.begin("read and select frames", 0);
    let Received {
        mut store,
        mesh,
        num_mesh_updates,
        duration_s,
        ingest,
    } = receive(source, params, clock);
    let mesh = mesh
        .filter(|mesh| mesh.num_triangles() > 0)
        .ok_or_else(|| {
            PipelineError::NoMesh(if num_mesh_updates > 0 && params.region.region.is_some() {
                "nothing of what arrived lies in region.box".to_owned()
            } else {
                why_nothing(&ingest, "mesh")
            })
        })?;
    let keyframes: Vec<_> = store.keyframes().cloned().collect();
    if keyframes.is_empty() {
        return Err(PipelineError::NoKeyframe(why_nothing(&ingest, "frame")));
    }

    clock.begin("weld the mesh", 0);
    let (mesh, num_welded_vertices) = prepared_mesh(&mesh, params)?;
    let memory = divide_memory(&mut store, &keyframes, &mesh, params);
    Ok(Scan {
        memory,
        mesh,
        keyframes,
        ingest,
        duration_s,
        num_mesh_updates,
        num_welded_vertices,
        store,
    })
}

/// Gives the decoded images what the budget leaves them, now that the rest is known.
fn divide_memory(
    store: &mut KeyframeStore,
    keyframes: &[Arc<Keyframe>],
    mesh: &TriMesh,
    params: &PipelineParams,
) -> MemoryPlan {
    let num_bytes = keyframes.iter().map(|keyframe| keyframe.num_bytes()).sum();
    let plan = params
        .memory
        .plan(params, num_bytes, keyframes.len(), mesh.num_triangles());
    set_decode_cache(store, &plan);
    plan
}

fn set_decode_cache(store: &mut KeyframeStore, plan: &MemoryPlan) {
    store.set_decode_cache_bytes(usize::try_from(plan.decode_cache).unwrap_or(usize::MAX));
}

/// The mesh as it is painted, welded and subdivided, and how many vertices welding merged into
/// others.
pub(super) fn prepared_mesh(
    mesh: &TriMesh,
    params: &PipelineParams,
) -> Result<(TriMesh, usize), PipelineError> {
    let welded = weld(mesh, params.weld_tolerance_m)?;
    let mesh = match params.num_subdivisions {
        0 => welded.mesh,
        num_rounds => subdivide(&welded.mesh, num_rounds)?,
    };
    Ok((mesh, welded.num_merged))
}

struct Received {
    store: KeyframeStore,
    mesh: Option<Arc<TriMesh>>,
    num_mesh_updates: usize,
    duration_s: f64,
    ingest: IngestReport,
}

fn receive(
    source: &mut dyn EventSource,
    params: &PipelineParams,
    clock: &StageClock<'_>,
) -> Received {
    let mut reader = FrameReader {
        assembler: Assembler::new(&params.ingest, source.topics()),
        source,
        clock,
        span: None,
        is_at_end: false,
    };
    let mut store = KeyframeStore::new(&params.region.applied_to(&params.keyframe));
    set_decode_cache(&mut store, &params.memory.first_plan(params));
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
                            mesh = Some(params.region.cut(update));
                            num_mesh_updates += 1;
                        }
                        Gained::Corrections(corrections) => {
                            let poses: Vec<_> =
                                corrections.iter().map(|c| (c.stamp, c.pose)).collect();
                            store.correct_poses(&poses);
                        }
                    }
                }
            },
            || reader.next_batch(),
        );
        batch = next;
    }
    Received {
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
    Corrections(Vec<PoseCorrection>),
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
                Assembled::Corrections(corrections) => Gained::Corrections(corrections),
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
