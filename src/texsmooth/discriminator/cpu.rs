//! The discriminator on the CPU.

use super::adam::{AdamStep, Moments};
use super::conv::{Map, Shape, Weights};
use super::losses::{self, Side};
use super::mask::PlaceMask;
use super::{
    Critic, CriticError, CriticLosses, DiscriminatorParams, Gate, NUM_CHANNELS, PatchView,
};

/// Inputs, outputs and stride of each layer.
const LAYERS: [(usize, usize, usize); 5] = [
    (NUM_CHANNELS, 64, 2),
    (64, 128, 2),
    (128, 128, 2),
    (128, 128, 1),
    (128, 1, 1),
];
const NUM_LAYERS: usize = LAYERS.len();
const MAGIC: &[u8; 8] = b"veneerD1";

/// See [`super`].
#[derive(Clone, Debug)]
pub struct CpuDiscriminator {
    params: DiscriminatorParams,
    layers: Vec<Layer>,
    /// Steps of Adam so far.
    num_steps: u64,
    real: Activations,
    fake: Activations,
}

#[derive(Clone, Debug)]
struct Layer {
    shape: Shape,
    weights: Weights,
    weight_moments: Moments,
    bias_moments: Moments,
    /// Gradients of the real and of the fake patch.
    gradients: [Weights; 2],
}

/// Of one patch: its planes with channels last, then each layer's output after its activation.
#[derive(Clone, Debug, Default)]
struct Activations {
    maps: [Map; NUM_LAYERS + 1],
    gradients: [Map; NUM_LAYERS + 1],
}

fn shapes(params: &DiscriminatorParams) -> [Shape; NUM_LAYERS] {
    LAYERS.map(|(inputs, outputs, stride)| Shape {
        inputs,
        outputs,
        stride,
        padding: params.padding.num_px(),
    })
}

impl Layer {
    fn new(shape: Shape, weights: Weights) -> Self {
        Self {
            weight_moments: Moments::new(weights.weight.len()),
            bias_moments: Moments::new(weights.bias.len()),
            gradients: [weights.clone(), weights.clone()],
            shape,
            weights,
        }
    }
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
                let weight = (0..shape.num_weights() as u64)
                    .map(|at| params.weight_std * normal(seed, index as u64, at))
                    .collect();
                let bias = vec![0.0; shape.outputs];
                Layer::new(shape, Weights { weight, bias })
            })
            .collect();
        Ok(Self::from_layers(params, layers, 0))
    }

    fn from_layers(params: &DiscriminatorParams, layers: Vec<Layer>, num_steps: u64) -> Self {
        Self {
            params: *params,
            layers,
            num_steps,
            real: Activations::default(),
            fake: Activations::default(),
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
            .map(|shape| {
                let num = shape.num_weights();
                let weights = Weights {
                    weight: take(num),
                    bias: take(shape.outputs),
                };
                let mut layer = Layer::new(shape, weights);
                layer.weight_moments.first = take(num);
                layer.weight_moments.second = take(num);
                layer.bias_moments.first = take(shape.outputs);
                layer.bias_moments.second = take(shape.outputs);
                layer
            })
            .collect();
        Ok(Self::from_layers(params, layers, num_steps))
    }

    /// Steps of Adam so far.
    #[cfg(feature = "gpu")]
    pub(super) fn num_steps_mut(&mut self) -> &mut u64 {
        &mut self.num_steps
    }

    /// Layer by layer: weights and biases, both moments of the weights, both of the biases.
    #[cfg(feature = "gpu")]
    pub(super) fn numbers_mut(&mut self) -> impl Iterator<Item = (Shape, [&mut Vec<f32>; 6])> {
        self.layers.iter_mut().map(|layer| {
            let numbers = [
                &mut layer.weights.weight,
                &mut layer.weights.bias,
                &mut layer.weight_moments.first,
                &mut layer.weight_moments.second,
                &mut layer.bias_moments.first,
                &mut layer.bias_moments.second,
            ];
            (layer.shape, numbers)
        })
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
            for layer in &self.layers {
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
        for layer in &self.layers {
            places = places.through(&layer.shape, self.params.mask_threshold);
        }
        places.counts
    }
}

impl Activations {
    /// The logits of a patch.
    fn forward(&mut self, patch: &PatchView<'_>, layers: &[Layer], slope: f32) {
        to_channels_last(patch, &mut self.maps[0]);
        for (index, layer) in layers.iter().enumerate() {
            let (before, after) = self.maps.split_at_mut(index + 1);
            let out = &mut after[0];
            layer.shape.forward(&before[index], &layer.weights, out);
            if index + 1 < layers.len() {
                for value in &mut out.data {
                    *value *= if *value < 0.0 { slope } else { 1.0 };
                }
            }
        }
    }

    fn logits(&self) -> &[f32] {
        &self.maps[NUM_LAYERS].data
    }

    /// Puts a loss' gradient at the end.
    fn begin_backward(&mut self, counts: &[f32], side: Side) {
        let (logits, gradient) = (&self.maps[NUM_LAYERS], &mut self.gradients[NUM_LAYERS]);
        (gradient.height, gradient.width, gradient.channels) = (logits.height, logits.width, 1);
        losses::gradient(&logits.data, counts, side, &mut gradient.data);
    }

    /// The gradient by a layer's input, from that by its output; its activation's slope included.
    fn backward(&mut self, index: usize, layer: &Layer, slope: f32) {
        let input = &self.maps[index];
        let (before, after) = self.gradients.split_at_mut(index + 1);
        let out = &mut before[index];
        layer
            .shape
            .input_gradient(&after[0], &layer.weights, [input.height, input.width], out);
        if index > 0 {
            // The leaky ReLU keeps the sign.
            for (gradient, value) in out.data.iter_mut().zip(&input.data) {
                *gradient *= if *value < 0.0 { slope } else { 1.0 };
            }
        }
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
        let slope = self.params.leaky_slope;
        let layers = &self.layers;
        rayon::join(
            || self.real.forward(&real, layers, slope),
            || self.fake.forward(&fake, layers, slope),
        );
        let mut losses = CriticLosses {
            real: losses::mean_loss(self.real.logits(), &counts, Side::Real),
            fake: losses::mean_loss(self.fake.logits(), &counts, Side::Fake),
            texture: losses::mean_loss(self.fake.logits(), &counts, Side::Real),
            stepped: false,
        };
        losses.stepped = gate == Gate::Always || losses.real + losses.fake > losses.texture;

        self.num_steps += 1;
        let adam = AdamStep::new(self.params.learning_rate, self.params.betas, self.num_steps);
        if losses.stepped {
            self.real.begin_backward(&counts, Side::Real);
            self.fake.begin_backward(&counts, Side::Fake);
            for (index, layer) in self.layers.iter_mut().enumerate().rev() {
                let [of_real, of_fake] = &mut layer.gradients;
                let (real, fake, shape) = (&self.real, &self.fake, layer.shape);
                rayon::join(
                    || {
                        shape.weight_gradient(
                            &real.maps[index],
                            &real.gradients[index + 1],
                            of_real,
                        )
                    },
                    || {
                        shape.weight_gradient(
                            &fake.maps[index],
                            &fake.gradients[index + 1],
                            of_fake,
                        )
                    },
                );
                if index > 0 {
                    rayon::join(
                        || self.real.backward(index, layer, slope),
                        || self.fake.backward(index, layer, slope),
                    );
                }
            }
        }
        for layer in &mut self.layers {
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
        let slope = self.params.leaky_slope;
        self.fake.forward(&fake, &self.layers, slope);
        let loss = losses::mean_loss(self.fake.logits(), &counts, Side::Real);
        self.fake.begin_backward(&counts, Side::Real);
        for (index, layer) in self.layers.iter().enumerate().rev() {
            self.fake.backward(index, layer, slope);
        }
        let gradient = &self.fake.gradients[0];
        for (pixel, channels) in gradient.data.chunks(NUM_CHANNELS).enumerate() {
            for (channel, value) in channels[NUM_CHANNELS - 3..].iter().enumerate() {
                out[channel * num_pixels + pixel] = *value;
            }
        }
        Ok(loss)
    }

    fn save(&self) -> Result<Vec<u8>, CriticError> {
        let mut out = Vec::new();
        out.extend_from_slice(MAGIC);
        out.extend_from_slice(&self.num_steps.to_le_bytes());
        for layer in &self.layers {
            for numbers in [
                &layer.weights.weight,
                &layer.weights.bias,
                &layer.weight_moments.first,
                &layer.weight_moments.second,
                &layer.bias_moments.first,
                &layer.bias_moments.second,
            ] {
                out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
            }
        }
        Ok(out)
    }
}

impl Layer {
    fn step(&mut self, adam: &AdamStep, has_gradient: bool) {
        let [real, fake] = &mut self.gradients;
        if has_gradient {
            let pairs = [
                (&mut real.weight, &fake.weight),
                (&mut real.bias, &fake.bias),
            ];
            for (sum, other) in pairs {
                sum.iter_mut()
                    .zip(other)
                    .for_each(|(sum, value)| *sum += value);
            }
        }
        let given = |gradient| has_gradient.then_some(gradient);
        adam.apply(
            &mut self.weights.weight,
            &mut self.weight_moments,
            given(real.weight.as_slice()),
        );
        adam.apply(
            &mut self.weights.bias,
            &mut self.bias_moments,
            given(real.bias.as_slice()),
        );
    }
}

fn to_channels_last(patch: &PatchView<'_>, out: &mut Map) {
    let num_pixels = patch.height * patch.width;
    (out.height, out.width, out.channels) = (patch.height, patch.width, NUM_CHANNELS);
    out.data.resize(num_pixels * NUM_CHANNELS, 0.0);
    for (channel, plane) in patch.data.chunks(num_pixels.max(1)).enumerate() {
        for (pixel, value) in out.data.chunks_mut(NUM_CHANNELS).zip(plane) {
            pixel[channel] = *value;
        }
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
    /// Weights and biases, layer by layer.
    pub(super) fn weights(&mut self) -> Vec<&mut Weights> {
        self.layers
            .iter_mut()
            .map(|layer| &mut layer.weights)
            .collect()
    }

    /// The gradients of the last step that had some.
    pub(super) fn gradients(&self) -> Vec<&Weights> {
        self.layers
            .iter()
            .map(|layer| &layer.gradients[0])
            .collect()
    }
}
