//! What stands for content that was sent: 128 bits of it.
//!
//! Only compared within one process. XXH3 reads texels about as fast as memory gives them.

use xxhash_rust::xxh3::Xxh3;

/// Stands for a content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Digest(pub(super) u128);

/// Takes content piece by piece.
pub(super) struct Digester(Xxh3);

impl Digester {
    pub(super) fn new() -> Self {
        Self(Xxh3::new())
    }

    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    pub(super) fn number(&mut self, number: u64) {
        self.bytes(&number.to_le_bytes());
    }

    pub(super) fn finish(&self) -> Digest {
        Digest(self.0.digest128())
    }
}
