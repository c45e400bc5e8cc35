//! Gains while keyframes come and go: each is given once, and stands.

use std::collections::BTreeSet;
use std::sync::Arc;

use rayon::prelude::*;

use crate::keyframe::{DecodedFrame, Keyframe, KeyframeId};
use crate::photometric::{GainTable, GainedFrame, gain_of_frame};
use crate::pipeline::RefineParams;
use crate::texinit::Decode;

/// Keyframes that a new one is compared with.
const NUM_NEIGHBOURS: usize = 6;
/// An angle between two views that counts like a metre between them, radians.
const RAD_PER_M: f64 = 0.5;

/// Gives each keyframe without a gain one, in their order, and forgets those of keyframes that went. One
/// that nothing can be said of has gain 1, as has the first.
pub(super) fn keep_up(
    gains: &mut GainTable,
    keyframes: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    params: &RefineParams,
) {
    let present: BTreeSet<KeyframeId> = keyframes.iter().map(|keyframe| keyframe.id).collect();
    gains.retain(|id| present.contains(&id));
    for keyframe in keyframes {
        if !gains.contains(keyframe.id) {
            let factors = gain(keyframe, keyframes, gains, decode, params);
            gains.insert(keyframe.id, factors.unwrap_or([1.0; 3]));
        }
    }
}

fn gain(
    keyframe: &Keyframe,
    keyframes: &[Arc<Keyframe>],
    gains: &GainTable,
    decode: &Decode<'_>,
    params: &RefineParams,
) -> Option<[f32; 3]> {
    let decoded = decode(keyframe).ok()?;
    let known = keyframes.iter().filter(|other| gains.contains(other.id));
    let near = nearest(keyframe, known);
    let neighbours: Vec<(&Arc<Keyframe>, Arc<DecodedFrame>)> = near
        .into_par_iter()
        .filter_map(|other| Some((other, decode(other).ok()?)))
        .collect();
    let others: Vec<GainedFrame<'_>> = neighbours
        .iter()
        .map(|(other, decoded)| GainedFrame {
            keyframe: other,
            decoded,
            factors: gains.factors(other.id),
        })
        .collect();
    gain_of_frame(keyframe, &decoded, &others, &params.gain)
}

/// Those that look nearly the same way from nearly the same place.
fn nearest<'a>(
    keyframe: &Keyframe,
    others: impl Iterator<Item = &'a Arc<Keyframe>>,
) -> Vec<&'a Arc<Keyframe>> {
    let camera_from_world = keyframe.world_from_camera.inverse();
    let mut by_distance: Vec<(f64, &Arc<Keyframe>)> = others
        .map(|other| {
            let between = camera_from_world * other.world_from_camera;
            let angle_rad = between.rotation().angle();
            (between.translation().norm() + angle_rad / RAD_PER_M, other)
        })
        .collect();
    by_distance.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.id.cmp(&b.1.id)));
    by_distance.truncate(NUM_NEIGHBOURS);
    by_distance.into_iter().map(|(_, other)| other).collect()
}
