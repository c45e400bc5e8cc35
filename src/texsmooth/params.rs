//! Settings of TexSmooth.

use super::align::{AlignForm, AlignParams};
use super::discriminator::{DiscriminatorParams, Gate, Padding};
use crate::render::Backend;

/// What the optimisation starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum SmoothStart {
    /// The texture as it is.
    #[default]
    Texture,
    /// Mid grey wherever the texture is painted (AdvTex-B).
    Blank,
}

/// What the L1 term compares the rendering with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum L1Target {
    /// The view's own photo (the paper's equation).
    #[default]
    Photo,
    /// The partner's photo, projected into the view (the authors' program).
    Partner,
}

/// Which views may be partners.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum PartnerRule {
    /// Those that look in nearly the same direction, of them those before whose camera the crop lies.
    #[default]
    ViewingAxis,
    /// Those in whose cameras the world's z axis has nearly the same direction (the authors' program).
    WorldAxis,
}

/// Which offset the partner's photo is taken at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum PartnerOffset {
    /// Its own.
    #[default]
    Own,
    /// The view's (the authors' program: photo and projection are shifted alike).
    View,
}

/// Settings of [`super::smooth`].
#[derive(Clone, Debug, PartialEq)]
pub struct TexSmoothParams {
    /// Steps in all; 0 leaves the texture as it is.
    pub num_steps: usize,
    /// Where views are drawn and the discriminator runs.
    pub backend: Backend,
    /// Seed of all draws and of the discriminator's weights.
    pub seed: u64,
    /// What the optimisation starts from.
    pub start: SmoothStart,
    /// Side of the crop that a step looks at, pixels; 0 takes the whole image.
    pub crop_px: usize,
    /// Columns and rows, drawn at random, that a whole image is cut by at the left and the top, so that
    /// the discriminator sees no fixed grid.
    pub max_jitter_px: usize,
    /// Adam's step for texels, on the scale of [−1, 1].
    pub learning_rate: f32,
    /// Share of it that is left at the last step; falls evenly in the logarithm.
    pub final_learning_rate_share: f32,
    /// Adam's decay of first and second moment for texels.
    pub betas: [f32; 2],
    /// Weight of the L1 term at first.
    pub lambda: f32,
    /// What it is multiplied by each [`Self::lambda_period`].
    pub lambda_decay: f32,
    /// Steps between.
    pub lambda_period: usize,
    /// What the L1 term compares with.
    pub l1_target: L1Target,
    /// A pixel that covers t > 1 texels in the direction in which it covers most counts t to minus
    /// this: it shows a mean over them, and would blur what a nearer photo shows. 0: all count alike
    /// (the paper).
    pub resolution_exponent: f32,
    /// How many times a pixel counts at texels that were painted from its photo. The L1 term alone has
    /// its least at the median over the views: where this is as much as all others together that is
    /// the photo itself, with its grain; where it is less, the photo as far as it agrees with the
    /// middle of the others. 1: all count alike (the paper).
    pub own_weight: f32,
    /// Whether there is a discriminator; without one only the L1 term is left.
    pub has_discriminator: bool,
    /// The discriminator.
    pub discriminator: DiscriminatorParams,
    /// When the discriminator steps.
    pub gate: Gate,
    /// Which views may be partners.
    pub partner_rule: PartnerRule,
    /// Partners' axes differ by less, radians.
    pub max_partner_angle_rad: f64,
    /// Where the partner's depth differs by more it does not count, metres.
    pub max_depth_difference_m: f32,
    /// Whether photo and rendering are aligned.
    pub has_alignment: bool,
    /// How.
    pub align: AlignParams,
    /// Patches along each side of an image that are aligned apart.
    pub align_grid: usize,
    /// Visits of a view after which it is aligned anew.
    pub align_interval: usize,
    /// Which offset the partner's photo is taken at.
    pub partner_offset: PartnerOffset,
    /// Seconds after which no further step begins; 0 for no bound. What a bound leaves undone depends
    /// on the machine, and so do the bytes.
    pub time_budget_s: f64,
    /// Memory for what the views see, MB.
    pub view_cache_mb: f64,
    /// Steps between previews; 0 for none.
    pub preview_interval: usize,
    /// Steps between checkpoints; 0 for none but at the end.
    pub checkpoint_interval: usize,
}

impl Default for TexSmoothParams {
    fn default() -> Self {
        Self {
            num_steps: 0,
            backend: Backend::Cpu,
            seed: 0,
            start: SmoothStart::Texture,
            crop_px: 256,
            max_jitter_px: 69,
            learning_rate: 1e-2,
            final_learning_rate_share: 0.1,
            betas: [0.5, 0.999],
            lambda: 10.0,
            lambda_decay: 0.8,
            lambda_period: 960,
            l1_target: L1Target::Photo,
            resolution_exponent: 2.0,
            own_weight: 50.0,
            has_discriminator: true,
            discriminator: DiscriminatorParams::default(),
            gate: Gate::WhenBehind,
            partner_rule: PartnerRule::ViewingAxis,
            max_partner_angle_rad: 15f64.to_radians(),
            max_depth_difference_m: 0.1,
            has_alignment: true,
            align: AlignParams::default(),
            align_grid: 1,
            align_interval: 16,
            partner_offset: PartnerOffset::Own,
            time_budget_s: 0.0,
            view_cache_mb: 400.0,
            preview_interval: 0,
            checkpoint_interval: 0,
        }
    }
}

impl TexSmoothParams {
    /// The paper's form, with the published program's choices where its text is silent: whole
    /// images, aligned anew at each step to whole pixels, L1 against the partner's projection.
    pub fn paper() -> Self {
        Self {
            crop_px: 0,
            learning_rate: 1e-3,
            final_learning_rate_share: 1.0,
            l1_target: L1Target::Partner,
            resolution_exponent: 0.0,
            own_weight: 1.0,
            discriminator: DiscriminatorParams {
                padding: Padding::One,
                ..DiscriminatorParams::default()
            },
            partner_rule: PartnerRule::WorldAxis,
            align: AlignParams {
                form: AlignForm::Reference,
                ..AlignParams::default()
            },
            align_interval: 1,
            partner_offset: PartnerOffset::View,
            ..Self::default()
        }
    }

    /// λ at a step: `lambda · lambda_decay^⌊step / lambda_period⌋`.
    pub fn lambda_at(&self, step: usize) -> f32 {
        let num_periods = i32::try_from(step / self.lambda_period.max(1)).unwrap_or(i32::MAX);
        self.lambda * self.lambda_decay.powi(num_periods)
    }

    /// Adam's step for texels at a step of the optimisation.
    pub fn learning_rate_at(&self, step: usize) -> f32 {
        let progress = step as f32 / self.num_steps.max(1) as f32;
        self.learning_rate * self.final_learning_rate_share.powf(progress)
    }
}
