//! Times the discriminator on random patches and leaves what it computed for another program:
//! `cargo run --release --example discriminator -- FOLDER [--side PX] [--steps N] [--threads N]
//! [--pad]`.
//!
//! Into FOLDER, little-endian f32: `real.f32`, `fake.f32` (six planes), `mask.f32`, `gradient.f32`
//! (the texture's, after one step); the saved discriminator `before.bin` and `after.bin` that step.
//! JSON on stdout: losses, milliseconds per call (least and median of the wall clock; the
//! processor's mean), and the rate of a large matrix product on the same threads.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, bail};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use rayon::prelude::*;
use serde_json::{Value, json};
use veneer::texsmooth::discriminator::{
    CpuDiscriminator, Critic, DiscriminatorParams, Gate, NUM_CHANNELS, Padding, PatchView,
};

struct Options {
    folder: PathBuf,
    side: usize,
    num_steps: usize,
    num_threads: usize,
    padding: Padding,
}

impl Options {
    fn parse() -> anyhow::Result<Self> {
        let mut args = std::env::args().skip(1);
        let mut options = Self {
            folder: args.next().context("no folder")?.into(),
            side: 256,
            num_steps: 30,
            num_threads: 0,
            padding: Padding::Valid,
        };
        while let Some(flag) = args.next() {
            let mut number = || args.next().context("no number")?.parse().context("number");
            match flag.as_str() {
                "--side" => options.side = number()?,
                "--steps" => options.num_steps = number()?,
                "--threads" => options.num_threads = number()?,
                "--pad" => options.padding = Padding::One,
                _ => bail!("unknown argument {flag}"),
            }
        }
        Ok(options)
    }
}

#[expect(clippy::print_stdout, reason = "the example's result")]
fn main() -> anyhow::Result<()> {
    let options = Options::parse()?;
    rayon::ThreadPoolBuilder::new()
        .num_threads(options.num_threads)
        .build_global()?;
    println!("{}", run(&options)?);
    Ok(())
}

fn run(options: &Options) -> anyhow::Result<Value> {
    let side = options.side;
    let (real, fake) = (patch(1, side), patch(2, side));
    let mask: Vec<f32> = (0..side * side)
        .map(|at| f32::from(u8::from(at % side < 3 * side / 4)))
        .collect();
    let view = |data| PatchView {
        data,
        height: side,
        width: side,
    };
    let params = DiscriminatorParams {
        padding: options.padding,
        ..DiscriminatorParams::default()
    };
    let mut critic = CpuDiscriminator::new(&params, 7)?;
    let mut gradient = vec![0.0; 3 * side * side];

    std::fs::create_dir_all(&options.folder)?;
    let write = |name: &str, bytes: &[u8]| std::fs::write(options.folder.join(name), bytes);
    write("before.bin", &critic.save()?)?;
    let losses = critic.step(view(&real), view(&fake), &mask, Gate::Always)?;
    let texture = critic.texture_gradient(view(&fake), &mask, &mut gradient)?;
    write("after.bin", &critic.save()?)?;
    for (name, numbers) in [
        ("real.f32", &real),
        ("fake.f32", &fake),
        ("mask.f32", &mask),
        ("gradient.f32", &gradient),
    ] {
        let bytes: Vec<u8> = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        write(name, &bytes)?;
    }

    let num = options.num_steps;
    let texture_ms = time(num, || {
        critic.texture_gradient(view(&fake), &mask, &mut gradient)?;
        Ok(())
    })?;
    let open_ms = time(num, || {
        critic.step(view(&real), view(&fake), &mask, Gate::Always)?;
        Ok(())
    })?;
    // It has seen nothing but these two patches, and soon tells them apart.
    let mut is_ahead = false;
    for _ in 0..300 {
        let found = critic.step(view(&real), view(&fake), &mask, Gate::WhenBehind)?;
        if !found.stepped {
            is_ahead = true;
            break;
        }
    }
    let shut_ms = if is_ahead {
        time(num, || {
            critic.step(view(&real), view(&fake), &mask, Gate::WhenBehind)?;
            Ok(())
        })?
    } else {
        Value::Null
    };
    Ok(json!({
        "side_px": side,
        "num_threads": rayon::current_num_threads(),
        "losses": { "real": losses.real, "fake": losses.fake, "texture": losses.texture },
        "texture_after": texture,
        "step_open_ms": open_ms,
        "step_shut_ms": shut_ms,
        "texture_ms": texture_ms,
        "peak_gflops": peak_gflops(),
    }))
}

/// Numbers in [-1, 1).
fn patch(seed: u64, side: usize) -> Vec<f32> {
    (0..(NUM_CHANNELS * side * side) as u64)
        .map(|at| {
            let mut z = (at + (seed << 32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (z >> 40) as f32 / 8_388_608.0 - 1.0
        })
        .collect()
}

fn time(num: usize, mut call: impl FnMut() -> anyhow::Result<()>) -> anyhow::Result<Value> {
    call()?;
    let mut wall_ms = Vec::new();
    let before = processor_ms()?;
    for _ in 0..num {
        let start = Instant::now();
        call()?;
        wall_ms.push(1e3 * start.elapsed().as_secs_f64());
    }
    let processor = (processor_ms()? - before) / num as f64;
    wall_ms.sort_by(f64::total_cmp);
    Ok(json!({ "least": wall_ms[0], "median": wall_ms[num / 2], "processor": processor }))
}

/// Time that all threads of this process have had, from Linux's `/proc`; to 10 ms.
fn processor_ms() -> anyhow::Result<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let after_name = stat.rsplit(')').next().context("no name")?;
    let fields: Vec<&str> = after_name.split_whitespace().collect();
    let ticks = |at: usize| {
        fields
            .get(at)
            .context("too few fields")?
            .parse::<f64>()
            .context("ticks")
    };
    Ok(10.0 * (ticks(11)? + ticks(12)?))
}

/// The best of many products that stay in cache, a thread each at the same time.
fn peak_gflops() -> f64 {
    const SIDE: usize = 384;
    let num_threads = rayon::current_num_threads();
    let best_s = (0..200).map(|_| {
        let start = Instant::now();
        (0..num_threads).into_par_iter().for_each_init(
            || {
                let a = Mat::<f32>::from_fn(SIDE, SIDE, |i, j| (i + j) as f32);
                (a.clone(), a.clone(), a)
            },
            |(out, a, b), _| {
                for _ in 0..4 {
                    matmul(
                        out.as_mut(),
                        Accum::Replace,
                        a.as_ref(),
                        b.as_ref(),
                        1.0,
                        Par::Seq,
                    );
                }
            },
        );
        start.elapsed().as_secs_f64()
    });
    let best_s = best_s.fold(f64::INFINITY, f64::min);
    (4 * num_threads * 2 * SIDE * SIDE * SIDE) as f64 / best_s / 1e9
}
