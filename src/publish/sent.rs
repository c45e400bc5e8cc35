//! What was sent on a topic: contents by digest, each with the name it went out under.

use std::collections::BTreeMap;

use super::PublishError;
use super::digest::Digest;

/// Contents that readers hold, each with a note of ours.
#[derive(Clone, Debug)]
pub(super) struct Sent<N> {
    names: BTreeMap<Digest, Vec<(u32, N)>>,
    next_name: u32,
}

impl<N> Default for Sent<N> {
    fn default() -> Self {
        Self {
            names: BTreeMap::new(),
            next_name: 0,
        }
    }
}

/// How what is there now differs from what readers hold.
#[derive(Debug)]
pub(super) struct Change<T, N> {
    /// Names and notes of what is gone, in the order of names.
    pub(super) removed: Vec<(u32, N)>,
    /// What is new, under its name.
    pub(super) added: Vec<(u32, T)>,
}

impl<N> Sent<N> {
    pub(super) fn contains(&self, digest: Digest) -> bool {
        self.names.contains_key(&digest)
    }

    /// Readers hold nothing. Names go on.
    pub(super) fn clear(&mut self) {
        self.names.clear();
    }

    /// Takes note of what is there now. Equal contents are told apart by their number only.
    pub(super) fn change<T>(
        &mut self,
        now: Vec<(Digest, N, T)>,
    ) -> Result<Change<T, N>, PublishError> {
        let mut before = std::mem::take(&mut self.names);
        let mut added = Vec::new();
        for (digest, note, content) in now {
            let kept = before.get_mut(&digest).and_then(Vec::pop);
            let name = match kept {
                Some((name, _)) => name,
                None => {
                    let name = self.next_name;
                    self.next_name = name.checked_add(1).ok_or(PublishError::OutOfNames)?;
                    added.push((name, content));
                    name
                }
            };
            self.names.entry(digest).or_default().push((name, note));
        }
        let mut removed: Vec<(u32, N)> = before.into_values().flatten().collect();
        removed.sort_unstable_by_key(|(name, _)| *name);
        Ok(Change { removed, added })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_with_their_content() {
        let mut sent = Sent::default();
        let now = |keys: &[u128]| keys.iter().map(|&k| (Digest(k), (), k)).collect::<Vec<_>>();
        let change = sent.change(now(&[7, 7, 8])).unwrap();
        assert_eq!(change.added, [(0, 7), (1, 7), (2, 8)]);
        let change = sent.change(now(&[8, 9, 7])).unwrap();
        assert_eq!(change.added, [(3, 9)]);
        assert_eq!(change.removed, [(0, ())]);
        assert!(sent.contains(Digest(7)) && sent.contains(Digest(9)));
        let change = sent.change(now(&[])).unwrap();
        assert_eq!(change.removed, [(1, ()), (2, ()), (3, ())]);
        // Names are never used twice.
        assert_eq!(sent.change(now(&[7])).unwrap().added, [(4, 7)]);
    }
}
