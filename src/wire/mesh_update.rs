//! `veneer/MeshUpdate`: the mesh as keyed blocks, only what changed.

use crate::ingest::MeshUpdate;
use crate::ingest::event::MeshBlockKey;
use crate::mesh::SoupReport;

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, geometry, schema};

/// `veneer/MeshBlock`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct WireMeshBlock {
    /// Identity of the block.
    pub key: i64,
    /// Vertices, metres.
    pub vertices_m: Vec<[f32; 3]>,
    /// Vertex indices, three a triangle.
    pub triangles: Vec<u32>,
}

/// `veneer/MeshUpdate`.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshUpdateMessage<'a> {
    /// Stamp, and the frame of the vertices.
    pub header: WireHeader<'a>,
    /// Counts the updates of one mesh.
    pub revision: u64,
    /// Whether all earlier blocks are dropped first.
    pub clear: bool,
    /// The blocks; an empty one removes its key.
    pub blocks: Vec<WireMeshBlock>,
}

/// Key and two empty sequences.
const MIN_BLOCK_BYTES: usize = 16;

impl<'a> Message<'a> for MeshUpdateMessage<'a> {
    const TYPE_NAME: &'static str = "veneer/msg/MeshUpdate";
    const SCHEMA: &'static str = schema::MESH_UPDATE;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            revision: reader.scalar("revision")?,
            clear: reader.bool("clear")?,
            blocks: reader.sequence("blocks", MIN_BLOCK_BYTES, |reader| {
                Ok(WireMeshBlock {
                    key: reader.scalar("blocks.key")?,
                    vertices_m: reader.tuples("blocks.vertices")?,
                    triangles: reader.scalars("blocks.triangles")?,
                })
            })?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.scalar(self.revision);
        writer.bool(self.clear);
        writer.sequence_len(self.blocks.len());
        for block in &self.blocks {
            writer.scalar(block.key);
            writer.tuples(&block.vertices_m);
            writer.scalars(&block.triangles);
        }
    }
}

impl<'a> MeshUpdateMessage<'a> {
    /// The blocks by key, in the header's frame.
    ///
    /// # Errors
    /// [`WireError::Mesh`] when an index is out of range.
    pub fn to_update(&self) -> Result<(MeshUpdate, SoupReport), WireError> {
        let mut total = SoupReport::default();
        let mut blocks = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let name = || format!("block {}", block.key);
            let triangles = geometry::triples(name, &block.triangles)?;
            let (mesh, report) = geometry::mesh(name, &block.vertices_m, triangles)?;
            total = geometry::add_reports(total, report);
            blocks.push((MeshBlockKey([block.key, 0, 0]), mesh));
        }
        let update = MeshUpdate::Blocks {
            clear: self.clear,
            blocks,
        };
        Ok((update, total))
    }

    /// The message for an update: a whole mesh is one block, key 0, that clears the rest. Keys
    /// keep their first component (the others are nvblox's own).
    pub fn from_update(header: WireHeader<'a>, revision: u64, update: &MeshUpdate) -> Self {
        let block = |key: i64, mesh: &crate::mesh::TriMesh| WireMeshBlock {
            key,
            vertices_m: geometry::points32(mesh),
            triangles: mesh.triangles().as_flattened().to_vec(),
        };
        let (clear, blocks) = match update {
            MeshUpdate::Whole(mesh) => (true, vec![block(0, mesh)]),
            MeshUpdate::Blocks { clear, blocks } => {
                let blocks = blocks.iter().map(|(key, mesh)| block(key.0[0], mesh));
                (*clear, blocks.collect())
            }
        };
        Self {
            header,
            revision,
            clear,
            blocks,
        }
    }
}
