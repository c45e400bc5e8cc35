//! The discriminator on a crop of 256×256, and alignment of photo and rendering.

use std::time::Duration;

use criterion::{Criterion, SamplingMode};
use veneer::geom::ColorImage;
use veneer::texsmooth::align::{AlignForm, AlignParams, align};
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
    bench_align(criterion);
}

/// `align/refined`, `align/phase`, `align/reference`: 1920×1440, three channels, the rendering moved
/// by (14, −9) pixels and a seventh of it masked.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "colours within bytes"
)]
fn bench_align(criterion: &mut Criterion) {
    let (width, height) = (1920u32, 1440u32);
    let picture = |dx: f32, dy: f32| {
        let pixel = |i: u32| {
            let (x, y) = ((i % width) as f32 - dx, (i / width) as f32 - dy);
            let wave = (0.05 * x).sin() * (0.031 * y).cos() + (0.0071 * x * y / 40.0).sin();
            let fine = (0.9 * x + 0.4 * y).sin() * (0.013 * x - 0.7 * y).cos();
            [90.0, 70.0, 50.0].map(|gain| (125.0 + 0.6 * gain * wave + 20.0 * fine) as u8)
        };
        let pixels = (0..width * height).map(pixel).collect();
        ColorImage::new(width, height, pixels).expect("a picture")
    };
    let (photo, render) = (picture(14.0, -9.0), picture(0.0, 0.0));
    let mask: Vec<bool> = (0..width * height).map(|i| i / 97 % 7 != 0).collect();

    let mut group = criterion.benchmark_group("align");
    group
        .sample_size(10)
        .sampling_mode(SamplingMode::Flat)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2));
    let forms = [
        ("refined", AlignForm::Refined),
        ("phase", AlignForm::Phase),
        ("reference", AlignForm::Reference),
    ];
    for (name, form) in forms {
        let params = AlignParams {
            form,
            ..AlignParams::default()
        };
        group.bench_function(name, |bencher| {
            bencher.iter(|| align(&photo, &render, Some(&mask), &params).expect("an alignment"));
        });
    }
    group.finish();
}
