//! Where to split a piece whose flattening was not good enough.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Point3;

use super::piece::Piece;
use crate::mesh::adjacency::NO_HALF_EDGE;

/// Rings of triangles that leave a chart with a badly distorted one.
const NUM_BLAMED_RINGS: usize = 2;

/// Labels that set the blamed triangles and those around them apart from the rest; none when that
/// is most of the piece.
pub(crate) fn around_blamed(piece: &Piece, mut blamed: Vec<bool>) -> Option<Vec<u32>> {
    for _ in 0..NUM_BLAMED_RINGS {
        let previous = blamed.clone();
        for (triangle, is_blamed) in blamed.iter_mut().enumerate() {
            *is_blamed |= piece.mates[3 * triangle..3 * triangle + 3]
                .iter()
                .any(|&mate| mate != NO_HALF_EDGE && previous[mate as usize / 3]);
        }
    }
    let num_blamed = blamed.iter().filter(|b| **b).count();
    (num_blamed > 0 && num_blamed <= piece.len() / 2)
        .then(|| blamed.into_iter().map(u32::from).collect())
}

/// Two labels: triangles nearer (along the piece) to one or the other of two far triangles.
pub(crate) fn halves(piece: &Piece, surface: &[[Point3<f64>; 3]]) -> Vec<u32> {
    let centroids: Vec<Point3<f64>> = surface
        .iter()
        .map(|[a, b, c]| Point3::from((a.coords + b.coords + c.coords) / 3.0))
        .collect();
    let farthest = |from: Point3<f64>| {
        let mut best = 0;
        for (i, centroid) in centroids.iter().enumerate() {
            if (centroid - from).norm_squared() > (centroids[best] - from).norm_squared() {
                best = i;
            }
        }
        best
    };
    let first = farthest(centroids[0]);
    let mut second = farthest(centroids[first]);
    if second == first {
        second = usize::from(first == 0);
    }
    let mut label = vec![u32::MAX; piece.len()];
    let mut heap = BinaryHeap::new();
    heap.push(Reverse((0_u64, first, 0)));
    heap.push(Reverse((0_u64, second, 1)));
    while let Some(Reverse((bits, triangle, side))) = heap.pop() {
        if label[triangle] != u32::MAX {
            continue;
        }
        label[triangle] = side;
        for &mate in &piece.mates[3 * triangle..3 * triangle + 3] {
            let neighbor = mate as usize / 3;
            if mate != NO_HALF_EDGE && label[neighbor] == u32::MAX {
                let step = (centroids[neighbor] - centroids[triangle]).norm();
                let distance = f64::from_bits(bits) + step.max(0.0);
                heap.push(Reverse((distance.to_bits(), neighbor, side)));
            }
        }
    }
    label
}
