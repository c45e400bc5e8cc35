//! Refinement without a network: gains before the texture is made, seams after it.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::clock::StageClock;
use super::pose_rounds::PoseReport;
use super::run::{PipelineError, PipelineParams};
use crate::atlas::{TexelSource, dilate_gutters};
use crate::keyframe::Keyframe;
use crate::mesh::TriMesh;
use crate::photometric::{
    CorrectedFrames, GainParams, GainReport, GainTable, PoseParams, SeamParams, SeamPhoto,
    SeamReport, estimate_gains, level_seams,
};
use crate::texinit::{Decode, TexInit, TexInitError};

/// What is refined, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct RefineParams {
    /// Whether each keyframe gets a gain per channel.
    pub has_gain: bool,
    /// How gains are estimated.
    pub gain: GainParams,
    /// Memory for frames with their gain, MB.
    pub cache_mb: f64,
    /// Whether keyframes are turned by the offset between photo and rendering.
    pub has_pose: bool,
    /// How.
    pub pose: PoseParams,
    /// Which seams are levelled, and how.
    pub seams: SeamParams,
}

impl Default for RefineParams {
    fn default() -> Self {
        Self {
            has_gain: false,
            gain: GainParams::default(),
            cache_mb: 256.0,
            has_pose: false,
            pose: PoseParams::default(),
            seams: SeamParams {
                has_global: false,
                has_local: false,
                ..SeamParams::default()
            },
        }
    }
}

/// What refinement did.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct RefineReport {
    /// The gains and how they came about; `None` where none were asked for.
    pub gain: Option<(GainTable, GainReport)>,
    /// Corrected poses; `None` where none were asked for.
    pub pose: Option<PoseReport>,
    /// Levelling; `None` where none was asked for.
    pub seams: Option<SeamReport>,
    /// Wall time of gains, then of seams, seconds.
    pub seconds: [f64; 2],
}

/// The gains of the keyframes; of none where none are asked for.
///
/// # Errors
/// [`PipelineError::Photometric`] for a parameter out of range.
pub fn gains(
    mesh: &TriMesh,
    keyframes: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    params: &RefineParams,
    clock: &StageClock<'_>,
    report: &mut RefineReport,
) -> Result<GainTable, PipelineError> {
    if !params.has_gain {
        return Ok(GainTable::default());
    }
    clock.begin("balance exposure", keyframes.len());
    let begun = Instant::now();
    let advance = |num_frames: usize| clock.advance(num_frames);
    let (table, details) = estimate_gains(mesh, keyframes, decode, &params.gain, &advance)?;
    report.seconds[0] = begun.elapsed().as_secs_f64();
    report.gain = Some((table.clone(), details));
    Ok(table)
}

/// `decode` with the gains; those of no keyframe leave it as it is.
pub fn corrected<'a>(
    decode: &'a Decode<'a>,
    gains: &'a GainTable,
    params: &RefineParams,
) -> CorrectedFrames<'a> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a float that is negative or too large becomes 0 or the largest"
    )]
    let max_bytes = (params.cache_mb * 1e6) as usize;
    CorrectedFrames::new(decode, gains, max_bytes)
}

/// Levels the seams of a texture made from `keyframes` and paints its gutters again, where asked.
///
/// # Errors
/// [`PipelineError`] for a parameter out of range.
pub fn level(
    mesh: &TriMesh,
    keyframes: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    texinit: &mut TexInit,
    params: &PipelineParams,
    clock: &StageClock<'_>,
    report: &mut RefineReport,
) -> Result<(), PipelineError> {
    let seams = &params.refine.seams;
    if !seams.has_global && !seams.has_local {
        return Ok(());
    }
    clock.begin("level seams", 0);
    let begun = Instant::now();
    let sources: Vec<TexelSource> = keyframes
        .iter()
        .map(|keyframe| TexelSource::keyframe(keyframe.id.0))
        .collect();
    let levelled = level_seams(
        mesh,
        &texinit.layout,
        &texinit.assignment.label,
        &sources,
        Some(&seam_photos(keyframes, decode)),
        seams,
        &mut texinit.texture,
    )?;
    report.seams = Some(levelled);
    if params.texinit.has_gutters {
        dilate_gutters(&texinit.layout, &mut texinit.texture).map_err(TexInitError::from)?;
    }
    report.seconds[1] = begun.elapsed().as_secs_f64();
    Ok(())
}

/// Columns of the photos that seams look at: a pixel is then a mean over what a seam is wide.
pub(super) const SEAM_PHOTO_WIDTH_PX: u32 = 480;

fn seam_photos(keyframes: &[Arc<Keyframe>], decode: &Decode<'_>) -> Vec<Option<SeamPhoto>> {
    keyframes
        .par_iter()
        .map(|keyframe| {
            let frame = decode(keyframe).ok()?;
            let factor = frame.color.width().div_ceil(SEAM_PHOTO_WIDTH_PX);
            Some(SeamPhoto {
                color: frame.color.reduced(factor),
                camera: frame.color_camera.reduced(factor).ok()?,
                camera_from_world: keyframe.world_from_camera.inverse(),
            })
        })
        .collect()
}
