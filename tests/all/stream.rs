//! A bag painted as it comes: after every update the texture is that of the whole at once.

use std::path::Path;

use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::keyframe::Keyframe;
use veneer::pipeline::{NoProgress, PipelineError, StreamPainter, Streamed, stream};
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
