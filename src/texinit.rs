//! TexInit: from a mesh and posed frames to an initial texture (ECCV 2022, section 3.1) (L3).

pub mod assign;
pub mod flatten;
pub mod overlap;
