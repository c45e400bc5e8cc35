//! `shape_msgs/Mesh`: a whole mesh without header; its frame comes from the configuration.

use crate::ingest::MeshUpdate;
use crate::mesh::{SoupReport, TriMesh};

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::{Message, geometry, schema};

/// `shape_msgs/Mesh`.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeMesh {
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Vertices, metres.
    pub vertices_m: Vec<[f64; 3]>,
}

impl Message<'_> for ShapeMesh {
    const TYPE_NAME: &'static str = "shape_msgs/msg/Mesh";
    const SCHEMA: &'static str = schema::SHAPE_MESH;

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, WireError> {
        Ok(Self {
            triangles: reader.tuples("triangles")?,
            vertices_m: reader.tuples("vertices")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.tuples(&self.triangles);
        writer.tuples(&self.vertices_m);
    }
}

impl ShapeMesh {
    /// The whole mesh.
    ///
    /// # Errors
    /// [`WireError::Mesh`] when an index is out of range.
    pub fn to_update(&self) -> Result<(MeshUpdate, SoupReport), WireError> {
        let block = || "mesh".to_owned();
        let (mesh, report) = geometry::mesh(block, &self.vertices_m, self.triangles.clone())?;
        Ok((MeshUpdate::Whole(mesh), report))
    }

    /// The message for a mesh.
    pub fn from_mesh(mesh: &TriMesh) -> Self {
        Self {
            triangles: mesh.triangles().to_vec(),
            vertices_m: geometry::points64(mesh),
        }
    }
}
