//! The live pipeline where painting follows the change: [`StreamPainter`] keeps charts, labels and
//! texels between captures, and paints what a capture has otherwise than the one before.
//!
//! What is painted is TexInit's result ([`crate::texinit::stream`]), from photos with their gains where
//! these are asked for: each keyframe gets its own when it comes, beside those that stand
//! ([`stream_gains`]), and keeps it. Corrected poses, levelled seams and the optimisation follow in idle
//! time ([`idle`]), part by part, on what changed. What works on the whole texture at once (an optimisation
//! that starts from grey, goes on from a checkpoint, or has a time) is refused, not left out.
//!
//! [`stream()`] drives it by the time of the stream, so that the same events give the same updates.

mod driver;
pub mod idle;
mod poses;
mod refined;
mod replayed;
mod small_photos;
mod smoothed;
mod stream_gains;

use std::sync::Arc;

use super::StreamMode;
use super::clock::StageClock;
use super::live::{Capture, memory_plan};
use super::progress::Progress;
use super::refine::{self, RefineParams};
use super::run::{PipelineError, PipelineParams, StageTime};
use super::scan::prepared_mesh;
use crate::atlas::AtlasTexture;
use crate::geom::ImageError;
use crate::keyframe::{DecodedFrame, Keyframe, KeyframeParams, KeyframeStore};
use crate::mesh::TriMesh;
use crate::photometric::{CorrectedFrames, GainTable};
use crate::texinit::stream::{StreamInit, StreamParams, StreamUpdate};
use crate::texinit::{Decode, TexInitParams};
use crate::texsmooth::{SmoothStart, TexSmoothParams};

pub use driver::stream;
use poses::StreamPoses;
use refined::{Refined, Wanted, tell};
pub use replayed::{UpdateSummary, run_streamed};
use small_photos::SmallPhotos;
use smoothed::StreamSmoothing;

/// What a capture or an idle step changed.
#[derive(Debug)]
pub struct Streamed {
    /// What was painted.
    pub capture: Capture,
    /// Its keyframes as they painted: their poses corrected where that was asked for.
    pub keyframes: Vec<Arc<Keyframe>>,
    /// What it changed.
    pub update: StreamUpdate,
    /// Whether the capture had been painted before and was refined now.
    pub is_idle_step: bool,
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
    texsmooth: TexSmoothParams,
    gains: GainTable,
    weld: (f64, u32),
    /// What was painted.
    capture: Option<Capture>,
    /// `None` where no charts are refined: then the state's texture is shown.
    refined: Option<Refined>,
    smoothing: StreamSmoothing,
    /// Whether charts are refined by more than the settings ask for.
    is_smoothed_more: bool,
    /// Whether charts that no update changed show TexInit's texels from the next one on.
    is_begun_anew: bool,
    /// `None` where poses are taken as they are.
    poses: Option<StreamPoses>,
    photos: SmallPhotos,
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

    /// Takes out what is painted: the state, and what is shown where that is not the state's texture.
    fn take_painted(&mut self) -> Option<(StreamInit, Option<AtlasTexture>)> {
        let kept = self.kept.take()?;
        Some((kept.state, kept.refined.map(Refined::into_texture)))
    }

    /// What is shown: the state's texture, with refined charts over it. `None` as [`Self::state`].
    pub fn texture(&self) -> Option<&AtlasTexture> {
        let kept = self.kept.as_ref()?;
        Some(match &kept.refined {
            Some(refined) => refined.texture(),
            None => kept.state.texture(),
        })
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
        let store = &self.store;
        let recorded = |keyframe: &Keyframe| store.decode(keyframe);
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
        let decode_cache = kept.divide_memory(&capture, params);
        self.store.set_decode_cache_bytes(decode_cache);
        let mesh = kept.prepared_mesh(&capture, params)?;
        let keyframes = match &mut kept.poses {
            Some(poses) => poses.keep_up(&capture.keyframes),
            None => capture.keyframes.clone(),
        };
        let store = &self.store;
        let recorded = |keyframe: &Keyframe| store.decode(keyframe);
        if params.refine.has_gain {
            clock.begin("balance exposure", 0);
            stream_gains::keep_up(&mut kept.gains, &keyframes, &recorded, &params.refine);
        }
        let gains = std::mem::take(&mut kept.gains);
        let corrected = refine::corrected(&recorded, &gains, &params.refine);
        let decode = |keyframe: &Keyframe| corrected.decode(keyframe);
        let update = kept.update(&mesh, &keyframes, &decode, &clock)?;
        kept.gains = gains;
        let present = |id| keyframes.binary_search_by_key(&id, |keyframe| keyframe.id);
        kept.photos.retain(|id| present(id).is_ok());
        kept.capture = Some(capture.clone());
        self.kept = Some(kept);
        Ok(Streamed {
            capture,
            keyframes,
            update,
            is_idle_step: false,
            stages: clock.finish(),
        })
    }

    /// What was painted with the same settings, or nothing.
    fn kept_for(&mut self, params: &PipelineParams) -> Result<Kept, PipelineError> {
        if let Some(kept) = self.kept.take().filter(|kept| kept.is_for(params)) {
            return Ok(kept);
        }
        Ok(Kept {
            state: StreamInit::new(&params.texinit, &params.stream)?,
            texinit: params.texinit.clone(),
            stream: params.stream.clone(),
            refine: params.refine.clone(),
            texsmooth: params.texsmooth.clone(),
            gains: GainTable::default(),
            weld: (params.weld_tolerance_m, params.num_subdivisions),
            capture: None,
            refined: Refined::new(Wanted::by(&params.refine, &params.texsmooth)),
            smoothing: StreamSmoothing::default(),
            is_smoothed_more: false,
            is_begun_anew: false,
            poses: params.refine.has_pose.then(StreamPoses::default),
            photos: SmallPhotos::default(),
            prepared: None,
            num_waiting: 0,
        })
    }
}

impl Kept {
    /// Whether it was painted with these settings.
    fn is_for(&self, params: &PipelineParams) -> bool {
        self.texinit == params.texinit
            && self.stream == params.stream
            && self.refine == params.refine
            && self.texsmooth == params.texsmooth
            && self.weld == (params.weld_tolerance_m, params.num_subdivisions)
    }

    /// Texels of all pages, and of one that may come.
    fn num_texels(&self) -> usize {
        let pages = &self.state.texture().pages;
        let of_page = pages.first().map_or(0, |page| page.srgb.len());
        (pages.len() + 1) * of_page
    }

    /// Gives the state its share of the memory; how many bytes of decoded images leave room for it.
    fn divide_memory(&mut self, capture: &Capture, params: &PipelineParams) -> usize {
        let mut following = PipelineParams {
            stream_mode: StreamMode::Changes,
            ..params.clone()
        };
        if let Some(refined) = &self.refined {
            let num_steps = &mut following.texsmooth.num_steps;
            *num_steps = refined.most_steps().max(*num_steps);
        }
        let memory = memory_plan(capture, &following).with_pages(self.num_texels(), &following);
        let usable = |num_bytes: u64| usize::try_from(num_bytes).unwrap_or(usize::MAX);
        self.state.set_view_bytes(usable(memory.kept_views));
        usable(memory.decode_cache)
    }

    /// Brings the state up to what there is, and what is shown with it.
    fn update(
        &mut self,
        mesh: &Arc<TriMesh>,
        keyframes: &[Arc<Keyframe>],
        decode: &Decode<'_>,
        clock: &StageClock<'_>,
    ) -> Result<StreamUpdate, PipelineError> {
        let mut changed = match &mut self.refined {
            Some(refined) => self.smoothing.end(refined)?,
            None => Vec::new(),
        };
        let mut update = self.state.update(mesh, keyframes, decode, clock)?;
        self.num_waiting = update.num_frames_waiting;
        if let Some(refined) = &mut self.refined {
            refined.follow(&self.state, &update);
        }
        if std::mem::take(&mut self.is_begun_anew) {
            changed = self.state.chart_ids().collect();
        }
        tell(&self.state, &changed, &mut update);
        Ok(update)
    }

    /// Recorded keyframes as they paint.
    fn painting(&self, recorded: &[Arc<Keyframe>]) -> Vec<Arc<Keyframe>> {
        match &self.poses {
            Some(poses) => poses.painting().collect(),
            None => recorded.to_vec(),
        }
    }

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
    let smooth = &params.texsmooth;
    if smooth.num_steps == 0 {
        return Ok(());
    }
    let is_whole = [
        ("texsmooth.start:=blank", smooth.start == SmoothStart::Blank),
        ("texsmooth.time_budget_s", smooth.time_budget_s > 0.0),
        (
            "texsmooth.checkpoint_interval",
            smooth.checkpoint_interval > 0,
        ),
        ("a checkpoint", params.smooth_from.is_some()),
    ];
    match is_whole.into_iter().find(|(_, is_whole)| *is_whole) {
        Some((what, _)) => Err(PipelineError::WholeScanOnly(what)),
        None => Ok(()),
    }
}
