//! Textured PLY: per face `texcoord` (v up) and `texnumber` with `comment TextureFile NAME`, as
//! MeshLab writes them, or colours per vertex.

use super::{ModelFile, ModelFileError};
use crate::import::ply;
use crate::mesh::{Material, ModelParts, Wrap};

pub(super) fn read(file: &ModelFile<'_>) -> Result<ModelParts, ModelFileError> {
    let bytes = file.bytes()?;
    let read = ply::parse_textured(&bytes).map_err(|source| ModelFileError::Ply {
        path: file.path.to_owned(),
        source,
    })?;
    let mut parts = ModelParts {
        positions_m: read.polygons.positions_m,
        triangles: read.polygons.triangles,
        materials_of_triangles: read.texture_of_triangles,
        corners_uv: read.corners_uv,
        vertex_srgb: read.vertex_srgb,
        ..ModelParts::default()
    };
    for name in &read.texture_files {
        parts.materials.push(Material {
            image: Some(file.image_beside(name)?),
            wrap: [Wrap::Repeat; 2],
            ..Material::default()
        });
    }
    if parts.materials.is_empty() {
        parts.materials.push(Material::default());
        parts.materials_of_triangles.fill(0);
        if parts.vertex_srgb.is_empty() {
            return Err(file.refuse("it has neither a texture nor colours"));
        }
    }
    Ok(parts)
}
