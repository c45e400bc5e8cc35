//! Keyframes: which frames are kept, and where (L2).

mod cache;
pub mod decoded;
pub mod frame;
mod overlap;
pub mod quality;
pub mod select;
mod sight;
pub mod store;

pub use cache::CacheReport;
pub use decoded::{DecodedDepth, DecodedFrame};
pub use frame::{FrameQuality, Keyframe, KeyframeDepth, KeyframeId};
pub use select::KeyframeParams;
pub use sight::SightBox;
pub use store::{Admission, KeyframeReport, KeyframeStore, RejectReason};
