//! MAP inference in a pairwise Markov random field of Potts terms by MPLP: Globerson and Jaakkola,
//! "Fixing max-product: convergent message passing algorithms for MAP LP-relaxations", NIPS 2007
//! (the edge-based updates).
//!
//! Maximise Σᵢ θᵢ(yᵢ) + Σₑ rₑ·[yₐ = y_b] or rₑ·[yₐ ≠ y_b]. With messages λ_{e→i}, beliefs
//! bᵢ = θᵢ + Σₑ λ_{e→i}, the dual bound is Σᵢ max bᵢ + Σₑ max (θₑ − λ_{e→a} − λ_{e→b}). An update of
//! one edge minimises the bound over that edge's messages, so it never rises; edges are visited
//! one after the other in the order given. Time and memory: edges × labels per sweep.

/// What an edge rewards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preference {
    /// Equal labels.
    Equal,
    /// Different labels.
    Different,
}

/// A Potts term between two nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PottsEdge {
    /// The two nodes, different from each other.
    pub nodes: [usize; 2],
    /// What is rewarded.
    pub preference: Preference,
    /// The reward, ≥ 0.
    pub reward: f64,
}

impl PottsEdge {
    fn value(&self, are_equal: bool) -> f64 {
        if are_equal == (self.preference == Preference::Equal) {
            self.reward
        } else {
            0.0
        }
    }
}

/// The field.
#[derive(Clone, Debug, PartialEq)]
pub struct PottsField {
    /// Labels per node, ≥ 1.
    pub num_labels: usize,
    /// Per node, then per label: its reward.
    pub unary: Vec<f64>,
    /// The pairs.
    pub edges: Vec<PottsEdge>,
}

impl PottsField {
    /// What a labelling earns.
    pub fn value(&self, labels: &[usize]) -> f64 {
        let unary: f64 = labels
            .iter()
            .zip(self.unary.chunks_exact(self.num_labels))
            .map(|(&label, rewards)| rewards[label])
            .sum();
        let pairs: f64 = self
            .edges
            .iter()
            .map(|edge| edge.value(labels[edge.nodes[0]] == labels[edge.nodes[1]]))
            .sum();
        unary + pairs
    }
}

/// Message passing in progress.
pub struct Mplp<'a> {
    field: &'a PottsField,
    beliefs: Vec<f64>,
    /// Per edge, then per end, then per label.
    messages: Vec<f64>,
    without_edge: [Vec<f64>; 2],
}

impl<'a> Mplp<'a> {
    /// All messages zero.
    pub fn new(field: &'a PottsField) -> Self {
        let num_labels = field.num_labels;
        Self {
            field,
            beliefs: field.unary.clone(),
            messages: vec![0.0; field.edges.len() * 2 * num_labels],
            without_edge: [vec![0.0; num_labels], vec![0.0; num_labels]],
        }
    }

    /// One update of every edge, in order.
    pub fn sweep(&mut self) {
        for index in 0..self.field.edges.len() {
            self.update(index);
        }
    }

    fn update(&mut self, index: usize) {
        let num_labels = self.field.num_labels;
        let edge = &self.field.edges[index];
        let messages = &mut self.messages[index * 2 * num_labels..][..2 * num_labels];
        for (end, node) in edge.nodes.into_iter().enumerate() {
            let beliefs = &self.beliefs[node * num_labels..][..num_labels];
            let own = &messages[end * num_labels..][..num_labels];
            for (out, (belief, message)) in self.without_edge[end]
                .iter_mut()
                .zip(beliefs.iter().zip(own))
            {
                *out = belief - message;
            }
        }
        for (end, node) in edge.nodes.into_iter().enumerate() {
            let own = &self.without_edge[end];
            let other = &self.without_edge[1 - end];
            let best = BestTwo::of(other.iter().copied());
            for label in 0..num_labels {
                let through_edge = (other[label] + edge.value(true))
                    .max(best.excluding(label) + edge.value(false));
                let message = 0.5 * (through_edge - own[label]);
                messages[end * num_labels + label] = message;
                self.beliefs[node * num_labels + label] = own[label] + message;
            }
        }
    }

    /// The upper bound on the value of every labelling.
    pub fn dual(&self) -> f64 {
        let num_labels = self.field.num_labels;
        let nodes: f64 = self
            .beliefs
            .chunks_exact(num_labels)
            .map(|beliefs| BestTwo::of(beliefs.iter().copied()).best)
            .sum();
        let edges: f64 = self
            .field
            .edges
            .iter()
            .zip(self.messages.chunks_exact(2 * num_labels))
            .map(|(edge, messages)| {
                let (first, second) = messages.split_at(num_labels);
                let best = BestTwo::of(second.iter().map(|m| -m));
                let at_label = |label: usize| {
                    let equal = edge.value(true) - second[label];
                    equal.max(best.excluding(label) + edge.value(false)) - first[label]
                };
                (0..num_labels)
                    .map(at_label)
                    .fold(f64::NEG_INFINITY, f64::max)
            })
            .sum();
        nodes + edges
    }

    /// Each node's best label by its belief; the lowest of equals.
    pub fn decode(&self) -> Vec<usize> {
        self.beliefs
            .chunks_exact(self.field.num_labels)
            .map(|beliefs| BestTwo::of(beliefs.iter().copied()).label)
            .collect()
    }
}

/// The largest of some values, where it is, and the largest of the rest.
struct BestTwo {
    best: f64,
    label: usize,
    second: f64,
}

impl BestTwo {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut found = Self {
            best: f64::NEG_INFINITY,
            label: 0,
            second: f64::NEG_INFINITY,
        };
        for (label, value) in values.enumerate() {
            if value > found.best {
                found.second = found.best;
                found.best = value;
                found.label = label;
            } else {
                found.second = found.second.max(value);
            }
        }
        found
    }

    fn excluding(&self, label: usize) -> f64 {
        if label == self.label {
            self.second
        } else {
            self.best
        }
    }
}

/// The best labelling seen in up to `max_sweeps` sweeps, decoded after each; stops when the bound
/// is reached or no longer falls.
pub fn solve(field: &PottsField, max_sweeps: usize) -> Vec<usize> {
    let mut mplp = Mplp::new(field);
    let mut best_labels = mplp.decode();
    let mut best_value = field.value(&best_labels);
    let mut dual = mplp.dual();
    for _ in 0..max_sweeps {
        mplp.sweep();
        let labels = mplp.decode();
        let value = field.value(&labels);
        if value > best_value {
            best_value = value;
            best_labels = labels;
        }
        let next_dual = mplp.dual();
        let tolerance = 1e-9 * (1.0 + next_dual.abs());
        if next_dual - best_value <= tolerance || dual - next_dual <= tolerance {
            break;
        }
        dual = next_dual;
    }
    best_labels
}

/// The labelling decoded after exactly `num_sweeps` sweeps.
pub fn last_of(field: &PottsField, num_sweeps: usize) -> Vec<usize> {
    let mut mplp = Mplp::new(field);
    for _ in 0..num_sweeps {
        mplp.sweep();
    }
    mplp.decode()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn field(num_nodes: usize) -> impl Strategy<Value = PottsField> {
        let edge = (0..num_nodes, 1..num_nodes, any::<bool>(), 0.0..2.0f64);
        (1usize..4).prop_flat_map(move |num_labels| {
            (
                proptest::collection::vec(0.0..2.0f64, num_nodes * num_labels),
                proptest::collection::vec(edge.clone(), 0..12),
            )
                .prop_map(move |(unary, edges)| PottsField {
                    num_labels,
                    unary,
                    edges: edges
                        .into_iter()
                        .map(|(a, step, equal, reward)| PottsEdge {
                            nodes: [a, (a + step) % num_nodes],
                            preference: if equal {
                                Preference::Equal
                            } else {
                                Preference::Different
                            },
                            reward,
                        })
                        .collect(),
                })
        })
    }

    fn best_by_enumeration(field: &PottsField) -> f64 {
        let num_nodes = field.unary.len() / field.num_labels;
        let mut labels = vec![0; num_nodes];
        let mut best = f64::NEG_INFINITY;
        loop {
            best = best.max(field.value(&labels));
            let Some(node) = labels.iter().position(|&l| l + 1 < field.num_labels) else {
                return best;
            };
            labels[node] += 1;
            labels[..node].fill(0);
        }
    }

    proptest! {
        #[test]
        fn dual_never_rises_and_bounds_every_labelling(field in field(5)) {
            let best = best_by_enumeration(&field);
            let mut mplp = Mplp::new(&field);
            let mut dual = mplp.dual();
            for _ in 0..20 {
                for index in 0..field.edges.len() {
                    mplp.update(index);
                    let next = mplp.dual();
                    prop_assert!(next <= dual + 1e-12, "{} rose to {}", dual, next);
                    dual = next;
                }
                prop_assert!(dual >= best - 1e-9, "{} is under {}", dual, best);
            }
            prop_assert!(field.value(&solve(&field, 20)) <= best + 1e-12);
        }

        #[test]
        fn chains_are_solved(field in field(6)) {
            let mut chain = field;
            chain.edges.truncate(5);
            for (node, edge) in chain.edges.iter_mut().enumerate() {
                edge.nodes = [node, node + 1];
            }
            let best = best_by_enumeration(&chain);
            let value = chain.value(&solve(&chain, 500));
            prop_assert!((value - best).abs() < 1e-6, "{} of {}", value, best);
        }
    }

    #[test]
    fn a_strip_that_overlaps_another_moves_as_one() {
        // Nodes 0–3 and 4–7 are chains; 0–4, 1–5, 2–6, 3–7 overlap.
        let pair = |a, b, preference| PottsEdge {
            nodes: [a, b],
            preference,
            reward: 1.0,
        };
        let mut edges = Vec::new();
        for k in 0..3 {
            edges.push(pair(k, k + 1, Preference::Equal));
            edges.push(pair(k + 4, k + 5, Preference::Equal));
        }
        edges.extend((0..4).map(|k| pair(k, k + 4, Preference::Different)));
        let mut unary = vec![0.0; 16];
        unary[0] = 1.0;
        unary[9] = 1.0;
        let field = PottsField {
            num_labels: 2,
            unary,
            edges,
        };
        assert_eq!(solve(&field, 50), [0, 0, 0, 0, 1, 1, 1, 1]);
    }
}
