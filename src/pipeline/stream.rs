//! The live pipeline where painting follows the change: [`StreamPainter`] keeps charts, labels and
//! texels between captures, and paints what a capture has otherwise than the one before.
//!
//! What is painted is TexInit's result ([`crate::texinit::stream`]), from photos with their gains where
//! these are asked for: each keyframe gets its own when it comes, beside those that stand
//! ([`stream_gains`]), and keeps it. What works on the whole texture at once (corrected poses, levelled
//! seams, the optimisation) is refused, not left out.
//!
//! [`stream()`] drives it by the time of the stream, so that the same events give the same updates.

mod replayed;
mod stream_gains;

use std::sync::Arc;

use super::clock::StageClock;
use super::live::{Capture, LiveScan, memory_plan};
use super::progress::Progress;
use super::refine::{self, RefineParams};
use super::run::{PipelineError, PipelineParams, StageTime};
use super::scan::prepared_mesh;
use crate::geom::{ImageError, Stamp};
use crate::ingest::EventSource;
use crate::keyframe::{DecodedFrame, Keyframe, KeyframeParams, KeyframeStore};
use crate::mesh::TriMesh;
use crate::photometric::{CorrectedFrames, GainTable};
use crate::texinit::TexInitParams;
use crate::texinit::stream::{StreamInit, StreamParams, StreamUpdate};

pub use replayed::{UpdateSummary, run_streamed};

/// What a capture changed.
#[derive(Debug)]
pub struct Streamed {
    /// What was painted.
    pub capture: Capture,
    /// What it changed.
    pub update: StreamUpdate,
    /// Wall times, in order.
    pub stages: Vec<StageTime>,
}

/// Paints captures, each from what the one before left; keeps decoded images between them.
#[derive(Debug)]
pub struct StreamPainter {
    store: KeyframeStore,
    kept: Option<Kept>,
}

/// A painted scan, and the settings that it was painted with.
#[derive(Debug)]
struct Kept {
    state: StreamInit,
    texinit: TexInitParams,
    stream: StreamParams,
    refine: RefineParams,
    gains: GainTable,
    weld: (f64, u32),
    /// The mesh as it arrived last, and as it was painted.
    prepared: Option<(Arc<TriMesh>, Arc<TriMesh>)>,
    /// Keyframes that wait for the next update.
    num_waiting: usize,
}

impl StreamPainter {
    /// Nothing is painted yet; the cache is of the size that `params` says.
    pub fn new(params: &KeyframeParams) -> Self {
        Self {
            store: KeyframeStore::new(params),
            kept: None,
        }
    }

    /// Keeps up to so many bytes of decoded images.
    pub fn set_decode_cache_bytes(&mut self, num_bytes: usize) {
        self.store.set_decode_cache_bytes(num_bytes);
    }

    /// Bytes of decoded images that are kept.
    pub fn num_cached_bytes(&self) -> usize {
        self.store.cache_report().num_bytes
    }

    /// What is painted; `None` before the first capture, and after an error.
    pub fn state(&self) -> Option<&StreamInit> {
        self.kept.as_ref().map(|kept| &kept.state)
    }

    /// Keyframes of the last capture that the next update takes in.
    pub fn num_waiting(&self) -> usize {
        self.kept.as_ref().map_or(0, |kept| kept.num_waiting)
    }

    /// A keyframe's images, with its gain.
    ///
    /// # Errors
    /// [`ImageError`] when an image does not decode.
    pub fn decode(&self, keyframe: &Keyframe) -> Result<Arc<DecodedFrame>, ImageError> {
        let recorded = |keyframe: &Keyframe| self.store.decode(keyframe);
        match &self.kept {
            Some(kept) => CorrectedFrames::new(&recorded, &kept.gains, 0).decode(keyframe),
            None => recorded(keyframe),
        }
    }

    /// A keyframe's images as they were recorded.
    ///
    /// # Errors
    /// [`ImageError`] when an image does not decode.
    pub fn decode_recorded(&self, keyframe: &Keyframe) -> Result<Arc<DecodedFrame>, ImageError> {
        self.store.decode(keyframe)
    }

    /// Brings the texture up to a capture. With other settings than before all is painted anew. A
    /// capture without a mesh or without keyframes takes what is painted off.
    ///
    /// # Errors
    /// [`PipelineError`] for settings that cannot follow changes, a mesh that cannot be welded, or a
    /// stage that refuses.
    pub fn paint(
        &mut self,
        capture: Capture,
        params: &PipelineParams,
        progress: &dyn Progress,
    ) -> Result<Streamed, PipelineError> {
        check(params)?;
        let clock = StageClock::new(progress);
        clock.begin("weld the mesh", 0);
        let mut kept = self.kept_for(params)?;
        let following = PipelineParams {
            follows_changes: true,
            ..params.clone()
        };
        let memory = memory_plan(&capture, &following);
        let usable = |num_bytes: u64| usize::try_from(num_bytes).unwrap_or(usize::MAX);
        self.store
            .set_decode_cache_bytes(usable(memory.decode_cache));
        kept.state.set_view_bytes(usable(memory.kept_views));
        let mesh = kept.prepared_mesh(&capture, params)?;
        let recorded = |keyframe: &Keyframe| self.store.decode(keyframe);
        if params.refine.has_gain {
            clock.begin("balance exposure", 0);
            stream_gains::keep_up(
                &mut kept.gains,
                &capture.keyframes,
                &recorded,
                &params.refine,
            );
        }
        let corrected = refine::corrected(&recorded, &kept.gains, &params.refine);
        let decode = |keyframe: &Keyframe| corrected.decode(keyframe);
        let updated = kept
            .state
            .update(&mesh, &capture.keyframes, &decode, &clock);
        let update = updated?;
        kept.num_waiting = update.num_frames_waiting;
        self.kept = Some(kept);
        Ok(Streamed {
            capture,
            update,
            stages: clock.finish(),
        })
    }

    /// What was painted with the same settings, or nothing.
    fn kept_for(&mut self, params: &PipelineParams) -> Result<Kept, PipelineError> {
        let weld = (params.weld_tolerance_m, params.num_subdivisions);
        let is_same = |kept: &Kept| {
            kept.texinit == params.texinit
                && kept.stream == params.stream
                && kept.refine == params.refine
                && kept.weld == weld
        };
        if let Some(kept) = self.kept.take().filter(is_same) {
            return Ok(kept);
        }
        Ok(Kept {
            state: StreamInit::new(&params.texinit, &params.stream)?,
            texinit: params.texinit.clone(),
            stream: params.stream.clone(),
            refine: params.refine.clone(),
            gains: GainTable::default(),
            weld,
            prepared: None,
            num_waiting: 0,
        })
    }
}

impl Kept {
    fn prepared_mesh(
        &mut self,
        capture: &Capture,
        params: &PipelineParams,
    ) -> Result<Arc<TriMesh>, PipelineError> {
        let given = capture.mesh.clone().unwrap_or_default();
        if let Some((before, prepared)) = &self.prepared
            && Arc::ptr_eq(before, &given)
        {
            return Ok(prepared.clone());
        }
        // Vertices of equal position become one on the grid anyway.
        let prepared = if self.weld == (0.0, 0) {
            given.clone()
        } else {
            Arc::new(prepared_mesh(&given, params)?.0)
        };
        self.prepared = Some((given, prepared.clone()));
        Ok(prepared)
    }
}

fn check(params: &PipelineParams) -> Result<(), PipelineError> {
    let refine = &params.refine;
    let whole = [
        ("photometric.pose", refine.has_pose),
        ("photometric.global_seams", refine.seams.has_global),
        ("photometric.local_seams", refine.seams.has_local),
        ("texsmooth.steps", params.texsmooth.num_steps > 0),
    ];
    match whole.into_iter().find(|(_, is_on)| *is_on) {
        Some((name, _)) => Err(PipelineError::WholeScanOnly(name)),
        None => Ok(()),
    }
}

/// Paints a stream as it comes: whenever keyframes or mesh changed and `period_s` of the stream's time
/// went by since the last time, and once more at its end. `see` is shown every update.
///
/// # Errors
/// [`PipelineError`] of the first update that failed, and when the stream held nothing to paint.
pub fn stream(
    source: &mut dyn EventSource,
    params: &PipelineParams,
    period_s: f64,
    progress: &dyn Progress,
    see: &mut dyn FnMut(&StreamPainter, &Streamed),
) -> Result<StreamPainter, PipelineError> {
    let mut scan = LiveScan::new(params, source.topics(), 0);
    let mut painter = StreamPainter::new(&params.keyframe);
    let mut painted: Option<(Stamp, u64)> = None;
    let mut paint = |scan: &LiveScan, painter: &mut StreamPainter| {
        let capture = scan.capture();
        if !capture.is_paintable() {
            return Ok(None);
        }
        let at = (capture.stamp, capture.revision);
        let streamed = painter.paint(capture, params, progress)?;
        see(painter, &streamed);
        Ok::<_, PipelineError>(Some(at))
    };
    while let Some(event) = source.next_event() {
        let now = event.received;
        let has_changed = scan.push(event);
        let is_due = match painted {
            Some((at, revision)) => {
                let has_work = revision != scan.revision() || painter.num_waiting() > 0;
                has_work && now.seconds_since(at) >= period_s
            }
            None => has_changed,
        };
        if is_due {
            painted = paint(&scan, &mut painter)?.or(painted);
        }
    }
    scan.flush();
    if painted.is_none_or(|(_, revision)| revision != scan.revision()) {
        painted = paint(&scan, &mut painter)?.or(painted);
    }
    while painter.num_waiting() > 0 {
        painted = paint(&scan, &mut painter)?.or(painted);
    }
    match painted {
        Some(_) => Ok(painter),
        None if scan.capture().mesh.is_none() => {
            Err(PipelineError::NoMesh("none has arrived".to_owned()))
        }
        None => Err(PipelineError::NoKeyframe("none was kept".to_owned())),
    }
}
