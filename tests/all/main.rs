//! The one integration binary: each file is one subject.

mod bag_interop;
mod import;
mod python;
mod synth;
