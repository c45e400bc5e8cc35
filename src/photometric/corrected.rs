//! Decoded frames with their gain, kept for reuse within a bound of bytes.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::geom::ImageError;
use crate::keyframe::{DecodedFrame, Keyframe, KeyframeId};

use super::gain::GainTable;

/// Makes of one way to decode keyframes another that corrects their colours. What it gives never
/// depends on what is kept. Of what was kept, that read longest ago goes first.
pub struct CorrectedFrames<'a> {
    decode: &'a (dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
    gains: &'a GainTable,
    max_bytes: usize,
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    /// Frame and when it was read last.
    frames: BTreeMap<KeyframeId, (Arc<DecodedFrame>, u64)>,
    num_bytes: usize,
    num_reads: u64,
}

impl<'a> CorrectedFrames<'a> {
    /// Corrects what `decode` gives by `gains`, and keeps up to `max_bytes` of it.
    pub fn new(
        decode: &'a (dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync),
        gains: &'a GainTable,
        max_bytes: usize,
    ) -> Self {
        Self {
            decode,
            gains,
            max_bytes,
            kept: Mutex::default(),
        }
    }

    /// The keyframe, decoded and corrected.
    ///
    /// # Errors
    /// [`ImageError`] where it does not decode.
    pub fn decode(&self, keyframe: &Keyframe) -> Result<Arc<DecodedFrame>, ImageError> {
        if self.gains.factors(keyframe.id) == [1.0; 3] {
            return (self.decode)(keyframe);
        }
        if let Some(frame) = self.lock().read(keyframe.id) {
            return Ok(frame);
        }
        let frame = (self.decode)(keyframe)?;
        let corrected = Arc::new(DecodedFrame {
            color: self.gains.corrected(keyframe.id, &frame.color),
            color_camera: frame.color_camera,
            depth: frame.depth.clone(),
        });
        self.lock().keep(keyframe.id, &corrected, self.max_bytes);
        Ok(corrected)
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn read(&mut self, id: KeyframeId) -> Option<Arc<DecodedFrame>> {
        self.num_reads += 1;
        let now = self.num_reads;
        let (frame, last_read) = self.frames.get_mut(&id)?;
        *last_read = now;
        Some(frame.clone())
    }

    fn keep(&mut self, id: KeyframeId, frame: &Arc<DecodedFrame>, max_bytes: usize) {
        // The depth image is shared with whoever decoded it.
        let num_bytes = |frame: &DecodedFrame| size_of_val(frame.color.pixels());
        if num_bytes(frame) > max_bytes || self.frames.contains_key(&id) {
            return;
        }
        while self.num_bytes + num_bytes(frame) > max_bytes {
            let oldest = self
                .frames
                .iter()
                .min_by_key(|(_, (_, last_read))| *last_read);
            let Some(oldest) = oldest.map(|(id, _)| *id) else {
                return;
            };
            if let Some((gone, _)) = self.frames.remove(&oldest) {
                self.num_bytes -= num_bytes(&gone);
            }
        }
        self.num_bytes += num_bytes(frame);
        self.frames.insert(id, (frame.clone(), self.num_reads));
    }
}
