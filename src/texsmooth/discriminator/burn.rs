//! The discriminator on a GPU: burn's tensors and automatic differentiation on wgpu.
//!
//! Layers, weights, losses and Adam are those of [`super::CpuDiscriminator`], whose saved bytes this
//! loads and makes. The device runs the five layers there and back, and Adam. What is small stays
//! here, and is the CPU's own code: the mask of places, the losses over the logits and their
//! gradient by the logits, which is handed to the device as the weights of a sum.
//!
//! The tensors live on the [`GpuDevice`] that they are given: memory and queue are shared with
//! whatever else draws there. Sums have the order that the driver's kernels give them: results are
//! the CPU's up to rounding, not to the bit.

use std::sync::{Mutex, PoisonError};

use ::burn::tensor::activation::leaky_relu;
use ::burn::tensor::module::conv2d;
use ::burn::tensor::ops::ConvOptions;
use ::burn::tensor::wgpu::WgpuSetup;
use ::burn::tensor::{Device, Tensor, TensorData};

use super::cpu::Plain;
use super::layer::{KERNEL, Shape};
use super::losses::{self, Side};
use super::{
    CpuDiscriminator, Critic, CriticError, CriticLosses, DiscriminatorParams, Gate, NUM_CHANNELS,
    PatchView,
};
use crate::render::gpu::GpuDevice;

const EPSILON: f32 = 1e-8;

/// See the module.
pub struct GpuDiscriminator {
    params: DiscriminatorParams,
    gpu: GpuDevice,
    device: Device,
    layers: Vec<Layer>,
    num_steps: u64,
    /// Knows sizes and masks, and how weights are saved; its own weights are those of the start.
    host: CpuDiscriminator,
}

struct Layer {
    shape: Shape,
    /// Weights `[output][input][row][column]`.
    weight: Learnt<4>,
    bias: Learnt<1>,
}

/// Numbers with their moments.
struct Learnt<const D: usize> {
    value: Tensor<D>,
    first: Tensor<D>,
    second: Tensor<D>,
}

/// Adam's numbers at a step.
#[derive(Clone, Copy)]
struct AdamStep {
    learning_rate: f32,
    betas: [f32; 2],
    corrections: [f32; 2],
}

/// The devices that burn was told of, and what it calls them: it would take a second word for a
/// second device.
static REGISTERED: Mutex<Vec<(wgpu::Device, Device)>> = Mutex::new(Vec::new());

fn register(gpu: &GpuDevice) -> Result<Device, CriticError> {
    let (instance, adapter, device, queue) = gpu.handles();
    let mut registered = REGISTERED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, known)) = registered.iter().find(|(of, _)| of == device) {
        return Ok(known.clone());
    }
    let setup = WgpuSetup {
        instance: instance.clone(),
        adapter: adapter.clone(),
        device: device.clone(),
        queue: queue.clone(),
        backend: adapter.get_info().backend,
    };
    let made = Device::wgpu_options()
        .setup(setup)
        .init()
        .map_err(|error| CriticError::Device(format!("{}: {error}", gpu.name())))?;
    registered.push((device.clone(), made.clone()));
    Ok(made)
}

impl GpuDiscriminator {
    /// A discriminator that has learnt nothing, with the weights that the same seed gives the CPU's.
    ///
    /// # Errors
    /// [`CriticError::Device`] when the device cannot be used.
    pub fn new(
        gpu: &GpuDevice,
        params: &DiscriminatorParams,
        seed: u64,
    ) -> Result<Self, CriticError> {
        Self::from_host(gpu, params, CpuDiscriminator::new(params, seed)?)
    }

    /// A discriminator as [`Critic::save`] left it, here or on the CPU.
    ///
    /// # Errors
    /// [`CriticError`] for bytes that are none, or when the device cannot be used.
    pub fn load(
        gpu: &GpuDevice,
        bytes: &[u8],
        params: &DiscriminatorParams,
    ) -> Result<Self, CriticError> {
        Self::from_host(gpu, params, CpuDiscriminator::load(bytes, params)?)
    }

    fn from_host(
        gpu: &GpuDevice,
        params: &DiscriminatorParams,
        host: CpuDiscriminator,
    ) -> Result<Self, CriticError> {
        let device = register(gpu)?;
        let plain = host.plain();
        let layers = plain
            .layers
            .iter()
            .map(
                |&(
                    shape,
                    [
                        ref weight,
                        ref bias,
                        ref weight1,
                        ref weight2,
                        ref bias1,
                        ref bias2,
                    ],
                )| {
                    let sides = [shape.outputs, shape.inputs, KERNEL, KERNEL];
                    let weights = |values: &[f32]| {
                        let values = outputs_first(values, shape);
                        Tensor::<4>::from_data(TensorData::new(values, sides), &device)
                    };
                    let biases = |values: &[f32]| {
                        let data = TensorData::new(values.to_vec(), [shape.outputs]);
                        Tensor::<1>::from_data(data, &device)
                    };
                    Layer {
                        shape,
                        weight: Learnt {
                            value: weights(weight),
                            first: weights(weight1),
                            second: weights(weight2),
                        },
                        bias: Learnt {
                            value: biases(bias),
                            first: biases(bias1),
                            second: biases(bias2),
                        },
                    }
                },
            )
            .collect();
        let made = Self {
            params: *params,
            gpu: gpu.clone(),
            device,
            layers,
            num_steps: plain.num_steps,
            host,
        };
        made.check_device()?;
        Ok(made)
    }

    fn failed(&self, error: impl std::fmt::Display) -> CriticError {
        CriticError::Device(format!("{}: {error}", self.gpu.name()))
    }

    fn check_device(&self) -> Result<(), CriticError> {
        self.gpu
            .check()
            .map_err(|error| CriticError::Device(error.to_string()))
    }

    fn read<const D: usize>(&self, tensor: Tensor<D>) -> Result<Vec<f32>, CriticError> {
        let data = tensor.try_into_data().map_err(|error| self.failed(error))?;
        self.check_device()?;
        data.try_into_vec_as::<f32>()
            .map_err(|error| self.failed(error))
    }

    /// Patches of one size as a batch.
    fn upload(&self, patches: &[&PatchView<'_>]) -> Tensor<4> {
        let values: Vec<f32> = patches.iter().flat_map(|p| p.data).copied().collect();
        let size = patches.first().map_or([0, 0], |p| [p.height, p.width]);
        let sides = [patches.len(), NUM_CHANNELS, size[0], size[1]];
        Tensor::from_data(TensorData::new(values, sides), &self.device).autodiff()
    }

    /// Adds up the logits, weighed: its gradient is that of a loss whose gradient by the logits is
    /// known.
    fn weigh(&self, logits: &Tensor<4>, weights: Vec<f32>) -> Tensor<1> {
        let weights = TensorData::new(weights, logits.dims());
        let weights = Tensor::<4>::from_data(weights, &self.device).autodiff();
        (logits.clone() * weights).sum()
    }
}

/// The logits of a batch, `[patch][1][row][column]`, through `weights` and biases.
fn forward(
    input: Tensor<4>,
    layers: &[Layer],
    parameters: &[(Tensor<4>, Tensor<1>)],
    slope: f32,
) -> Tensor<4> {
    let mut map = input;
    for (index, (layer, (weight, bias))) in layers.iter().zip(parameters).enumerate() {
        let Shape {
            stride, padding, ..
        } = layer.shape;
        let options = ConvOptions::new([stride; 2], [padding; 2], [1; 2], 1);
        map = conv2d(map, weight.clone(), Some(bias.clone()), options);
        if index + 1 < layers.len() {
            map = leaky_relu(map, f64::from(slope));
        }
    }
    map
}

impl Critic for GpuDiscriminator {
    fn step(
        &mut self,
        real: PatchView<'_>,
        fake: PatchView<'_>,
        mask: &[f32],
        gate: Gate,
    ) -> Result<CriticLosses, CriticError> {
        self.host.check(&real, mask)?;
        self.host.check(&fake, mask)?;
        if (real.height, real.width) != (fake.height, fake.width) {
            return Err(CriticError::Length {
                what: "fake patch",
                actual: fake.data.len(),
                expected: real.data.len(),
            });
        }
        let counts = self.host.place_mask(&real, mask);
        let parameters: Vec<_> = self
            .layers
            .iter()
            .map(|layer| (tracked(&layer.weight.value), tracked(&layer.bias.value)))
            .collect();
        let input = self.upload(&[&real, &fake]);
        let slope = self.params.leaky_slope;
        let logits = forward(input, &self.layers, &parameters, slope);
        let on_host = self.read(logits.clone().without_autodiff())?;
        let (of_real, of_fake) = on_host.split_at(counts.len());
        let mut losses = CriticLosses {
            real: losses::mean_loss(of_real, &counts, Side::Real),
            fake: losses::mean_loss(of_fake, &counts, Side::Fake),
            texture: losses::mean_loss(of_fake, &counts, Side::Real),
            stepped: false,
        };
        losses.stepped = gate == Gate::Always || losses.real + losses.fake > losses.texture;

        let mut gradients = losses.stepped.then(|| {
            let total = losses::total(&counts);
            let mut weights = vec![0.0; on_host.len()];
            let (by_real, by_fake) = weights.split_at_mut(counts.len());
            losses::gradient(of_real, &counts, total, Side::Real, by_real);
            losses::gradient(of_fake, &counts, total, Side::Fake, by_fake);
            self.weigh(&logits, weights).backward()
        });
        self.num_steps += 1;
        let adam = AdamStep::new(&self.params, self.num_steps);
        for (layer, (weight, bias)) in self.layers.iter_mut().zip(&parameters) {
            let gradients = gradients.as_mut();
            let (by_weight, by_bias) = gradients
                .map(|all| (weight.grad_remove(all), bias.grad_remove(all)))
                .unwrap_or_default();
            layer.weight.step(&adam, by_weight);
            layer.bias.step(&adam, by_bias);
        }
        self.check_device()?;
        Ok(losses)
    }

    fn texture_gradient(
        &mut self,
        fake: PatchView<'_>,
        mask: &[f32],
        out: &mut [f32],
    ) -> Result<f32, CriticError> {
        self.host.check(&fake, mask)?;
        let num_pixels = fake.height * fake.width;
        if out.len() != 3 * num_pixels {
            return Err(CriticError::Length {
                what: "gradient",
                actual: out.len(),
                expected: 3 * num_pixels,
            });
        }
        let counts = self.host.place_mask(&fake, mask);
        let parameters: Vec<_> = self
            .layers
            .iter()
            .map(|layer| {
                let (weight, bias) = (layer.weight.value.clone(), layer.bias.value.clone());
                (weight.autodiff(), bias.autodiff())
            })
            .collect();
        let input = self.upload(&[&fake]).require_grad();
        let slope = self.params.leaky_slope;
        let logits = forward(input.clone(), &self.layers, &parameters, slope);
        let on_host = self.read(logits.clone().without_autodiff())?;
        let loss = losses::mean_loss(&on_host, &counts, Side::Real);
        let mut weights = vec![0.0; on_host.len()];
        let total = losses::total(&counts);
        losses::gradient(&on_host, &counts, total, Side::Real, &mut weights);
        let gradients = self.weigh(&logits, weights).backward();
        let by_input = input
            .grad(&gradients)
            .ok_or_else(|| self.failed("no gradient by the patch"))?;
        let by_rendering = by_input.slice([0..1, NUM_CHANNELS - 3..NUM_CHANNELS]);
        out.copy_from_slice(&self.read(by_rendering)?);
        Ok(loss)
    }

    fn save(&self) -> Result<Vec<u8>, CriticError> {
        let mut layers = Vec::with_capacity(self.layers.len());
        for Layer {
            shape,
            weight,
            bias,
        } in &self.layers
        {
            let weights = |tensor: &Tensor<4>| -> Result<Vec<f32>, CriticError> {
                Ok(outputs_last(&self.read(tensor.clone())?, *shape))
            };
            let numbers = [
                weights(&weight.value)?,
                self.read(bias.value.clone())?,
                weights(&weight.first)?,
                weights(&weight.second)?,
                self.read(bias.first.clone())?,
                self.read(bias.second.clone())?,
            ];
            layers.push((*shape, numbers));
        }
        let plain = Plain {
            num_steps: self.num_steps,
            layers,
        };
        Ok(plain.to_bytes())
    }
}

fn tracked<const D: usize>(value: &Tensor<D>) -> Tensor<D> {
    value.clone().autodiff().require_grad()
}

impl AdamStep {
    fn new(params: &DiscriminatorParams, number: u64) -> Self {
        let number = i32::try_from(number).unwrap_or(i32::MAX);
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let correction = |beta: f32| (1.0 - f64::from(beta).powi(number)) as f32;
        Self {
            learning_rate: params.learning_rate,
            betas: params.betas,
            corrections: params.betas.map(correction),
        }
    }
}

impl<const D: usize> Learnt<D> {
    /// Steps along a gradient; `None` stands for zeros.
    fn step(&mut self, adam: &AdamStep, gradient: Option<Tensor<D>>) {
        let [beta1, beta2] = adam.betas;
        let (mut first, mut second) = (
            self.first.clone().mul_scalar(beta1),
            self.second.clone().mul_scalar(beta2),
        );
        if let Some(gradient) = gradient {
            let gradient = gradient.without_autodiff();
            first = first + gradient.clone().mul_scalar(1.0 - beta1);
            second = second + (gradient.clone() * gradient).mul_scalar(1.0 - beta2);
        }
        let size = second
            .clone()
            .div_scalar(adam.corrections[1])
            .sqrt()
            .add_scalar(EPSILON);
        let along = first
            .clone()
            .mul_scalar(adam.learning_rate / adam.corrections[0])
            / size;
        self.value = self.value.clone() - along;
        self.first = first;
        self.second = second;
    }
}

/// From `[(row · 4 + column) · inputs + input][output]` to `[output][input][row][column]`.
fn outputs_first(values: &[f32], shape: Shape) -> Vec<f32> {
    let num_rows = shape.num_weights() / shape.outputs;
    let mut out = Vec::with_capacity(values.len());
    for output in 0..shape.outputs {
        for input in 0..shape.inputs {
            for tap in 0..num_rows / shape.inputs {
                out.push(values[(tap * shape.inputs + input) * shape.outputs + output]);
            }
        }
    }
    out
}

/// The inverse of [`outputs_first`].
fn outputs_last(values: &[f32], shape: Shape) -> Vec<f32> {
    let num_taps = shape.num_weights() / (shape.inputs * shape.outputs);
    let mut out = vec![0.0; values.len()];
    for (from, value) in values.iter().enumerate() {
        let (channels, tap) = (from / num_taps, from % num_taps);
        let (output, input) = (channels / shape.inputs, channels % shape.inputs);
        out[(tap * shape.inputs + input) * shape.outputs + output] = *value;
    }
    out
}

#[cfg(test)]
mod tests;
