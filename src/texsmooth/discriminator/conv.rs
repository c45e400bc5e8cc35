//! A convolution of 4×4 by matrix products.
//!
//! Images are row-major with channels last. What a place of the output looks at is gathered into a
//! row of a matrix, tap by tap (a memory copy, as channels lie together), and rows are multiplied
//! by the weights in pieces of a fixed number of rows that stay in cache. The gradient by the input
//! is the same with the roles of input and output exchanged: an input pixel gathers, for those taps
//! that reach it (by its row and column modulo the stride), the gradients of the places that look
//! at it; so that nothing is scattered and no product is wasted on zeros. The gradient by the
//! weights is divided by taps, so that no two threads add to one sum.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

pub(super) const KERNEL: usize = 4;
const NUM_TAPS: usize = KERNEL * KERNEL;
/// Rows of a gathered matrix, about: with 2048 columns it takes 2 MB.
const CHUNK_PLACES: usize = 256;
/// Taps whose weights' gradients are worked out together.
const TAPS_TOGETHER: usize = 2;

/// A feature map: `data[(y · width + x) · channels + channel]`.
#[derive(Clone, Debug, Default)]
pub(super) struct Map {
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) channels: usize,
    pub(super) data: Vec<f32>,
}

impl Map {
    fn resize(&mut self, height: usize, width: usize, channels: usize) {
        (self.height, self.width, self.channels) = (height, width, channels);
        self.data.resize(height * width * channels, 0.0);
    }

    /// The channels of a pixel; nothing outside.
    fn pixel(&self, y: usize, x: usize) -> Option<&[f32]> {
        // Positions left of and above the image wrap to large ones.
        if y >= self.height || x >= self.width {
            return None;
        }
        let at = (y * self.width + x) * self.channels;
        Some(&self.data[at..at + self.channels])
    }
}

/// Shape of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) stride: usize,
    pub(super) padding: usize,
}

/// Weights `[(ky · 4 + kx) · inputs + input][output]` and biases.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Weights {
    pub(super) weight: Vec<f32>,
    pub(super) bias: Vec<f32>,
}

impl Shape {
    pub(super) fn num_weights(&self) -> usize {
        NUM_TAPS * self.inputs * self.outputs
    }

    /// Side of the output; `None` when the kernel does not fit.
    pub(super) fn output_side(&self, side: usize) -> Option<usize> {
        Some((side + 2 * self.padding).checked_sub(KERNEL)? / self.stride + 1)
    }

    /// The convolution plus bias, before any activation. `input` must be large enough.
    pub(super) fn forward(&self, input: &Map, weights: &Weights, out: &mut Map) {
        let sides = [input.height, input.width].map(|s| self.output_side(s).unwrap_or(0));
        out.resize(sides[0], sides[1], self.outputs);
        let width = out.width;
        if out.data.is_empty() {
            return;
        }
        let num_columns = NUM_TAPS * self.inputs;
        let rows = (CHUNK_PLACES / width).max(1);
        out.data
            .par_chunks_mut(rows * width * self.outputs)
            .enumerate()
            .for_each_init(Vec::new, |gathered, (chunk, out)| {
                let num_places = out.len() / self.outputs;
                gathered.resize(num_places * num_columns, 0.0);
                for (place, row) in gathered.chunks_mut(num_columns).enumerate() {
                    let (y, x) = (chunk * rows + place / width, place % width);
                    self.gather(input, [y, x], 0..NUM_TAPS, row);
                }
                for row in out.chunks_mut(self.outputs) {
                    row.copy_from_slice(&weights.bias);
                }
                multiply(
                    out,
                    gathered,
                    &weights.weight,
                    [num_places, num_columns, self.outputs],
                    Accum::Add,
                );
            });
    }

    /// What a place looks at through some taps, in their order; 0 outside the image.
    fn gather(
        &self,
        input: &Map,
        [y, x]: [usize; 2],
        taps: std::ops::Range<usize>,
        row: &mut [f32],
    ) {
        for (tap, part) in taps.zip(row.chunks_mut(self.inputs)) {
            let at_y = (y * self.stride + tap / KERNEL).wrapping_sub(self.padding);
            let at_x = (x * self.stride + tap % KERNEL).wrapping_sub(self.padding);
            match input.pixel(at_y, at_x) {
                Some(pixel) => part.copy_from_slice(pixel),
                None => part.fill(0.0),
            }
        }
    }

    /// Gradients by weights and biases, from those by the output.
    pub(super) fn weight_gradient(&self, input: &Map, by_output: &Map, out: &mut Weights) {
        let per_task = TAPS_TOGETHER * self.inputs;
        out.weight
            .par_chunks_mut(per_task * self.outputs)
            .enumerate()
            .for_each_init(Vec::new, |gathered, (task, out)| {
                let taps = task * TAPS_TOGETHER..(task + 1) * TAPS_TOGETHER;
                out.fill(0.0);
                let chunks = by_output.data.chunks(4 * CHUNK_PLACES * self.outputs);
                for (chunk, by_output_rows) in chunks.enumerate() {
                    let num_places = by_output_rows.len() / self.outputs;
                    gathered.resize(num_places * per_task, 0.0);
                    for (place, row) in gathered.chunks_mut(per_task).enumerate() {
                        let place = chunk * 4 * CHUNK_PLACES + place;
                        let at = [place / by_output.width, place % by_output.width];
                        self.gather(input, at, taps.clone(), row);
                    }
                    matmul(
                        MatMut::from_row_major_slice_mut(out, per_task, self.outputs),
                        Accum::Add,
                        MatRef::from_row_major_slice(gathered, num_places, per_task).transpose(),
                        MatRef::from_row_major_slice(by_output_rows, num_places, self.outputs),
                        1.0,
                        Par::Seq,
                    );
                }
            });
        out.bias.fill(0.0);
        for place in by_output.data.chunks(self.outputs) {
            for (sum, value) in out.bias.iter_mut().zip(place) {
                *sum += value;
            }
        }
    }

    /// Gradient by the input, of `height`×`width` pixels, from that by the output.
    pub(super) fn input_gradient(
        &self,
        by_output: &Map,
        weights: &Weights,
        [height, width]: [usize; 2],
        out: &mut Map,
    ) {
        out.resize(height, width, self.inputs);
        let phases: Vec<Phase> = (0..self.stride * self.stride)
            .map(|phase| Phase::new(self, weights, [phase / self.stride, phase % self.stride]))
            .collect();
        // Whole periods of rows, so that a piece has all its phases.
        let rows = (4 * CHUNK_PLACES / width.max(1))
            .next_multiple_of(self.stride)
            .max(self.stride);
        out.data
            .par_chunks_mut((rows * width * self.inputs).max(1))
            .enumerate()
            .for_each_init(Default::default, |workspace, (chunk, out)| {
                for phase in &phases {
                    phase.input_gradient(self, by_output, [chunk * rows, width], out, workspace);
                }
            });
    }
}

/// Input pixels of one row and one column modulo the stride, with the taps that reach them.
struct Phase {
    at: [usize; 2],
    /// Rows and columns of the kernel.
    taps: Vec<[usize; 2]>,
    /// Their weights: `[tap · outputs + output][input]`.
    weight: Vec<f32>,
}

impl Phase {
    fn new(shape: &Shape, weights: &Weights, at: [usize; 2]) -> Self {
        let reaches = |at: usize, tap: usize| {
            (at + shape.padding + shape.stride * KERNEL - tap).is_multiple_of(shape.stride)
        };
        let taps: Vec<[usize; 2]> = (0..NUM_TAPS)
            .map(|tap| [tap / KERNEL, tap % KERNEL])
            .filter(|&[ky, kx]| reaches(at[0], ky) && reaches(at[1], kx))
            .collect();
        let mut weight = Vec::with_capacity(taps.len() * shape.inputs * shape.outputs);
        for &[ky, kx] in &taps {
            let first = (ky * KERNEL + kx) * shape.inputs;
            for output in 0..shape.outputs {
                let of_input = |input| weights.weight[(first + input) * shape.outputs + output];
                weight.extend((0..shape.inputs).map(of_input));
            }
        }
        Self { at, taps, weight }
    }

    /// Writes this phase's pixels of a piece that begins at a row of the input.
    fn input_gradient(
        &self,
        shape: &Shape,
        by_output: &Map,
        [first_row, width]: [usize; 2],
        out: &mut [f32],
        (gathered, product): &mut (Vec<f32>, Vec<f32>),
    ) {
        let num_rows = out.len() / (width * shape.inputs);
        let columns: Vec<usize> = (self.at[1]..width).step_by(shape.stride).collect();
        let rows: Vec<usize> = (self.at[0]..num_rows).step_by(shape.stride).collect();
        let num_pixels = columns.len() * rows.len();
        let num_columns = self.taps.len() * shape.outputs;
        if num_pixels == 0 {
            return;
        }
        gathered.resize(num_pixels * num_columns, 0.0);
        product.resize(num_pixels * shape.inputs, 0.0);
        let pixels = || {
            rows.iter()
                .flat_map(|&y| columns.iter().map(move |&x| [y, x]))
        };
        for ([y, x], row) in pixels().zip(gathered.chunks_mut(num_columns)) {
            for (&[ky, kx], part) in self.taps.iter().zip(row.chunks_mut(shape.outputs)) {
                // Places left of and above the first wrap to large ones.
                let place = |at: usize, tap: usize| (at + shape.padding).wrapping_sub(tap);
                let (y, x) = (place(first_row + y, ky), place(x, kx));
                let is_before = (y | x) > usize::MAX / 2;
                let found = if is_before {
                    None
                } else {
                    by_output.pixel(y / shape.stride, x / shape.stride)
                };
                match found {
                    Some(pixel) => part.copy_from_slice(pixel),
                    None => part.fill(0.0),
                }
            }
        }
        multiply(
            product,
            gathered,
            &self.weight,
            [num_pixels, num_columns, shape.inputs],
            Accum::Replace,
        );
        for ([y, x], value) in pixels().zip(product.chunks(shape.inputs)) {
            let at = (y * width + x) * shape.inputs;
            out[at..at + shape.inputs].copy_from_slice(value);
        }
    }
}

/// `out (+)= a · b` of row-major matrices n×k and k×m, on this thread.
fn multiply(out: &mut [f32], a: &[f32], b: &[f32], [n, k, m]: [usize; 3], accum: Accum) {
    matmul(
        MatMut::from_row_major_slice_mut(out, n, m),
        accum,
        MatRef::from_row_major_slice(a, n, k),
        MatRef::from_row_major_slice(b, k, m),
        1.0,
        Par::Seq,
    );
}
