//! The five layers one after the other, forward and backward, on some images of one size.

use super::PatchView;
use super::adam::{AdamStep, Moments};
use super::conv::{self, Grid};
use super::grid;
use super::layer::{Kernels, Shape, Weights};
use super::losses::{self, Side};

pub(super) const NUM_LAYERS: usize = 5;

/// A layer and the state of its optimisation.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    pub(super) shape: Shape,
    weights: Weights,
    kernels: Kernels,
    pub(super) weight_moments: Moments,
    pub(super) bias_moments: Moments,
    pub(super) gradients: Weights,
}

impl Layer {
    pub(super) fn new(shape: Shape, weights: Weights, mut kernels: Kernels) -> Self {
        kernels.refresh(shape, &weights);
        Self {
            weight_moments: Moments::new(weights.weight.len()),
            bias_moments: Moments::new(weights.bias.len()),
            gradients: weights.clone(),
            shape,
            weights,
            kernels,
        }
    }

    pub(super) fn weights(&self) -> &Weights {
        &self.weights
    }

    #[cfg(test)]
    pub(super) fn set_bias(&mut self, bias: Vec<f32>) {
        self.weights.bias = bias;
    }

    /// Steps along the gradients, or by the momentum alone.
    pub(super) fn step(&mut self, adam: &AdamStep, has_gradient: bool) {
        let weight = has_gradient.then_some(self.gradients.weight.as_slice());
        adam.apply(&mut self.weights.weight, &mut self.weight_moments, weight);
        let bias = has_gradient.then_some(self.gradients.bias.as_slice());
        adam.apply(&mut self.weights.bias, &mut self.bias_moments, bias);
        self.kernels.refresh(self.shape, &self.weights);
    }
}

/// The layers.
#[derive(Clone, Debug)]
pub(super) struct Network {
    pub(super) layers: Vec<Layer>,
    /// Of the leaky ReLU below 0.
    pub(super) slope: f32,
}

/// What a pass leaves behind; buffers grow once and are used again.
#[derive(Clone, Debug, Default)]
pub(super) struct Workspace {
    num_images: usize,
    grids: [Grid; NUM_LAYERS],
    /// Each layer's input in cells.
    inputs: [Vec<f32>; NUM_LAYERS],
    /// Gradient by each layer's output, before its activation.
    gradients: [Vec<f32>; NUM_LAYERS],
    /// A layer's output before bias and activation.
    raw: Vec<f32>,
    /// Gradient by a layer's input.
    by_input: Vec<f32>,
    /// A layer's gradient with places last.
    places_last: Vec<f32>,
    /// Of one image after the other.
    logits: Vec<f32>,
}

/// The first `len` of a buffer that grows when it must.
fn first(buffer: &mut Vec<f32>, len: usize) -> &mut [f32] {
    if buffer.len() < len {
        buffer.resize(len, 0.0);
    }
    &mut buffer[..len]
}

impl Workspace {
    /// The logits of an image.
    pub(super) fn logits(&self, image: usize) -> &[f32] {
        let num = self.logits.len() / self.num_images;
        &self.logits[image * num..(image + 1) * num]
    }
}

impl Network {
    /// The logits of patches of one size, large enough for the layers.
    pub(super) fn forward(&self, patches: &[PatchView<'_>], workspace: &mut Workspace) {
        let num_images = patches.len();
        workspace.num_images = num_images;
        let mut size = patches.first().map_or([0; 2], |p| [p.height, p.width]);
        for (grid, layer) in workspace.grids.iter_mut().zip(&self.layers) {
            *grid = Grid::new(layer.shape, size).unwrap_or_default();
            size = [grid.output_rows, grid.output_columns];
        }
        let grids = workspace.grids;
        for (index, layer) in self.layers.iter().enumerate() {
            let (shape, grid) = (layer.shape, grids[index]);
            let input = first(
                &mut workspace.inputs[index],
                grid.input_len(shape, num_images),
            );
            let (cells, after) = input.split_at_mut(num_images * grid.num_cells() * shape.depth());
            after.fill(0.0);
            if index == 0 {
                let images = cells.chunks_exact_mut(grid.num_cells() * shape.depth());
                for (patch, out) in patches.iter().zip(images) {
                    grid::planes_to_cells(patch, shape, grid, out);
                }
            } else {
                let before = &self.layers[index - 1];
                let (bias, slope) = (&before.weights.bias, self.slope);
                let raw = &workspace.raw;
                grid::activate(raw, bias, slope, grids[index - 1], (shape, grid), cells);
            }
            let raw = first(
                &mut workspace.raw,
                num_images * grid.num_places() * shape.outputs,
            );
            conv::forward(shape, grid, input, &layer.kernels, raw);
        }
        let (grid, last) = (grids[NUM_LAYERS - 1], &self.layers[NUM_LAYERS - 1]);
        workspace.logits.clear();
        let rows = workspace.raw[..num_images * grid.num_places()].chunks_exact(grid.columns);
        for row in rows {
            let row = &row[..grid.output_columns];
            let logits = row.iter().map(|value| value + last.weights.bias[0]);
            workspace.logits.extend(logits);
        }
    }

    /// Puts the gradients of the images' losses at the end.
    pub(super) fn begin_backward(&self, workspace: &mut Workspace, counts: &[f32], sides: &[Side]) {
        let (grid, shape) = (
            workspace.grids[NUM_LAYERS - 1],
            self.layers[NUM_LAYERS - 1].shape,
        );
        let num_before = grid.num_before(shape);
        let num_images = workspace.num_images;
        let out = first(
            &mut workspace.gradients[NUM_LAYERS - 1],
            num_before + num_images * grid.num_cells(),
        );
        out.fill(0.0);
        let images = out[num_before..].chunks_exact_mut(grid.num_cells());
        let per_image = workspace.logits.chunks_exact(counts.len());
        for ((out, logits), side) in images.zip(per_image).zip(sides) {
            let rows = logits.chunks_exact(grid.output_columns);
            let counts_rows = counts.chunks_exact(grid.output_columns);
            let total = losses::total(counts);
            for ((out, logits), counts) in out
                .chunks_exact_mut(grid.columns)
                .zip(rows)
                .zip(counts_rows)
            {
                losses::gradient(logits, counts, total, *side, out);
            }
        }
    }

    /// Every layer's gradients, after [`Self::begin_backward`].
    pub(super) fn weight_gradients(&mut self, workspace: &mut Workspace) {
        let num_images = workspace.num_images;
        for index in (0..NUM_LAYERS).rev() {
            let layer = &mut self.layers[index];
            let (shape, grid) = (layer.shape, workspace.grids[index]);
            let num_places = num_images * grid.num_places() * shape.outputs;
            let transposed = first(&mut workspace.places_last, num_places);
            let (input, by_output) = (&workspace.inputs[index], &workspace.gradients[index]);
            conv::places_last(shape, grid, by_output, num_images, transposed);
            let (kernels, gradients) = (&layer.kernels, &mut layer.gradients);
            let by_input = &mut workspace.by_input;
            rayon::join(
                || {
                    conv::weight_gradient(shape, grid, input, transposed, &mut gradients.weight);
                    conv::bias_gradient(transposed, &mut gradients.bias);
                },
                || {
                    if index > 0 {
                        let len = num_images * grid.num_cells() * shape.depth();
                        conv::input_gradient(shape, grid, by_output, kernels, first(by_input, len));
                    }
                },
            );
            self.through_activation(workspace, index);
        }
    }

    /// The gradient by the one patch's last planes, after [`Self::begin_backward`].
    pub(super) fn patch_gradient(
        &self,
        workspace: &mut Workspace,
        size: [usize; 2],
        out: &mut [f32],
    ) {
        for (index, layer) in self.layers.iter().enumerate().rev() {
            let (shape, grid) = (layer.shape, workspace.grids[index]);
            let len = grid.num_cells() * layer.kernels.kept_depth(shape);
            let by_input = first(&mut workspace.by_input, len);
            let by_output = &workspace.gradients[index];
            conv::input_gradient(shape, grid, by_output, &layer.kernels, by_input);
            if index == 0 {
                grid::cells_to_planes(by_input, (shape, grid), size, out);
            }
            self.through_activation(workspace, index);
        }
    }

    /// From the gradient by a layer's input to that by the layer before, which there is not for 0.
    fn through_activation(&self, workspace: &mut Workspace, index: usize) {
        let Some(previous) = index.checked_sub(1) else {
            return;
        };
        let (shape, grid) = (self.layers[index].shape, workspace.grids[index]);
        let (before_shape, before) = (self.layers[previous].shape, workspace.grids[previous]);
        let num_zeros = before.num_before(before_shape) * shape.inputs;
        let out = first(
            &mut workspace.gradients[previous],
            num_zeros + workspace.num_images * before.num_cells() * shape.inputs,
        );
        let (zeros, out) = out.split_at_mut(num_zeros);
        zeros.fill(0.0);
        grid::deactivate(
            &workspace.by_input,
            &workspace.inputs[index],
            self.slope,
            (shape, grid),
            before,
            out,
        );
    }
}
