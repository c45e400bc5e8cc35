//! Decoded frames kept for reuse, bounded by bytes; callable from many threads at once.
//!
//! Stages go over all keyframes again and again in the same order, for which dropping the least
//! recently used entry is the worst rule: with room for all but one, nothing would ever be found.
//! So a full cache turns newcomers away, and gives up an entry only when it was not read during
//! the last few rounds. What `get_or_decode` returns never depends on what the cache holds.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use super::decoded::{DecodedFrame, LensCache, lock};
use super::frame::{Keyframe, KeyframeId};
use crate::geom::ImageError;

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
}

#[derive(Debug)]
struct Entry {
    /// Tells keyframes of another store apart that have the same number.
    source: Arc<[u8]>,
    frame: Arc<DecodedFrame>,
    num_bytes: usize,
    last_read: u64,
}

/// What the cache did; the counts depend on the timing of threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheReport {
    /// Frames asked for.
    pub num_reads: u64,
    /// Frames that had to be decoded.
    pub num_decoded: u64,
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
        if let Some(frame) = lock(&self.state).read(keyframe) {
            return Ok(frame);
        }
        let frame = Arc::new(DecodedFrame::decode(keyframe, &self.lenses)?);
        lock(&self.state).offer(keyframe, &frame, self.max_bytes);
        Ok(frame)
    }

    pub(super) fn remove(&self, id: KeyframeId) {
        lock(&self.state).remove(id);
    }

    pub(super) fn report(&self) -> CacheReport {
        let state = lock(&self.state);
        CacheReport {
            num_reads: state.num_reads,
            num_decoded: state.num_decoded,
            num_bytes: state.num_bytes,
            peak_bytes: state.peak_bytes,
        }
    }
}

impl State {
    fn read(&mut self, keyframe: &Keyframe) -> Option<Arc<DecodedFrame>> {
        self.num_reads += 1;
        let now = self.num_reads;
        let entry = self.entries.get_mut(&keyframe.id)?;
        if !Arc::ptr_eq(&entry.source, keyframe.color.bytes()) {
            return None;
        }
        entry.last_read = now;
        Some(entry.frame.clone())
    }

    fn offer(&mut self, keyframe: &Keyframe, frame: &Arc<DecodedFrame>, max_bytes: usize) {
        self.num_decoded += 1;
        let num_bytes = frame.num_bytes();
        if self.entries.contains_key(&keyframe.id) || num_bytes > max_bytes {
            return;
        }
        while self.num_bytes > max_bytes - num_bytes {
            let Some(stale) = self.stalest() else {
                return;
            };
            self.remove(stale);
        }
        self.num_bytes += num_bytes;
        self.peak_bytes = self.peak_bytes.max(self.num_bytes);
        self.entries.insert(
            keyframe.id,
            Entry {
                source: keyframe.color.bytes().clone(),
                frame: frame.clone(),
                num_bytes,
                last_read: self.num_reads,
            },
        );
    }

    fn stalest(&self) -> Option<KeyframeId> {
        let (id, entry) = self
            .entries
            .iter()
            .min_by_key(|(_, entry)| entry.last_read)?;
        let stale_before = STALE_ROUNDS * (self.entries.len() as u64).max(8);
        (self.num_reads - entry.last_read > stale_before).then_some(*id)
    }

    fn remove(&mut self, id: KeyframeId) {
        if let Some(entry) = self.entries.remove(&id) {
            self.num_bytes -= entry.num_bytes;
        }
    }
}
