//! Wavefront OBJ with its MTL: `map_Kd`, else the vertices' colours, else `Kd`.

use nalgebra::Point3;

use super::{ModelFile, ModelFileError};
use crate::geom::color::srgb_from_linear;
use crate::mesh::{Material, ModelParts};

pub(super) fn read(file: &ModelFile<'_>) -> Result<ModelParts, ModelFileError> {
    let bytes = file.bytes()?;
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..tobj::LoadOptions::default()
    };
    let load_materials = |name: &std::path::Path| {
        let text = file
            .beside(&name.to_string_lossy())
            .map_err(|_| tobj::LoadError::OpenFileFailed)?;
        tobj::load_mtl_buf(&mut text.as_slice())
    };
    let (models, materials) =
        tobj::load_obj_buf(&mut bytes.as_slice(), &options, load_materials)
            .map_err(|error| file.refuse(format!("not a readable OBJ file: {error}")))?;
    let materials =
        materials.map_err(|error| file.refuse(format!("its material file: {error}")))?;

    let mut parts = ModelParts::default();
    for material in &materials {
        parts.materials.push(convert(file, material)?);
    }
    // For what uses no material.
    parts.materials.push(Material::default());
    let none = u32::try_from(materials.len()).map_err(|_| file.refuse("too many materials"))?;
    let num_vertices: usize = models.iter().map(|m| m.mesh.positions.len() / 3).sum();
    let is_colored = models.iter().any(|m| !m.mesh.vertex_color.is_empty());
    for tobj::Model { mesh, .. } in models {
        let material = match mesh.material_id {
            Some(id) => u32::try_from(id).map_err(|_| file.refuse("too many materials"))?,
            None => none,
        };
        push_mesh(file, &mesh, material, &mut parts)?;
        if is_colored {
            push_colors(&mesh, &mut parts);
        }
    }
    debug_assert_eq!(parts.positions_m.len(), num_vertices);
    Ok(parts)
}

fn convert(file: &ModelFile<'_>, material: &tobj::Material) -> Result<Material, ModelFileError> {
    let Some(statement) = &material.diffuse_texture else {
        return Ok(Material {
            factor: material.diffuse.unwrap_or([1.0; 3]),
            ..Material::default()
        });
    };
    Ok(Material {
        // `map_Kd` may have options before its file's name.
        image: Some(match file.image_beside(statement) {
            Err(ModelFileError::Read { .. }) if statement.starts_with('-') => {
                let name = statement
                    .split_whitespace()
                    .next_back()
                    .unwrap_or(statement);
                file.image_beside(name)?
            }
            other => other?,
        }),
        ..Material::default()
    })
}

fn push_mesh(
    file: &ModelFile<'_>,
    mesh: &tobj::Mesh,
    material: u32,
    parts: &mut ModelParts,
) -> Result<(), ModelFileError> {
    let first =
        u32::try_from(parts.positions_m.len()).map_err(|_| file.refuse("too many vertices"))?;
    let positions = mesh.positions.chunks_exact(3);
    parts
        .positions_m
        .extend(positions.map(|p| Point3::new(p[0], p[1], p[2]).cast::<f64>()));
    let has_uv = !mesh.texcoord_indices.is_empty();
    if has_uv && mesh.texcoord_indices.len() != mesh.indices.len() {
        return Err(
            file.refuse("some faces of a group have texture coordinates and some have none")
        );
    }
    for (at, corners) in mesh.indices.chunks_exact(3).enumerate() {
        let mut triangle = [0; 3];
        let mut corners_uv = [[f32::NAN; 2]; 3];
        for (corner, &index) in corners.iter().enumerate() {
            if index as usize >= mesh.positions.len() / 3 {
                return Err(file.refuse(format!("a face has vertex {index} that is not there")));
            }
            triangle[corner] = first
                .checked_add(index)
                .ok_or_else(|| file.refuse("too many vertices"))?;
            if has_uv {
                let uv = mesh.texcoord_indices[3 * at + corner] as usize;
                let Some([u, v]) = mesh.texcoords.get(2 * uv..2 * uv + 2) else {
                    return Err(file.refuse(format!(
                        "a face has texture coordinate {uv} that is not there"
                    )));
                };
                corners_uv[corner] = [*u, 1.0 - v];
            }
        }
        parts.triangles.push(triangle);
        parts.corners_uv.push(corners_uv);
        parts.materials_of_triangles.push(material);
    }
    Ok(())
}

/// Colours per vertex, in [0, 1] as sRGB; white for groups without.
fn push_colors(mesh: &tobj::Mesh, parts: &mut ModelParts) {
    let num_missing = parts.positions_m.len() - parts.vertex_srgb.len();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped; NaN becomes 0"
    )]
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let colors = mesh.vertex_color.chunks_exact(3);
    parts.vertex_srgb.extend(
        colors
            .take(num_missing)
            .map(|c| [c[0], c[1], c[2]].map(byte)),
    );
    let white = srgb_from_linear(1.0);
    parts
        .vertex_srgb
        .resize(parts.positions_m.len(), [white; 3]);
}
