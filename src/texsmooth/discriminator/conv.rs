//! The three products of a convolution on cells ([`Shape`]): output, gradient by the input, gradient
//! by the weights.
//!
//! A layer's input is a grid of cells, row by row, a cell's channels together. In one row of the
//! kernel, what a place of the output looks at is then one run of numbers, and the next place's run
//! begins one cell later: the matrix of all runs is the grid itself, read with a row stride shorter
//! than its rows. So nothing is gathered. Places are counted along the whole width of the grid;
//! the few at the end of each row where the kernel would not fit are worked out and not used.
//!
//! The gradient by the output lies on the same grid with zeros at those places and before the first
//! row; seen from an input cell it is a convolution of the same kind with the kernel reversed. The
//! gradient by the weights is divided by weights, so that no two threads add to one sum.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

use super::layer::{Kernels, Shape};

/// Places of a product on one thread, at most. The weights are packed for each anew.
const CHUNK_PLACES: usize = 256;
/// Outputs whose weights' gradients are worked out together.
const OUTPUTS_TOGETHER: usize = 64;
/// Outputs that are transposed together.
const TRANSPOSED_TOGETHER: usize = 16;

/// The cells of a layer's input, and the places of its output among them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Grid {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) output_rows: usize,
    pub(super) output_columns: usize,
}

impl Grid {
    /// Of an input of `height`×`width` pixels; `None` when the kernel does not fit.
    pub(super) fn new(shape: Shape, [height, width]: [usize; 2]) -> Option<Self> {
        let (output_rows, output_columns) = (shape.output_side(height)?, shape.output_side(width)?);
        Some(Self {
            rows: output_rows + shape.side() - 1,
            columns: output_columns + shape.side() - 1,
            output_rows,
            output_columns,
        })
    }

    pub(super) fn num_cells(&self) -> usize {
        self.rows * self.columns
    }

    /// Places of the output, those of no use at the ends of rows included.
    pub(super) fn num_places(&self) -> usize {
        self.output_rows * self.columns
    }

    /// Numbers of an input: some images' cells, and zeros after them that the last places look at.
    pub(super) fn input_len(&self, shape: Shape, num_images: usize) -> usize {
        (num_images * self.num_cells() + shape.side() - 1) * shape.depth()
    }

    /// Zeros, in places, before the gradient by the output.
    pub(super) fn num_before(&self, shape: Shape) -> usize {
        (shape.side() - 1) * (self.columns + 1)
    }
}

/// Divides `len` into equal parts of at most [`CHUNK_PLACES`].
fn chunk_len(len: usize) -> usize {
    len.div_ceil(len.div_ceil(CHUNK_PLACES).max(1)).max(1)
}

/// The convolutions of some images, without the bias: `out` is `[image][place][output]`.
pub(super) fn forward(shape: Shape, grid: Grid, input: &[f32], kernels: &Kernels, out: &mut [f32]) {
    let (depth, row_len, outputs) = (shape.depth(), shape.row_len(), shape.outputs);
    let chunk = chunk_len(grid.num_places());
    out.par_chunks_mut(grid.num_places() * outputs)
        .enumerate()
        .for_each(|(image, out)| {
            let chunks = out.par_chunks_mut(chunk * outputs).enumerate();
            chunks.for_each(|(index, out)| {
                let first = image * grid.num_cells() + index * chunk;
                let num_places = out.len() / outputs;
                for (row, weights) in kernels.forward.chunks_exact(row_len * outputs).enumerate() {
                    let runs = &input[(first + row * grid.columns) * depth..];
                    matmul(
                        MatMut::from_row_major_slice_mut(out, num_places, outputs),
                        accum(row),
                        MatRef::from_row_major_slice_with_stride(runs, num_places, row_len, depth),
                        MatRef::from_row_major_slice(weights, row_len, outputs),
                        1.0,
                        Par::Seq,
                    );
                }
            });
        });
}

/// Gradient by the input, `[image][cell][channel kept]`, from that by the output with its zeros
/// before.
pub(super) fn input_gradient(
    shape: Shape,
    grid: Grid,
    by_output: &[f32],
    kernels: &Kernels,
    out: &mut [f32],
) {
    let (outputs, kept_depth) = (shape.outputs, kernels.kept_depth(shape));
    let run_len = shape.side() * outputs;
    let chunk = chunk_len(grid.num_cells());
    out.par_chunks_mut(chunk * kept_depth)
        .enumerate()
        .for_each(|(index, out)| {
            let num_cells = out.len() / kept_depth;
            let last = grid.num_before(shape) + index * chunk - (shape.side() - 1);
            let rows = kernels.backward.chunks_exact(run_len * kept_depth);
            for (row, weights) in rows.enumerate() {
                let runs = &by_output[(last - row * grid.columns) * outputs..];
                matmul(
                    MatMut::from_row_major_slice_mut(out, num_cells, kept_depth),
                    accum(row),
                    MatRef::from_row_major_slice_with_stride(runs, num_cells, run_len, outputs),
                    MatRef::from_row_major_slice(weights, run_len, kept_depth),
                    1.0,
                    Par::Seq,
                );
            }
        });
}

/// The gradient by the output with places last: `[output][image][place]`.
pub(super) fn places_last(
    shape: Shape,
    grid: Grid,
    by_output: &[f32],
    num_images: usize,
    out: &mut [f32],
) {
    let outputs = shape.outputs;
    let row_len = num_images * grid.num_places();
    let together = TRANSPOSED_TOGETHER.min(outputs);
    out.par_chunks_mut(together * row_len)
        .enumerate()
        .for_each(|(index, out)| {
            for image in 0..num_images {
                let first = grid.num_before(shape) + image * grid.num_cells();
                let places = &by_output[first * outputs..(first + grid.num_places()) * outputs];
                for (tile, values) in places.chunks(TRANSPOSED_TOGETHER * outputs).enumerate() {
                    // By squares, so that whole lines of the cache are written.
                    let mut square = [[0.0; TRANSPOSED_TOGETHER]; TRANSPOSED_TOGETHER];
                    for (row, values) in square.iter_mut().zip(values.chunks_exact(outputs)) {
                        let values = &values[index * together..(index + 1) * together];
                        row[..together].copy_from_slice(values);
                    }
                    let at = image * grid.num_places() + tile * TRANSPOSED_TOGETHER;
                    let num_places = values.len() / outputs;
                    for (column, out) in out.chunks_exact_mut(row_len).enumerate() {
                        let out = &mut out[at..at + num_places];
                        for (out, row) in out.iter_mut().zip(&square) {
                            *out = row[column];
                        }
                    }
                }
            }
        });
}

/// Gradient by the weights, in their order, of some images together. `by_output` has
/// [`places_last`].
pub(super) fn weight_gradient(
    shape: Shape,
    grid: Grid,
    input: &[f32],
    by_output: &[f32],
    out: &mut [f32],
) {
    let (depth, row_len, outputs) = (shape.depth(), shape.row_len(), shape.outputs);
    let together = OUTPUTS_TOGETHER.min(outputs);
    let per_kernel_row = outputs / together;
    let num_images = by_output.len() / (outputs * grid.num_places());
    let by_output_len = num_images * grid.num_places();
    out.par_chunks_mut(together * row_len)
        .enumerate()
        .for_each(|(task, out)| {
            let (row, first_output) = (task / per_kernel_row, task % per_kernel_row * together);
            for image in 0..num_images {
                let first = image * grid.num_cells() + row * grid.columns;
                let at = first_output * by_output_len + image * grid.num_places();
                matmul(
                    MatMut::from_row_major_slice_mut(out, together, row_len),
                    accum(image),
                    MatRef::from_row_major_slice_with_stride(
                        &by_output[at..],
                        together,
                        grid.num_places(),
                        by_output_len,
                    ),
                    MatRef::from_row_major_slice_with_stride(
                        &input[first * depth..],
                        grid.num_places(),
                        row_len,
                        depth,
                    ),
                    1.0,
                    Par::Seq,
                );
            }
        });
}

/// Gradient by the biases. `by_output` has [`places_last`].
pub(super) fn bias_gradient(by_output: &[f32], out: &mut [f32]) {
    const LANES: usize = 16;
    let row_len = by_output.len() / out.len().max(1);
    for (out, row) in out.iter_mut().zip(by_output.chunks_exact(row_len.max(1))) {
        let mut sums = [0.0f32; LANES];
        for values in row.chunks(LANES) {
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += value;
            }
        }
        *out = sums.iter().sum();
    }
}

/// The first of several products replaces, the others add.
fn accum(index: usize) -> Accum {
    if index == 0 {
        Accum::Replace
    } else {
        Accum::Add
    }
}
