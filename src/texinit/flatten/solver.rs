//! Dirichlet and Neumann solves with the cotangent Laplacian of a disk, factored once.
//!
//! Interior vertices are eliminated first (in AMD order), boundary vertices last, and the last one
//! is pinned to zero. The leading block of that one Cholesky factor `L` is the factor of `A_II`:
//! forward and back substitution on it solve the Dirichlet problem, on all of `L` the Neumann
//! problem. The trailing block is dense, so a disk with a long boundary (whole components) has
//! two factors of its own instead, each in its own AMD order.
//!
//! faer does the factoring, sequentially, so that the bits do not depend on the thread count.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

/// Boundary length up to which one factor with a dense trailing block serves both problems.
const MAX_DENSE_BOUNDARY: usize = 256;

/// Why there is no factor.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SolverError {
    /// The matrix is not numerically positive definite.
    #[error("Laplacian of {num_vertices} vertices is not positive definite")]
    NotPositiveDefinite {
        /// How many vertices it has.
        num_vertices: usize,
    },
    /// faer ran out of memory or index range.
    #[error("Laplacian of {num_vertices} vertices is too large to factor")]
    TooLarge {
        /// How many vertices it has.
        num_vertices: usize,
    },
}

/// The Laplacian with vertices renumbered: interior first, boundary after it in loop order.
pub(crate) struct Solver {
    num_interior: usize,
    diagonal: Vec<f64>,
    weights: Vec<(u32, u32, f64)>,
    factor: Factor,
}

enum Factor {
    Shared {
        /// Row of each vertex.
        place: Vec<u32>,
        whole: Box<Cholesky>,
    },
    Separate(Box<[Cholesky; 2]>),
}

impl Solver {
    /// From off-diagonal weights (vertex, vertex, ½ Σ cot) in the renumbering.
    pub(crate) fn new(
        num_interior: usize,
        num_vertices: usize,
        weights: Vec<(u32, u32, f64)>,
    ) -> Result<Self, SolverError> {
        let mut diagonal = vec![0.0; num_vertices];
        for &(a, b, weight) in &weights {
            diagonal[a as usize] += weight;
            diagonal[b as usize] += weight;
        }
        let num_pinned = num_vertices.saturating_sub(1);
        let factor = if num_vertices - num_interior <= MAX_DENSE_BOUNDARY {
            let mut place = interior_order(&diagonal, &weights, num_interior)?;
            place.extend((0_u32..).take(num_vertices).skip(num_interior));
            let matrix = UpperMatrix::new(&diagonal, &weights, &place, num_pinned);
            let ordering = SymmetricOrdering::Identity;
            let whole = Cholesky::new(&matrix, ordering, SupernodalThreshold::FORCE_SIMPLICIAL)?;
            Factor::Shared {
                place,
                whole: Box::new(whole),
            }
        } else {
            let place: Vec<u32> = (0_u32..).take(num_vertices).collect();
            let factor = |size| {
                let matrix = UpperMatrix::new(&diagonal, &weights, &place, size);
                Cholesky::new(&matrix, SymmetricOrdering::Amd, SupernodalThreshold::AUTO)
            };
            Factor::Separate(Box::new([factor(num_interior)?, factor(num_pinned)?]))
        };
        Ok(Self {
            num_interior,
            diagonal,
            weights,
            factor,
        })
    }

    /// A x.
    pub(crate) fn apply(&self, x: &[f64]) -> Vec<f64> {
        let mut product: Vec<f64> = x.iter().zip(&self.diagonal).map(|(x, d)| x * d).collect();
        for &(a, b, weight) in &self.weights {
            product[a as usize] -= weight * x[b as usize];
            product[b as usize] -= weight * x[a as usize];
        }
        product
    }

    /// The x with (A x)_I = `source` (one per interior vertex) and x_B = `boundary`.
    pub(crate) fn dirichlet(&self, source: &[f64], boundary: &[f64]) -> Vec<f64> {
        let mut x = vec![0.0; self.num_interior];
        x.extend_from_slice(boundary);
        let known = self.apply(&x);
        for i in 0..self.num_interior {
            x[i] = source[i] - known[i];
        }
        match &self.factor {
            Factor::Shared { place, whole } => {
                let interior = &mut x[..self.num_interior];
                whole.solve_leading(&place[..self.num_interior], interior);
            }
            Factor::Separate(factors) => factors[0].solve(&mut x[..self.num_interior]),
        }
        x
    }

    /// The x with A x = `flux` (which sums to zero) that is zero at the last vertex.
    pub(crate) fn neumann(&self, flux: &[f64]) -> Vec<f64> {
        let mut x = flux.to_vec();
        let Some((last, free)) = x.split_last_mut() else {
            return x;
        };
        match &self.factor {
            Factor::Shared { place, whole } => whole.solve_leading(&place[..free.len()], free),
            Factor::Separate(factors) => factors[1].solve(free),
        }
        *last = 0.0;
        x
    }
}

/// The Dirichlet problem alone, boundary values zero: for components of any size.
pub(crate) struct InteriorSolver {
    factor: Cholesky,
}

impl InteriorSolver {
    /// As [`Solver::new`].
    pub(crate) fn new(
        num_interior: usize,
        num_vertices: usize,
        weights: &[(u32, u32, f64)],
    ) -> Result<Self, SolverError> {
        let mut diagonal = vec![0.0; num_vertices];
        for &(a, b, weight) in weights {
            diagonal[a as usize] += weight;
            diagonal[b as usize] += weight;
        }
        let place: Vec<u32> = (0_u32..).take(num_vertices).collect();
        let matrix = UpperMatrix::new(&diagonal, weights, &place, num_interior);
        let factor = Cholesky::new(&matrix, SymmetricOrdering::Amd, SupernodalThreshold::AUTO)?;
        Ok(Self { factor })
    }

    /// Replaces a load per interior vertex by the solution.
    pub(crate) fn solve(&self, load: &mut [f64]) {
        self.factor.solve(load);
    }
}

/// Row of each interior vertex in the AMD order of the interior block.
fn interior_order(
    diagonal: &[f64],
    weights: &[(u32, u32, f64)],
    num_interior: usize,
) -> Result<Vec<u32>, SolverError> {
    let too_large = SolverError::TooLarge {
        num_vertices: diagonal.len(),
    };
    let identity: Vec<u32> = (0_u32..).take(num_interior).collect();
    if num_interior < 3 {
        return Ok(identity);
    }
    let matrix = UpperMatrix::new(diagonal, weights, &identity, num_interior);
    let mut order = vec![0; num_interior];
    let mut place = vec![0; num_interior];
    let scratch = amd::order_scratch::<u32>(num_interior, matrix.rows.len());
    let mut memory = MemBuffer::try_new(scratch).map_err(|_| too_large.clone())?;
    amd::order(
        &mut order,
        &mut place,
        matrix.symbolic(),
        amd::Control::default(),
        MemStack::new(&mut memory),
    )
    .map_err(|_| too_large)?;
    Ok(place)
}

/// Upper triangle of a leading block of the permuted Laplacian, compressed columns, rows sorted.
struct UpperMatrix {
    column_starts: Vec<u32>,
    rows: Vec<u32>,
    values: Vec<f64>,
}

impl UpperMatrix {
    /// The first `size` rows and columns after moving vertex `v` to `place[v]`; vertices without a
    /// place, or beyond `size`, are left out.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "fewer entries than a mesh has half-edges"
    )]
    fn new(diagonal: &[f64], weights: &[(u32, u32, f64)], place: &[u32], size: usize) -> Self {
        let at = |v: u32| place.get(v as usize).copied().unwrap_or(u32::MAX);
        let mut entries: Vec<(u32, u32, f64)> = Vec::with_capacity(weights.len() + size);
        for (vertex, &value) in (0_u32..).zip(diagonal) {
            entries.push((at(vertex), at(vertex), value));
        }
        for &(a, b, weight) in weights {
            let (a, b) = (at(a), at(b));
            entries.push((a.max(b), a.min(b), -weight));
        }
        entries.retain(|&(column, _, _)| (column as usize) < size);
        // Stable, so that parallel edges are summed in one order.
        entries.sort_by_key(|&(column, row, _)| (column, row));
        let mut matrix = Self {
            column_starts: vec![0; size + 1],
            rows: Vec::with_capacity(entries.len()),
            values: Vec::with_capacity(entries.len()),
        };
        for same in entries.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
            let (column, row, _) = same[0];
            matrix.rows.push(row);
            matrix.values.push(same.iter().map(|entry| entry.2).sum());
            matrix.column_starts[column as usize + 1] = matrix.rows.len() as u32;
        }
        matrix
    }

    fn symbolic(&self) -> SymbolicSparseColMatRef<'_, u32> {
        let size = self.column_starts.len() - 1;
        SymbolicSparseColMatRef::new_checked(size, size, &self.column_starts, None, &self.rows)
    }
}

struct Cholesky {
    symbolic: SymbolicCholesky<u32>,
    values: Vec<f64>,
}

impl Cholesky {
    fn new(
        matrix: &UpperMatrix,
        ordering: SymmetricOrdering<'_, u32>,
        threshold: SupernodalThreshold,
    ) -> Result<Self, SolverError> {
        let num_vertices = matrix.column_starts.len() - 1;
        let too_large = SolverError::TooLarge { num_vertices };
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: threshold,
            ..Default::default()
        };
        let symbolic =
            factorize_symbolic_cholesky(matrix.symbolic(), Side::Upper, ordering, params)
                .map_err(|_| too_large.clone())?;
        let mut values = vec![0.0; symbolic.len_val()];
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| too_large)?;
        symbolic
            .factorize_numeric_llt(
                &mut values,
                SparseColMatRef::new(matrix.symbolic(), &matrix.values),
                Side::Upper,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Default::default(),
            )
            .map_err(|_| SolverError::NotPositiveDefinite { num_vertices })?;
        Ok(Self { symbolic, values })
    }

    /// L Lᵀ x = x on the leading rows and columns that `place` (row per unknown) covers.
    fn solve_leading(&self, place: &[u32], x: &mut [f64]) {
        let values = &self.values;
        let SymbolicCholeskyRaw::Simplicial(pattern) = self.symbolic.raw() else {
            unreachable!("factored with FORCE_SIMPLICIAL")
        };
        let (starts, rows) = (pattern.col_ptr(), pattern.row_idx());
        let size = place.len();
        let mut y = vec![0.0; size];
        for (&row, value) in place.iter().zip(x.iter()) {
            y[row as usize] = *value;
        }
        let column = |j: usize| {
            let range = starts[j] as usize..starts[j + 1] as usize;
            let below = rows[range.clone()]
                .iter()
                .zip(&values[range.clone()])
                .skip(1);
            let leading = below.take_while(move |(row, _)| (**row as usize) < size);
            (values[range.start], leading)
        };
        for j in 0..size {
            let (pivot, below) = column(j);
            y[j] /= pivot;
            let solved = y[j];
            for (&row, &value) in below {
                y[row as usize] -= value * solved;
            }
        }
        for j in (0..size).rev() {
            let (pivot, below) = column(j);
            let mut rest = y[j];
            for (&row, &value) in below {
                rest -= value * y[row as usize];
            }
            y[j] = rest / pivot;
        }
        for (&row, value) in place.iter().zip(x) {
            *value = y[row as usize];
        }
    }

    fn solve(&self, x: &mut [f64]) {
        let num_rows = x.len();
        let scratch = self.symbolic.solve_in_place_scratch::<f64>(1, Par::Seq);
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(x, num_rows, 1),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of unit squares with weight 1 on its edges: interior first, boundary after.
    fn grid(side: u32) -> (usize, usize, Vec<(u32, u32, f64)>) {
        let is_inner = |x, y| x > 0 && y > 0 && x < side - 1 && y < side - 1;
        let cells = || (0..side).flat_map(|y| (0..side).map(move |x| (x, y)));
        let mut number = vec![0; (side * side) as usize];
        let mut count = 0;
        for inner in [true, false] {
            for (x, y) in cells().filter(|&(x, y)| is_inner(x, y) == inner) {
                number[(y * side + x) as usize] = count;
                count += 1;
            }
        }
        let at = |x: u32, y: u32| number[(y * side + x) as usize];
        let mut weights = Vec::new();
        for (x, y) in cells() {
            if x + 1 < side {
                weights.push((at(x, y), at(x + 1, y), 1.0));
            }
            if y + 1 < side {
                weights.push((at(x, y), at(x, y + 1), 1.0));
            }
        }
        (
            ((side - 2) * (side - 2)) as usize,
            (side * side) as usize,
            weights,
        )
    }

    fn check_residuals(side: u32) {
        let (num_interior, num_vertices, weights) = grid(side);
        let solver = Solver::new(num_interior, num_vertices, weights).unwrap();
        let wave = |n: usize, f: f64| (0..n).map(|i| (f * i as f64).sin()).collect::<Vec<_>>();
        let source = wave(num_interior, 1.3);
        let boundary = wave(num_vertices - num_interior, 0.7);
        let x = solver.dirichlet(&source, &boundary);
        let product = solver.apply(&x);
        for i in 0..num_interior {
            assert!((product[i] - source[i]).abs() < 1e-10);
        }
        assert_eq!(&x[num_interior..], &boundary[..]);
        let mut flux = wave(num_vertices, 2.1);
        let mean = flux.iter().sum::<f64>() / num_vertices as f64;
        flux.iter_mut().for_each(|f| *f -= mean);
        let y = solver.neumann(&flux);
        let product = solver.apply(&y);
        for i in 0..num_vertices {
            assert!((product[i] - flux[i]).abs() < 1e-9);
        }
    }

    #[test]
    fn one_factor_solves_both_problems() {
        check_residuals(3);
        check_residuals(12);
    }

    #[test]
    fn two_factors_solve_both_problems() {
        check_residuals(80);
    }

    #[test]
    fn an_indefinite_matrix_is_an_error() {
        let error = Solver::new(1, 3, vec![(0, 1, -1.0), (0, 2, -1.0)]).err();
        assert!(matches!(
            error,
            Some(SolverError::NotPositiveDefinite { .. })
        ));
    }
}
