//! Keyframes: which frames are kept, and where (L2).

pub mod frame;

pub use frame::{FrameQuality, Keyframe, KeyframeId};
