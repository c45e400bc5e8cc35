//! What a camera sees of a mesh: triangle ids, depth, visibility, and the textured picture (L1).

pub mod backend;
pub mod depth_bound;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod kept_view;
pub mod model;
pub mod part;
pub mod raster;
pub mod textured;
pub mod visibility;
pub mod window;

pub use backend::{Backend, GpuError, MeshViews, ViewRasterizer};
pub use depth_bound::DepthBound;
pub use kept_view::{KeptView, ViewPoint, ViewScratch};
pub use model::render_model;
pub use part::{BoundingBox, Frustum, MeshPart, MeshRuns};
pub use raster::{
    NO_TRIANGLE, RasterWorkspace, ViewBuffer, barycentric, rasterize, rasterize_part,
    rasterize_window,
};
pub use textured::{RenderParams, RenderedView, render_textured};
pub use visibility::{SurfacePoint, VisibilityBuffer, VisibilityParams};
pub use window::{PixelWindow, WindowFinder};
