//! From a scan to its texture: every stage that makes or changes texels, in order.

use std::sync::Arc;

use super::clock::StageClock;
use super::pose_rounds;
use super::refine::{self, RefineReport};
use super::run::{PipelineError, PipelineParams};
use super::scan::Scan;
use crate::keyframe::Keyframe;
use crate::texinit::{TexInit, texinit};
use crate::texsmooth::{self, SmoothFrom, SmoothReport};

/// A textured scan.
#[derive(Debug)]
pub struct Textured {
    /// The keyframes that painted, their poses corrected where that was asked for.
    pub keyframes: Vec<Arc<Keyframe>>,
    /// The layout, the texture and how they came about.
    pub texinit: TexInit,
    /// What gains and seam levelling did.
    pub refine: RefineReport,
    /// How the optimisation went; `None` where none was asked for.
    pub texsmooth: Option<SmoothReport>,
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
    let recorded = |keyframe: &Keyframe| scan.decode(keyframe);
    let mut refined = RefineReport::default();
    let gains = refine::gains(
        &scan.mesh,
        painting,
        &recorded,
        &params.refine,
        clock,
        &mut refined,
    )?;
    let corrected = refine::corrected(&recorded, &gains, &params.refine);
    let decode = |keyframe: &Keyframe| corrected.decode(keyframe);
    let mut texinit = texinit(&scan.mesh, painting, &decode, &params.texinit, clock)?;
    let mut keyframes = painting.to_vec();
    if params.refine.has_pose {
        let pose = &params.refine.pose;
        let corrected = pose_rounds::correct(
            scan,
            &mut keyframes,
            &decode,
            &mut texinit,
            pose,
            &params.texinit,
            clock,
        )?;
        refined.pose = Some(corrected);
    }
    refine::level(
        &scan.mesh,
        &keyframes,
        &decode,
        &mut texinit,
        params,
        clock,
        &mut refined,
    )?;
    let texsmooth = if params.texsmooth.num_steps > 0 {
        clock.begin("refine the texture", params.texsmooth.num_steps);
        let from = match &params.smooth_from {
            Some(bytes) => SmoothFrom::Checkpoint(bytes),
            None => SmoothFrom::Nothing,
        };
        let report = texsmooth::smooth(
            &scan.mesh,
            &texinit.layout,
            &mut texinit.texture,
            &keyframes,
            &decode,
            &params.texsmooth,
            from,
            clock,
        )?;
        Some(report)
    } else {
        None
    };
    Ok(Textured {
        keyframes,
        texinit,
        refine: refined,
        texsmooth,
    })
}
