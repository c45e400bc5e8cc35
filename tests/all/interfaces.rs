//! Our messages and services against `msg/` and `srv/`: field names, types and order, by a decoder
//! that knows only those files; and by the real rosidl and rclpy, built from PyPI.

mod definitions;
mod offered;
mod rosidl;
mod samples;

use std::path::Path;

pub(crate) use rosidl::rosidl_python;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}
