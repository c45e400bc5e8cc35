//! A whole run that paints as the stream goes: [`super::stream()`] to its end.

use std::sync::Arc;

use super::super::held_out;
use super::super::live::{Capture, memory_plan};
use super::super::progress::Progress;
use super::super::refine::RefineReport;
use super::super::run::{PipelineError, PipelineParams, Run, StageTime};
use super::driver::painted_to_the_end;
use super::{StreamPainter, Streamed};
use crate::atlas::AtlasTexture;
use crate::ingest::EventSource;
use crate::keyframe::Keyframe;
use crate::mesh::TriMesh;
use crate::texinit::stream::StreamInit;
use crate::texinit::{TexInit, TexInitReport};

/// What the updates of a run did together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UpdateSummary {
    /// Updates.
    pub num_updates: usize,
    /// (chart, keyframe) pairs that were scored.
    pub num_pairs_scored: usize,
    /// Triangles painted, as often as they were.
    pub num_triangles_painted: usize,
    /// Wall time of the slowest, seconds.
    pub slowest_s: f64,
    /// Wall time of all, seconds.
    pub all_s: f64,
    /// Steps that refined while nothing changed.
    pub num_idle_steps: usize,
    /// Wall time of the slowest of them, seconds.
    pub slowest_idle_s: f64,
    /// Wall time of all of them, seconds.
    pub idle_s: f64,
}

impl UpdateSummary {
    fn add(&mut self, streamed: &Streamed) {
        let seconds = streamed.stages.iter().map(|stage| stage.seconds).sum();
        if streamed.is_idle_step {
            self.num_idle_steps += 1;
            self.slowest_idle_s = self.slowest_idle_s.max(seconds);
            self.idle_s += seconds;
            return;
        }
        self.num_updates += 1;
        self.num_pairs_scored += streamed.update.num_pairs_scored;
        self.num_triangles_painted += streamed.update.num_triangles_painted;
        self.slowest_s = self.slowest_s.max(seconds);
        self.all_s += seconds;
    }
}

/// [`super::super::run()`] with a texture that is kept up: painted whenever `period_s` of the
/// stream's time went by with something new, and refined as long as there is something to refine.
/// Keyframes that judge the result paint until the stream ends; then they are taken out, and where the
/// optimisation saw them what is shown is refined anew: it learns from all photos of a chart, not only
/// from those that paint it.
///
/// # Errors
/// [`PipelineError`], as [`super::super::run()`]; and for settings that cannot follow changes.
pub fn run_streamed(
    source: &mut dyn EventSource,
    params: &PipelineParams,
    period_s: f64,
    progress: &dyn Progress,
) -> Result<Run, PipelineError> {
    let params = &params.memory.applied_to(params);
    let mut updates = UpdateSummary::default();
    let mut last: Option<Capture> = None;
    let mut stages: Vec<StageTime> = Vec::new();
    let mut see = |streamed: &Streamed| {
        updates.add(streamed);
        add_times(&mut stages, &streamed.stages);
    };
    let mut note = |_: &StreamPainter, streamed: &Streamed| {
        see(streamed);
        last = Some(streamed.capture.clone());
    };
    let mut painter = painted_to_the_end(source, params, period_s, progress, &mut note)?;
    let Some(mut capture) = last else {
        return Err(PipelineError::NoMesh("none has arrived".to_owned()));
    };
    let memory = memory_plan(&capture, params);
    let keyframes = std::mem::take(&mut capture.keyframes);
    let (painting, judging) = held_out::split(keyframes, &params.held_out);
    capture.keyframes = painting;
    if !judging.is_empty() && params.texsmooth.num_steps > 0 {
        painter.begin_refining_anew();
    }
    let mut streamed = painter.paint(capture, params, progress)?;
    see(&streamed);
    while let Some(step) = painter.refine_some(params, progress)? {
        see(&step);
        streamed = step;
    }
    let Streamed {
        capture, keyframes, ..
    } = streamed;
    let Some((state, texture)) = painter.take_painted() else {
        return Err(PipelineError::NoMesh("nothing is painted".to_owned()));
    };
    let (mut mesh, mut texinit) = texinit_of(state, texture, &keyframes);
    params.region.keep_own_of(&mut mesh, &mut texinit);
    let held_out = held_out::render_views(
        &judging,
        &|keyframe| painter.decode_recorded(keyframe),
        &mesh,
        &texinit.layout,
        &texinit.texture,
    );
    Ok(Run {
        mesh,
        keyframes,
        texinit,
        refine: RefineReport::default(),
        texsmooth: None,
        held_out,
        ingest: capture.ingest,
        store: capture.store,
        duration_s: capture.duration_s,
        num_mesh_updates: capture.num_mesh_updates,
        num_welded_vertices: 0,
        memory,
        updates: Some(updates),
        stages,
    })
}

/// Adds the times of an update's stages to those of all before.
fn add_times(all: &mut Vec<StageTime>, more: &[StageTime]) {
    for stage in more {
        match all.iter_mut().find(|known| known.name == stage.name) {
            Some(known) => known.seconds += stage.seconds,
            None => all.push(*stage),
        }
    }
}

/// The state as the batch would hand it over, with the texture that is shown where that is not its own.
/// How single stages went is not kept from update to update, and left at nothing.
fn texinit_of(
    state: StreamInit,
    shown: Option<AtlasTexture>,
    painting: &[Arc<Keyframe>],
) -> (TriMesh, TexInit) {
    let mut assignment = state.assignment();
    for label in &mut assignment.label {
        *label = label.and_then(|number| {
            let index = painting.binary_search_by_key(&number, |keyframe| keyframe.id.0);
            index.ok().and_then(|index| u32::try_from(index).ok())
        });
    }
    let (mesh, layout, own) = state.into_parts();
    let texinit = TexInit {
        report: TexInitReport {
            wanted_texels_per_m: layout.texels_per_m,
            ..TexInitReport::default()
        },
        texture: shown.unwrap_or(own),
        assignment,
        layout,
    };
    (mesh, texinit)
}
