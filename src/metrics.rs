//! How near a rendering is to a photograph (L3).

pub mod psnr;
pub mod ssim;

pub use psnr::PixelError;
pub use ssim::{SsimChannels, ssim};

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
