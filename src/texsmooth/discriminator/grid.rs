//! Between the layers: pixels to cells, activation, and the way back of the gradients.

use rayon::prelude::*;

use super::conv::Grid;
use super::layer::Shape;
use super::{NUM_CHANNELS, PatchView};

/// One image's planes as cells.
pub(super) fn planes_to_cells(patch: &PatchView<'_>, shape: Shape, grid: Grid, out: &mut [f32]) {
    let num_pixels = patch.height * patch.width;
    out.par_chunks_mut(grid.columns * shape.depth())
        .enumerate()
        .for_each(|(row, out)| {
            out.fill(0.0);
            for dy in 0..shape.stride {
                let y = (row * shape.stride + dy).wrapping_sub(shape.padding);
                if y >= patch.height {
                    continue;
                }
                for channel in 0..NUM_CHANNELS {
                    let at = channel * num_pixels + y * patch.width;
                    let values = &patch.data[at..at + patch.width];
                    for dx in 0..shape.stride {
                        let (column, x) = first_column(shape, dx);
                        let block = dy * shape.stride + dx;
                        let at = column * shape.depth() + block * NUM_CHANNELS + channel;
                        let values = values.iter().skip(x).step_by(shape.stride);
                        let out = out.iter_mut().skip(at).step_by(shape.depth());
                        out.zip(values).for_each(|(out, value)| *out = *value);
                    }
                }
            }
        });
}

/// A layer's output, before bias and activation, as the next layer's cells after both.
pub(super) fn activate(
    raw: &[f32],
    bias: &[f32],
    slope: f32,
    before: Grid,
    (shape, grid): (Shape, Grid),
    out: &mut [f32],
) {
    let inputs = shape.inputs;
    out.par_chunks_mut(grid.columns * shape.depth())
        .enumerate()
        .for_each(|(index, out)| {
            let (image, row) = (index / grid.rows, index % grid.rows);
            for (block, out) in out.chunks_exact_mut(inputs).enumerate() {
                let per_cell = shape.stride * shape.stride;
                let (column, block) = (block / per_cell, block % per_cell);
                let y = (row * shape.stride + block / shape.stride).wrapping_sub(shape.padding);
                let x = (column * shape.stride + block % shape.stride).wrapping_sub(shape.padding);
                if y >= before.output_rows || x >= before.output_columns {
                    out.fill(0.0);
                    continue;
                }
                let at = (image * before.num_places() + y * before.columns + x) * inputs;
                let values = raw[at..at + inputs].iter().zip(bias);
                for (out, (value, bias)) in out.iter_mut().zip(values) {
                    let sum = value + bias;
                    // As the slope is at most 1. A branch on the sign would be guessed wrong half
                    // of the time.
                    *out = sum.max(slope * sum);
                }
            }
        });
}

/// The bits of 1.
const ONE: u32 = 1.0_f32.to_bits();

/// The gradient by a layer's output before its activation, from that by the next layer's cells;
/// `out` begins after its zeros. The leaky ReLU keeps the sign.
pub(super) fn deactivate(
    by_cells: &[f32],
    cells: &[f32],
    slope: f32,
    (shape, grid): (Shape, Grid),
    before: Grid,
    out: &mut [f32],
) {
    // 1 or the slope is picked by bits, as a branch on the sign would be guessed wrong half of the time.
    let inputs = shape.inputs;
    out.par_chunks_mut(before.columns * inputs)
        .enumerate()
        .for_each(|(index, out)| {
            let (image, y) = (index / before.rows, index % before.rows);
            for (x, out) in out.chunks_exact_mut(inputs).enumerate() {
                let is_output = y < before.output_rows && x < before.output_columns;
                let (at_y, at_x) = (y + shape.padding, x + shape.padding);
                let (row, column) = (at_y / shape.stride, at_x / shape.stride);
                // The last row or column may be one that no kernel reaches.
                if !is_output || row >= grid.rows || column >= grid.columns {
                    out.fill(0.0);
                    continue;
                }
                let block = at_y % shape.stride * shape.stride + at_x % shape.stride;
                let cell = image * grid.num_cells() + row * grid.columns + column;
                let at = cell * shape.depth() + block * inputs;
                let pairs = by_cells[at..at + inputs]
                    .iter()
                    .zip(&cells[at..at + inputs]);
                for (out, (gradient, value)) in out.iter_mut().zip(pairs) {
                    let is_negative = 0_u32.wrapping_sub(value.to_bits() >> 31);
                    let factor = ONE ^ is_negative & (ONE ^ slope.to_bits());
                    *out = f32::from_bits(factor) * gradient;
                }
            }
        });
}

/// Gradients by one image's cells, of the channels kept, as planes of `height`×`width`.
pub(super) fn cells_to_planes(
    by_cells: &[f32],
    (shape, grid): (Shape, Grid),
    [height, width]: [usize; 2],
    out: &mut [f32],
) {
    let num_planes = out.len() / (height * width);
    let kept_depth = shape.stride * shape.stride * num_planes;
    out.par_chunks_mut(width)
        .enumerate()
        .for_each(|(index, out)| {
            let (channel, y) = (index / height, index % height + shape.padding);
            let row = y / shape.stride;
            out.fill(0.0);
            if row >= grid.rows {
                return;
            }
            let row_len = grid.columns * kept_depth;
            let cells = &by_cells[row * row_len..(row + 1) * row_len];
            for dx in 0..shape.stride {
                let (column, x) = first_column(shape, dx);
                let block = y % shape.stride * shape.stride + dx;
                let at = column * kept_depth + block * num_planes + channel;
                let values = cells.iter().skip(at).step_by(kept_depth);
                let out = out.iter_mut().skip(x).step_by(shape.stride);
                out.zip(values).for_each(|(out, value)| *out = *value);
            }
        });
}

/// The first column of cells whose pixel `dx` lies in the image, and that pixel.
fn first_column(shape: Shape, dx: usize) -> (usize, usize) {
    let column = shape.padding.saturating_sub(dx).div_ceil(shape.stride);
    (column, column * shape.stride + dx - shape.padding)
}
