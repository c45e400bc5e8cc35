//! Keyframes: which frames are kept, and where (L2).

pub mod decoded;
pub mod frame;

pub use decoded::{DecodedDepth, DecodedFrame};
pub use frame::{FrameQuality, Keyframe, KeyframeId};
