//! The score of a synthetic recording against the texture that it was made with.

use std::path::Path;

use crate::bag;
use crate::pipeline::Run;
use crate::report::SyntheticScore;
use crate::synth::{self, GroundTruth, PaintingView};

/// Surfaces whose error goes to the log, the largest total error first.
const NUM_WORST_SURFACES: usize = 12;

/// The score, when the bag says which scene it shows; `None` for any other recording.
///
/// # Errors
/// When the bag names a scene that cannot be rebuilt.
pub(super) fn against_truth(bag: &Path, run: &Run) -> anyhow::Result<Option<SyntheticScore>> {
    let Some(description) = bag::metadata(bag, synth::METADATA_NAME)? else {
        return Ok(None);
    };
    let truth = GroundTruth::from_metadata(&description)?;
    let views: Vec<PaintingView> = run
        .keyframes
        .iter()
        .map(|keyframe| PaintingView {
            keyframe: keyframe.id.0,
            world_from_camera: keyframe.world_from_camera,
            camera: keyframe.color_camera.pinhole,
        })
        .collect();
    let (layout, texture) = (&run.texinit.layout, &run.texinit.texture);
    let score = synth::score(&run.mesh, layout, texture, &truth, &views);
    for surface in score.surfaces.iter().take(NUM_WORST_SURFACES) {
        tracing::info!(
            surface = surface.name,
            num_texels = surface.num_texels,
            mean_abs_error_255 = surface.mean_abs_error_255,
            "error against the known texture"
        );
    }
    Ok(Some(SyntheticScore {
        num_texels: score.num_seen_texels,
        num_hidden_texels: score.num_hidden_texels,
        mean_abs: score.mean_abs_error_255,
        p90_abs: score.percentiles_255.p90,
        covered_share: score.seen_area_share,
    }))
}
