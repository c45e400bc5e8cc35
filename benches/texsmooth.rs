//! The discriminator on a crop of 256×256.

use std::time::Duration;

use criterion::{Criterion, SamplingMode};
use veneer::texsmooth::discriminator::{
    CpuDiscriminator, Critic, DiscriminatorParams, Gate, NUM_CHANNELS, PatchView,
};

const SIDE: usize = 256;

/// `discriminator/step` (both patches, forward and backward, Adam) and `discriminator/texture`
/// (the gradient by the rendering).
pub(crate) fn bench(criterion: &mut Criterion) {
    let mut critic =
        CpuDiscriminator::new(&DiscriminatorParams::default(), 7).expect("a discriminator");
    let [real, fake] = [37u32, 41].map(|period| -> Vec<f32> {
        (0..NUM_CHANNELS * SIDE * SIDE)
            .map(|at| (at as f32 / period as f32).sin())
            .collect()
    });
    let view = |data| PatchView {
        data,
        height: SIDE,
        width: SIDE,
    };
    let (real, fake) = (view(&real), view(&fake));
    let mask = vec![1.0; SIDE * SIDE];
    let mut gradient = vec![0.0; 3 * SIDE * SIDE];

    let mut group = criterion.benchmark_group("discriminator");
    group
        .sample_size(10)
        .sampling_mode(SamplingMode::Flat)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2));
    group.bench_function("step", |bencher| {
        bencher.iter(|| {
            critic
                .step(real, fake, &mask, Gate::Always)
                .expect("a step")
        });
    });
    group.bench_function("texture", |bencher| {
        bencher.iter(|| {
            critic
                .texture_gradient(fake, &mask, &mut gradient)
                .expect("a gradient")
        });
    });
    group.finish();
}
