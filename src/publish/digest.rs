//! What stands for content that was sent: 128 bits of it.
//!
//! Only compared within one process, so that the standard library may change its hash.

use std::hash::{DefaultHasher, Hasher};

/// Stands for a content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Digest(pub(super) u128);

/// Takes content piece by piece.
pub(super) struct Digester([DefaultHasher; 2]);

impl Digester {
    pub(super) fn new() -> Self {
        let mut halves = [DefaultHasher::new(), DefaultHasher::new()];
        halves[1].write_u8(1);
        Self(halves)
    }

    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        for half in &mut self.0 {
            half.write(bytes);
        }
    }

    pub(super) fn number(&mut self, number: u64) {
        self.bytes(&number.to_le_bytes());
    }

    pub(super) fn finish(&self) -> Digest {
        let [low, high] = [&self.0[0], &self.0[1]].map(|half| u128::from(half.finish()));
        Digest(high << 64 | low)
    }
}
