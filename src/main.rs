//! The `veneer` command: parse, build, run, exit code.

fn main() {}
