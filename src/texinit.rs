//! TexInit: from a mesh and posed frames to an initial texture (ECCV 2022, section 3.1) (L3).

pub mod assign;
//! TexInit: a texture atlas from a mesh and posed keyframes (L3).

pub mod fill;
pub mod flatten;
pub mod overlap;
pub mod transfer;

#[cfg(test)]
pub(crate) mod analytic_scene;
