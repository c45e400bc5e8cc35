//! TexInit: a texture atlas from a mesh and posed keyframes (L3).

pub mod assign;
pub mod fill;
pub mod flatten;
pub mod overlap;
pub mod transfer;

#[cfg(test)]
pub(crate) mod analytic_scene;
