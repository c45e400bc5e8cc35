//! Triangle meshes: validated storage, connectivity, and what makes any soup manifold (L1).

pub mod ids;
pub mod tri_mesh;

pub use ids::{TriangleId, VertexId};
pub use tri_mesh::{MeshError, SoupReport, TriMesh};
