//! Rounds of pose correction: measure every keyframe against the texture, turn it, repaint.
//!
//! Between rounds labels stay and only colours are transferred anew: poses change by less than what
//! decides who sees a triangle. At the end labels are chosen and everything is painted once more. A
//! keyframe whose own residual rises is put back and left alone; when the mean residual no longer
//! falls, the round is undone and the rounds end.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::clock::StageClock;
use super::run::PipelineError;
use super::scan::Scan;
use crate::geom::RigidTransform;
use crate::keyframe::Keyframe;
use crate::photometric::PhotometricError;
use crate::photometric::pose::{Painted, PoseMeasure, PoseParams, PosePhoto, measure_pose, turned};
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
    let recorded: Vec<_> = keyframes.iter().map(|k| k.world_from_camera).collect();
    let photos = Photos::new(keyframes, decode, params);
    let mut rounds = Rounds {
        params,
        recorded: &recorded,
        is_settled: vec![false; keyframes.len()],
        before: None,
        report: PoseReport::default(),
    };
    let mut texture = None;
    for round in 0..=params.max_rounds {
        let painted = Painted {
            mesh: &scan.mesh,
            layout: &made.layout,
            texture: texture.as_ref().unwrap_or(&made.texture),
            label: &made.assignment.label,
        };
        let measures = photos.measure(painted, keyframes)?;
        if !rounds.goes_on(&measures, keyframes) || round == params.max_rounds {
            break;
        }
        rounds.turn(measures, keyframes);
        let (colors, _) = transfer::transfer(
            &scan.mesh,
            &made.layout,
            &made.assignment,
            keyframes,
            decode,
            &texinit.transfer,
            &|_| {},
        )
        .map_err(TexInitError::from)?;
        texture = Some(colors);
        clock.advance(1);
    }

    let mut report = rounds.finish(keyframes);
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

/// Memory for photos at the size at which they are compared; those beyond are made anew each round.
const MAX_PHOTO_BYTES: usize = 128_000_000;

/// The keyframes' photos at the size at which they are compared.
struct Photos<'a> {
    decode: &'a Decode<'a>,
    params: &'a PoseParams,
    /// Of the first keyframes, as many as there is memory for; `None` where one does not decode.
    kept: Vec<Option<PosePhoto>>,
}

impl<'a> Photos<'a> {
    fn new(keyframes: &[Arc<Keyframe>], decode: &'a Decode<'a>, params: &'a PoseParams) -> Self {
        let num_bytes = |keyframe: &Arc<Keyframe>| {
            let camera = &keyframe.color_camera.pinhole;
            let factor = camera.width().div_ceil(params.max_width_px.max(1)).max(1);
            3 * (camera.width() / factor) as usize * (camera.height() / factor) as usize
        };
        let mut total = 0;
        let num_kept = keyframes
            .iter()
            .take_while(|keyframe| {
                total += num_bytes(keyframe);
                total <= MAX_PHOTO_BYTES
            })
            .count();
        let mut photos = Self {
            decode,
            params,
            kept: Vec::new(),
        };
        photos.kept = keyframes[..num_kept]
            .par_iter()
            .map(|keyframe| photos.make(keyframe))
            .collect();
        photos
    }

    fn make(&self, keyframe: &Keyframe) -> Option<PosePhoto> {
        PosePhoto::new(&*(self.decode)(keyframe).ok()?, self.params)
    }

    /// Every keyframe against the texture; one that does not decode measures nothing.
    fn measure(
        &self,
        painted: Painted<'_>,
        keyframes: &[Arc<Keyframe>],
    ) -> Result<Vec<PoseMeasure>, PipelineError> {
        let measures: Result<Vec<PoseMeasure>, _> = keyframes
            .par_iter()
            .enumerate()
            .map(|(index, keyframe)| {
                let made;
                let photo = match self.kept.get(index) {
                    Some(kept) => kept.as_ref(),
                    None => {
                        made = self.make(keyframe);
                        made.as_ref()
                    }
                };
                let Some(photo) = photo else {
                    return Ok(PoseMeasure::default());
                };
                let camera_from_world = keyframe.world_from_camera.inverse();
                measure_pose(painted, index, &camera_from_world, photo, self.params)
            })
            .collect();
        Ok(measures.map_err(PhotometricError::from)?)
    }
}

/// What the rounds remember.
struct Rounds<'a> {
    params: &'a PoseParams,
    recorded: &'a [RigidTransform],
    /// Keyframes that are left alone.
    is_settled: Vec<bool>,
    /// The keyframes before the last turn, and what they measured.
    before: Option<(Vec<Arc<Keyframe>>, Vec<PoseMeasure>)>,
    report: PoseReport,
}

impl Rounds<'_> {
    /// Whether the residual still falls. Where it rose the last round is undone.
    fn goes_on(&mut self, measures: &[PoseMeasure], keyframes: &mut [Arc<Keyframe>]) -> bool {
        let residual = mean(measures.iter().filter_map(|m| m.residual_255));
        match (&self.before, self.report.residual_255.last()) {
            (Some((poses, _)), Some(&last)) if residual > last * (1.0 - self.params.min_gain) => {
                if residual > last {
                    keyframes.clone_from_slice(poses);
                }
                return false;
            }
            (None, _) => {
                let unknown = measures.iter().filter(|m| m.offset_px.is_none());
                self.report.num_unknown = unknown.count();
            }
            _ => {}
        }
        self.report.residual_255.push(residual);
        let lengths = measures.iter().filter_map(|m| m.offset_px);
        let mean_px = mean(lengths.map(|[x, y]| x.hypot(y)));
        self.report.offset_px.push(mean_px);
        true
    }

    /// Turns each keyframe by its offset, but puts back those whose own residual rose.
    fn turn(&mut self, measures: Vec<PoseMeasure>, keyframes: &mut [Arc<Keyframe>]) {
        let mut poses = keyframes.to_vec();
        for (index, keyframe) in keyframes.iter_mut().enumerate() {
            if self.is_settled[index] {
                continue;
            }
            if let Some((last_poses, last)) = &self.before
                && has_risen(last[index].residual_255, measures[index].residual_255)
            {
                // Put back for good, should this round be undone.
                *keyframe = Arc::clone(&last_poses[index]);
                poses[index] = Arc::clone(keyframe);
                self.is_settled[index] = true;
                self.report.num_put_back += 1;
                continue;
            }
            if let Some(offset_px) = measures[index].offset_px {
                match turned(keyframe, &self.recorded[index], offset_px, self.params) {
                    Some(turned) => *keyframe = Arc::new(turned),
                    None => self.is_settled[index] = true,
                }
            }
        }
        self.before = Some((poses, measures));
    }

    fn finish(mut self, keyframes: &[Arc<Keyframe>]) -> PoseReport {
        for (keyframe, recorded) in keyframes.iter().zip(self.recorded) {
            let turn = keyframe.world_from_camera.rotation();
            let turn_rad = turn.angle_to(recorded.rotation());
            self.report.num_turned += usize::from(turn_rad > 0.0);
            self.report.max_turn_rad = self.report.max_turn_rad.max(turn_rad);
        }
        self.report
    }
}

/// More than the noise of a new mosaic.
pub(super) fn has_risen(before: Option<f64>, after: Option<f64>) -> bool {
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
