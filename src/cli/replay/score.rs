//! The score of a synthetic recording against the texture that it was made with.

use std::path::Path;

use crate::bag;
use crate::pipeline::Run;
use crate::report::SyntheticScore;
use crate::synth::{self, GroundTruth};

/// The score, when the bag says which scene it shows; `None` for any other recording.
///
/// # Errors
/// When the bag names a scene that cannot be rebuilt.
pub(super) fn against_truth(bag: &Path, run: &Run) -> anyhow::Result<Option<SyntheticScore>> {
    let Some(description) = bag::metadata(bag, synth::METADATA_NAME)? else {
        return Ok(None);
    };
    let truth = GroundTruth::from_metadata(&description)?;
    let score = synth::score(&run.mesh, &run.texinit.layout, &run.texinit.texture, &truth);
    Ok(Some(SyntheticScore {
        num_texels: score.num_seen_texels,
        mean_abs: score.mean_abs_error_255,
        p90_abs: score.percentiles_255.p90,
        covered_share: score.seen_area_share,
    }))
}
