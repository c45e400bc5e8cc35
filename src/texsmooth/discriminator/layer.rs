//! A layer's shape, its weights, and the forms of them that the products read.

use rayon::prelude::*;

/// Side of every convolution's kernel.
pub(super) const KERNEL: usize = 4;

/// Shape of a layer.
///
/// A convolution of 4×4 with stride s is one of (4/s)×(4/s) with stride 1 on an image whose s×s
/// blocks of pixels are stacked into channels. Such a block is a *cell*, of `depth` channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    /// Divides the kernel's side.
    pub(super) stride: usize,
    pub(super) padding: usize,
}

impl Shape {
    /// Side of the kernel in cells.
    pub(super) fn side(&self) -> usize {
        KERNEL / self.stride
    }

    /// Channels of a cell.
    pub(super) fn depth(&self) -> usize {
        self.stride * self.stride * self.inputs
    }

    /// Weights of an output in a row of the kernel; they meet numbers that lie together.
    pub(super) fn row_len(&self) -> usize {
        self.side() * self.depth()
    }

    pub(super) fn num_weights(&self) -> usize {
        KERNEL * KERNEL * self.inputs * self.outputs
    }

    /// Side of the output; `None` when the kernel does not fit.
    pub(super) fn output_side(&self, side: usize) -> Option<usize> {
        Some((side + 2 * self.padding).checked_sub(KERNEL)? / self.stride + 1)
    }

    /// Where the cells' order has the weight of `[(ky · 4 + kx) · inputs + input][output]`.
    fn cell_index(&self, plain: usize) -> usize {
        let (output, rest) = (plain % self.outputs, plain / self.outputs);
        let (input, tap) = (rest % self.inputs, rest / self.inputs);
        let (ky, kx) = (tap / KERNEL, tap % KERNEL);
        let (cell_y, cell_x) = (ky / self.stride, kx / self.stride);
        let block = ky % self.stride * self.stride + kx % self.stride;
        ((cell_y * self.outputs + output) * self.side() + cell_x) * self.depth()
            + block * self.inputs
            + input
    }

    /// Weights `[(ky · 4 + kx) · inputs + input][output]` in the order of [`Weights`].
    pub(super) fn to_cells(self, plain: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; plain.len()];
        for (index, value) in plain.iter().enumerate() {
            out[self.cell_index(index)] = *value;
        }
        out
    }

    /// The inverse of [`Self::to_cells`].
    pub(super) fn to_plain(self, cells: &[f32]) -> Vec<f32> {
        (0..cells.len())
            .map(|index| cells[self.cell_index(index)])
            .collect()
    }
}

/// Weights `[row of the kernel][output][column of the kernel][channel of the cell]`, and biases.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Weights {
    pub(super) weight: Vec<f32>,
    pub(super) bias: Vec<f32>,
}

/// The weights as the products read them, made again after every step.
#[derive(Clone, Debug)]
pub(super) struct Kernels {
    /// `[row of the kernel][column, channel of the cell][output]`.
    pub(super) forward: Vec<f32>,
    /// `[row of the kernel][column from the last to the first, output][channel kept]`.
    pub(super) backward: Vec<f32>,
    /// The first input whose gradient is wanted.
    first_kept: usize,
}

impl Kernels {
    /// Nothing yet. Gradients are wanted of the inputs from `first_kept` on.
    pub(super) fn new(shape: Shape, first_kept: usize) -> Self {
        let num_kept = shape.num_weights() / shape.inputs * (shape.inputs - first_kept);
        Self {
            forward: vec![0.0; shape.num_weights()],
            backward: vec![0.0; num_kept],
            first_kept,
        }
    }

    /// Channels of a cell's gradient.
    pub(super) fn kept_depth(&self, shape: Shape) -> usize {
        shape.stride * shape.stride * (shape.inputs - self.first_kept)
    }

    /// Takes in new weights.
    pub(super) fn refresh(&mut self, shape: Shape, weights: &Weights) {
        let per_row = shape.outputs * shape.row_len();
        let per_kept_row = shape.side() * shape.outputs * self.kept_depth(shape);
        let first_kept = self.first_kept;
        self.forward
            .par_chunks_mut(per_row)
            .zip(self.backward.par_chunks_mut(per_kept_row))
            .zip(weights.weight.par_chunks(per_row))
            .for_each(|((forward, backward), weight)| {
                transpose(weight, shape.row_len(), forward, shape.outputs);
                reverse(weight, shape, first_kept, backward);
            });
    }
}

/// A kernel's row for [`Kernels::backward`].
fn reverse(weight: &[f32], shape: Shape, first_kept: usize, out: &mut [f32]) {
    let (side, outputs, depth) = (shape.side(), shape.outputs, shape.depth());
    let kept_depth = out.len() / (side * outputs);
    for (output, of_output) in weight.chunks_exact(side * depth).enumerate() {
        for (column, cell) in of_output.chunks_exact(depth).enumerate() {
            let at = ((side - 1 - column) * outputs + output) * kept_depth;
            let blocks = cell.chunks_exact(shape.inputs);
            let out = out[at..at + kept_depth].chunks_exact_mut(shape.inputs - first_kept);
            for (out, block) in out.zip(blocks) {
                out.copy_from_slice(&block[first_kept..]);
            }
        }
    }
}

/// Side of the squares that are transposed at a time: a cache line.
const TILE: usize = 16;

/// Transposes the rows, `row_len` long each, of `from` into the first columns of `out`, whose rows
/// are `out_row_len` long.
pub(super) fn transpose(from: &[f32], row_len: usize, out: &mut [f32], out_row_len: usize) {
    for (band, rows) in from.chunks(TILE * row_len).enumerate() {
        for first in (0..row_len).step_by(TILE) {
            let columns = first..(first + TILE).min(row_len);
            for column in columns {
                let at = column * out_row_len + band * TILE;
                for (out, row) in out[at..].iter_mut().zip(rows.chunks_exact(row_len)) {
                    *out = row[column];
                }
            }
        }
    }
}
