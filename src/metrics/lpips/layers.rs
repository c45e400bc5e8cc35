//! The two layers of the backbone: convolution with ReLU, and max pooling.
//!
//! Planar `f32`: `[channel][row][column]`. A convolution unfolds its input (im2col) for a fixed
//! number of output rows at a time and multiplies each piece on one thread, so that the bits do
//! not depend on the number of threads.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

/// Activations.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Planes {
    pub(super) num_channels: usize,
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) data: Vec<f32>,
}

impl Planes {
    pub(super) fn num_positions(&self) -> usize {
        self.height * self.width
    }

    pub(super) fn channel(&self, channel: usize) -> &[f32] {
        let num_positions = self.num_positions();
        &self.data[channel * num_positions..(channel + 1) * num_positions]
    }
}

/// The shape of a convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ConvShape {
    pub(super) num_inputs: usize,
    pub(super) num_outputs: usize,
    pub(super) kernel: usize,
    pub(super) stride: usize,
    pub(super) padding: usize,
}

impl ConvShape {
    fn num_taps(&self) -> usize {
        self.num_inputs * self.kernel * self.kernel
    }

    fn output_side(&self, side: usize) -> Option<usize> {
        let room = (side + 2 * self.padding).checked_sub(self.kernel)?;
        Some(room / self.stride + 1)
    }
}

/// A convolution: weights `[output][input][row][column]`, one bias per output.
#[derive(Clone, Debug)]
pub(super) struct Conv {
    pub(super) shape: ConvShape,
    pub(super) weights: Vec<f32>,
    pub(super) biases: Vec<f32>,
}

/// Output positions that are multiplied at once: large enough for the multiplication to run at
/// full speed, small enough for the unfolded input to stay in the cache.
const CHUNK_POSITIONS: usize = 384;

impl Conv {
    /// Convolution, bias and ReLU; `None` where the input is smaller than the kernel.
    pub(super) fn apply(&self, input: &Planes) -> Option<Planes> {
        let shape = &self.shape;
        let height = shape.output_side(input.height)?;
        let width = shape.output_side(input.width)?;
        let rows_per_chunk = CHUNK_POSITIONS.div_ceil(width);
        let first_rows: Vec<usize> = (0..height).step_by(rows_per_chunk).collect();
        let chunks: Vec<Vec<f32>> = first_rows
            .par_iter()
            .map(|&first| {
                let num_rows = rows_per_chunk.min(height - first);
                self.apply_rows(input, first, num_rows, width)
            })
            .collect();

        let mut data = vec![0.0; shape.num_outputs * height * width];
        for (&first, chunk) in first_rows.iter().zip(&chunks) {
            let num_positions = chunk.len() / shape.num_outputs;
            for (channel, values) in chunk.chunks_exact(num_positions).enumerate() {
                let start = (channel * height + first) * width;
                data[start..start + num_positions].copy_from_slice(values);
            }
        }
        Some(Planes {
            num_channels: shape.num_outputs,
            height,
            width,
            data,
        })
    }

    /// Some rows of the output, as `[output][row][column]`.
    fn apply_rows(&self, input: &Planes, first: usize, num_rows: usize, width: usize) -> Vec<f32> {
        let shape = &self.shape;
        let num_positions = num_rows * width;
        let unfolded = unfold(shape, input, first, num_rows, width);
        let mut output = vec![0.0; shape.num_outputs * num_positions];
        matmul(
            MatMut::from_row_major_slice_mut(&mut output, shape.num_outputs, num_positions),
            Accum::Replace,
            MatRef::from_row_major_slice(&self.weights, shape.num_outputs, shape.num_taps()),
            MatRef::from_row_major_slice(&unfolded, shape.num_taps(), num_positions),
            1.0,
            Par::Seq,
        );
        for (values, bias) in output.chunks_exact_mut(num_positions).zip(&self.biases) {
            for value in values {
                *value = (*value + bias).max(0.0);
            }
        }
        output
    }
}

/// For each tap of the kernel a row with what it meets at each output position; zero outside.
fn unfold(
    shape: &ConvShape,
    input: &Planes,
    first: usize,
    num_rows: usize,
    width: usize,
) -> Vec<f32> {
    let mut unfolded = vec![0.0; shape.num_taps() * num_rows * width];
    let mut rows = unfolded.chunks_exact_mut(width);
    for channel in 0..input.num_channels {
        let plane = input.channel(channel);
        for (ky, kx) in (0..shape.kernel).flat_map(|ky| (0..shape.kernel).map(move |kx| (ky, kx))) {
            for y in first..first + num_rows {
                let Some(row) = rows.next() else {
                    return unfolded;
                };
                let source_y = (y * shape.stride + ky).checked_sub(shape.padding);
                let Some(source_y) = source_y.filter(|&source_y| source_y < input.height) else {
                    continue;
                };
                let source = &plane[source_y * input.width..(source_y + 1) * input.width];
                for (x, value) in row.iter_mut().enumerate() {
                    if let Some(source_x) = (x * shape.stride + kx).checked_sub(shape.padding)
                        && let Some(&read) = source.get(source_x)
                    {
                        *value = read;
                    }
                }
            }
        }
    }
    unfolded
}

const POOL_SIDE: usize = 3;
const POOL_STRIDE: usize = 2;

/// The largest of 3×3, every second row and column; `None` where the input is smaller.
pub(super) fn max_pool(input: &Planes) -> Option<Planes> {
    let side = |side: usize| Some(side.checked_sub(POOL_SIDE)? / POOL_STRIDE + 1);
    let (height, width) = (side(input.height)?, side(input.width)?);
    let planes: Vec<Vec<f32>> = (0..input.num_channels)
        .into_par_iter()
        .map(|channel| {
            let plane = input.channel(channel);
            let mut pooled = Vec::with_capacity(height * width);
            for y in 0..height {
                for x in 0..width {
                    let mut largest = f32::NEG_INFINITY;
                    for dy in 0..POOL_SIDE {
                        let start = (y * POOL_STRIDE + dy) * input.width + x * POOL_STRIDE;
                        for &value in &plane[start..start + POOL_SIDE] {
                            largest = largest.max(value);
                        }
                    }
                    pooled.push(largest);
                }
            }
            pooled
        })
        .collect();
    Some(Planes {
        num_channels: input.num_channels,
        height,
        width,
        data: planes.concat(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(num_channels: usize, height: usize, width: usize) -> Planes {
        let value = |i: usize| ((i * 37 + 11) % 23) as f32 / 7.0 - 1.2;
        Planes {
            num_channels,
            height,
            width,
            data: (0..num_channels * height * width).map(value).collect(),
        }
    }

    /// The definition: six nested sums.
    fn by_definition(conv: &Conv, input: &Planes, output: &Planes) -> Vec<f64> {
        let shape = conv.shape;
        let mut expected = Vec::new();
        for o in 0..shape.num_outputs {
            for (y, x) in (0..output.height).flat_map(|y| (0..output.width).map(move |x| (y, x))) {
                let mut sum = f64::from(conv.biases[o]);
                for c in 0..shape.num_inputs {
                    for (ky, kx) in
                        (0..shape.kernel).flat_map(|ky| (0..shape.kernel).map(move |kx| (ky, kx)))
                    {
                        let sy = (y * shape.stride + ky) as i64 - shape.padding as i64;
                        let sx = (x * shape.stride + kx) as i64 - shape.padding as i64;
                        let inside = (0..input.height as i64).contains(&sy)
                            && (0..input.width as i64).contains(&sx);
                        if inside {
                            let at = sy as usize * input.width + sx as usize;
                            let tap = ((o * shape.num_inputs + c) * shape.kernel + ky)
                                * shape.kernel
                                + kx;
                            sum += f64::from(input.channel(c)[at]) * f64::from(conv.weights[tap]);
                        }
                    }
                }
                expected.push(sum.max(0.0));
            }
        }
        expected
    }

    #[test]
    fn convolution_is_its_definition_for_any_stride_and_padding() {
        for (kernel, stride, padding) in [(3, 1, 1), (5, 1, 2), (11, 4, 2), (4, 2, 0)] {
            let shape = ConvShape {
                num_inputs: 3,
                num_outputs: 5,
                kernel,
                stride,
                padding,
            };
            let conv = Conv {
                shape,
                weights: ramp(1, 5, shape.num_taps()).data,
                biases: vec![0.1, -3.0, 0.0, 2.5, -0.7],
            };
            // More positions than a chunk has, with a last chunk that is not full.
            let input = ramp(3, 41, 67);
            let output = conv.apply(&input).unwrap();
            let expected = by_definition(&conv, &input, &output);
            assert_eq!(expected.len(), output.data.len());
            for (value, expected) in output.data.iter().zip(&expected) {
                let error = (f64::from(*value) - expected).abs();
                assert!(error < 1e-3 * (1.0 + expected.abs()), "{value} {expected}");
            }
        }
    }

    #[test]
    fn pooling_takes_the_largest() {
        let input = ramp(2, 8, 9);
        let pooled = max_pool(&input).unwrap();
        assert_eq!([pooled.height, pooled.width], [3, 4]);
        for (c, y, x) in [(0, 0, 0), (1, 2, 3), (0, 1, 2)] {
            let largest = (0..9)
                .map(|i| input.channel(c)[(2 * y + i / 3) * 9 + 2 * x + i % 3])
                .fold(f32::MIN, f32::max);
            assert_eq!(pooled.channel(c)[y * 4 + x], largest);
        }
        assert!(max_pool(&ramp(1, 2, 9)).is_none());
    }
}
