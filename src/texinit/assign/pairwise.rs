//! C4: adjacent triangles earn a reward when the same frame paints both.
//!
//! Maximises Σ ψ_i(t_i) + w·Σ 1(t_i = t_j) over pairs of triangles that share an edge, each
//! triangle choosing among its best few frames. Solver: max-product on the LP dual by block
//! coordinate descent, one block per edge (MPLP; Globerson and Jaakkola, "Fixing max-product",
//! NIPS 2007), edges in a fixed order; the dual value never rises. Labels are decoded from the
//! beliefs and then improved one triangle at a time (ICM) until no single change gains. The same
//! improvement starts from each triangle's own best as well, and the better of the two ends counts:
//! the labels are never worth less than those of triangles that decide alone.

use rayon::prelude::*;

use super::adjacency::{Adjacency, BLOCK_SIZE};

/// The pairwise cue.
#[derive(Clone, Debug, PartialEq)]
pub struct PairwiseParams {
    /// ω4: reward per pair of adjacent triangles with the same frame (≥ 0).
    pub weight: f32,
    /// Each triangle chooses among this many of its best frames, 1..=16.
    pub num_candidates: u32,
    /// Sweeps over all edges, 0..=100.
    pub num_sweeps: u32,
}

impl Default for PairwiseParams {
    fn default() -> Self {
        Self {
            weight: 1.0,
            num_candidates: 8,
            num_sweeps: 10,
        }
    }
}

impl PairwiseParams {
    pub(crate) fn num_ranked(&self) -> usize {
        self.num_candidates.clamp(1, 16) as usize
    }
}

/// Frame and score of a candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Choice {
    frame: u32,
    score: f32,
}

impl Choice {
    const NONE: Self = Self {
        frame: u32::MAX,
        score: f32::NEG_INFINITY,
    };
}

/// The best few candidates of each triangle.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ranked {
    width: usize,
    /// `width` slots a triangle, best first.
    choices: Vec<Choice>,
    num_choices: Vec<u8>,
}

impl Ranked {
    pub(crate) fn new(num_triangles: usize, width: usize) -> Self {
        let width = width.clamp(1, 16);
        Self {
            width,
            choices: vec![Choice::NONE; num_triangles * width],
            num_choices: vec![0; num_triangles],
        }
    }

    /// Equal scores go to the later frame; frames are offered in ascending order.
    pub(crate) fn offer(&mut self, triangle: usize, frame: u32, score: f32) {
        let slots = &mut self.choices[triangle * self.width..(triangle + 1) * self.width];
        let mut incoming = Choice { frame, score };
        for slot in slots.iter_mut() {
            let is_better = incoming.score > slot.score
                || (incoming.score == slot.score && incoming.frame > slot.frame)
                || slot.frame == u32::MAX;
            if is_better {
                std::mem::swap(slot, &mut incoming);
            }
        }
        let num = &mut self.num_choices[triangle];
        if usize::from(*num) < self.width {
            *num += 1;
        }
    }

    /// Forgets what a triangle was offered.
    pub(crate) fn clear(&mut self, triangle: usize) {
        let start = triangle * self.width;
        self.choices[start..start + self.width].fill(Choice::NONE);
        self.num_choices[triangle] = 0;
    }

    /// What a frame scores for a triangle; `None` where it is no candidate.
    pub(super) fn score_of(&self, triangle: u32, frame: u32) -> Option<f32> {
        let mut choices = self.of(triangle as usize).iter();
        choices
            .find(|choice| choice.frame == frame)
            .map(|choice| choice.score)
    }

    #[cfg(test)]
    /// What labels earn: scores, and `weight` for each pair of the same frame. A label that is no
    /// candidate earns nothing.
    pub(crate) fn value_of(
        &self,
        label: &[Option<u32>],
        adjacency: &[[u32; 2]],
        weight: f32,
    ) -> f64 {
        let score_of = |(triangle, frame): (usize, &Option<u32>)| {
            let frame = (*frame)?;
            let choice = self.of(triangle).iter().find(|c| c.frame == frame)?;
            Some(f64::from(choice.score))
        };
        let scores: f64 = label.iter().enumerate().filter_map(score_of).sum();
        let is_equal = |pair: &&[u32; 2]| {
            let [a, b] = pair.map(|triangle| label[triangle as usize]);
            a.is_some() && a == b
        };
        let num_equal = adjacency.iter().filter(is_equal).count();
        scores + f64::from(weight) * num_equal as f64
    }

    /// Adds the triangles of another ranking of the same width after its own.
    pub(crate) fn append(&mut self, mut other: Self) {
        self.choices.append(&mut other.choices);
        self.num_choices.append(&mut other.num_choices);
    }

    pub(crate) fn best_labels(&self) -> Vec<Option<u32>> {
        (0..self.num_choices.len())
            .map(|triangle| self.of(triangle).first().map(|choice| choice.frame))
            .collect()
    }

    fn of(&self, triangle: usize) -> &[Choice] {
        let first = triangle * self.width;
        &self.choices[first..first + usize::from(self.num_choices[triangle])]
    }
}

/// The labels of best total score found.
pub(crate) fn solve(
    ranked: &Ranked,
    adjacency: &Adjacency,
    params: &PairwiseParams,
) -> Vec<Option<u32>> {
    // Slots of a fixed number are worked on together.
    match ranked.width {
        0..=4 => solve_in::<4>(ranked, adjacency, params),
        5..=8 => solve_in::<8>(ranked, adjacency, params),
        _ => solve_in::<16>(ranked, adjacency, params),
    }
}

fn solve_in<const SLOTS: usize>(
    ranked: &Ranked,
    adjacency: &Adjacency,
    params: &PairwiseParams,
) -> Vec<Option<u32>> {
    let mut messages = Messages::<SLOTS>::new(ranked, adjacency, params.weight);
    for _ in 0..params.num_sweeps.min(100) {
        if !messages.sweep() {
            break;
        }
    }
    // The decoding may lose to deciding alone where the relaxation is not tight; what is improved
    // from there cannot.
    let alone = vec![0; ranked.num_choices.len()];
    let ends: Vec<(Vec<usize>, f64)> = [messages.decode(), alone]
        .into_par_iter()
        .map(|mut chosen| {
            improve(ranked, adjacency, params.weight, &mut chosen);
            let value = total_score(ranked, adjacency, params.weight, &chosen);
            (chosen, value)
        })
        .collect();
    let [decoded, alone] = [0, 1].map(|index: usize| &ends[index]);
    let (chosen, _) = if alone.1 > decoded.1 { alone } else { decoded };
    chosen
        .iter()
        .enumerate()
        .map(|(triangle, &slot)| ranked.of(triangle).get(slot).map(|choice| choice.frame))
        .collect()
}

/// A value for each slot of a triangle.
type Slots<T, const SLOTS: usize> = [T; SLOTS];

/// The dual: beliefs of all triangles and what each pair put into them. Slots without a candidate
/// believe −∞ and are sent 0.
struct Messages<'a, const SLOTS: usize> {
    adjacency: &'a Adjacency,
    weight: f32,
    /// Scores plus all messages, in the slots of the ranking.
    beliefs: Vec<Slots<f32, SLOTS>>,
    /// Per pair: what it put into its first and its second triangle.
    sent: Vec<[Slots<f32, SLOTS>; 2]>,
    /// Where there is a message: which slot of the other triangle has the same frame, or [`NO_SLOT`].
    same_slot: Vec<[Slots<u8, SLOTS>; 2]>,
}

const NO_SLOT: u8 = u8::MAX;

impl<'a, const SLOTS: usize> Messages<'a, SLOTS> {
    fn new(ranked: &Ranked, adjacency: &'a Adjacency, weight: f32) -> Self {
        let choices = ranked.choices.par_chunks_exact(ranked.width);
        let (frames, beliefs): (Vec<_>, Vec<_>) = choices
            .map(|choices| {
                let mut slots = [Choice::NONE; SLOTS];
                for (slot, choice) in slots.iter_mut().zip(choices) {
                    *slot = *choice;
                }
                (slots.map(|slot| slot.frame), slots.map(|slot| slot.score))
            })
            .unzip();
        let same_slot = adjacency
            .pairs()
            .par_iter()
            .with_min_len(BLOCK_SIZE)
            .map(|pair| {
                let [first, second] = pair.map(|triangle| &frames[triangle as usize]);
                [same_slots(first, second), same_slots(second, first)]
            })
            .collect();
        Self {
            sent: vec![[[0.0; SLOTS]; 2]; adjacency.pairs().len()],
            adjacency,
            weight,
            beliefs,
            same_slot,
        }
    }

    /// One update of every pair: it splits what it can reach evenly between the two. Whether
    /// anything changed; where nothing did, nothing ever will.
    fn sweep(&mut self) -> bool {
        let weight = self.weight;
        let (mut pairs, mut same_slot) = (self.adjacency.pairs(), &*self.same_slot);
        let mut sent = &mut *self.sent;
        let mut blocks = Vec::with_capacity(self.adjacency.block_ends().len());
        let mut start = 0;
        let beliefs = self.beliefs.chunks_mut(BLOCK_SIZE);
        for (block, (beliefs, &end)) in beliefs.zip(self.adjacency.block_ends()).enumerate() {
            let len = end - start;
            start = end;
            let (of_pairs, of_same) = (pairs.split_at(len), same_slot.split_at(len));
            let of_sent = std::mem::take(&mut sent).split_at_mut(len);
            blocks.push((
                block * BLOCK_SIZE,
                of_pairs.0,
                of_same.0,
                of_sent.0,
                beliefs,
            ));
            (pairs, same_slot, sent) = (of_pairs.1, of_same.1, of_sent.1);
        }
        let has_changed: Vec<bool> = blocks
            .into_par_iter()
            .map(|(first, pairs, same_slot, sent, beliefs)| {
                sweep_pairs(pairs, same_slot, sent, beliefs, first, weight)
            })
            .collect();
        let between = sweep_pairs(pairs, same_slot, sent, &mut self.beliefs, 0, weight);
        has_changed.contains(&true) | between
    }

    /// Slot of the best belief per triangle.
    fn decode(&self) -> Vec<usize> {
        let best_of = |beliefs: &Slots<f32, SLOTS>| {
            let mut best = 0;
            for (slot, &belief) in beliefs.iter().enumerate() {
                if belief > beliefs[best] {
                    best = slot;
                }
            }
            best
        };
        self.beliefs.iter().map(best_of).collect()
    }

    /// Upper bound of the score of any labelling.
    #[cfg(test)]
    fn dual_value(&self) -> f64 {
        let max =
            |slots: &Slots<f32, SLOTS>| slots.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let triangles = self.beliefs.iter().map(max).map(f64::from);
        let mut value: f64 = triangles.filter(|best| best.is_finite()).sum();
        let messages = self.sent.iter().zip(&self.same_slot);
        for (pair, (sent, same_slot)) in self.adjacency.pairs().iter().zip(messages) {
            let [a, b] = pair.map(|triangle| &self.beliefs[triangle as usize]);
            let mut best = f64::NEG_INFINITY;
            for i in (0..SLOTS).filter(|&i| a[i].is_finite()) {
                for j in (0..SLOTS).filter(|&j| b[j].is_finite()) {
                    let is_same = usize::from(same_slot[0][i]) == j;
                    let reward = if is_same { self.weight } else { 0.0 };
                    best = best.max(f64::from(reward - sent[0][i] - sent[1][j]));
                }
            }
            if best.is_finite() {
                value += best;
            }
        }
        value
    }
}

/// For each slot, that of the other triangle with the same frame.
fn same_slots<const SLOTS: usize>(
    frames: &Slots<u32, SLOTS>,
    others: &Slots<u32, SLOTS>,
) -> Slots<u8, SLOTS> {
    frames.map(|frame| {
        let mut same = NO_SLOT;
        for (slot, other) in (0_u8..).zip(others) {
            if *other == frame {
                same = slot;
            }
        }
        same
    })
}

/// [`Messages::sweep`] of some pairs; the beliefs are those of triangles from `first` on.
fn sweep_pairs<const SLOTS: usize>(
    pairs: &[[u32; 2]],
    same_slot: &[[Slots<u8, SLOTS>; 2]],
    sent: &mut [[Slots<f32, SLOTS>; 2]],
    beliefs: &mut [Slots<f32, SLOTS>],
    first: usize,
    weight: f32,
) -> bool {
    let mut has_changed = false;
    for (pair, (sent, same_slot)) in pairs.iter().zip(sent.iter_mut().zip(same_slot)) {
        let rows = pair.map(|triangle| triangle as usize - first);
        let [own, other] = rows.map(|row| beliefs[row]);
        let without = [less(&own, &sent[0]), less(&other, &sent[1])];
        let best = without.each_ref().map(largest);
        if best.contains(&f32::NEG_INFINITY) {
            continue;
        }
        for side in 0..2 {
            let reached = same_slot[side].map(|slot| {
                let same = without[1 - side].get(usize::from(slot));
                same.map_or(f32::NEG_INFINITY, |same| same + weight)
            });
            let before = [own, other][side];
            let belief = &mut beliefs[rows[side]];
            for slot in 0..SLOTS {
                let own = without[side][slot];
                let message = 0.5 * (best[1 - side].max(reached[slot]) - own);
                let message = if own == f32::NEG_INFINITY {
                    0.0
                } else {
                    message
                };
                has_changed |= sent[side][slot] != message;
                sent[side][slot] = message;
                belief[slot] = own + message;
                has_changed |= belief[slot] != before[slot];
            }
        }
    }
    has_changed
}

fn less<const SLOTS: usize>(a: &Slots<f32, SLOTS>, b: &Slots<f32, SLOTS>) -> Slots<f32, SLOTS> {
    std::array::from_fn(|slot| a[slot] - b[slot])
}

fn largest<const SLOTS: usize>(slots: &Slots<f32, SLOTS>) -> f32 {
    slots
        .iter()
        .copied()
        .fold(f32::NEG_INFINITY, |a, b| if b > a { b } else { a })
}

/// What a choice of slots earns.
fn total_score(ranked: &Ranked, adjacency: &Adjacency, weight: f32, chosen: &[usize]) -> f64 {
    let choice = |triangle: usize| ranked.of(triangle).get(chosen[triangle]);
    let unary: f64 = (0..chosen.len())
        .filter_map(choice)
        .map(|choice| f64::from(choice.score))
        .sum();
    let num_equal = adjacency
        .pairs()
        .iter()
        .filter(|pair| {
            let [a, b] = pair.map(|triangle| choice(triangle as usize));
            a.zip(b).is_some_and(|(a, b)| a.frame == b.frame)
        })
        .count();
    unary + f64::from(weight) * num_equal as f64
}

/// Changes single triangles while that gains, at most ten times over all. One whose neighbours are as
/// they were is as good as it was.
fn improve(ranked: &Ranked, adjacency: &Adjacency, weight: f32, chosen: &mut [usize]) {
    let frame_at = |triangle: usize, slot: usize| {
        let choice = ranked.of(triangle).get(slot);
        choice.map_or(Choice::NONE.frame, |choice| choice.frame)
    };
    let chosen_frames = chosen.iter().enumerate();
    let mut frames: Vec<u32> = chosen_frames
        .map(|(triangle, &slot)| frame_at(triangle, slot))
        .collect();
    let mut is_due = vec![true; chosen.len()];
    for _ in 0..10 {
        let mut has_changed = false;
        for triangle in 0..chosen.len() {
            if !std::mem::take(&mut is_due[triangle]) {
                continue;
            }
            let neighbours = adjacency.of_triangle(triangle);
            let gain = |choice: &Choice| {
                let same = |&&other: &&u32| frames[other as usize] == choice.frame;
                let num_equal = neighbours.iter().filter(same).count();
                // In f64, where the sum is exact: what counts as a gain is one.
                f64::from(choice.score) + f64::from(weight) * num_equal as f64
            };
            let choices = ranked.of(triangle);
            let mut best = chosen[triangle];
            let Some(mut best_gain) = choices.get(best).map(gain) else {
                continue;
            };
            for (slot, choice) in choices.iter().enumerate() {
                let slot_gain = gain(choice);
                if slot_gain > best_gain {
                    (best, best_gain) = (slot, slot_gain);
                }
            }
            if best != chosen[triangle] {
                has_changed = true;
                chosen[triangle] = best;
                frames[triangle] = choices[best].frame;
                for &other in neighbours {
                    is_due[other as usize] = true;
                }
            }
        }
        if !has_changed {
            break;
        }
    }
}

#[cfg(test)]
#[expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ranked_of(scores: &[Vec<(u32, f32)>], width: usize) -> Ranked {
        let mut ranked = Ranked::new(scores.len(), width);
        for (triangle, offers) in scores.iter().enumerate() {
            for &(frame, score) in offers {
                ranked.offer(triangle, frame, score);
            }
        }
        ranked
    }

    fn value(
        scores: &[Vec<(u32, f32)>],
        adjacency: &[[u32; 2]],
        weight: f32,
        labels: &[Option<u32>],
    ) -> f64 {
        let unary: f64 = scores
            .iter()
            .zip(labels)
            .filter_map(|(offers, label)| {
                let label = (*label)?;
                offers
                    .iter()
                    .find(|(frame, _)| *frame == label)
                    .map(|(_, s)| f64::from(*s))
            })
            .sum();
        let equal = adjacency
            .iter()
            .filter(|[i, j]| {
                labels[*i as usize].is_some() && labels[*i as usize] == labels[*j as usize]
            })
            .count();
        unary + f64::from(weight) * equal as f64
    }

    /// Offers per triangle, adjacent pairs, weight.
    type Problem = (Vec<Vec<(u32, f32)>>, Vec<[u32; 2]>, f32);

    fn problem() -> impl Strategy<Value = Problem> {
        let offers = prop::collection::vec(
            prop::collection::btree_map(0u32..4, -1.0..1.0f32, 0..4),
            2..7,
        );
        (
            offers,
            prop::collection::vec((0u32..7, 0u32..7), 0..9),
            0.0..1.0f32,
        )
            .prop_map(|(offers, edges, weight)| {
                let num = offers.len() as u32;
                let mut edges: Vec<[u32; 2]> = edges
                    .into_iter()
                    .map(|(i, j)| [(i % num).min(j % num), (i % num).max(j % num)])
                    .filter(|[i, j]| i != j)
                    .collect();
                edges.sort_unstable();
                edges.dedup();
                (
                    offers
                        .into_iter()
                        .map(|o| o.into_iter().collect())
                        .collect(),
                    edges,
                    weight,
                )
            })
    }

    fn best_by_enumeration(scores: &[Vec<(u32, f32)>], adjacency: &[[u32; 2]], weight: f32) -> f64 {
        let mut best = f64::NEG_INFINITY;
        let total: usize = scores.iter().map(|offers| offers.len().max(1)).product();
        for code in 0..total {
            let mut rest = code;
            let labels: Vec<Option<u32>> = scores
                .iter()
                .map(|offers| {
                    let num = offers.len().max(1);
                    let label = offers.get(rest % num).map(|offer| offer.0);
                    rest /= num;
                    label
                })
                .collect();
            best = best.max(value(scores, adjacency, weight, &labels));
        }
        best
    }

    proptest! {
        #[test]
        fn the_dual_never_rises_and_bounds_every_labelling((scores, adjacency, weight) in problem()) {
            let ranked = ranked_of(&scores, 4);
            let best = best_by_enumeration(&scores, &adjacency, weight);
            let pairs = Adjacency::new(scores.len(), adjacency.clone());
            let mut messages = Messages::<4>::new(&ranked, &pairs, weight);
            let mut dual = messages.dual_value();
            for _ in 0..20 {
                messages.sweep();
                let next = messages.dual_value();
                prop_assert!(next <= dual + 1e-5, "{next} after {dual}");
                prop_assert!(next >= best - 1e-4, "{next} under {best}");
                dual = next;
            }
            let params = PairwiseParams { weight, ..PairwiseParams::default() };
            let found = value(&scores, &adjacency, weight, &solve(&ranked, &pairs, &params));
            let alone = value(&scores, &adjacency, weight, &ranked.best_labels());
            prop_assert!(found <= best + 1e-5);
            prop_assert!(found >= alone - 1e-5, "{found} is worse than {alone} alone");
            // Trees are solved; loops of this size come close.
            prop_assert!(found >= best - 1.5 * f64::from(weight));
        }
    }

    #[test]
    fn a_chain_is_solved_exactly() {
        let scores: Vec<Vec<(u32, f32)>> = (0..9u8)
            .map(|i| {
                vec![
                    (0, f32::from(i % 3) * 0.2),
                    (1, 0.25),
                    (2, f32::from(i % 2) * 0.5),
                ]
            })
            .collect();
        let adjacency: Vec<[u32; 2]> = (0..8).map(|i| [i, i + 1]).collect();
        for weight in [0.0, 0.1, 0.3, 1.0] {
            let params = PairwiseParams {
                weight,
                num_sweeps: 40,
                ..PairwiseParams::default()
            };
            let pairs = Adjacency::new(scores.len(), adjacency.clone());
            let labels = solve(&ranked_of(&scores, 3), &pairs, &params);
            let found = value(&scores, &adjacency, weight, &labels);
            let best = best_by_enumeration(&scores, &adjacency, weight);
            assert!((found - best).abs() < 1e-4, "{found} of {best} at {weight}");
        }
    }

    #[test]
    fn pairs_between_blocks_send_messages_like_those_within() {
        let num = BLOCK_SIZE + 3;
        let last = BLOCK_SIZE as u32 - 1;
        // Before the border 0 is a little better, behind it 1 by far; another pair lies within each block.
        let mut scores = vec![vec![]; num];
        scores[BLOCK_SIZE - 1] = vec![(0, 0.5), (1, 0.25)];
        scores[BLOCK_SIZE] = vec![(0, 0.0), (1, 8.0)];
        for pair in [[0, 1], [BLOCK_SIZE + 1, BLOCK_SIZE + 2]] {
            scores[pair[0]] = vec![(2, 1.0), (3, 0.5)];
            scores[pair[1]] = vec![(2, 0.0), (3, 4.0)];
        }
        let adjacency = vec![[0, 1], [last, last + 1], [last + 2, last + 3]];
        let pairs = Adjacency::new(num, adjacency.clone());
        assert_eq!(pairs.pairs(), [adjacency[0], adjacency[2], adjacency[1]]);
        assert_eq!(pairs.block_ends(), [1, 2]);
        let ranked = ranked_of(&scores, 2);
        let mut messages = Messages::<4>::new(&ranked, &pairs, 1.0);
        while messages.sweep() {}
        // 0.25 + 8 + 1, and twice 0.5 + 4 + 1: no more than labels reach.
        assert!((messages.dual_value() - 20.25).abs() < 1e-5);
        let labels = solve(&ranked, &pairs, &PairwiseParams::default());
        assert!((value(&scores, &adjacency, 1.0, &labels) - 20.25).abs() < 1e-5);
    }

    #[test]
    fn ranking_keeps_the_best_and_gives_ties_to_the_later_frame() {
        let ranked = ranked_of(&[vec![(0, 1.0), (3, 2.0), (5, 2.0), (7, 0.5)], vec![]], 2);
        let frames: Vec<u32> = ranked.of(0).iter().map(|choice| choice.frame).collect();
        assert_eq!(frames, [5, 3]);
        assert_eq!(ranked.best_labels(), [Some(5), None]);
    }
}
