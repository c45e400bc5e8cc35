//! The discriminator of the adversarial optimisation (ECCV 2022, section 3.2), as a trait and on
//! the CPU.
//!
//! Five convolutions of 4×4: 6→64 and 64→128 and 128→128 with stride 2, 128→128 and 128→1 with
//! stride 1; leaky ReLU on the first four, a sigmoid at the end, worked with as logits. Its receptive
//! field is 70 pixels. Input: six planes in [−1, 1], a photo and the difference X − photo, with X
//! another photo projected into the view (real) or the rendering (fake). The mask of pixels that
//! count goes through the same strides: a place counts where more than a tenth of its 4×4 do.
//!
//! Losses, as means over the places that count: −log D(real) − log(1 − D(fake)) for the
//! discriminator, −log D(fake) for the texture. No place that counts: losses and gradients are 0.
//!
//! Every sum has an order that does not depend on the number of threads: the same bits for any. They
//! depend on the instruction set, which the matrix kernels are chosen by.

mod adam;
#[cfg(feature = "gpu")]
mod burn;
mod conv;
mod cpu;
mod grid;
mod layer;
mod losses;
mod mask;
mod network;

#[cfg(feature = "gpu")]
pub use burn::GpuDiscriminator;
pub use cpu::CpuDiscriminator;

use crate::render::ViewRasterizer;

/// Pixels of zeros around each convolution's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Padding {
    /// None (the paper).
    #[default]
    Valid,
    /// One (the authors' program).
    One,
}

impl Padding {
    pub(super) const fn num_px(self) -> usize {
        match self {
            Self::Valid => 0,
            Self::One => 1,
        }
    }
}

/// When the discriminator learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Gate {
    /// At every step.
    Always,
    /// Where its loss exceeds the texture's; elsewhere its gradient is 0 and Adam goes on by its
    /// momentum (the authors' program).
    #[default]
    WhenBehind,
}

/// Settings of the discriminator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiscriminatorParams {
    /// Adam's step.
    pub learning_rate: f32,
    /// Adam's decay of first and second moment.
    pub betas: [f32; 2],
    /// Pixels of zeros around each convolution's input.
    pub padding: Padding,
    /// Standard deviation of the weights at first; biases are 0.
    pub weight_std: f32,
    /// Slope of the leaky ReLU below 0.
    pub leaky_slope: f32,
    /// A place counts where more than this share of what it looks at does.
    pub mask_threshold: f32,
}

impl Default for DiscriminatorParams {
    fn default() -> Self {
        Self {
            learning_rate: 1e-4,
            betas: [0.5, 0.999],
            padding: Padding::Valid,
            weight_std: 0.02,
            leaky_slope: 0.2,
            mask_threshold: 0.1,
        }
    }
}

/// Channels of the input.
pub const NUM_CHANNELS: usize = 6;

/// Six planes, row-major each: `data[(channel · height + row) · width + column]`.
#[derive(Clone, Copy, Debug)]
pub struct PatchView<'a> {
    /// The values.
    pub data: &'a [f32],
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

/// The losses of a discriminator's step, before the step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CriticLosses {
    /// −log D(real).
    pub real: f32,
    /// −log(1 − D(fake)).
    pub fake: f32,
    /// −log D(fake).
    pub texture: f32,
    /// Whether the gradients counted.
    pub stepped: bool,
}

/// Why a discriminator refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CriticError {
    /// A patch is too small for the five layers.
    #[error("a patch of {width}x{height} pixels is too small; {min} a side are needed")]
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// The least side.
        min: usize,
    },
    /// A patch, a mask or an output does not have the size that was said.
    #[error("{what} has {actual} values, not {expected}")]
    Length {
        /// Which.
        what: &'static str,
        /// How many values it has.
        actual: usize,
        /// How many it should have.
        expected: usize,
    },
    /// Saved bytes are not a discriminator's, or another form's.
    #[error("saved discriminator: {0}")]
    Saved(&'static str),
    /// A graphics card failed, or there is none.
    #[error("graphics card: {0}")]
    Device(String),
}

/// What judges the rendering.
pub trait Critic: Send {
    /// The discriminator's step on a real and a fake patch of one size. `mask` says per pixel whether
    /// it counts (1 or 0).
    ///
    /// # Errors
    /// [`CriticError`] for patches that differ in size or are too small.
    fn step(
        &mut self,
        real: PatchView<'_>,
        fake: PatchView<'_>,
        mask: &[f32],
        gate: Gate,
    ) -> Result<CriticLosses, CriticError>;

    /// −log D(fake), and in `out` its gradient by the last three of the fake patch's planes.
    ///
    /// # Errors
    /// [`CriticError`] for a patch that is too small, or an output of another size.
    fn texture_gradient(
        &mut self,
        fake: PatchView<'_>,
        mask: &[f32],
        out: &mut [f32],
    ) -> Result<f32, CriticError>;

    /// Weights and the state of Adam, for [`CpuDiscriminator::load`].
    ///
    /// # Errors
    /// [`CriticError::Device`] when a graphics card does not give them.
    fn save(&self) -> Result<Vec<u8>, CriticError>;
}

/// A discriminator where the views are drawn: as `known` was saved, or one that has learnt nothing.
///
/// # Errors
/// [`CriticError`] for bytes that are none, or where the device fails.
#[cfg_attr(
    not(feature = "gpu"),
    expect(unused_variables, reason = "there is no device to ask for")
)]
pub fn make(
    rasterizer: &ViewRasterizer,
    params: &DiscriminatorParams,
    seed: u64,
    known: Option<&[u8]>,
) -> Result<Box<dyn Critic>, CriticError> {
    #[cfg(feature = "gpu")]
    if let Some(device) = rasterizer.device() {
        return Ok(match known {
            Some(bytes) => Box::new(GpuDiscriminator::load(device, bytes, params)?),
            None => Box::new(GpuDiscriminator::new(device, params, seed)?),
        });
    }
    Ok(match known {
        Some(bytes) => Box::new(CpuDiscriminator::load(bytes, params)?),
        None => Box::new(CpuDiscriminator::new(params, seed)?),
    })
}

#[cfg(test)]
mod tests;
