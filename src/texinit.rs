//! TexInit: a texture atlas from a mesh and posed keyframes (L3).

pub mod fill;
pub mod flatten;
pub mod overlap;
