//! `mesh_msgs/MeshGeometryStamped`: a whole mesh.

use crate::ingest::MeshUpdate;
use crate::mesh::{SoupReport, TriMesh};

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, geometry, schema};

/// `mesh_msgs/MeshGeometryStamped`.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshGeometryStamped<'a> {
    /// Stamp, and the frame of the vertices.
    pub header: WireHeader<'a>,
    /// Name of the mesh among those of its publisher.
    pub uuid: &'a str,
    /// Vertices, metres.
    pub vertices_m: Vec<[f64; 3]>,
    /// Normals of the vertices; may be empty.
    pub vertex_normals: Vec<[f64; 3]>,
    /// Vertex indices of each face.
    pub faces: Vec<[u32; 3]>,
}

impl<'a> Message<'a> for MeshGeometryStamped<'a> {
    const TYPE_NAME: &'static str = "mesh_msgs/msg/MeshGeometryStamped";
    const SCHEMA: &'static str = schema::MESH_GEOMETRY_STAMPED;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            uuid: reader.string("uuid")?,
            vertices_m: reader.tuples("mesh_geometry.vertices")?,
            vertex_normals: reader.tuples("mesh_geometry.vertex_normals")?,
            faces: reader.tuples("mesh_geometry.faces")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.string(self.uuid);
        writer.tuples(&self.vertices_m);
        writer.tuples(&self.vertex_normals);
        writer.tuples(&self.faces);
    }
}

impl<'a> MeshGeometryStamped<'a> {
    /// The whole mesh, in the header's frame.
    ///
    /// # Errors
    /// [`WireError::Mesh`] when an index is out of range.
    pub fn to_update(&self) -> Result<(MeshUpdate, SoupReport), WireError> {
        let block = || "mesh_geometry".to_owned();
        let (mesh, report) = geometry::mesh(block, &self.vertices_m, self.faces.clone())?;
        Ok((MeshUpdate::Whole(mesh), report))
    }

    /// The message for a mesh.
    pub fn from_mesh(header: WireHeader<'a>, mesh: &TriMesh) -> Self {
        Self {
            header,
            uuid: "",
            vertices_m: geometry::points64(mesh),
            vertex_normals: Vec::new(),
            faces: mesh.triangles().to_vec(),
        }
    }
}
