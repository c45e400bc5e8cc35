//! The texture atlas: where each triangle lies on which page, and the pages' texels (L1).
//!
//! Texel coordinates are as in graphics: (0, 0) is the top-left corner of a page, the centre of
//! the first texel is (0.5, 0.5), v points down.

pub mod cells;
pub mod chart_key;
pub mod gutter;
pub mod layout;
pub mod pack;
pub mod proof;
pub mod restrict;
pub mod spread;
pub mod texels;
pub mod texture;

pub use cells::{CellMask, QuarterTurn};
pub use chart_key::ChartKey;
pub use gutter::{GutterReport, dilate_gutters};
pub use layout::{AtlasLayout, ChartId, PlacedChart, TexelRect};
pub use pack::allocator::{PageAllocator, Slot, SlotId};
pub use pack::placer::{ChartPlacer, Compaction, PlacedPiece};
pub use pack::{PackError, PackParams, PackReport, PlaneChart, pack, pack_plates, pack_to_budget};
pub use proof::num_shared_texels;
pub use restrict::restrict;
pub use spread::DensitySpread;
pub use texels::{for_each_texel, for_each_texel_within};
pub use texture::{AtlasTexture, PageTrace, SharedPage, TexelSource, TextureMismatch, TexturePage};
