//! Frames, stamps, cameras and images: the words every other module speaks (L0).
//!
//! Conventions, held everywhere behind this module: metres, radians, integer nanoseconds;
//! optical frames (x right, y down, z forward); images row-major from the top left with the
//! centre of the first pixel at (0, 0); depth along z; colours are sRGB bytes at the edges.

pub mod bayer;
pub mod camera;
pub mod color;
pub mod encoded;
mod file_codec;
mod file_header;
pub mod frame;
pub mod image;
mod pixel_format;
pub mod rvl;
pub mod stamp;

pub use camera::{CameraError, CameraModel, Distortion, PinholeCamera};
pub use encoded::{ColorEncoding, DepthEncoding, EncodedColor, EncodedDepth};
pub use frame::{FrameError, RigidTransform};
pub use image::{ColorImage, DepthImage, ImageError};
pub use stamp::Stamp;
