//! The layers against their definition in f64, and that against finite differences.

use super::layer::Weights;
use super::*;

fn random(index: u64) -> f64 {
    let mut z = index.wrapping_add(7).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (z >> 11) as f64 / (1u64 << 53) as f64
}

fn patch(seed: u64, height: usize, width: usize) -> Vec<f32> {
    (0..6 * height * width)
        .map(|i| (2.0 * random(seed * 1_000_003 + i as u64) - 1.0) as f32)
        .collect()
}

fn view(data: &[f32], height: usize, width: usize) -> PatchView<'_> {
    PatchView {
        data,
        height,
        width,
    }
}

const CHANNELS: [usize; 6] = [6, 64, 128, 128, 128, 1];
const STRIDES: [usize; 5] = [2, 2, 2, 1, 1];

/// The network as it is defined, number by number in f64: logits and their size.
fn logits(
    patch: &[f64],
    [height, width]: [usize; 2],
    weights: &[(Vec<f64>, Vec<f64>)],
    padding: usize,
) -> (Vec<f64>, [usize; 2]) {
    let (mut map, mut size) = (patch.to_vec(), [height, width]);
    for (index, (weight, bias)) in weights.iter().enumerate() {
        let (inputs, outputs, stride) = (CHANNELS[index], CHANNELS[index + 1], STRIDES[index]);
        let out_size = size.map(|side| (side + 2 * padding - 4) / stride + 1);
        let mut out = vec![0.0; outputs * out_size[0] * out_size[1]];
        for y in 0..out_size[0] {
            for x in 0..out_size[1] {
                let mut sums = bias.clone();
                for tap in 0..16 {
                    let at_y = (y * stride + tap / 4) as i64 - padding as i64;
                    let at_x = (x * stride + tap % 4) as i64 - padding as i64;
                    let is_inside =
                        at_y >= 0 && at_x >= 0 && at_y < size[0] as i64 && at_x < size[1] as i64;
                    if !is_inside {
                        continue;
                    }
                    let at = at_y as usize * size[1] + at_x as usize;
                    for input in 0..inputs {
                        let value = map[input * size[0] * size[1] + at];
                        let row = (tap * inputs + input) * outputs;
                        for (sum, weight) in sums.iter_mut().zip(&weight[row..row + outputs]) {
                            *sum += value * weight;
                        }
                    }
                }
                for (output, sum) in sums.into_iter().enumerate() {
                    let is_last = index == 4;
                    let value = if sum < 0.0 && !is_last {
                        0.2 * sum
                    } else {
                        sum
                    };
                    out[(output * out_size[0] + y) * out_size[1] + x] = value;
                }
            }
        }
        (map, size) = (out, out_size);
    }
    (map, size)
}

/// Which logits count, as the text says it.
fn counted(mask: &[f32], [height, width]: [usize; 2], padding: usize) -> Vec<bool> {
    let mut counts: Vec<f32> = mask.to_vec();
    let mut size = [height, width];
    for stride in STRIDES {
        let out = size.map(|side| (side + 2 * padding - 4) / stride + 1);
        let mut next = Vec::new();
        for place in 0..out[0] * out[1] {
            let mut sum = 0.0;
            for tap in 0..16 {
                let y = (place / out[1] * stride + tap / 4) as i64 - padding as i64;
                let x = (place % out[1] * stride + tap % 4) as i64 - padding as i64;
                if (0..size[0] as i64).contains(&y) && (0..size[1] as i64).contains(&x) {
                    sum += counts[y as usize * size[1] + x as usize];
                }
            }
            next.push(if sum / 16.0 > 0.1 { 1.0 } else { 0.0 });
        }
        (counts, size) = (next, out);
    }
    counts.into_iter().map(|count| count > 0.0).collect()
}

struct Case {
    size: [usize; 2],
    padding: Padding,
    real: Vec<f32>,
    fake: Vec<f32>,
    mask: Vec<f32>,
}

impl Case {
    fn new(size: [usize; 2], padding: Padding) -> Self {
        let [height, width] = size;
        let mask = (0..height * width)
            .map(|i| f32::from(u8::from(i % width < 3 * width / 4)))
            .collect();
        Self {
            size,
            padding,
            real: patch(1, height, width),
            fake: patch(2, height, width),
            mask,
        }
    }

    fn params(&self) -> DiscriminatorParams {
        DiscriminatorParams {
            padding: self.padding,
            // Larger than usual, so that all layers matter.
            weight_std: 0.05,
            ..DiscriminatorParams::default()
        }
    }

    fn discriminator(&self) -> CpuDiscriminator {
        let mut made = CpuDiscriminator::new(&self.params(), 5).unwrap();
        for (layer, weights) in made.weights().into_iter().enumerate() {
            let bias = |i| (0.2 * random(layer as u64 * 999 + i as u64) - 0.1) as f32;
            made.set_biases(layer, (0..weights.bias.len()).map(bias).collect());
        }
        made
    }

    /// −log D(real), −log(1 − D(fake)), −log D(fake).
    fn losses(&self, real: &[f64], fake: &[f64], weights: &[(Vec<f64>, Vec<f64>)]) -> [f64; 3] {
        let padding = self.padding.num_px();
        let counts = counted(&self.mask, self.size, padding);
        let mean = |patch: &[f64], sign: f64| {
            let (logits, _) = logits(patch, self.size, weights, padding);
            assert_eq!(logits.len(), counts.len());
            let chosen = logits.iter().zip(&counts).filter(|(_, counts)| **counts);
            let terms: Vec<f64> = chosen.map(|(z, _)| (1.0 + (sign * z).exp()).ln()).collect();
            terms.iter().sum::<f64>() / terms.len() as f64
        };
        [mean(real, -1.0), mean(fake, 1.0), mean(fake, -1.0)]
    }
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

fn wide_weights(made: &CpuDiscriminator) -> Vec<(Vec<f64>, Vec<f64>)> {
    let weights = made.weights();
    weights
        .into_iter()
        .map(|w: Weights| (wide(&w.weight), wide(&w.bias)))
        .collect()
}

fn cases() -> [Case; 2] {
    [
        Case::new([32, 41], Padding::One),
        Case::new([70, 73], Padding::Valid),
    ]
}

#[test]
fn losses_are_those_of_the_definition() {
    for case in cases() {
        let mut made = case.discriminator();
        let weights = wide_weights(&made);
        let expected = case.losses(&wide(&case.real), &wide(&case.fake), &weights);
        let [height, width] = case.size;
        let found = made
            .step(
                view(&case.real, height, width),
                view(&case.fake, height, width),
                &case.mask,
                Gate::Always,
            )
            .unwrap();
        for (found, expected) in [found.real, found.fake, found.texture].iter().zip(expected) {
            let error = (f64::from(*found) - expected).abs();
            assert!(error < 1e-5, "{found} for {expected}");
        }
    }
}

#[test]
fn gradients_of_every_layer_are_the_finite_differences() {
    for case in cases() {
        let [height, width] = case.size;
        let mut made = case.discriminator();
        let weights = wide_weights(&made);
        let (real, fake) = (wide(&case.real), wide(&case.fake));
        made.step(
            view(&case.real, height, width),
            view(&case.fake, height, width),
            &case.mask,
            Gate::Always,
        )
        .unwrap();
        let gradients: Vec<(Vec<f64>, Vec<f64>)> = made
            .gradients()
            .into_iter()
            .map(|g| (wide(&g.weight), wide(&g.bias)))
            .collect();
        // Small, so that hardly any ReLU changes its side.
        let h = 1e-6;
        for layer in 0..5 {
            let largest = |values: &[f64]| values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let scale = [largest(&gradients[layer].0), largest(&gradients[layer].1)];
            assert!(scale[0] > 0.0 && scale[1] > 0.0);
            for trial in 0..4 {
                let is_bias = trial == 3;
                let pick = |num: usize| (random(layer as u64 * 31 + trial) * num as f64) as usize;
                let at = pick(if is_bias {
                    weights[layer].1.len()
                } else {
                    weights[layer].0.len()
                });
                let loss = |delta: f64| {
                    let mut moved = weights.clone();
                    let values = if is_bias {
                        &mut moved[layer].1
                    } else {
                        &mut moved[layer].0
                    };
                    values[at] += delta;
                    let [real, fake, _] = case.losses(&real, &fake, &moved);
                    real + fake
                };
                let difference = (loss(h) - loss(-h)) / (2.0 * h);
                let found = if is_bias {
                    gradients[layer].1[at]
                } else {
                    gradients[layer].0[at]
                };
                let error = (found - difference).abs() / scale[usize::from(is_bias)];
                assert!(error < 1e-5, "layer {layer}: {found} for {difference}");
            }
        }
    }
}

#[test]
fn the_texture_s_gradient_is_the_finite_difference() {
    for case in cases() {
        let [height, width] = case.size;
        let num = height * width;
        let mut made = case.discriminator();
        let weights = wide_weights(&made);
        let (real, fake) = (wide(&case.real), wide(&case.fake));
        let mut gradient = vec![9.0f32; 3 * num];
        let loss = made
            .texture_gradient(view(&case.fake, height, width), &case.mask, &mut gradient)
            .unwrap();
        let [_, _, expected] = case.losses(&real, &fake, &weights);
        assert!((f64::from(loss) - expected).abs() < 1e-5);
        let scale = gradient.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        for trial in 0..12 {
            let at = (random(1234 + trial) * (3 * num) as f64) as usize;
            let loss = |delta: f64| {
                let mut moved = fake.clone();
                moved[3 * num + at] += delta;
                case.losses(&real, &moved, &weights)[2]
            };
            let difference = (loss(1e-6) - loss(-1e-6)) / 2e-6;
            let error = (f64::from(gradient[at]) - difference).abs() / f64::from(scale);
            assert!(error < 1e-5, "{} for {difference}", gradient[at]);
        }
    }
}

/// Runs some steps; the bytes of the discriminator and a gradient after them.
fn run(
    made: &mut CpuDiscriminator,
    steps: std::ops::Range<u64>,
    gate: Gate,
) -> (Vec<u8>, Vec<f32>) {
    let (height, width) = (80, 90);
    let mask = vec![1.0; height * width];
    let mut out = vec![0.0; 3 * height * width];
    for step in steps {
        let (real, fake) = (
            patch(2 * step, height, width),
            patch(2 * step + 1, height, width),
        );
        made.step(
            view(&real, height, width),
            view(&fake, height, width),
            &mask,
            gate,
        )
        .unwrap();
        made.texture_gradient(view(&fake, height, width), &mask, &mut out)
            .unwrap();
    }
    (made.save().unwrap(), out)
}

#[test]
fn what_an_earlier_patch_left_behind_does_not_matter() {
    for case in cases() {
        let [height, width] = case.size;
        let judge = |made: &mut CpuDiscriminator| {
            let mut out = vec![0.0; 3 * height * width];
            let (real, fake) = (
                view(&case.real, height, width),
                view(&case.fake, height, width),
            );
            let losses = made.step(real, fake, &case.mask, Gate::Always).unwrap();
            made.texture_gradient(fake, &case.mask, &mut out).unwrap();
            (losses, made.save().unwrap(), out)
        };
        let expected = judge(&mut case.discriminator());
        let mut used = case.discriminator();
        // One that is larger and of other proportions, full of what must not come back.
        let (large, mask) = (patch(9, 83, 120), vec![1.0; 83 * 120]);
        let mut out = vec![0.0; 3 * 83 * 120];
        used.texture_gradient(view(&large, 83, 120), &mask, &mut out)
            .unwrap();
        let strange = vec![f32::NAN; 6 * 83 * 120];
        used.texture_gradient(view(&strange, 83, 120), &mask, &mut out)
            .unwrap();
        assert!(judge(&mut used) == expected);
    }
}

#[test]
fn any_thread_count_gives_the_same_bits() {
    let with = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut made = CpuDiscriminator::new(&DiscriminatorParams::default(), 3).unwrap();
            run(&mut made, 0..2, Gate::Always)
        })
    };
    let one = with(1);
    assert!(one == with(2) && one == with(4));
}

#[test]
fn a_saved_one_goes_on_as_if_it_had_not_been() {
    let params = DiscriminatorParams::default();
    let mut whole = CpuDiscriminator::new(&params, 3).unwrap();
    let expected = run(&mut whole, 0..4, Gate::WhenBehind);
    let mut first = CpuDiscriminator::new(&params, 3).unwrap();
    let (bytes, _) = run(&mut first, 0..2, Gate::WhenBehind);
    let mut second = CpuDiscriminator::load(&bytes, &params).unwrap();
    assert!(run(&mut second, 2..4, Gate::WhenBehind) == expected);
    for cut in [0, 7, 12, 100, bytes.len() - 1] {
        assert!(CpuDiscriminator::load(&bytes[..cut], &params).is_err());
    }
}

#[test]
fn it_learns_what_is_real_and_then_waits() {
    let (height, width) = (80, 80);
    let params = DiscriminatorParams {
        learning_rate: 1e-3,
        ..DiscriminatorParams::default()
    };
    let mut made = CpuDiscriminator::new(&params, 1).unwrap();
    let real = vec![0.5f32; 6 * height * width];
    let fake = vec![-0.5f32; 6 * height * width];
    let mask = vec![1.0; height * width];
    let mut losses = Vec::new();
    for _ in 0..25 {
        let found = made
            .step(
                view(&real, height, width),
                view(&fake, height, width),
                &mask,
                Gate::WhenBehind,
            )
            .unwrap();
        losses.push(found);
    }
    let first = losses[0];
    assert!((first.real - 2f32.ln()).abs() < 0.1 && first.stepped);
    let last = losses[24];
    assert!(last.real + last.fake < 0.3, "{last:?}");
    assert!(!last.stepped, "{last:?}");
}

#[test]
fn nothing_to_count_gives_nothing_and_bad_sizes_are_refused() {
    let (height, width) = (80, 80);
    let mut made = CpuDiscriminator::new(&DiscriminatorParams::default(), 1).unwrap();
    let data = patch(1, height, width);
    let mut out = vec![1.0; 3 * height * width];
    let none = vec![0.0; height * width];
    let given = view(&data, height, width);
    let losses = made.step(given, given, &none, Gate::Always).unwrap();
    assert_eq!((losses.real, losses.fake), (0.0, 0.0));
    assert_eq!(made.texture_gradient(given, &none, &mut out), Ok(0.0));
    assert!(out.iter().all(|value| *value == 0.0));

    let small = patch(1, 69, 80);
    let error = made.step(
        view(&small, 69, 80),
        view(&small, 69, 80),
        &none[..69 * 80],
        Gate::Always,
    );
    let expected = CriticError::TooSmall {
        width: 80,
        height: 69,
        min: 70,
    };
    assert_eq!(error, Err(expected));
    assert!(made.step(given, given, &none[1..], Gate::Always).is_err());
    assert!(made.texture_gradient(given, &none, &mut out[1..]).is_err());
    assert!(
        made.step(view(&data, 70, 80), given, &none, Gate::Always)
            .is_err()
    );
}
