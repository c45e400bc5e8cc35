//! All benches, one criterion binary.

use criterion::{criterion_group, criterion_main};

mod bag;

criterion_group!(benches, bag::bench);
criterion_main!(benches);
