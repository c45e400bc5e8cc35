//! The one integration binary: each file is one subject.
mod import;

mod bag_interop;
mod python;
