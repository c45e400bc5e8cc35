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

    /// The same where a triangle's candidate of a given frame scores more by `bonus`.
    pub(crate) fn favouring(&self, label: &[Option<u32>], bonus: f32) -> Self {
        let mut ranked = self.clone();
        for (triangle, frame) in label.iter().enumerate() {
            let num = usize::from(self.num_choices[triangle]);
            let slots = &mut ranked.choices[triangle * self.width..][..num];
            let favoured = slots.iter().position(|choice| Some(choice.frame) == *frame);
            if let Some(slot) = favoured {
                slots[slot].score += bonus;
                let before = slots.partition_point(|choice| choice.score > slots[slot].score);
                slots[before.min(slot)..=slot].rotate_right(1);
            }
        }
        ranked
    }

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

/// Pairs of triangles that share an edge, sorted. Where more than two meet, each is paired with
/// the next.
pub(crate) fn adjacent_pairs(triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(3 * triangles.len());
    for (triangle, &[a, b, c]) in (0u32..).zip(triangles) {
        for [p, q] in [[a, b], [b, c], [c, a]] {
            if p != q {
                sides.push(([p.min(q), p.max(q)], triangle));
            }
        }
    }
    sides.sort_unstable();
    let mut pairs: Vec<[u32; 2]> = sides
        .windows(2)
        .filter(|pair| pair[0].0 == pair[1].0 && pair[0].1 != pair[1].1)
        .map(|pair| [pair[0].1, pair[1].1])
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// The labels of best total score found.
pub(crate) fn solve(
    ranked: &Ranked,
    adjacency: &[[u32; 2]],
    params: &PairwiseParams,
) -> Vec<Option<u32>> {
    let mut messages = Messages::new(ranked, adjacency, params.weight);
    for _ in 0..params.num_sweeps.min(100) {
        if !messages.sweep() {
            break;
        }
    }
    // The decoding may lose to deciding alone where the relaxation is not tight; what is improved
    // from there cannot.
    let alone = vec![0; ranked.num_choices.len()];
    let mut candidates = [messages.decode(), alone];
    candidates
        .par_iter_mut()
        .for_each(|chosen| improve(ranked, adjacency, params.weight, chosen));
    let [decoded, alone] = candidates;
    let value = |chosen: &[usize]| total_score(ranked, adjacency, params.weight, chosen);
    let chosen = if value(&alone) > value(&decoded) {
        alone
    } else {
        decoded
    };
    chosen
        .iter()
        .enumerate()
        .map(|(triangle, &slot)| ranked.of(triangle).get(slot).map(|choice| choice.frame))
        .collect()
}

/// The dual: beliefs of all triangles and what each edge put into them.
struct Messages<'a> {
    ranked: &'a Ranked,
    adjacency: &'a [[u32; 2]],
    weight: f32,
    /// Scores plus all messages, in the slots of `ranked`.
    beliefs: Vec<f32>,
    /// Per edge: what it put into its first and its second triangle.
    sent: Vec<f32>,
    /// Where there is a message: which slot of the other triangle has the same frame, or [`NO_SLOT`].
    same_slot: Vec<u8>,
}

const NO_SLOT: u8 = u8::MAX;

impl<'a> Messages<'a> {
    fn new(ranked: &'a Ranked, adjacency: &'a [[u32; 2]], weight: f32) -> Self {
        let width = ranked.width;
        let mut same_slot = vec![NO_SLOT; adjacency.len() * 2 * width];
        for (pair, same_slot) in adjacency.iter().zip(same_slot.chunks_exact_mut(2 * width)) {
            let sides = pair.map(|triangle| ranked.of(triangle as usize));
            for (i, mine) in (0_u8..).zip(sides[0]) {
                for (j, theirs) in (0_u8..).zip(sides[1]) {
                    if mine.frame == theirs.frame {
                        same_slot[usize::from(i)] = j;
                        same_slot[width + usize::from(j)] = i;
                    }
                }
            }
        }
        Self {
            same_slot,
            ranked,
            adjacency,
            weight,
            beliefs: ranked.choices.iter().map(|choice| choice.score).collect(),
            sent: vec![0.0; adjacency.len() * 2 * ranked.width],
        }
    }

    /// One update of every edge: it splits what its pair can reach evenly between the two. Whether
    /// anything changed; where nothing did, nothing ever will.
    fn sweep(&mut self) -> bool {
        let width = self.ranked.width;
        let mut without = [[0.0f32; 16]; 2];
        let mut has_changed = false;
        let messages = self.sent.chunks_exact_mut(2 * width);
        let messages = messages.zip(self.same_slot.chunks_exact(2 * width));
        for (pair, (sent, same_slot)) in self.adjacency.iter().zip(messages) {
            let num_choices =
                pair.map(|triangle| usize::from(self.ranked.num_choices[triangle as usize]));
            if num_choices.contains(&0) {
                continue;
            }
            let starts = pair.map(|triangle| triangle as usize * width);
            let mut best = [f32::NEG_INFINITY; 2];
            for side in 0..2 {
                for slot in 0..num_choices[side] {
                    let value = self.beliefs[starts[side] + slot] - sent[side * width + slot];
                    without[side][slot] = value;
                    best[side] = best[side].max(value);
                }
            }
            for side in 0..2 {
                let other = 1 - side;
                for slot in 0..num_choices[side] {
                    let same = match same_slot[side * width + slot] {
                        NO_SLOT => f32::NEG_INFINITY,
                        at => without[other][usize::from(at)] + self.weight,
                    };
                    let own = without[side][slot];
                    let message = 0.5 * (best[other].max(same) - own);
                    let sent = &mut sent[side * width + slot];
                    let belief = &mut self.beliefs[starts[side] + slot];
                    has_changed |= *sent != message || *belief != own + message;
                    (*sent, *belief) = (message, own + message);
                }
            }
        }
        has_changed
    }

    /// Slot of the best belief per triangle.
    fn decode(&self) -> Vec<usize> {
        (0..self.ranked.num_choices.len())
            .map(|triangle| {
                let start = triangle * self.ranked.width;
                let beliefs = &self.beliefs[start..start + self.ranked.of(triangle).len()];
                let mut best = 0;
                for (slot, &belief) in beliefs.iter().enumerate() {
                    if belief > beliefs[best] {
                        best = slot;
                    }
                }
                best
            })
            .collect()
    }

    /// Upper bound of the score of any labelling.
    #[cfg(test)]
    fn dual_value(&self) -> f64 {
        let width = self.ranked.width;
        let mut value = 0.0f64;
        for triangle in 0..self.ranked.num_choices.len() {
            let num = self.ranked.of(triangle).len();
            let beliefs = &self.beliefs[triangle * width..triangle * width + num];
            if let Some(best) = beliefs.iter().copied().reduce(f32::max) {
                value += f64::from(best);
            }
        }
        for (pair, sent) in self.adjacency.iter().zip(self.sent.chunks_exact(2 * width)) {
            let sides = pair.map(|triangle| self.ranked.of(triangle as usize));
            let mut best = f64::NEG_INFINITY;
            for (i, a) in sides[0].iter().enumerate() {
                for (j, b) in sides[1].iter().enumerate() {
                    let reward = if a.frame == b.frame { self.weight } else { 0.0 };
                    best = best.max(f64::from(reward - sent[i] - sent[width + j]));
                }
            }
            if best.is_finite() {
                value += best;
            }
        }
        value
    }
}

/// What a choice of slots earns.
fn total_score(ranked: &Ranked, adjacency: &[[u32; 2]], weight: f32, chosen: &[usize]) -> f64 {
    let choice = |triangle: usize| ranked.of(triangle).get(chosen[triangle]);
    let unary: f64 = (0..chosen.len())
        .filter_map(choice)
        .map(|choice| f64::from(choice.score))
        .sum();
    let num_equal = adjacency
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
fn improve(ranked: &Ranked, adjacency: &[[u32; 2]], weight: f32, chosen: &mut [usize]) {
    let neighbours = Neighbours::new(chosen.len(), adjacency);
    let mut is_due = vec![true; chosen.len()];
    for _ in 0..10 {
        let mut has_changed = false;
        for triangle in 0..chosen.len() {
            if !std::mem::take(&mut is_due[triangle]) {
                continue;
            }
            let choices = ranked.of(triangle);
            let gain = |slot: usize| {
                let choice: &Choice = &choices[slot];
                let num_equal = neighbours
                    .of(triangle)
                    .iter()
                    .filter(|&&other| {
                        ranked
                            .of(other as usize)
                            .get(chosen[other as usize])
                            .is_some_and(|theirs| theirs.frame == choice.frame)
                    })
                    .count();
                // In f64, where the sum is exact: what counts as a gain is one.
                f64::from(choice.score) + f64::from(weight) * num_equal as f64
            };
            let Some(mut best) = choices.get(chosen[triangle]).map(|_| chosen[triangle]) else {
                continue;
            };
            let mut best_gain = gain(best);
            for slot in 0..choices.len() {
                let slot_gain = gain(slot);
                if slot_gain > best_gain {
                    (best, best_gain) = (slot, slot_gain);
                }
            }
            if best != chosen[triangle] {
                has_changed = true;
                chosen[triangle] = best;
                for &other in neighbours.of(triangle) {
                    is_due[other as usize] = true;
                }
            }
        }
        if !has_changed {
            break;
        }
    }
}

/// Adjacent triangles of each triangle.
struct Neighbours {
    first: Vec<usize>,
    others: Vec<u32>,
}

impl Neighbours {
    fn new(num_triangles: usize, adjacency: &[[u32; 2]]) -> Self {
        let mut directed: Vec<[u32; 2]> = adjacency
            .iter()
            .flat_map(|&[i, j]| [[i, j], [j, i]])
            .collect();
        directed.sort_unstable();
        let mut first = vec![0; num_triangles + 1];
        for &[i, _] in &directed {
            first[i as usize + 1] += 1;
        }
        for triangle in 0..num_triangles {
            first[triangle + 1] += first[triangle];
        }
        Self {
            first,
            others: directed.into_iter().map(|[_, j]| j).collect(),
        }
    }

    fn of(&self, triangle: usize) -> &[u32] {
        &self.others[self.first[triangle]..self.first[triangle + 1]]
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
            let mut messages = Messages::new(&ranked, &adjacency, weight);
            let mut dual = messages.dual_value();
            for _ in 0..20 {
                messages.sweep();
                let next = messages.dual_value();
                prop_assert!(next <= dual + 1e-5, "{next} after {dual}");
                prop_assert!(next >= best - 1e-4, "{next} under {best}");
                dual = next;
            }
            let params = PairwiseParams { weight, ..PairwiseParams::default() };
            let found = value(&scores, &adjacency, weight, &solve(&ranked, &adjacency, &params));
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
            let labels = solve(&ranked_of(&scores, 3), &adjacency, &params);
            let found = value(&scores, &adjacency, weight, &labels);
            let best = best_by_enumeration(&scores, &adjacency, weight);
            assert!((found - best).abs() < 1e-4, "{found} of {best} at {weight}");
        }
    }

    #[test]
    fn ranking_keeps_the_best_and_gives_ties_to_the_later_frame() {
        let ranked = ranked_of(&[vec![(0, 1.0), (3, 2.0), (5, 2.0), (7, 0.5)], vec![]], 2);
        let frames: Vec<u32> = ranked.of(0).iter().map(|choice| choice.frame).collect();
        assert_eq!(frames, [5, 3]);
        assert_eq!(ranked.best_labels(), [Some(5), None]);
    }

    #[test]
    fn pairs_share_an_edge() {
        let triangles = [[0, 1, 2], [0, 2, 3], [2, 4, 3], [2, 0, 4], [1, 1, 2]];
        let pairs = adjacent_pairs(&triangles);
        // Edge 0–2 has three triangles, edge 1–2 two, edges 2–3 and 2–4 two each.
        assert_eq!(pairs, [[0, 1], [0, 4], [1, 2], [1, 3], [2, 3]]);
    }
}
