//! Conjugate gradients with Jacobi's preconditioner, three right-hand sides at once: one per
//! channel, over the same positive definite matrix. Sums run in order, so the bits do not depend
//! on threads.

/// When to stop.
pub(super) struct Stop {
    /// The residual's length as a share of the right-hand side's.
    pub(super) tolerance: f64,
    /// Most steps.
    pub(super) max_steps: usize,
}

/// Improves `x` towards A x = `rhs`; `apply` writes A times its first argument to its second, and
/// `diagonal` is A's, positive. Returns the number of steps.
pub(super) fn solve(
    mut apply: impl FnMut(&[[f64; 3]], &mut [[f64; 3]]),
    diagonal: &[f64],
    rhs: &[[f64; 3]],
    x: &mut [[f64; 3]],
    stop: &Stop,
) -> usize {
    let size = x.len();
    let mut product = vec![[0.0; 3]; size];
    apply(x, &mut product);
    let mut residual: Vec<[f64; 3]> = rhs
        .iter()
        .zip(&product)
        .map(|(b, p)| [0, 1, 2].map(|c| b[c] - p[c]))
        .collect();
    let goal = dot(rhs, rhs).map(|square| square * stop.tolerance * stop.tolerance);
    let precondition = |residual: &[[f64; 3]], out: &mut Vec<[f64; 3]>| {
        out.clear();
        let scaled = residual.iter().zip(diagonal);
        out.extend(scaled.map(|(r, d)| r.map(|value| value / d)));
    };
    let mut scaled = Vec::with_capacity(size);
    precondition(&residual, &mut scaled);
    let mut direction = scaled.clone();
    let mut energy = dot(&residual, &scaled);
    for step in 0..stop.max_steps {
        let left = dot(&residual, &residual);
        if (0..3).all(|c| left[c] <= goal[c]) {
            return step;
        }
        apply(&direction, &mut product);
        let curvature = dot(&direction, &product);
        let length: [f64; 3] = std::array::from_fn(|c| ratio(energy[c], curvature[c]));
        for (i, direction) in direction.iter().enumerate() {
            for c in 0..3 {
                x[i][c] += length[c] * direction[c];
                residual[i][c] -= length[c] * product[i][c];
            }
        }
        precondition(&residual, &mut scaled);
        let next = dot(&residual, &scaled);
        let keep: [f64; 3] = std::array::from_fn(|c| ratio(next[c], energy[c]));
        for (direction, scaled) in direction.iter_mut().zip(&scaled) {
            for c in 0..3 {
                direction[c] = scaled[c] + keep[c] * direction[c];
            }
        }
        energy = next;
    }
    stop.max_steps
}

/// A channel that is solved already has nothing left to divide by.
fn ratio(over: f64, under: f64) -> f64 {
    if under > f64::MIN_POSITIVE {
        over / under
    } else {
        0.0
    }
}

fn dot(a: &[[f64; 3]], b: &[[f64; 3]]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (a, b) in a.iter().zip(b) {
        for c in 0..3 {
            sum[c] += a[c] * b[c];
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;

    #[test]
    fn agrees_with_a_dense_factorisation() {
        let size = 30;
        let entry = |i: usize, j: usize| (((i * 7 + j * 13) % 11) as f64 - 5.0) / 5.0;
        let root = DMatrix::from_fn(size, size, entry);
        let matrix = &root * root.transpose() + DMatrix::identity(size, size);
        let rhs: Vec<[f64; 3]> = (0..size).map(|i| [entry(i, 1), entry(i, 2), 0.0]).collect();
        let diagonal: Vec<f64> = matrix.diagonal().iter().copied().collect();
        let mut x = vec![[0.0; 3]; size];
        let stop = Stop {
            tolerance: 1e-12,
            max_steps: 500,
        };
        solve(
            |x, out| {
                for (i, out) in out.iter_mut().enumerate() {
                    *out = [0, 1, 2].map(|c| (0..size).map(|j| matrix[(i, j)] * x[j][c]).sum());
                }
            },
            &diagonal,
            &rhs,
            &mut x,
            &stop,
        );
        let factor = matrix.cholesky().unwrap();
        for c in 0..3 {
            let exact = factor.solve(&DVector::from_iterator(size, rhs.iter().map(|b| b[c])));
            for i in 0..size {
                assert!((exact[i] - x[i][c]).abs() < 1e-9);
            }
        }
    }
}
