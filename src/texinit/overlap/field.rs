//! The field of Eq. MRFPlane: which planes there are, which one each triangle prefers by itself,
//! and what its pairs prefer; as the paper prints it, and as the authors' program has it.

use super::OverlapParams;
use super::detect::PlaneTriangles;
use super::graph::Neighbours;
use super::mplp::{self, PottsEdge, PottsField, Preference};
use super::stack::max_stacked;

/// Whose Eq. MRFPlane it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum OverlapForm {
    /// The paper's. Planes: the largest number of triangles stacked at one place. A triangle gets 1
    /// for its first plane without overlap, taking triangles breadth-first (the paper leaves the
    /// order open); none where all planes are taken. A pair gets 1. Adjacent are triangles that
    /// share an edge in the plane.
    #[default]
    Printed,
    /// The authors' program's. A triangle gets 0.5 for its label in the chain
    /// label(j) = max(label(j), label(i) + 1) over overlapping pairs i < j in the order of
    /// triangles; planes are as many as the largest label. A pair gets 10. Adjacent are triangles
    /// that share an edge on the surface, cut or not. All sweeps are made, and the last decoded.
    Reference,
}

impl OverlapForm {
    const fn unary_reward(self) -> f64 {
        match self {
            Self::Printed => 1.0,
            Self::Reference => 0.5,
        }
    }

    const fn pair_reward(self) -> f64 {
        match self {
            Self::Printed => 1.0,
            Self::Reference => 10.0,
        }
    }
}

/// Planes, and each triangle's own.
pub(super) struct Preferred {
    /// As many as the form asks for.
    pub(super) num_planes: usize,
    /// Per triangle; nothing where none of the planes is free.
    pub(super) plane_of: Vec<Option<usize>>,
}

impl Preferred {
    /// What the form says, of a chart in which triangles overlap.
    pub(super) fn new(
        form: OverlapForm,
        layer: &PlaneTriangles,
        order: &[usize],
        overlaps: &Neighbours,
        pairs: &[[u32; 2]],
    ) -> Self {
        match form {
            OverlapForm::Printed => {
                let num_planes = max_stacked(layer, overlaps);
                let planes = first_fit(order, overlaps).into_iter();
                let within = |plane: u32| Some(plane as usize).filter(|p| *p < num_planes);
                Self {
                    num_planes,
                    plane_of: planes.map(within).collect(),
                }
            }
            OverlapForm::Reference => {
                let labels = chain_labels(layer.len(), pairs);
                Self {
                    num_planes: labels.iter().max().map_or(1, |&label| label as usize + 1),
                    plane_of: labels.iter().map(|&label| Some(label as usize)).collect(),
                }
            }
        }
    }

    /// With no more planes than that; triangles whose own lies beyond have none.
    pub(super) fn capped(mut self, max_planes: usize) -> Self {
        self.num_planes = self.num_planes.min(max_planes);
        for plane in &mut self.plane_of {
            *plane = plane.filter(|p| *p < self.num_planes);
        }
        self
    }
}

/// The field over a chart's triangles: adjacent pairs in the order given, then overlapping ones.
pub(super) fn field(
    form: OverlapForm,
    preferred: &Preferred,
    adjacent: &[[u32; 2]],
    overlapping: &[[u32; 2]],
) -> PottsField {
    let num_labels = preferred.num_planes;
    let mut unary = vec![0.0; preferred.plane_of.len() * num_labels];
    for (triangle, plane) in preferred.plane_of.iter().enumerate() {
        if let Some(plane) = plane {
            unary[triangle * num_labels + plane] = form.unary_reward();
        }
    }
    let edge = |preference| {
        move |pair: &[u32; 2]| PottsEdge {
            nodes: pair.map(|t| t as usize),
            preference,
            reward: form.pair_reward(),
        }
    };
    let equal = adjacent.iter().map(edge(Preference::Equal));
    let different = overlapping.iter().map(edge(Preference::Different));
    PottsField {
        num_labels,
        unary,
        edges: equal.chain(different).collect(),
    }
}

/// Messages that the field passes.
pub(super) fn num_messages(num_planes: usize, num_pairs: usize) -> usize {
    num_pairs.saturating_mul(2).saturating_mul(num_planes)
}

/// Each triangle's plane, as the form solves its field.
pub(super) fn solve(field: &PottsField, params: &OverlapParams) -> Vec<u32> {
    let labels = match params.form {
        OverlapForm::Printed => mplp::solve(field, params.max_sweeps),
        OverlapForm::Reference => mplp::last_of(field, params.max_sweeps),
    };
    let plane = |label| u32::try_from(label).unwrap_or(u32::MAX);
    labels.into_iter().map(plane).collect()
}

/// The smallest plane that is not among those taken.
pub(super) fn smallest_free(taken: &mut Vec<u32>) -> u32 {
    taken.sort_unstable();
    taken.dedup();
    (0u32..)
        .zip(taken.iter())
        .find(|(plane, used)| plane != *used)
        .map_or_else(
            || u32::try_from(taken.len()).unwrap_or(u32::MAX),
            |(p, _)| p,
        )
}

/// Each triangle's first plane where it overlaps none of those before it in the order.
fn first_fit(order: &[usize], overlaps: &Neighbours) -> Vec<u32> {
    let mut planes = vec![u32::MAX; overlaps.len()];
    let mut taken = Vec::new();
    for &triangle in order {
        taken.clear();
        let assigned = overlaps.of(triangle).map(|t| planes[t]);
        taken.extend(assigned.filter(|&plane| plane != u32::MAX));
        planes[triangle] = smallest_free(&mut taken);
    }
    planes
}

/// The authors' labels, from 0, for pairs in order.
fn chain_labels(num_triangles: usize, pairs: &[[u32; 2]]) -> Vec<u32> {
    let mut labels = vec![0u32; num_triangles];
    for [first, second] in pairs.iter().map(|pair| pair.map(|t| t as usize)) {
        labels[second] = labels[second].max(labels[first] + 1);
    }
    labels
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_climb_along_chains_of_overlaps() {
        // 0–1, 1–2, 2–3 overlap: a chain of four, of which no three lie on one place.
        let pairs = [[0, 1], [1, 2], [2, 3], [0, 4]];
        assert_eq!(chain_labels(6, &pairs), [0, 1, 2, 3, 1, 0]);
        let overlaps = Neighbours::new(6, &pairs);
        assert_eq!(
            first_fit(&[0, 1, 2, 3, 4, 5], &overlaps),
            [0, 1, 0, 1, 1, 0]
        );
    }

    #[test]
    fn a_capped_field_leaves_those_beyond_without_preference() {
        let preferred = Preferred {
            num_planes: 4,
            plane_of: vec![Some(0), Some(3), None],
        };
        let capped = preferred.capped(2);
        assert_eq!(capped.num_planes, 2);
        assert_eq!(capped.plane_of, [Some(0), None, None]);
        let made = field(OverlapForm::Reference, &capped, &[[1, 2]], &[[0, 1]]);
        assert_eq!(made.unary, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(made.value(&[0, 1, 1]), 20.5);
        assert_eq!(made.value(&[0, 0, 0]), 10.5);
    }
}
