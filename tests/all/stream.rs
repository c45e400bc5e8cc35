//! A bag painted as it comes: after every update the texture is that of the whole at once.

mod smoothed;

use std::path::Path;

use veneer::atlas::{AtlasTexture, TexelRect};
use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::keyframe::{Keyframe, KeyframeStore};
use veneer::pipeline::{
    NoProgress, PipelineError, PipelineParams, StreamPainter, Streamed, run_streamed, stream,
};
use veneer::texinit::stream::StreamInit;
use veneer::texinit::{Coupling, Observer, Repainted, Stage, TexInitParams, repaint};

use crate::command::small_tabletop;

struct Silent;

impl Observer for Silent {
    fn begin(&self, _stage: Stage, _num_steps: usize) {}
    fn advance(&self, _num_steps: usize) {}
}

fn whole(painter: &StreamPainter, streamed: &Streamed, params: &TexInitParams) -> Repainted {
    let state = painter.state().unwrap();
    let params = TexInitParams {
        coupling: Coupling::Chart,
        ..params.clone()
    };
    let decode = |keyframe: &Keyframe| painter.decode(keyframe);
    let (mesh, layout) = (state.mesh(), state.layout());
    repaint(mesh, layout, &streamed.keyframes, &decode, &params, &Silent).unwrap()
}

fn grown_tabletop(dir: &Path) -> BagReader {
    let bag = small_tabletop(dir, &["--grow", "4"]);
    BagReader::open(&bag, &Config::default().topics).unwrap()
}

/// Labels that do not depend on those before, and no keyframe that waits for others.
fn exact() -> PipelineParams {
    let mut params = Config::default().pipeline;
    params.stream.hysteresis = 0.0;
    params.stream.batch_frames = 1;
    params
}

#[test]
fn every_update_of_a_growing_scan_equals_the_whole() {
    let dir = tempfile::tempdir().unwrap();
    let mut params = exact();
    params.stream.page_size_texel = 256;
    let mut sizes = vec![];
    let mut see = |painter: &StreamPainter, streamed: &Streamed| {
        let state = painter.state().unwrap();
        let whole = whole(painter, streamed, &params.texinit);
        assert!(whole.texture == state.texture().clone());
        sizes.push(state.mesh().num_triangles());
    };
    let mut source = grown_tabletop(dir.path());
    stream(&mut source, &params, 0.0, &NoProgress, &mut see).unwrap();
    assert!(sizes.len() > 3, "{sizes:?}");
    assert!(sizes.first() < sizes.last(), "{sizes:?}");
}

#[test]
fn a_streamed_run_is_the_whole_on_its_charts_without_the_frames_that_judge() {
    let dir = tempfile::tempdir().unwrap();
    let mut params = exact();
    params.held_out.num_views = 1;
    // All but two wait at times.
    params.stream.max_new_frames = 2;
    let mut source = grown_tabletop(dir.path());
    let run = run_streamed(&mut source, &params, 0.2, &NoProgress).unwrap();
    assert_eq!(run.held_out.len(), 1);
    let judge = run.held_out[0].keyframe.id;
    assert!(run.keyframes.iter().all(|keyframe| keyframe.id != judge));
    assert!(run.updates.unwrap().num_updates > 3);
    let store = KeyframeStore::new(&params.keyframe);
    let decode = |keyframe: &Keyframe| store.decode(keyframe);
    let chartwise = TexInitParams {
        coupling: Coupling::Chart,
        ..params.texinit.clone()
    };
    let layout = &run.texinit.layout;
    let whole = repaint(
        &run.mesh,
        layout,
        &run.keyframes,
        &decode,
        &chartwise,
        &Silent,
    )
    .unwrap();
    assert!(whole.texture == run.texinit.texture);
    assert_eq!(whole.assignment.label, run.texinit.assignment.label);
}

#[test]
fn what_works_on_the_whole_texture_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut params = Config::default().pipeline;
    params.texsmooth.num_steps = 3;
    let follows = params.clone().for_live();
    assert!(follows.0.follows_changes() && follows.1.is_none());
    params.texsmooth.time_budget_s = 5.0;
    let (whole, why) = params.clone().for_live();
    assert!(!whole.follows_changes());
    assert!(why.unwrap().contains("texsmooth.time_budget_s"));
    let mut source = grown_tabletop(dir.path());
    let refused = stream(&mut source, &params, 0.0, &NoProgress, &mut |_, _| ());
    assert!(matches!(
        refused.err(),
        Some(PipelineError::WholeScanOnly("texsmooth.time_budget_s"))
    ));
}

/// Whether two textures differ only within some rectangles of their pages.
fn is_same_beyond(a: &AtlasTexture, b: &AtlasTexture, rects: &[(u32, TexelRect)]) -> bool {
    a.pages.len() == b.pages.len()
        && (0_u32..)
            .zip(a.pages.iter().zip(&b.pages))
            .all(|(page, (a, b))| {
                let (width, texels) = (a.width as usize, a.srgb.iter().zip(&b.srgb));
                let sources = a.source.iter().zip(&b.source);
                texels
                    .zip(sources)
                    .enumerate()
                    .all(|(index, ((a, b), (from_a, from_b)))| {
                        let [x, y] =
                            [index % width, index / width].map(|side| u32::try_from(side).unwrap());
                        let is_in = |rect: &TexelRect| {
                            let across = rect.x..rect.x + rect.width;
                            let down = rect.y..rect.y + rect.height;
                            across.contains(&x) && down.contains(&y)
                        };
                        let is_told = rects.iter().any(|(on, rect)| *on == page && is_in(rect));
                        is_told || (a == b && from_a == from_b)
                    })
            })
}

#[test]
fn seams_are_levelled_in_idle_time_and_texinit_stays_below() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &["--grow", "4", "--exposure-noise", "0.3"]);
    let mut source = BagReader::open(&bag, &Config::default().topics).unwrap();
    let mut params = exact();
    params.stream.page_size_texel = 256;
    params.refine.seams.has_global = true;
    params.refine.seams.has_local = true;
    // Several steps for what an update leaves, and some while the scan goes on.
    params.idle.max_triangles = 600;
    let mut shown: Option<AtlasTexture> = None;
    let (mut num_steps, mut num_between, mut most_waiting) = (0, 0, 0);
    let mut see = |painter: &StreamPainter, streamed: &Streamed| {
        let (state, texture) = (painter.state().unwrap(), painter.texture().unwrap());
        let num_waiting = painter.num_charts_waiting();
        most_waiting = most_waiting.max(num_waiting);
        let update = &streamed.update;
        if streamed.is_idle_step {
            num_steps += 1;
            // Charts own parts of their rectangles only, but what is told is all that changed.
            let before = shown.as_ref().unwrap();
            assert!(is_same_beyond(before, texture, &update.dirty_rects));
            assert!(!update.changed_charts.is_empty() && update.new_charts.is_empty());
        } else {
            num_between = num_steps;
            let whole = whole(painter, streamed, &params.texinit);
            assert!(whole.texture == state.texture().clone());
        }
        let sources = texture.pages.iter().map(|page| &page.source);
        assert!(sources.eq(state.texture().pages.iter().map(|page| &page.source)));
        shown = Some(texture.clone());
    };
    let painter = stream(&mut source, &params, 0.1, &NoProgress, &mut see).unwrap();
    assert!(
        num_steps > 3 && num_between > 0,
        "{num_steps} {num_between}"
    );
    assert!(most_waiting > 3, "{most_waiting}");
    assert_eq!(painter.num_charts_waiting(), 0);
    assert!(painter.texture() != painter.state().map(StreamInit::texture));
    let (level, flat) = (shown.unwrap(), painter.state().unwrap().texture().clone());
    let num_levelled = level.pages.iter().zip(&flat.pages).map(|(level, flat)| {
        let texels = level.srgb.iter().zip(&flat.srgb);
        texels.filter(|(level, flat)| level != flat).count()
    });
    assert!(num_levelled.sum::<usize>() > 1000);
}

#[test]
fn without_refinement_there_is_one_texture() {
    let dir = tempfile::tempdir().unwrap();
    let mut source = grown_tabletop(dir.path());
    let params = Config::default().pipeline;
    let mut see = |_: &StreamPainter, streamed: &Streamed| assert!(!streamed.is_idle_step);
    let painter = stream(&mut source, &params, 0.0, &NoProgress, &mut see).unwrap();
    let base = painter.state().unwrap().texture();
    assert!(std::ptr::eq(base, painter.texture().unwrap()));
}

#[test]
fn poses_are_corrected_in_idle_time_and_what_depends_on_them_is_painted_anew() {
    let dir = tempfile::tempdir().unwrap();
    let noise = ["--grow", "3", "--pose-noise-rad", "0.01"];
    let bag = small_tabletop(dir.path(), &noise);
    let mut source = BagReader::open(&bag, &Config::default().topics).unwrap();
    let mut params = exact();
    params.refine.has_pose = true;
    params.idle.max_keyframes = 3;
    let mut num_moved = vec![];
    let mut see = |painter: &StreamPainter, streamed: &Streamed| {
        if streamed.is_idle_step {
            num_moved.push(streamed.update.num_frames_moved);
        }
        let state = painter.state().unwrap();
        let whole = whole(painter, streamed, &params.texinit);
        assert!(whole.texture == state.texture().clone());
    };
    let painter = stream(&mut source, &params, 0.1, &NoProgress, &mut see).unwrap();
    assert_eq!(painter.num_poses_waiting(), 0);
    assert!(num_moved.iter().all(|num| *num <= 3), "{num_moved:?}");
    assert!(num_moved.iter().sum::<usize>() > 3, "{num_moved:?}");
    let mut source = BagReader::open(&bag, &Config::default().topics).unwrap();
    let run = run_streamed(&mut source, &params, 0.1, &NoProgress).unwrap();
    let mut source = BagReader::open(&bag, &Config::default().topics).unwrap();
    params.refine.has_pose = false;
    let recorded = run_streamed(&mut source, &params, 0.1, &NoProgress).unwrap();
    let pairs = run.keyframes.iter().zip(&recorded.keyframes);
    let num_turned = pairs.filter(|(a, b)| a.world_from_camera != b.world_from_camera);
    assert!(num_turned.count() > 2);
}
