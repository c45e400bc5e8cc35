//! All benches, one criterion binary.

use criterion::{criterion_group, criterion_main};

mod bag;
mod texinit;

criterion_group!(benches, bag::bench, texinit::bench);
criterion_main!(benches);
