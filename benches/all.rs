//! All benches, one criterion binary.

use criterion::{criterion_group, criterion_main};

mod bag;
mod texinit;
mod texsmooth;

criterion_group!(benches, bag::bench, texinit::bench, texsmooth::bench);
criterion_main!(benches);
