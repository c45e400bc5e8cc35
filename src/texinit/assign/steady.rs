//! Labels that stay where others are hardly better.
//!
//! Whole patches are given back what they had before: adjacent triangles whose frame would change from
//! the same one to the same other. Each costs at most `hysteresis` a triangle, so that the labels are
//! worth less than the best that were found by at most that times the number of triangles, and no patch
//! of a frame is torn for it.

use super::adjacency::Adjacency;
use super::pairwise::Ranked;

/// Rounds over all patches at most: what stays makes what is beside it worth more to stay.
const MAX_ROUNDS: usize = 3;

const NO_PATCH: u32 = u32::MAX;

/// What labels may be given back.
pub(super) struct Steadying<'a> {
    pub(super) ranked: &'a Ranked,
    pub(super) adjacency: &'a Adjacency,
    /// Reward of a pair of equal labels.
    pub(super) weight: f32,
    /// A label per triangle.
    pub(super) before: &'a [Option<u32>],
}

/// Triangles whose label may stay.
struct Patches {
    of_triangle: Vec<u32>,
    /// By the lowest of their triangles; those of each in the order in which they were found.
    triangles: Vec<Vec<u32>>,
}

impl Steadying<'_> {
    /// `label` with patches given back what they had before where that costs at most `hysteresis` (≥ 0) a
    /// triangle.
    pub(super) fn steadied(
        &self,
        mut label: Vec<Option<u32>>,
        hysteresis: f32,
    ) -> Vec<Option<u32>> {
        let Patches {
            of_triangle,
            mut triangles,
        } = self.patches(&label);
        for _ in 0..MAX_ROUNDS {
            let num_patches = triangles.len();
            triangles.retain(|patch| {
                let limit = f64::from(hysteresis) * patch.len() as f64;
                let is_given_up = self.cost(patch, &of_triangle, &label) > limit;
                if !is_given_up {
                    for &triangle in patch {
                        label[triangle as usize] = self.before[triangle as usize];
                    }
                }
                is_given_up
            });
            if triangles.len() == num_patches {
                break;
            }
        }
        label
    }

    fn patches(&self, label: &[Option<u32>]) -> Patches {
        let change_of = |triangle: u32| {
            let (before, now) = (self.before[triangle as usize]?, label[triangle as usize]?);
            let may_stay = before != now && self.ranked.score_of(triangle, before).is_some();
            may_stay.then_some((before, now))
        };
        let mut patches = Patches {
            of_triangle: vec![NO_PATCH; label.len()],
            triangles: Vec::new(),
        };
        for (first, _) in (0_u32..).zip(label) {
            let Some(change) = change_of(first) else {
                continue;
            };
            if patches.of_triangle[first as usize] != NO_PATCH {
                continue;
            }
            #[expect(
                clippy::cast_possible_truncation,
                reason = "no more patches than triangles"
            )]
            let number = patches.triangles.len() as u32;
            patches.of_triangle[first as usize] = number;
            let mut found = vec![first];
            let mut next = 0;
            while let Some(&triangle) = found.get(next) {
                next += 1;
                for &other in self.adjacency.of_triangle(triangle as usize) {
                    let patch = &mut patches.of_triangle[other as usize];
                    if *patch == NO_PATCH && change_of(other) == Some(change) {
                        *patch = number;
                        found.push(other);
                    }
                }
            }
            patches.triangles.push(found);
        }
        patches
    }

    /// How much less labels are worth with a patch as it was before.
    fn cost(&self, patch: &[u32], patch_of: &[u32], label: &[Option<u32>]) -> f64 {
        let mut cost = 0.0;
        for &triangle in patch {
            let own = patch_of[triangle as usize];
            let [before, now] = [self.before, label].map(|label| label[triangle as usize]);
            let score = |label: Option<u32>| {
                let score = label.and_then(|frame| self.ranked.score_of(triangle, frame));
                f64::from(score.unwrap_or_default())
            };
            let others = self.adjacency.of_triangle(triangle as usize).iter();
            let beside = others.filter(|other| patch_of[**other as usize] != own);
            let gain = |frame: Option<u32>| {
                let equal = beside
                    .clone()
                    .filter(|other| label[**other as usize] == frame);
                score(frame) + f64::from(self.weight) * equal.count() as f64
            };
            cost += gain(now) - gain(before);
        }
        cost
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Scores per triangle by frame, pairs, weight, labels before.
    type Problem = (Vec<Vec<f32>>, Vec<[u32; 2]>, f32, Vec<Option<u32>>);

    fn problem() -> impl Strategy<Value = Problem> {
        let scores = prop::collection::vec(prop::collection::vec(-1.0..1.0f32, 0..4), 12);
        let pairs = prop::collection::btree_set((0u32..12, 0u32..12), 0..24);
        let before = prop::collection::vec(prop::option::of(0u32..4), 12);
        (scores, pairs, 0.0..1.0f32, before).prop_map(|(scores, pairs, weight, before)| {
            let pairs = pairs.into_iter().filter(|(i, j)| i < j);
            let pairs = pairs.map(|(i, j)| [i, j]).collect();
            (scores, pairs, weight, before)
        })
    }

    proptest! {
        #[test]
        fn what_stays_costs_no_more_than_it_may((scores, pairs, weight, before) in problem()) {
            let mut ranked = Ranked::new(scores.len(), 4);
            for (triangle, scores) in scores.iter().enumerate() {
                for (frame, score) in (0_u32..).zip(scores) {
                    ranked.offer(triangle, frame, *score);
                }
            }
            let adjacency = Adjacency::new(scores.len(), pairs.clone());
            let best = ranked.best_labels();
            let steadying = Steadying {
                ranked: &ranked,
                adjacency: &adjacency,
                weight,
                before: &before,
            };
            let value = |label: &[Option<u32>]| ranked.value_of(label, &pairs, weight);
            let is_candidate = |triangle: u32, frame: u32| ranked.score_of(triangle, frame).is_some();
            for hysteresis in [0.0, 0.2, 1.0, 100.0] {
                let steady = steadying.steadied(best.clone(), hysteresis);
                let bound = f64::from(hysteresis) * scores.len() as f64;
                prop_assert!(value(&steady) >= value(&best) - bound - 1e-5);
                for triangle in 0..12_u32 {
                    let [now, best, before] =
                        [&steady, &best, &before].map(|label| label[triangle as usize]);
                    prop_assert!(now == best || now == before);
                    prop_assert!(now.is_none_or(|frame| is_candidate(triangle, frame)));
                }
                let stayed = steady.iter().zip(&before).filter(|(now, before)| now == before);
                if hysteresis == 100.0 {
                    let may_stay = |(triangle, before): (u32, &Option<u32>)| {
                        before.is_some_and(|frame| is_candidate(triangle, frame))
                    };
                    let num_may = (0_u32..).zip(&before).filter(|p| may_stay(*p)).count();
                    let num_stayed = stayed.filter(|(now, _)| now.is_some()).count();
                    prop_assert_eq!(num_stayed, num_may);
                }
            }
        }
    }

    #[test]
    fn a_patch_stays_or_goes_as_one() {
        // Four triangles in a row that all saw frame 0 best; the third now hardly prefers frame 1, the
        // fourth by far.
        let mut ranked = Ranked::new(4, 2);
        for (triangle, scores) in [[1.0, 0.0], [1.0, 0.0], [1.0, 1.1], [1.0, 3.0]]
            .iter()
            .enumerate()
        {
            ranked.offer(triangle, 0, scores[0]);
            ranked.offer(triangle, 1, scores[1]);
        }
        let adjacency = Adjacency::new(4, vec![[0, 1], [1, 2], [2, 3]]);
        let steadying = Steadying {
            ranked: &ranked,
            adjacency: &adjacency,
            weight: 0.5,
            before: &[Some(0); 4],
        };
        let best = vec![Some(0), Some(0), Some(1), Some(1)];
        // The patch earns 0.1 + 2 more, and costs the pair in the middle: 0.8 a triangle.
        let at = |hysteresis: f32| steadying.steadied(best.clone(), hysteresis);
        assert_eq!(at(0.75), best);
        assert_eq!(at(0.85), [Some(0); 4]);
    }
}
