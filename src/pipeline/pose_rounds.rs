//! Rounds of pose correction: measure every keyframe against the texture, turn it, repaint.
//!
//! Between rounds labels stay and only colours are transferred anew: poses change by less than what
//! decides who sees a triangle. At the end labels are chosen and everything is painted once more. A
//! keyframe whose own residual rises is put back and left alone; when the mean residual no longer
//! falls, the round is undone and the rounds end.

use std::sync::Arc;
use std::time::Instant;

use super::clock::StageClock;
use super::run::PipelineError;
use super::scan::Scan;
use crate::keyframe::Keyframe;
use crate::photometric::PhotometricError;
use crate::photometric::pose::{PoseMeasure, PoseParams, measure_poses, turned};
use crate::texinit::{Decode, TexInit, TexInitError, TexInitParams, repaint, transfer};

/// What the rounds did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseReport {
    /// Mean residual of the keyframes before the first round and after each one that counted, 0–255.
    pub residual_255: Vec<f64>,
    /// Mean length of the offsets then, pixels of the full photo.
    pub offset_px: Vec<f64>,
    /// Keyframes that were turned.
    pub num_turned: usize,
    /// Keyframes whose offset could not be told at first.
    pub num_unknown: usize,
    /// Keyframes that were put back.
    pub num_put_back: usize,
    /// The largest turn, radians.
    pub max_turn_rad: f64,
    /// Wall time, seconds.
    pub seconds: f64,
}

/// Corrects the poses of `keyframes` in place and repaints.
///
/// # Errors
/// [`PipelineError`] when a stage refuses its parameters.
pub(super) fn correct(
    scan: &Scan,
    keyframes: &mut [Arc<Keyframe>],
    decode: &Decode<'_>,
    made: &mut TexInit,
    params: &PoseParams,
    texinit: &TexInitParams,
    clock: &StageClock<'_>,
) -> Result<PoseReport, PipelineError> {
    clock.begin("correct poses", params.max_rounds);
    let begun = Instant::now();
    let mut report = PoseReport::default();
    let recorded: Vec<_> = keyframes.iter().map(|k| k.world_from_camera).collect();
    let mut texture = None;
    let mut before: Option<(Vec<Arc<Keyframe>>, Vec<PoseMeasure>)> = None;
    let mut is_settled = vec![false; keyframes.len()];
    for round in 0..=params.max_rounds {
        let measures = measure_poses(
            &scan.mesh,
            &made.layout,
            texture.as_ref().unwrap_or(&made.texture),
            &made.assignment.label,
            keyframes,
            decode,
            params,
        )
        .map_err(PhotometricError::from)?;
        if round == 0 {
            let unknown = measures.iter().filter(|m| m.offset_px.is_none());
            report.num_unknown = unknown.count();
        }
        let residual = mean(measures.iter().filter_map(|m| m.residual_255));
        if let Some((poses, _)) = &before
            && report
                .residual_255
                .last()
                .is_some_and(|last| residual > last * (1.0 - params.min_gain))
        {
            if report
                .residual_255
                .last()
                .is_some_and(|last| residual > *last)
            {
                keyframes.clone_from_slice(poses);
            }
            break;
        }
        report.residual_255.push(residual);
        let lengths = measures.iter().filter_map(|m| m.offset_px);
        report
            .offset_px
            .push(mean(lengths.map(|[x, y]| x.hypot(y))));
        if round == params.max_rounds {
            break;
        }

        let mut poses = keyframes.to_vec();
        for (index, keyframe) in keyframes.iter_mut().enumerate() {
            if is_settled[index] {
                continue;
            }
            if let Some((last_poses, last)) = &before
                && has_risen(last[index].residual_255, measures[index].residual_255)
            {
                // Put back for good, should this round be undone.
                *keyframe = Arc::clone(&last_poses[index]);
                poses[index] = Arc::clone(keyframe);
                is_settled[index] = true;
                report.num_put_back += 1;
                continue;
            }
            if let Some(offset_px) = measures[index].offset_px {
                match turned(keyframe, &recorded[index], offset_px, params) {
                    Some(turned) => *keyframe = Arc::new(turned),
                    None => is_settled[index] = true,
                }
            }
        }
        before = Some((poses, measures));
        let (painted, _) = transfer::transfer(
            &scan.mesh,
            &made.layout,
            &made.assignment,
            keyframes,
            decode,
            &texinit.transfer,
            &|_| {},
        )
        .map_err(TexInitError::from)?;
        texture = Some(painted);
        clock.advance(1);
    }

    let turns = keyframes.iter().zip(&recorded).map(|(keyframe, recorded)| {
        let turn = keyframe.world_from_camera.rotation();
        turn.angle_to(recorded.rotation())
    });
    for turn in turns.filter(|turn| *turn > 0.0) {
        report.num_turned += 1;
        report.max_turn_rad = report.max_turn_rad.max(turn);
    }
    if report.num_turned > 0 {
        let again = repaint(&scan.mesh, &made.layout, keyframes, decode, texinit, clock)?;
        made.texture = again.texture;
        made.assignment = again.assignment;
        made.report.transfer = again.transfer;
        made.report.fill = again.fill;
        made.report.gutter = again.gutter;
    }
    report.seconds = begun.elapsed().as_secs_f64();
    Ok(report)
}

/// More than the noise of a new mosaic.
fn has_risen(before: Option<f64>, after: Option<f64>) -> bool {
    matches!((before, after), (Some(before), Some(after)) if after > 1.02 * before)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut num) = (0.0, 0usize);
    for value in values {
        sum += value;
        num += 1;
    }
    if num == 0 { 0.0 } else { sum / num as f64 }
}
