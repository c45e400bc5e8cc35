//! Connected pieces of a set of triangles.

use super::adjacency::NO_HALF_EDGE;

/// Labels triangles by the piece they are connected to across mates: per triangle its piece, and
/// the number of pieces. Pieces are numbered by their first triangle.
pub fn components(mates: &[u32]) -> (Vec<u32>, u32) {
    components_within(mates, |_, _| true)
}

/// As [`components`], crossing from one triangle to the next only where `is_joined` says so.
pub fn components_within(
    mates: &[u32],
    is_joined: impl Fn(usize, usize) -> bool,
) -> (Vec<u32>, u32) {
    let mut label = vec![u32::MAX; mates.len() / 3];
    let mut num_components = 0;
    let mut stack = Vec::new();
    for seed in 0..label.len() {
        if label[seed] != u32::MAX {
            continue;
        }
        label[seed] = num_components;
        stack.push(seed);
        while let Some(triangle) = stack.pop() {
            for &mate in &mates[3 * triangle..3 * triangle + 3] {
                let neighbor = mate as usize / 3;
                if mate != NO_HALF_EDGE
                    && label[neighbor] == u32::MAX
                    && is_joined(triangle, neighbor)
                {
                    label[neighbor] = num_components;
                    stack.push(neighbor);
                }
            }
        }
        num_components += 1;
    }
    (label, num_components)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_and_a_single_are_two_pieces() {
        const NO: u32 = NO_HALF_EDGE;
        let mates = [NO, NO, 6, NO, NO, NO, 2, NO, NO];
        assert_eq!(components(&mates), (vec![0, 1, 0], 2));
        assert_eq!(components_within(&mates, |_, _| false).1, 3);
    }
}
