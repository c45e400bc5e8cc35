//! Keyframes' photos at the size at which idle steps look at them, kept for reuse.

use std::collections::BTreeMap;
use std::sync::Arc;

use rayon::prelude::*;

use crate::keyframe::{Keyframe, KeyframeId};
use crate::photometric::{PoseParams, PosePhoto};
use crate::texinit::Decode;

/// Memory for them; of those beyond, the ones read longest ago go. What an idle step looks at is held
/// besides while it runs.
const MAX_BYTES: usize = 16_000_000;

/// A keyframe and the most columns of its photo.
type Key = (KeyframeId, u32);

/// See the module. What it gives never depends on what is kept.
#[derive(Debug, Default)]
pub(super) struct SmallPhotos {
    /// The photo, and when it was read last.
    kept: BTreeMap<Key, (Arc<PosePhoto>, u64)>,
    num_bytes: usize,
    num_reads: u64,
}

impl SmallPhotos {
    /// The photos of keyframes, no wider than `max_width_px`; `None` for one that does not decode.
    pub(super) fn of(
        &mut self,
        keyframes: &[Arc<Keyframe>],
        max_width_px: u32,
        decode: &Decode<'_>,
    ) -> Vec<Option<Arc<PosePhoto>>> {
        let params = PoseParams {
            max_width_px,
            ..PoseParams::default()
        };
        let photos: Vec<Option<Arc<PosePhoto>>> = keyframes
            .par_iter()
            .map(|keyframe| {
                if let Some((photo, _)) = self.kept.get(&(keyframe.id, max_width_px)) {
                    return Some(Arc::clone(photo));
                }
                let photo = PosePhoto::new(&*decode(keyframe).ok()?, &params)?;
                Some(Arc::new(photo))
            })
            .collect();
        for (keyframe, photo) in keyframes.iter().zip(&photos) {
            if let Some(photo) = photo {
                self.keep((keyframe.id, max_width_px), photo);
            }
        }
        photos
    }

    /// Forgets those of keyframes that are no more.
    pub(super) fn retain(&mut self, is_present: impl Fn(KeyframeId) -> bool) {
        self.kept.retain(|(id, _), _| is_present(*id));
        self.num_bytes = self.kept.values().map(|(photo, _)| num_bytes(photo)).sum();
    }

    fn keep(&mut self, key: Key, photo: &Arc<PosePhoto>) {
        self.num_reads += 1;
        let before = self.kept.insert(key, (Arc::clone(photo), self.num_reads));
        self.num_bytes += num_bytes(photo);
        self.num_bytes -= before.map_or(0, |(photo, _)| num_bytes(&photo));
        while self.num_bytes > MAX_BYTES {
            let oldest = self.kept.iter().min_by_key(|(_, (_, read))| *read);
            let Some(oldest) = oldest.map(|(key, _)| *key) else {
                return;
            };
            if let Some((gone, _)) = self.kept.remove(&oldest) {
                self.num_bytes -= num_bytes(&gone);
            }
        }
    }
}

fn num_bytes(photo: &PosePhoto) -> usize {
    size_of_val(photo.color.pixels())
}
