//! The one integration binary: each file is one subject.

mod bag_interop;
mod python;
