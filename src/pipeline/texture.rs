//! From a scan to its texture: every stage that makes or changes texels, in order.

use std::sync::Arc;

use super::clock::StageClock;
use super::run::{PipelineError, PipelineParams};
use super::scan::Scan;
use crate::keyframe::Keyframe;
use crate::texinit::{TexInit, texinit};

/// A textured scan.
#[derive(Debug)]
pub struct Textured {
    /// The layout, the texture and how they came about.
    pub texinit: TexInit,
}

/// Textures the mesh of `scan` from `painting`: some or all of its keyframes, possibly with other
/// poses.
///
/// # Errors
/// [`PipelineError`] when a stage refuses its parameters.
pub fn texture_scan(
    scan: &Scan,
    painting: &[Arc<Keyframe>],
    params: &PipelineParams,
    clock: &StageClock<'_>,
) -> Result<Textured, PipelineError> {
    let decode = |keyframe: &Keyframe| scan.decode(keyframe);
    let texinit = texinit(&scan.mesh, painting, &decode, &params.texinit, clock)?;
    Ok(Textured { texinit })
}
