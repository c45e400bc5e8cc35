//! The device's numbers against the CPU's, from the same weights.

use super::*;
use crate::render::gpu::tests::device;

fn random(index: usize) -> f32 {
    let mut z = (index as u64 + 7).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (z >> 40) as f32 / (1u64 << 24) as f32
}

struct Case {
    height: usize,
    width: usize,
    params: DiscriminatorParams,
    real: Vec<f32>,
    fake: Vec<f32>,
    mask: Vec<f32>,
}

impl Case {
    fn new([height, width]: [usize; 2], padding: super::super::Padding, weight_std: f32) -> Self {
        let patch = |seed: usize| {
            (0..NUM_CHANNELS * height * width)
                .map(|i| 2.0 * random(seed * 1_000_003 + i) - 1.0)
                .collect()
        };
        Self {
            height,
            width,
            params: DiscriminatorParams {
                padding,
                weight_std,
                ..DiscriminatorParams::default()
            },
            real: patch(1),
            fake: patch(2),
            mask: (0..height * width)
                .map(|i| f32::from(u8::from(i % width < 3 * width / 4)))
                .collect(),
        }
    }

    fn view<'a>(&self, data: &'a [f32]) -> PatchView<'a> {
        PatchView {
            data,
            height: self.height,
            width: self.width,
        }
    }

    /// The same discriminator on the CPU and on the device.
    fn pair(&self, gpu: &GpuDevice) -> (CpuDiscriminator, GpuDiscriminator) {
        let mut plain = CpuDiscriminator::new(&self.params, 5).unwrap().plain();
        for (layer, (_, [_, bias, ..])) in plain.layers.iter_mut().enumerate() {
            for (i, bias) in bias.iter_mut().enumerate() {
                *bias = 0.2 * random(layer * 999 + i) - 0.1;
            }
        }
        let bytes = plain.to_bytes();
        let cpu = CpuDiscriminator::load(&bytes, &self.params).unwrap();
        let on_device = GpuDiscriminator::load(gpu, &bytes, &self.params).unwrap();
        assert!(
            bytes == on_device.save().unwrap(),
            "what is loaded is saved"
        );
        (cpu, on_device)
    }

    fn step(&self, critic: &mut dyn Critic, gate: Gate) -> CriticLosses {
        let (real, fake) = (self.view(&self.real), self.view(&self.fake));
        critic.step(real, fake, &self.mask, gate).unwrap()
    }

    fn texture_gradient(&self, critic: &mut dyn Critic) -> (f32, Vec<f32>) {
        let mut out = vec![f32::NAN; 3 * self.height * self.width];
        let fake = self.view(&self.fake);
        let loss = critic.texture_gradient(fake, &self.mask, &mut out).unwrap();
        (loss, out)
    }
}

fn cases() -> [Case; 2] {
    use super::super::Padding;
    [
        Case::new([32, 41], Padding::One, 0.05),
        Case::new([70, 73], Padding::Valid, 0.05),
    ]
}

/// The largest difference, in units of the largest number.
fn difference(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(0.0f32, |scale, v| scale.max(v.abs()));
    assert!(scale > 0.0 && found.iter().all(|v| v.is_finite()));
    let largest = found
        .iter()
        .zip(expected)
        .fold(0.0f32, |largest, (a, b)| largest.max((a - b).abs()));
    largest / scale
}

fn assert_losses_agree(found: CriticLosses, expected: CriticLosses, tolerance: f32) {
    for (found, expected) in [
        (found.real, expected.real),
        (found.fake, expected.fake),
        (found.texture, expected.texture),
    ] {
        let error = (found - expected).abs() / expected.max(1e-3);
        assert!(error < tolerance, "{found} for {expected}");
    }
    assert_eq!(found.stepped, expected.stepped);
}

/// A device's discriminator as the CPU's.
fn fetched(on_device: &GpuDiscriminator) -> CpuDiscriminator {
    CpuDiscriminator::load(&on_device.save().unwrap(), &on_device.params).unwrap()
}

/// Names of the numbers of [`CpuDiscriminator::plain`].
const NUMBERS: [&str; 6] = ["weight", "bias", "weight 1", "weight 2", "bias 1", "bias 2"];

/// After one step from moments of zero, the first moments are the gradients, up to a factor.
#[test]
fn losses_and_gradients_of_every_layer_are_the_cpus() {
    let Some(gpu) = device() else { return };
    for case in cases() {
        let (mut cpu, mut on_device) = case.pair(&gpu);
        let expected = case.step(&mut cpu, Gate::Always);
        assert_losses_agree(case.step(&mut on_device, Gate::Always), expected, 1e-5);
        let (cpu, found) = (cpu.plain(), fetched(&on_device).plain());
        for (layer, (cpu, found)) in cpu.layers.iter().zip(&found.layers).enumerate() {
            for (at, name) in NUMBERS.iter().enumerate().skip(2) {
                let error = difference(&found.1[at], &cpu.1[at]);
                assert!(error < 1e-5, "layer {layer}, {name}: {error}");
            }
            // Adam's first step is the gradient's sign, near enough, times the learning rate.
            let rate = case.params.learning_rate;
            for (at, moment) in [(0, 2), (1, 4)] {
                let largest = cpu.1[moment].iter().fold(0.0f32, |m, g| m.max(g.abs()));
                let values = found.1[at].iter().zip(cpu.1[at].iter());
                for ((found, expected), g) in values.zip(cpu.1[moment].iter()) {
                    let error = (found - expected).abs();
                    assert!(error < 2.1 * rate);
                    assert!(g.abs() < 0.01 * largest || error < 0.01 * rate, "{error}");
                }
            }
        }
    }
}

#[test]
fn gradients_by_the_rendering_are_the_cpus() {
    let Some(gpu) = device() else { return };
    for case in cases() {
        let (mut cpu, mut on_device) = case.pair(&gpu);
        let (expected_loss, expected) = case.texture_gradient(&mut cpu);
        let (loss, gradient) = case.texture_gradient(&mut on_device);
        assert!((loss - expected_loss).abs() < 1e-5 * expected_loss);
        let error = difference(&gradient, &expected);
        assert!(error < 1e-5, "{error}");
    }
}

#[test]
fn where_the_discriminator_is_ahead_it_goes_on_by_momentum() {
    let Some(gpu) = device() else { return };
    let mut case = Case::new([32, 41], super::super::Padding::One, 0.1);
    let is_ahead = |case: &Case| {
        let (mut cpu, _) = case.pair(&gpu);
        !case.step(&mut cpu, Gate::WhenBehind).stepped
    };
    if !is_ahead(&case) {
        std::mem::swap(&mut case.real, &mut case.fake);
    }
    assert!(is_ahead(&case), "of a pair one order has it ahead");
    let (mut cpu, mut on_device) = case.pair(&gpu);
    for gate in [Gate::Always, Gate::WhenBehind] {
        let expected = case.step(&mut cpu, gate);
        assert_eq!(expected.stepped, gate == Gate::Always);
        // Weights five times the usual ones: logits are sums of large numbers that nearly cancel.
        assert_losses_agree(case.step(&mut on_device, gate), expected, 1e-4);
    }
    let (cpu, found) = (cpu.plain(), fetched(&on_device).plain());
    assert_eq!(found.num_steps, 2);
    for (cpu, found) in cpu.layers.iter().zip(&found.layers) {
        for (at, name) in NUMBERS.iter().enumerate().skip(2) {
            let error = difference(&found.1[at], &cpu.1[at]);
            assert!(error < 1e-4, "{name}: {error}");
        }
    }
}

#[test]
fn patches_that_do_not_fit_are_refused() {
    let Some(gpu) = device() else { return };
    let case = Case::new([40, 40], super::super::Padding::One, 0.02);
    let (_, mut on_device) = case.pair(&gpu);
    let full = case.view(&case.fake);
    let refused = on_device.texture_gradient(full, &case.mask, &mut [0.0; 3]);
    assert!(
        matches!(refused, Err(CriticError::Length { .. })),
        "{refused:?}"
    );
    let small = PatchView {
        data: &case.fake[..6 * 16],
        height: 4,
        width: 4,
    };
    let refused = on_device.step(small, small, &case.mask[..16], Gate::Always);
    assert!(
        matches!(refused, Err(CriticError::TooSmall { .. })),
        "{refused:?}"
    );
    let refused = GpuDiscriminator::load(&gpu, b"veneer", &case.params).err();
    assert!(
        matches!(refused, Some(CriticError::Saved(_))),
        "{refused:?}"
    );
}

#[test]
fn nothing_that_counts_gives_nothing() {
    let Some(gpu) = device() else { return };
    let mut case = Case::new([32, 41], super::super::Padding::One, 0.05);
    case.mask.fill(0.0);
    let (_, mut on_device) = case.pair(&gpu);
    let (loss, gradient) = case.texture_gradient(&mut on_device);
    assert_eq!(loss, 0.0);
    assert!(gradient.iter().all(|&g| g == 0.0));
}
