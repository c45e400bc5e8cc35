//! TexSmooth: from an initial texture to a sharp one (ECCV 2022, section 3.2) (L3).
//!
//! 1. [`align`]: how far the rendering of a view is displaced from its photo.

pub mod align;
