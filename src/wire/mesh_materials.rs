//! `mesh_msgs/MeshMaterialsStamped`, `MeshVertexColorsStamped` and `MeshTexture`: how a mesh of
//! mesh_tools looks.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Image, Message, schema};

/// `mesh_msgs/MeshFaceCluster`.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct MeshFaceCluster<'a> {
    /// Faces of the cluster.
    pub face_indices: Vec<u32>,
    /// Its name; may be empty.
    pub label: &'a str,
}

/// `mesh_msgs/MeshMaterial`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshMaterial {
    /// Which texture, as the service `get_texture` counts them.
    pub texture_index: u32,
    /// RGBA in [0, 1].
    pub color: [f32; 4],
    /// Whether it has a texture.
    pub has_texture: bool,
}

/// `mesh_msgs/MeshMaterialsStamped`.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshMaterialsStamped<'a> {
    /// Stamp, and the frame of the mesh.
    pub header: WireHeader<'a>,
    /// Name of the mesh.
    pub uuid: &'a str,
    /// Faces that look alike.
    pub clusters: Vec<MeshFaceCluster<'a>>,
    /// The materials.
    pub materials: Vec<MeshMaterial>,
    /// Per cluster: its material.
    pub cluster_materials: Vec<u32>,
    /// Per vertex of the mesh: its place in the texture, in [0, 1].
    pub vertex_tex_coords: Vec<[f32; 2]>,
}

/// Two empty sequences.
const MIN_CLUSTER_BYTES: usize = 8;
/// An index, a colour, a flag.
const MIN_MATERIAL_BYTES: usize = 21;

impl<'a> Message<'a> for MeshMaterialsStamped<'a> {
    const TYPE_NAME: &'static str = "mesh_msgs/msg/MeshMaterialsStamped";
    const SCHEMA: &'static str = schema::MESH_MATERIALS_STAMPED;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            uuid: reader.string("uuid")?,
            clusters: reader.sequence("mesh_materials.clusters", MIN_CLUSTER_BYTES, |reader| {
                Ok(MeshFaceCluster {
                    face_indices: reader.scalars("mesh_materials.clusters.face_indices")?,
                    label: reader.string("mesh_materials.clusters.label")?,
                })
            })?,
            materials: reader.sequence(
                "mesh_materials.materials",
                MIN_MATERIAL_BYTES,
                |reader| {
                    Ok(MeshMaterial {
                        texture_index: reader.scalar("mesh_materials.materials.texture_index")?,
                        color: reader.array("mesh_materials.materials.color")?,
                        has_texture: reader.bool("mesh_materials.materials.has_texture")?,
                    })
                },
            )?,
            cluster_materials: reader.scalars("mesh_materials.cluster_materials")?,
            vertex_tex_coords: reader.tuples("mesh_materials.vertex_tex_coords")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.string(self.uuid);
        writer.sequence_len(self.clusters.len());
        for cluster in &self.clusters {
            writer.scalars(&cluster.face_indices);
            writer.string(cluster.label);
        }
        writer.sequence_len(self.materials.len());
        for material in &self.materials {
            writer.scalar(material.texture_index);
            writer.array(&material.color);
            writer.bool(material.has_texture);
        }
        writer.scalars(&self.cluster_materials);
        writer.tuples(&self.vertex_tex_coords);
    }
}

/// `mesh_msgs/MeshVertexColorsStamped`.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshVertexColorsStamped<'a> {
    /// Stamp, and the frame of the mesh.
    pub header: WireHeader<'a>,
    /// Name of the mesh.
    pub uuid: &'a str,
    /// Per vertex: RGBA in [0, 1].
    pub vertex_colors: Vec<[f32; 4]>,
}

impl<'a> Message<'a> for MeshVertexColorsStamped<'a> {
    const TYPE_NAME: &'static str = "mesh_msgs/msg/MeshVertexColorsStamped";
    const SCHEMA: &'static str = schema::MESH_VERTEX_COLORS_STAMPED;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            uuid: reader.string("uuid")?,
            vertex_colors: reader.tuples("mesh_vertex_colors.vertex_colors")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.string(self.uuid);
        writer.tuples(&self.vertex_colors);
    }
}

/// `mesh_msgs/MeshTexture`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshTexture<'a> {
    /// Name of the mesh.
    pub uuid: &'a str,
    /// Which texture of it.
    pub texture_index: u32,
    /// The texture.
    pub image: Image<'a>,
}

impl<'a> Message<'a> for MeshTexture<'a> {
    const TYPE_NAME: &'static str = "mesh_msgs/msg/MeshTexture";
    const SCHEMA: &'static str = schema::MESH_TEXTURE;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            uuid: reader.string("uuid")?,
            texture_index: reader.scalar("texture_index")?,
            image: Image::read(reader)?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.string(self.uuid);
        writer.scalar(self.texture_index);
        self.image.write(writer);
    }
}
