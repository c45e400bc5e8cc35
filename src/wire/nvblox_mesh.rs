//! `nvblox_msgs/Mesh`: mesh blocks on nvblox's grid.

use crate::ingest::MeshUpdate;
use crate::ingest::event::MeshBlockKey;
use crate::mesh::{MeshError, SoupReport};

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, geometry, schema};

/// `nvblox_msgs/MeshBlock`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct NvbloxBlock {
    /// Vertices, metres.
    pub vertices_m: Vec<[f32; 3]>,
    /// Normals of the vertices; may be empty.
    pub normals: Vec<[f32; 3]>,
    /// Colours of the vertices, RGBA in [0, 1]; may be empty.
    pub colors: Vec<[f32; 4]>,
    /// Vertex indices, three a triangle.
    pub triangles: Vec<i32>,
}

/// `nvblox_msgs/Mesh`.
#[derive(Clone, Debug, PartialEq)]
pub struct NvbloxMesh<'a> {
    /// Stamp, and the frame of the vertices.
    pub header: WireHeader<'a>,
    /// Side of a block, metres.
    pub block_size_m: f32,
    /// Grid index of each block.
    pub block_indices: Vec<[i32; 3]>,
    /// The blocks; an empty one removes what was there.
    pub blocks: Vec<NvbloxBlock>,
    /// Whether all earlier blocks are dropped first.
    pub clear: bool,
}

/// Four empty sequences.
const MIN_BLOCK_BYTES: usize = 16;

impl<'a> Message<'a> for NvbloxMesh<'a> {
    const TYPE_NAME: &'static str = "nvblox_msgs/msg/Mesh";
    const SCHEMA: &'static str = schema::NVBLOX_MESH;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            block_size_m: reader.scalar("block_size_m")?,
            block_indices: reader.tuples("block_indices")?,
            blocks: reader.sequence("blocks", MIN_BLOCK_BYTES, |reader| {
                Ok(NvbloxBlock {
                    vertices_m: reader.tuples("blocks.vertices")?,
                    normals: reader.tuples("blocks.normals")?,
                    colors: reader.tuples("blocks.colors")?,
                    triangles: reader.scalars("blocks.triangles")?,
                })
            })?,
            clear: reader.bool("clear")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.scalar(self.block_size_m);
        writer.tuples(&self.block_indices);
        writer.sequence_len(self.blocks.len());
        for block in &self.blocks {
            writer.tuples(&block.vertices_m);
            writer.tuples(&block.normals);
            writer.tuples(&block.colors);
            writer.scalars(&block.triangles);
        }
        writer.bool(self.clear);
    }
}

impl NvbloxMesh<'_> {
    /// The blocks by grid index, in the header's frame.
    ///
    /// # Errors
    /// [`WireError`] when blocks and their indices differ in number, or a vertex index is out of
    /// range.
    pub fn to_update(&self) -> Result<(MeshUpdate, SoupReport), WireError> {
        if self.block_indices.len() != self.blocks.len() {
            return Err(WireError::Field {
                field: "block_indices",
                reason: format!(
                    "has {} entries for {} blocks",
                    self.block_indices.len(),
                    self.blocks.len()
                ),
            });
        }
        let mut total = SoupReport::default();
        let mut blocks = Vec::with_capacity(self.blocks.len());
        for (index, block) in self.block_indices.iter().zip(&self.blocks) {
            let name = || format!("block {index:?}");
            let indices = unsigned_indices(name, block)?;
            let triangles = geometry::triples(name, &indices)?;
            let (mesh, report) = geometry::mesh(name, &block.vertices_m, triangles)?;
            total = geometry::add_reports(total, report);
            blocks.push((MeshBlockKey(index.map(i64::from)), mesh));
        }
        let update = MeshUpdate::Blocks {
            clear: self.clear,
            blocks,
        };
        Ok((update, total))
    }
}

fn unsigned_indices(
    name: impl FnOnce() -> String,
    block: &NvbloxBlock,
) -> Result<Vec<u32>, WireError> {
    if let Some(at) = block.triangles.iter().position(|&index| index < 0) {
        return Err(WireError::Mesh {
            block: name(),
            error: MeshError::IndexOutOfRange {
                triangle: at / 3,
                index: i64::from(block.triangles[at]),
                num_vertices: block.vertices_m.len(),
            },
        });
    }
    Ok(block.triangles.iter().map(|i| i.cast_unsigned()).collect())
}
