//! The one integration binary: each file is one subject.

#![expect(
    clippy::unwrap_used,
    reason = "a test fails by panicking, helpers included"
)]
#![expect(
    clippy::print_stderr,
    reason = "a test whose oracle cannot be reached says SKIPPED"
)]

mod architecture;
mod bad_input;
mod bag_interop;
mod claims;
mod command;
mod corpus;
mod docs;
mod eval;
mod export;
mod faults;
mod flatten_peers;
mod import;
mod interfaces;
mod interrupt;
mod journal;
mod launch_configs;
mod lens;
mod live;
mod memory;
mod mesh_types;
mod metric_peers;
mod mips;
mod overlap;
mod published;
mod python;
mod regions;
mod replay;
mod report;
mod stream;
mod synth;
mod texsmooth;
mod textured_room;
