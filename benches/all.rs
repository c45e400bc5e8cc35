//! All benches, one criterion binary.

fn main() {}
