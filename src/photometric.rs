//! Photometric refinement without a network: one exposure for all frames, and no steps where the
//! frame that paints changes (L3).
//!
//! - [`gain`]: keyframes + mesh → a gain per keyframe and channel, in linear light, so that all
//!   show a surface point in the same colour; [`corrected`] applies it to decoded frames.
//! - [`frame_gain`]: a new keyframe + some before it → its gain, once and for all.
//! - [`pose`]: photos beside renderings → cameras turned by a fraction of a degree.
//! - [`seams`]: a painted texture → the same with the steps between labels levelled, over whole
//!   regions and then within a narrow band; or those of some triangles, beside what stays.
//!
//! Everything is done in linear light. Results do not depend on the number of threads. What a
//! texel shows changes, never where it came from; gutters are the caller's to paint again.

mod conjugate;
pub mod corrected;
pub mod frame_gain;
pub mod gain;
mod points;
pub mod pose;
pub mod seams;

pub use corrected::CorrectedFrames;
pub use frame_gain::{GainedFrame, gain_of_frame};
pub use gain::{GainParams, GainReport, GainTable, estimate_gains};
pub use pose::{Painted, PoseMeasure, PoseParams, PosePhoto, measure_pose, turned};
pub use seams::{Levelled, SeamParams, SeamPatch, SeamPhoto, SeamReport, Standing, level_seams};

use crate::atlas::texture::TextureMismatch;
use crate::mesh::MeshError;
use crate::texsmooth::align::AlignError;

/// Why nothing was refined.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhotometricError {
    /// A setting that has no meaning.
    #[error("photometric setting {name} cannot be {value}")]
    Parameter {
        /// Which one.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The layout or the labels are for another mesh.
    #[error("mesh has {num_triangles} triangles, layout {num_in_layout}, labels {num_labels}")]
    Mismatch {
        /// Triangles of the mesh.
        num_triangles: usize,
        /// Triangles of the layout.
        num_in_layout: usize,
        /// Labels.
        num_labels: usize,
    },
    /// The texture was not made for the layout.
    #[error(transparent)]
    Texture(#[from] TextureMismatch),
    /// The alignment's settings are out of range.
    #[error("alignment: {0}")]
    Align(#[from] AlignError),
    /// The mesh has more sides than 32 bits can number.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// Refuses what is not finite or lies outside `range`.
fn check(
    name: &'static str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
) -> Result<(), PhotometricError> {
    if range.contains(&value) {
        Ok(())
    } else {
        Err(PhotometricError::Parameter { name, value })
    }
}
