//! Decoded frames kept for reuse, bounded by bytes; callable from many threads at once.
//!
//! Stages go over all keyframes again and again in the same order, for which dropping the least
//! recently used entry is the worst rule: with room for all but one, nothing would ever be found.
//! So a full cache turns newcomers away, and gives up an entry only when it was not read during
//! the last few rounds, or when its keyframe is no more. What `get_or_decode` returns never depends
//! on what the cache holds.
//!
//! Depth images come first: a byte of theirs (two a pixel, where they were recorded in
//! millimetres) saves more decoding than a byte of colour, and admission has decoded them already.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use super::decoded::{DecodedDepth, DecodedFrame, LensCache, lock};
use super::frame::{Keyframe, KeyframeId};
use crate::geom::{DepthImage, Distortion, ImageError};

/// An entry is stale when it was not read during this many reads for each entry.
const STALE_ROUNDS: u64 = 8;

/// A bounded cache of decoded keyframes.
#[derive(Debug)]
pub(super) struct DecodeCache {
    max_bytes: usize,
    lenses: LensCache,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    entries: BTreeMap<KeyframeId, Entry>,
    num_bytes: usize,
    peak_bytes: usize,
    num_reads: u64,
    num_decoded: u64,
    num_depths_decoded: u64,
}

#[derive(Debug)]
struct Entry {
    /// Tells keyframes of another store apart that have the same number.
    source: Arc<[u8]>,
    held: Held,
    num_bytes: usize,
    last_read: u64,
}

/// What is there of a keyframe.
#[derive(Clone, Debug)]
enum Held {
    Depth(DecodedDepth),
    Whole(Arc<DecodedFrame>),
}

impl Held {
    fn num_bytes(&self) -> usize {
        match self {
            Self::Depth(depth) => depth.image.num_bytes(),
            Self::Whole(frame) => frame.num_bytes(),
        }
    }
}

/// What the cache did; the counts depend on the timing of threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheReport {
    /// Frames asked for.
    pub num_reads: u64,
    /// Frames whose colour had to be decoded.
    pub num_decoded: u64,
    /// Frames whose depth had to be decoded, after admission.
    pub num_depths_decoded: u64,
    /// Bytes held now.
    pub num_bytes: usize,
    /// Most bytes ever held.
    pub peak_bytes: usize,
}

impl DecodeCache {
    pub(super) fn new(max_bytes: usize) -> Self {
        Self {
            max_bytes,
            lenses: LensCache::default(),
            state: Mutex::default(),
        }
    }

    pub(super) fn get_or_decode(
        &self,
        keyframe: &Keyframe,
    ) -> Result<Arc<DecodedFrame>, ImageError> {
        let known_depth = match lock(&self.state).read(keyframe) {
            Some(Held::Whole(frame)) => return Ok(frame),
            Some(Held::Depth(depth)) => Some(depth),
            None => None,
        };
        let has_to_decode_depth = known_depth.is_none() && keyframe.depth.is_some();
        let frame = Arc::new(DecodedFrame::decode_with_depth(
            keyframe,
            known_depth,
            &self.lenses,
        )?);
        let mut state = lock(&self.state);
        state.num_decoded += 1;
        state.num_depths_decoded += u64::from(has_to_decode_depth);
        let is_kept = state.offer(keyframe, Held::Whole(frame.clone()), self.max_bytes);
        if let (false, Some(depth)) = (is_kept, &frame.depth) {
            state.offer(keyframe, Held::Depth(depth.clone()), self.max_bytes);
        }
        Ok(frame)
    }

    /// Takes a keyframe's depth image, decoded as recorded by someone else, if there is room. One
    /// that a lens distorts is left to whoever needs it.
    pub(super) fn offer_depth(&self, keyframe: &Keyframe, recorded: DepthImage) {
        let half = keyframe.depth.as_ref();
        if let Some(half) = half.filter(|half| half.camera.distortion == Distortion::None) {
            let depth = Held::Depth(DecodedDepth {
                image: recorded,
                camera: half.camera.pinhole,
                depth_from_color: half.depth_from_color,
            });
            lock(&self.state).offer(keyframe, depth, self.max_bytes);
        }
    }

    /// Drops depth images last, as they save most decoding for their bytes.
    pub(super) fn set_max_bytes(&mut self, max_bytes: usize) {
        self.max_bytes = max_bytes;
        let mut state = lock(&self.state);
        state.forget_gone();
        while state.num_bytes > max_bytes
            && let Some(id) = state.largest()
        {
            state.remove(id);
        }
    }

    pub(super) fn remove(&self, id: KeyframeId) {
        lock(&self.state).remove(id);
    }

    pub(super) fn report(&self) -> CacheReport {
        let state = lock(&self.state);
        CacheReport {
            num_reads: state.num_reads,
            num_decoded: state.num_decoded,
            num_depths_decoded: state.num_depths_decoded,
            num_bytes: state.num_bytes,
            peak_bytes: state.peak_bytes,
        }
    }
}

impl State {
    fn read(&mut self, keyframe: &Keyframe) -> Option<Held> {
        self.num_reads += 1;
        let now = self.num_reads;
        let entry = self.entries.get_mut(&keyframe.id)?;
        if !Arc::ptr_eq(&entry.source, keyframe.color.bytes()) {
            return None;
        }
        entry.last_read = now;
        Some(entry.held.clone())
    }

    /// Whether it is held now, all of it.
    fn offer(&mut self, keyframe: &Keyframe, held: Held, max_bytes: usize) -> bool {
        let num_bytes = held.num_bytes();
        let num_known_bytes = match self.entries.get(&keyframe.id).map(|entry| &entry.held) {
            Some(Held::Whole(_)) => return true,
            Some(Held::Depth(depth)) => depth.image.num_bytes(),
            None => 0,
        };
        if num_bytes > max_bytes {
            return false;
        }
        if self.num_bytes + num_bytes > max_bytes + num_known_bytes {
            self.forget_gone();
        }
        while self.num_bytes + num_bytes > max_bytes + num_known_bytes {
            let Some(stale) = self.stalest().filter(|&stale| stale != keyframe.id) else {
                return false;
            };
            self.remove(stale);
        }
        self.remove(keyframe.id);
        self.num_bytes += num_bytes;
        self.peak_bytes = self.peak_bytes.max(self.num_bytes);
        self.entries.insert(
            keyframe.id,
            Entry {
                source: keyframe.color.bytes().clone(),
                held,
                num_bytes,
                last_read: self.num_reads,
            },
        );
        true
    }

    /// Drops entries whose encoded image nobody else holds: their keyframe was evicted, and who
    /// decodes may be another than who evicts.
    fn forget_gone(&mut self) {
        let entries = self.entries.iter();
        let gone = entries.filter(|(_, entry)| Arc::strong_count(&entry.source) == 1);
        let gone: Vec<KeyframeId> = gone.map(|(id, _)| *id).collect();
        for id in gone {
            self.remove(id);
        }
    }

    fn stalest(&self) -> Option<KeyframeId> {
        let (id, entry) = self
            .entries
            .iter()
            .min_by_key(|(_, entry)| entry.last_read)?;
        let stale_before = STALE_ROUNDS * (self.entries.len() as u64).max(8);
        (self.num_reads - entry.last_read > stale_before).then_some(*id)
    }

    /// Of equals the newest.
    fn largest(&self) -> Option<KeyframeId> {
        let largest = self.entries.iter().max_by_key(|(_, entry)| entry.num_bytes);
        largest.map(|(id, _)| *id)
    }

    fn remove(&mut self, id: KeyframeId) {
        if let Some(entry) = self.entries.remove(&id) {
            self.num_bytes -= entry.num_bytes;
        }
    }
}
