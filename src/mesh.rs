//! Triangle meshes: validated storage, connectivity, and what makes any soup manifold (L1).

pub mod adjacency;
pub mod components;
pub mod diff;
pub mod ids;
pub mod manifold;
pub mod model;
pub mod region;
pub mod subdivide;
pub mod tri_mesh;
pub mod weld;

pub use diff::{
    DiffCounts, DiffError, DiffParams, MeshDiff, OldTriangle, Origin, TrackedMesh, diff,
};
pub use ids::{TriangleId, VertexId};
pub use manifold::{Manifold, ManifoldReport};
pub use model::{Material, ModelError, ModelParts, TexturedModel, Wrap};
pub use region::{Region, RegionError};
pub use subdivide::subdivide;
pub use tri_mesh::{MeshError, SoupReport, TriMesh};
pub use weld::{WeldError, Welded, weld};
