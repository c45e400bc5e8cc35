//! A bag painted as it comes: after every update the texture is that of the whole at once.

use std::path::Path;

use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::keyframe::{Keyframe, KeyframeStore};
use veneer::pipeline::{NoProgress, PipelineError, StreamPainter, Streamed, run_streamed, stream};
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
    let frames = &streamed.capture.keyframes;
    repaint(mesh, layout, frames, &decode, &params, &Silent).unwrap()
}

fn grown_tabletop(dir: &Path) -> BagReader {
    let bag = small_tabletop(dir, &["--grow", "4"]);
    BagReader::open(&bag, &Config::default().topics).unwrap()
}

#[test]
fn every_update_of_a_growing_scan_equals_the_whole() {
    let dir = tempfile::tempdir().unwrap();
    let mut params = Config::default().pipeline;
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
    let mut params = Config::default().pipeline;
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
    params.refine.has_pose = true;
    let mut source = grown_tabletop(dir.path());
    let refused = stream(&mut source, &params, 0.0, &NoProgress, &mut |_, _| ());
    assert!(matches!(
        refused.err(),
        Some(PipelineError::WholeScanOnly("photometric.pose"))
    ));
}
