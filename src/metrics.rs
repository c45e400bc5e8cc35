//! How near a rendering is to a photograph (L3).
//!
//! Single measures of two images, and [`protocol`]: the paper's way of comparing several methods
//! on the photos that none of them has seen.

pub mod gradient;
pub mod lpips;
pub mod protocol;
pub mod psnr;
pub mod s3;
pub mod ssim;

pub use gradient::gradient_difference;
pub use lpips::{Lpips, LpipsError};
pub use psnr::PixelError;
pub use s3::{SharpnessMap, sharpness_map};
pub use ssim::{SsimChannels, SsimWindow, ssim, ssim_windowed};

/// Why two images cannot be compared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MetricError {
    /// The images differ in size.
    #[error("images of {a_width}x{a_height} and {b_width}x{b_height} pixels cannot be compared")]
    Size {
        /// Width of the first.
        a_width: u32,
        /// Height of the first.
        a_height: u32,
        /// Width of the second.
        b_width: u32,
        /// Height of the second.
        b_height: u32,
    },
    /// The mask does not have one value per pixel.
    #[error("mask of {actual} values for an image of {expected} pixels")]
    Mask {
        /// Pixels of the image.
        expected: usize,
        /// Values of the mask.
        actual: usize,
    },
}

use crate::geom::ColorImage;

/// Luma of BT.601 in whole steps, as the Python imaging library and Matlab give it.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the weights add up to 2¹⁶, so that the quotient is at most 255"
)]
fn luma_byte([r, g, b]: [u8; 3]) -> u8 {
    let sum = 19_595 * u32::from(r) + 38_470 * u32::from(g) + 7_471 * u32::from(b);
    ((sum + 0x8000) >> 16) as u8
}

fn check(a: &ColorImage, b: &ColorImage, mask: Option<&[bool]>) -> Result<(), MetricError> {
    if (a.width(), a.height()) != (b.width(), b.height()) {
        return Err(MetricError::Size {
            a_width: a.width(),
            a_height: a.height(),
            b_width: b.width(),
            b_height: b.height(),
        });
    }
    match mask {
        Some(mask) if mask.len() != a.pixels().len() => Err(MetricError::Mask {
            expected: a.pixels().len(),
            actual: mask.len(),
        }),
        _ => Ok(()),
    }
}
