//! How colours are transferred.

use crate::render::VisibilityParams;

/// Where texels take their colours from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum TransferMode {
    /// From the frame that its triangle was assigned to.
    #[default]
    Assigned,
    /// The mean over all frames that see it.
    L2Avg,
}

/// How a texel's colour is looked up in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Lookup {
    /// Perspective-correct, averaged over the texel's footprint.
    #[default]
    Footprint,
    /// The pixel nearest to where the texel's centre lands when the triangle's three pixels are
    /// joined affinely (the authors' program).
    NearestAffine,
}

/// Which frames a mean runs over, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum MeanForm {
    /// The frames that see the texel, in linear light.
    #[default]
    Seeing,
    /// The frames into whose image it projects, whatever lies before it, of sRGB values (the
    /// authors' program).
    Projecting,
}

/// How colours are transferred.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferParams {
    /// Where texels take their colours from.
    pub mode: TransferMode,
    /// How colours are looked up.
    pub lookup: Lookup,
    /// What a mean runs over.
    pub mean_form: MeanForm,
    /// Samples along each side of a texel where the image is finer, 1..=16.
    pub max_samples: u32,
    /// Which frames a mean runs over: visibility by the mesh.
    pub visibility: VisibilityParams,
    /// Which frames a mean runs over: the measured depth differs by less than this, metres (> 0).
    pub max_depth_difference_m: f32,
}

impl Default for TransferParams {
    fn default() -> Self {
        Self {
            mode: TransferMode::Assigned,
            lookup: Lookup::Footprint,
            mean_form: MeanForm::Seeing,
            max_samples: 8,
            visibility: VisibilityParams {
                edge_margin_px: 2,
                ..VisibilityParams::default()
            },
            max_depth_difference_m: 0.25,
        }
    }
}

impl TransferParams {
    /// The published program's form: nearest pixels, affine in the image, means over every frame.
    pub fn paper() -> Self {
        Self {
            lookup: Lookup::NearestAffine,
            mean_form: MeanForm::Projecting,
            ..Self::default()
        }
    }

    /// Depth of what a mean takes in, metres.
    pub(crate) fn far_m(&self) -> f64 {
        match self.mean_form {
            MeanForm::Seeing => self.visibility.far_m,
            MeanForm::Projecting => f64::INFINITY,
        }
    }
}
