//! The discriminator on the CPU.

use super::adam::AdamStep;
use super::layer::{Kernels, Shape, Weights};
use super::losses::{self, Side};
use super::mask::PlaceMask;
use super::network::{Layer, NUM_LAYERS, Network, Workspace};
use super::{
    Critic, CriticError, CriticLosses, DiscriminatorParams, Gate, NUM_CHANNELS, PatchView,
};

/// Inputs, outputs and stride of each layer.
const LAYERS: [(usize, usize, usize); NUM_LAYERS] = [
    (NUM_CHANNELS, 64, 2),
    (64, 128, 2),
    (128, 128, 2),
    (128, 128, 1),
    (128, 1, 1),
];
/// The planes before are the photo's, and nothing is asked of them.
const FIRST_KEPT: usize = NUM_CHANNELS - 3;
const MAGIC: &[u8; 8] = b"veneerD1";

/// See [`super`].
#[derive(Clone, Debug)]
pub struct CpuDiscriminator {
    params: DiscriminatorParams,
    network: Network,
    /// Steps of Adam so far.
    num_steps: u64,
    workspace: Workspace,
}

fn shapes(params: &DiscriminatorParams) -> [Shape; NUM_LAYERS] {
    LAYERS.map(|(inputs, outputs, stride)| Shape {
        inputs,
        outputs,
        stride,
        padding: params.padding.num_px(),
    })
}

fn make_layer(index: usize, shape: Shape, weights: Weights) -> Layer {
    let first_kept = if index == 0 { FIRST_KEPT } else { 0 };
    Layer::new(shape, weights, Kernels::new(shape, first_kept))
}

impl CpuDiscriminator {
    /// A discriminator that has learnt nothing; the seed decides its weights.
    ///
    /// # Errors
    /// None today; kept for discriminators that need a device.
    pub fn new(params: &DiscriminatorParams, seed: u64) -> Result<Self, CriticError> {
        let layers = shapes(params)
            .into_iter()
            .enumerate()
            .map(|(index, shape)| {
                let plain: Vec<f32> = (0..shape.num_weights() as u64)
                    .map(|at| params.weight_std * normal(seed, index as u64, at))
                    .collect();
                let weights = Weights {
                    weight: shape.to_cells(&plain),
                    bias: vec![0.0; shape.outputs],
                };
                make_layer(index, shape, weights)
            })
            .collect();
        Ok(Self::from_layers(params, layers, 0))
    }

    fn from_layers(params: &DiscriminatorParams, layers: Vec<Layer>, num_steps: u64) -> Self {
        Self {
            params: *params,
            network: Network {
                layers,
                slope: params.leaky_slope,
            },
            num_steps,
            workspace: Workspace::default(),
        }
    }

    /// A discriminator as [`Critic::save`] left it.
    ///
    /// # Errors
    /// [`CriticError::Saved`] for bytes that are none, or of another size.
    pub fn load(bytes: &[u8], params: &DiscriminatorParams) -> Result<Self, CriticError> {
        let rest = bytes
            .strip_prefix(MAGIC)
            .ok_or(CriticError::Saved("not a discriminator's bytes"))?;
        let (head, rest) = rest
            .split_first_chunk::<8>()
            .ok_or(CriticError::Saved("cut short"))?;
        let num_steps = u64::from_le_bytes(*head);
        let (shapes, mut numbers) = (shapes(params), rest.chunks_exact(4));
        let expected: usize = shapes
            .iter()
            .map(|shape| 3 * (shape.num_weights() + shape.outputs))
            .sum();
        if rest.len() != 4 * expected {
            return Err(CriticError::Saved("of another size"));
        }
        let mut take = |num: usize| -> Vec<f32> {
            let bytes = numbers.by_ref().take(num);
            bytes
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect()
        };
        let layers = shapes
            .into_iter()
            .enumerate()
            .map(|(index, shape)| {
                let num = shape.num_weights();
                let weights = Weights {
                    weight: shape.to_cells(&take(num)),
                    bias: take(shape.outputs),
                };
                let mut layer = make_layer(index, shape, weights);
                layer.weight_moments.first = shape.to_cells(&take(num));
                layer.weight_moments.second = shape.to_cells(&take(num));
                layer.bias_moments.first = take(shape.outputs);
                layer.bias_moments.second = take(shape.outputs);
                layer
            })
            .collect();
        Ok(Self::from_layers(params, layers, num_steps))
    }

    /// What [`Critic::save`] writes: steps of Adam so far, and layer by layer weights and biases, both
    /// moments of the weights, both of the biases. Weights are `[(ky · 4 + kx) · inputs +
    /// input][output]`.
    pub(super) fn plain(&self) -> Plain {
        let layers = self.network.layers.iter().map(|layer| {
            let numbers = [
                layer.shape.to_plain(&layer.weights().weight),
                layer.weights().bias.clone(),
                layer.shape.to_plain(&layer.weight_moments.first),
                layer.shape.to_plain(&layer.weight_moments.second),
                layer.bias_moments.first.clone(),
                layer.bias_moments.second.clone(),
            ];
            (layer.shape, numbers)
        });
        Plain {
            num_steps: self.num_steps,
            layers: layers.collect(),
        }
    }

    pub(super) fn check(&self, patch: &PatchView<'_>, mask: &[f32]) -> Result<(), CriticError> {
        let num_pixels = patch.height * patch.width;
        let length = |what, actual, expected| {
            if actual == expected {
                Ok(())
            } else {
                Err(CriticError::Length {
                    what,
                    actual,
                    expected,
                })
            }
        };
        length("patch", patch.data.len(), NUM_CHANNELS * num_pixels)?;
        length("mask", mask.len(), num_pixels)?;
        let fits = |side: usize| {
            let mut side = Some(side);
            for layer in &self.network.layers {
                side = side.and_then(|side| layer.shape.output_side(side));
            }
            side.is_some_and(|side| side > 0)
        };
        if fits(patch.height) && fits(patch.width) {
            return Ok(());
        }
        Err(CriticError::TooSmall {
            width: patch.width,
            height: patch.height,
            min: (1..).find(|&side| fits(side)).unwrap_or(usize::MAX),
        })
    }

    pub(super) fn place_mask(&self, patch: &PatchView<'_>, mask: &[f32]) -> Vec<f32> {
        let mut places = PlaceMask {
            height: patch.height,
            width: patch.width,
            counts: mask.to_vec(),
        };
        for layer in &self.network.layers {
            places = places.through(&layer.shape, self.params.mask_threshold);
        }
        places.counts
    }
}

impl Critic for CpuDiscriminator {
    fn step(
        &mut self,
        real: PatchView<'_>,
        fake: PatchView<'_>,
        mask: &[f32],
        gate: Gate,
    ) -> Result<CriticLosses, CriticError> {
        self.check(&real, mask)?;
        self.check(&fake, mask)?;
        if (real.height, real.width) != (fake.height, fake.width) {
            return Err(CriticError::Length {
                what: "fake patch",
                actual: fake.data.len(),
                expected: real.data.len(),
            });
        }
        let counts = self.place_mask(&real, mask);
        let (network, workspace) = (&mut self.network, &mut self.workspace);
        network.forward(&[real, fake], workspace);
        let mut losses = CriticLosses {
            real: losses::mean_loss(workspace.logits(0), &counts, Side::Real),
            fake: losses::mean_loss(workspace.logits(1), &counts, Side::Fake),
            texture: losses::mean_loss(workspace.logits(1), &counts, Side::Real),
            stepped: false,
        };
        losses.stepped = gate == Gate::Always || losses.real + losses.fake > losses.texture;

        self.num_steps += 1;
        let adam = AdamStep::new(self.params.learning_rate, self.params.betas, self.num_steps);
        if losses.stepped {
            network.begin_backward(workspace, &counts, &[Side::Real, Side::Fake]);
            network.weight_gradients(workspace);
        }
        for layer in &mut network.layers {
            layer.step(&adam, losses.stepped);
        }
        Ok(losses)
    }

    fn texture_gradient(
        &mut self,
        fake: PatchView<'_>,
        mask: &[f32],
        out: &mut [f32],
    ) -> Result<f32, CriticError> {
        self.check(&fake, mask)?;
        let num_pixels = fake.height * fake.width;
        if out.len() != 3 * num_pixels {
            return Err(CriticError::Length {
                what: "gradient",
                actual: out.len(),
                expected: 3 * num_pixels,
            });
        }
        let counts = self.place_mask(&fake, mask);
        let (network, workspace) = (&mut self.network, &mut self.workspace);
        network.forward(&[fake], workspace);
        let loss = losses::mean_loss(workspace.logits(0), &counts, Side::Real);
        network.begin_backward(workspace, &counts, &[Side::Real]);
        network.patch_gradient(workspace, [fake.height, fake.width], out);
        Ok(loss)
    }

    fn save(&self) -> Result<Vec<u8>, CriticError> {
        Ok(self.plain().to_bytes())
    }
}

/// See [`CpuDiscriminator::plain`].
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plain {
    pub(super) num_steps: u64,
    pub(super) layers: Vec<(Shape, [Vec<f32>; 6])>,
}

impl Plain {
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        out.extend_from_slice(MAGIC);
        out.extend_from_slice(&self.num_steps.to_le_bytes());
        let numbers = self
            .layers
            .iter()
            .flat_map(|(_, numbers)| numbers)
            .flatten();
        out.extend(numbers.flat_map(|number| number.to_le_bytes()));
        out
    }
}

/// Normal with mean 0 and deviation 1, by Box and Muller from two numbers of SplitMix64.
fn normal(seed: u64, layer: u64, at: u64) -> f32 {
    let uniform = |index: u64| {
        let mut z = mix(seed ^ mix(layer ^ mix(index))) >> 11;
        z += 1;
        z as f64 / ((1u64 << 53) + 1) as f64
    };
    let radius = (-2.0 * uniform(2 * at).ln()).sqrt();
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let value = (radius * (std::f64::consts::TAU * uniform(2 * at + 1)).cos()) as f32;
    value
}

fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
impl CpuDiscriminator {
    /// Weights `[(ky · 4 + kx) · inputs + input][output]` and biases, layer by layer.
    pub(super) fn weights(&self) -> Vec<Weights> {
        let layers = self.network.layers.iter();
        layers
            .map(|layer| plain(layer.shape, layer.weights()))
            .collect()
    }

    pub(super) fn set_biases(&mut self, layer: usize, biases: Vec<f32>) {
        self.network.layers[layer].set_bias(biases);
    }

    /// The gradients of the last step that had some, in the order of [`Self::weights`].
    pub(super) fn gradients(&self) -> Vec<Weights> {
        let layers = self.network.layers.iter();
        layers
            .map(|layer| plain(layer.shape, &layer.gradients))
            .collect()
    }
}

#[cfg(test)]
fn plain(shape: Shape, weights: &Weights) -> Weights {
    Weights {
        weight: shape.to_plain(&weights.weight),
        bias: weights.bias.clone(),
    }
}
