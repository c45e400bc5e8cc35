//! TexInit: from a mesh and posed frames to an atlas with every texel coloured (L3).

pub mod assign;
pub mod flatten;
pub mod transfer;

#[cfg(test)]
pub(crate) mod analytic_scene;
