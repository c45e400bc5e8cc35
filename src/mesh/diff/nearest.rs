//! Which vertices moved where: pairs that are each other's nearest.

use super::lookup::Places;
use super::{DiffParams, GridPoint};

/// Places that vertices left, with the ones that they went to.
pub(super) struct Moves {
    /// By the place left, ascending.
    pairs: Vec<(u32, u32)>,
}

impl Moves {
    /// Pairs of a place that was left and one that came, each the nearest to the other and no
    /// farther than the largest move; of equally near ones the first along x, then y, then z.
    pub(super) fn mutual(places: &Places, left: &[u32], came: &[u32], params: &DiffParams) -> Self {
        let reach = params.max_move_m / params.quantum_m;
        let came_bins = Bins::new(places, came, reach);
        let left_bins = Bins::new(places, left, reach);
        let nearest_to = |bins: &Bins, place: u32| bins.nearest(places.point(place));
        let pairs = left.iter().filter_map(|&from| {
            let to = nearest_to(&came_bins, from)?;
            (nearest_to(&left_bins, to) == Some(from)).then_some((from, to))
        });
        Self {
            pairs: pairs.collect(),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Where the vertex of a place is afterwards.
    pub(super) fn after(&self, place: u32) -> u32 {
        match self.pairs.binary_search_by_key(&place, |pair| pair.0) {
            Ok(found) => self.pairs[found].1,
            Err(_) => place,
        }
    }
}

/// Points by cells as wide as the reach.
struct Bins {
    /// Cell, point, place; sorted.
    entries: Vec<([i64; 3], GridPoint, u32)>,
    side_steps: f64,
    reach2: f64,
}

impl Bins {
    fn new(places: &Places, members: &[u32], reach_steps: f64) -> Self {
        let mut bins = Self {
            entries: Vec::new(),
            side_steps: reach_steps.max(1.0),
            reach2: reach_steps * reach_steps,
        };
        let entries = members.iter().map(|&place| {
            let point = places.point(place);
            (bins.cell(point), point, place)
        });
        let mut entries: Vec<_> = entries.collect();
        entries.sort_unstable();
        bins.entries = entries;
        bins
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "a quotient of numbers below 2⁵² by one of at least 1"
    )]
    fn cell(&self, point: GridPoint) -> [i64; 3] {
        point.map(|c| (c as f64 / self.side_steps).floor() as i64)
    }

    fn nearest(&self, point: GridPoint) -> Option<u32> {
        let [x, y, z] = self.cell(point);
        let mut best: Option<(f64, GridPoint, u32)> = None;
        for dx in -1..=1 {
            for dy in -1..=1 {
                let low = [x + dx, y + dy, z - 1];
                let high = [x + dx, y + dy, z + 1];
                let first = self.entries.partition_point(|entry| entry.0 < low);
                let near = self.entries[first..].iter();
                for &(_, other, place) in near.take_while(|entry| entry.0 <= high) {
                    let difference = [0, 1, 2].map(|k| (other[k] - point[k]) as f64);
                    let distance2: f64 = difference.iter().map(|d| d * d).sum();
                    let is_nearer =
                        best.is_none_or(|(least, at, _)| (distance2, other) < (least, at));
                    if distance2 <= self.reach2 && is_nearer {
                        best = Some((distance2, other, place));
                    }
                }
            }
        }
        best.map(|(_, _, place)| place)
    }
}
