//! Adversarial optimisation of the texture (ECCV 2022, section 3.2, Eq. adv optim loss; after Huang
//! et al. 2020, "Adversarial Texture Optimization from RGB-D Scans").
//!
//! A step draws a view and a partner, renders a crop of the view from the texture, and lets a
//! discriminator tell [photo, partner − photo] from [photo, rendering − photo]; the texture goes down
//! the gradient of λ · L1 − log D(rendering). The paper's step covers a whole image. A crop covers
//! as much as the discriminator can look at (its receptive field is 70 px) many times over, and a
//! step costs what its crop costs.
//!
//! Where the mesh is not seen, nothing is painted, or the partner does not see the same surface,
//! photo, projection and rendering are all −1, and neither loss counts it.

mod crop;
mod draw;
mod partner;
mod smoothing;
mod step;

use std::sync::Arc;

use super::align::AlignError;
use super::checkpoint::CheckpointError;
use super::discriminator::CriticError;
use super::offsets::OffsetReport;
use super::{Decode, TexSmoothParams};
use crate::atlas::{AtlasLayout, AtlasTexture, TextureMismatch};
use crate::geom::ColorImage;
use crate::keyframe::Keyframe;
use crate::mesh::TriMesh;
use crate::render::GpuError;

pub use smoothing::{SmoothScene, Smoothing};

/// Why the texture was not refined.
#[derive(Debug, thiserror::Error)]
pub enum SmoothError {
    /// The texture is another layout's.
    #[error(transparent)]
    Texture(#[from] TextureMismatch),
    /// The layout is another mesh's.
    #[error("mesh has {num_triangles} triangles, layout {num_in_layout}")]
    Layout {
        /// Triangles of the mesh.
        num_triangles: usize,
        /// Triangles of the layout.
        num_in_layout: usize,
    },
    /// Which charts may change is said of another layout.
    #[error("{num_flags} charts may change or not, the layout has {num_charts}")]
    Charts {
        /// How many charts it is said of.
        num_flags: usize,
        /// Charts of the layout.
        num_charts: usize,
    },
    /// The scene is not the one that the refinement was begun on.
    #[error("the {what} changed since the refinement of some charts was begun")]
    Changed {
        /// What differs.
        what: &'static str,
    },
    /// There are more texels than addresses.
    #[error("the atlas has more than 2^32 texels in tiles of 64")]
    TooManyTexels,
    /// The alignment's settings are out of range.
    #[error("alignment: {0}")]
    Align(#[from] AlignError),
    /// The discriminator refused.
    #[error("discriminator: {0}")]
    Critic(#[from] CriticError),
    /// The device that was asked for is not there, or failed.
    #[error(transparent)]
    Device(#[from] GpuError),
    /// The checkpoint is damaged, or another run's.
    #[error("checkpoint: {0}")]
    Checkpoint(#[from] CheckpointError),
}

/// The losses of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepLosses {
    /// Mean absolute difference of rendering and target on the scale of [−1, 1], without λ.
    pub l1: f32,
    /// −log D of the rendering, after the discriminator's step.
    pub adversarial: f32,
    /// −log D of the partner's projection.
    pub real: f32,
    /// −log(1 − D) of the rendering.
    pub fake: f32,
    /// Whether the discriminator's gradients counted.
    pub has_critic_stepped: bool,
}

/// Where the optimisation is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepProgress {
    /// Steps done, those before a checkpoint included.
    pub num_done: usize,
    /// Steps in all.
    pub num_steps: usize,
    /// Running means of the losses over about the last hundred steps.
    pub losses: StepLosses,
    /// λ.
    pub lambda: f32,
}

/// Is told where TexSmooth is; must not influence it.
pub trait Observer: Sync {
    /// A step is done.
    fn step(&self, progress: &StepProgress);
    /// A preview is due: a photo, and beside it its rendering as it is now.
    fn preview(&self, num_done: usize, image: &ColorImage);
    /// A checkpoint is due.
    fn checkpoint(&self, num_done: usize, bytes: &[u8]);
}

/// What is known before the first step.
#[derive(Clone, Copy, Debug, Default)]
pub enum SmoothFrom<'a> {
    /// Nothing.
    #[default]
    Nothing,
    /// A discriminator that has learnt on another texture ([`SmoothReport::critic`]).
    Critic(&'a [u8]),
    /// A checkpoint of the same run, to be gone on with.
    Checkpoint(&'a [u8]),
}

/// Tells nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoObserver;

impl Observer for NoObserver {
    fn step(&self, _progress: &StepProgress) {}
    fn preview(&self, _num_done: usize, _image: &ColorImage) {}
    fn checkpoint(&self, _num_done: usize, _bytes: &[u8]) {}
}

/// How the optimisation went.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothReport {
    /// Steps done, those before a checkpoint included.
    pub num_steps: usize,
    /// Steps of these whose crop showed no painted surface.
    pub num_empty: usize,
    /// Steps whose partner saw too little of the crop, so that the view was its own partner.
    pub num_self_partnered: usize,
    /// Frames that did not decode; their steps were left out.
    pub num_undecodable: usize,
    /// Views that were drawn from; where only some charts may change, those that may show them.
    pub num_views: usize,
    /// Steps whose discriminator loss counted.
    pub num_critic_steps: usize,
    /// Mean losses by stretches of a hundredth of the run.
    pub curve: Vec<(usize, StepLosses)>,
    /// Texels that changed.
    pub num_texels: u64,
    /// Steps that each of them made, on average.
    pub num_steps_per_texel: f64,
    /// Offsets at the end.
    pub offsets: OffsetReport,
    /// What the discriminator ran on.
    pub backend: String,
    /// Whether the time budget ended it.
    pub is_cut_short: bool,
    /// The discriminator as it was at the end, for [`SmoothFrom::Critic`].
    pub critic: Vec<u8>,
    /// Wall time that it took here, seconds; what it took before a checkpoint is not known.
    pub seconds: f64,
}

/// Refines `texture` in place.
///
/// # Errors
/// [`SmoothError`] for a layout, texture, setting or checkpoint that does not fit. Frames that do not
/// decode are no error: they are counted.
#[expect(
    clippy::too_many_arguments,
    reason = "a mesh with its layout and texture, the photos, and how to go about it"
)]
pub fn smooth(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &mut AtlasTexture,
    frames: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    params: &TexSmoothParams,
    from: SmoothFrom<'_>,
    observer: &dyn Observer,
) -> Result<SmoothReport, SmoothError> {
    let scene = SmoothScene {
        mesh,
        layout,
        frames,
        decode,
    };
    let mut smoothing = Smoothing::of_all(&scene, texture, params, from)?;
    smoothing.advance_whole(&scene, texture, observer)?;
    smoothing.finish(observer)
}

#[cfg(test)]
mod tests;
