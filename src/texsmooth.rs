//! TexSmooth: from an initial texture to a sharp one (ECCV 2022, section 3.2) (L3).
//!
//! In: a mesh with its layout and texture, and the photos that see it. Out: the texture, refined.
//! Step after step ([`adv_optim`]):
//!
//! 1. a view, a crop of it and a partner view are drawn ([`TexSmoothParams`] says by which rule);
//! 2. [`align`]: how far the view's photo is displaced from the rendering;
//! 3. the crop is rendered from the texture, and the partner's photo is projected into it;
//! 4. [`discriminator`]: a step of the network that tells the partner's photo from the rendering;
//! 5. the texture goes down the gradient of λ · L1 − log D(rendering), by Adam; a pixel counts by how much
//!    of the texture it resolves, and more where its own photo was painted.
//!
//! [`smooth`] does all of it at once for the whole texture; [`Smoothing`] does it in pieces, and only
//! for the charts that a scan has changed.
//!
//! Colours are sRGB in [−1, 1]. The same seed gives the same bits for any number of threads.

pub mod adv_optim;
pub mod align;
pub mod checkpoint;
pub mod discriminator;
mod focus;
mod loss_curve;
mod offsets;
mod params;
mod random;
mod texels;
mod view;
mod views;

use std::sync::Arc;

use crate::geom::ImageError;
use crate::keyframe::{DecodedFrame, Keyframe};

pub use crate::render::Backend;
pub use adv_optim::{
    NoObserver, Observer, SmoothError, SmoothFrom, SmoothReport, SmoothScene, Smoothing,
    StepLosses, StepProgress, smooth,
};
pub use offsets::OffsetReport;
pub use params::{L1Target, PartnerOffset, PartnerRule, SmoothStart, TexSmoothParams};

/// Decodes a keyframe; called from many threads.
pub type Decode<'a> = dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync + 'a;
