//! Numbers for places and triangles that are looked up, by hashing with a fixed function: nothing
//! is ever listed in the order of the hashes.

use super::{GridPoint, OldTriangle};
use crate::mesh::ids::TriangleId;

const EMPTY: u32 = u32::MAX;

/// Finalizer of MurmurHash3: every bit of the input reaches every bit of the output.
const fn mixed(mut bits: u64) -> u64 {
    bits ^= bits >> 33;
    bits = bits.wrapping_mul(0xff51_afd7_ed55_8ccd);
    bits ^= bits >> 33;
    bits = bits.wrapping_mul(0xc4ce_b9fe_1a85_ec53);
    bits ^ (bits >> 33)
}

fn hash(words: [u64; 3]) -> u64 {
    words.into_iter().fold(0, |hash, word| {
        mixed(hash.wrapping_add(0x9e37_79b9_7f4a_7c15) ^ word)
    })
}

/// Open addressing: slots with the numbers of entries.
#[derive(Debug)]
struct Slots {
    slots: Vec<u32>,
}

impl Slots {
    /// At most half full.
    fn for_entries(num_entries: usize) -> Self {
        Self {
            slots: vec![EMPTY; (2 * num_entries).next_power_of_two().max(2)],
        }
    }

    /// The slot of the entry that `is_it` says, or the free one where it belongs.
    fn find(&mut self, hash: u64, is_it: impl Fn(u32) -> bool) -> &mut u32 {
        let at = self.place_of(hash, is_it);
        &mut self.slots[at]
    }

    /// The entry that `is_it` says.
    fn get(&self, hash: u64, is_it: impl Fn(u32) -> bool) -> Option<u32> {
        let at = self.place_of(hash, is_it);
        Some(self.slots[at]).filter(|&entry| entry != EMPTY)
    }

    /// Where the entry is that `is_it` says, or the free slot where it belongs.
    #[expect(clippy::cast_possible_truncation, reason = "masked")]
    fn place_of(&self, hash: u64, is_it: impl Fn(u32) -> bool) -> usize {
        let mask = self.slots.len() - 1;
        let mut at = hash as usize & mask;
        while self.slots[at] != EMPTY && !is_it(self.slots[at]) {
            at = (at + 1) & mask;
        }
        at
    }

    /// Makes room for twice as many entries, whose hashes are asked for.
    fn grow(&mut self, hash_of: impl Fn(u32) -> u64) {
        let before = std::mem::take(&mut self.slots);
        self.slots = vec![EMPTY; 2 * before.len()];
        for entry in before.into_iter().filter(|&entry| entry != EMPTY) {
            *self.find(hash_of(entry), |_| false) = entry;
        }
    }

    /// Takes an entry out, and moves those up that were pushed on by it.
    #[expect(clippy::cast_possible_truncation, reason = "masked")]
    fn remove(&mut self, entry: u32, hash_of: impl Fn(u32) -> u64) {
        let mask = self.slots.len() - 1;
        let mut hole = self.place_of(hash_of(entry), |k| k == entry);
        let mut at = hole;
        loop {
            at = (at + 1) & mask;
            let Some(&other) = self.slots.get(at).filter(|&&other| other != EMPTY) else {
                break;
            };
            // It may go to the hole unless that lies before the slot where its search begins.
            let home = hash_of(other) as usize & mask;
            if at.wrapping_sub(home) & mask >= at.wrapping_sub(hole) & mask {
                self.slots[hole] = other;
                hole = at;
            }
        }
        self.slots[hole] = EMPTY;
    }
}

/// Numbers grid points in the order in which they come; numbers of points that are forgotten are
/// given anew.
#[derive(Debug)]
pub(super) struct Places {
    slots: Slots,
    /// By number, those that are forgotten among them.
    points: Vec<GridPoint>,
    /// Numbers to be given anew.
    free: Vec<u32>,
}

fn hash_of(point: GridPoint) -> u64 {
    hash(point.map(i64::cast_unsigned))
}

impl Places {
    pub(super) fn with_capacity(num_points: usize) -> Self {
        Self {
            slots: Slots::for_entries(num_points),
            points: Vec::with_capacity(num_points),
            free: Vec::new(),
        }
    }

    /// The number of a point.
    pub(super) fn insert(&mut self, point: GridPoint) -> u32 {
        self.enter(point).0
    }

    /// The number of a point, and whether it had none before.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "two meshes of 32 bits at most"
    )]
    pub(super) fn enter(&mut self, point: GridPoint) -> (u32, bool) {
        let points = &mut self.points;
        if 2 * (points.len() - self.free.len()) >= self.slots.slots.len() {
            self.slots.grow(|place| hash_of(points[place as usize]));
        }
        let slot = self
            .slots
            .find(hash_of(point), |k| points[k as usize] == point);
        let is_new = *slot == EMPTY;
        if is_new {
            *slot = match self.free.pop() {
                Some(free) => {
                    points[free as usize] = point;
                    free
                }
                None => {
                    points.push(point);
                    points.len() as u32 - 1
                }
            };
        }
        (*slot, is_new)
    }

    /// The number of a point that has one.
    pub(super) fn get(&self, point: GridPoint) -> Option<u32> {
        let is_it = |k: u32| self.points[k as usize] == point;
        self.slots.get(hash_of(point), is_it)
    }

    /// Forgets a point, by its number.
    pub(super) fn remove(&mut self, place: u32) {
        let points = &self.points;
        self.slots.remove(place, |k| hash_of(points[k as usize]));
        self.free.push(place);
    }

    /// All numbers are below this.
    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    /// How many numbers stand for nothing.
    pub(super) fn num_free(&self) -> usize {
        self.free.len()
    }

    pub(super) fn point(&self, place: u32) -> GridPoint {
        self.points[place as usize]
    }
}

/// A triangle's places, the smallest number first, in the turn of its corners.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Turned {
    pub(super) places: [u32; 3],
    /// The corner that comes first.
    first_corner: u8,
}

impl Turned {
    pub(super) fn of(corners: [u32; 3]) -> Self {
        let [a, b, c] = corners;
        // Of equal corners the one whose successor is smaller, so that the turn alone decides.
        let turns = [([a, b, c], 0), ([b, c, a], 1), ([c, a, b], 2)];
        let (places, first_corner) = turns.into_iter().min().unwrap_or(turns[0]);
        Self {
            places,
            first_corner,
        }
    }

    /// The triangle with its corners elsewhere.
    pub(super) fn with_places(&self, place: impl Fn(u32) -> u32) -> Self {
        let moved = Self::of(self.places.map(place));
        Self {
            first_corner: (self.first_corner + moved.first_corner) % 3,
            ..moved
        }
    }

    fn hash(&self) -> u64 {
        hash(self.places.map(u64::from))
    }
}

/// Triangles that are each given out once.
pub(super) struct Pool {
    slots: Slots,
    /// Per triangle: the next equal one.
    next: Vec<u32>,
    is_left: Vec<bool>,
}

impl Pool {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a mesh has 32 bits of triangles"
    )]
    pub(super) fn of(triangles: &[Turned]) -> Self {
        let mut slots = Slots::for_entries(triangles.len());
        let mut next = vec![EMPTY; triangles.len()];
        // From the last, so that the first of equals is found first.
        for (index, triangle) in triangles.iter().enumerate().rev() {
            let is_equal = |k: u32| triangles[k as usize].places == triangle.places;
            let slot = slots.find(triangle.hash(), is_equal);
            next[index] = std::mem::replace(slot, index as u32);
        }
        Self {
            slots,
            is_left: vec![true; triangles.len()],
            next,
        }
    }

    /// Takes an equal triangle out; `triangles` are those of the pool.
    #[expect(clippy::cast_possible_truncation, reason = "below three")]
    pub(super) fn take(&mut self, wanted: Turned, triangles: &[Turned]) -> Option<OldTriangle> {
        let is_equal = |k: u32| triangles[k as usize].places == wanted.places;
        let slot = self.slots.find(wanted.hash(), is_equal);
        let mut found = *slot;
        while found != EMPTY && !self.is_left[found as usize] {
            found = self.next[found as usize];
        }
        if found == EMPTY {
            return None;
        }
        // The one before may be gone for good, but the slot must stay filled for those behind it.
        *slot = found;
        self.is_left[found as usize] = false;
        let turn = 3 + wanted.first_corner - triangles[found as usize].first_corner;
        Some(OldTriangle {
            triangle: TriangleId(found),
            first_corner: (turn as usize % 3) as u8,
        })
    }

    pub(super) fn remove(&mut self, triangle: TriangleId) {
        self.is_left[triangle.index()] = false;
    }

    /// Those that nobody took, ascending.
    pub(super) fn left(&self) -> Vec<TriangleId> {
        let ids = (0_u32..).map(TriangleId).zip(&self.is_left);
        ids.filter(|(_, is_left)| **is_left)
            .map(|(id, _)| id)
            .collect()
    }
}
