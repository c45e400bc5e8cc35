//! A textured mesh that was made elsewhere: any number of images, coordinates per triangle corner,
//! colours per vertex.
//!
//! Texture coordinates are in [0, 1] of their image, v down; outside they go on as the material's
//! [`Wrap`] says. A triangle's colour is its material's image times its factor (in linear light);
//! without an image the vertices' colours; without those the factor alone.

use std::sync::Arc;

use nalgebra::Point3;

use super::{MeshError, TriMesh};
use crate::geom::{ColorImage, RigidTransform};

/// What lies outside of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Wrap {
    /// The image again.
    #[default]
    Repeat,
    /// The image mirrored, then again.
    Mirror,
    /// Its border.
    Clamp,
}

/// What triangles are painted with.
#[derive(Clone, Debug)]
pub struct Material {
    /// The image, where there is one.
    pub image: Option<Arc<ColorImage>>,
    /// What it is multiplied with, linear.
    pub factor: [f32; 3],
    /// Along u and v.
    pub wrap: [Wrap; 2],
}

impl Default for Material {
    fn default() -> Self {
        Self {
            image: None,
            factor: [1.0; 3],
            wrap: [Wrap::Repeat; 2],
        }
    }
}

/// Why parts do not make a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// Triangles and vertices do not make a mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// There is no triangle.
    #[error("there is no triangle")]
    Empty,
    /// A list does not have one value for each.
    #[error("{actual} {what} for {expected}")]
    Length {
        /// What is listed.
        what: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        actual: usize,
    },
    /// A triangle's material is not there.
    #[error("triangle {triangle} has material {material} of {num_materials}")]
    Material {
        /// Which triangle.
        triangle: usize,
        /// Its material.
        material: u32,
        /// How many there are.
        num_materials: usize,
    },
}

/// The parts of a model, not yet checked.
#[derive(Clone, Debug, Default)]
pub struct ModelParts {
    /// Vertices, metres.
    pub positions_m: Vec<Point3<f64>>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle: which material.
    pub materials_of_triangles: Vec<u32>,
    /// Per triangle: coordinates of its corners, v down; not finite where there are none.
    pub corners_uv: Vec<[[f32; 2]; 3]>,
    /// The materials.
    pub materials: Vec<Material>,
    /// Per vertex: sRGB bytes; empty where vertices have no colour.
    pub vertex_srgb: Vec<[u8; 3]>,
}

/// A textured mesh.
#[derive(Clone, Debug)]
pub struct TexturedModel {
    mesh: TriMesh,
    parts: ModelParts,
    num_dropped_triangles: usize,
}

impl TexturedModel {
    /// Checks the parts. Triangles at vertices that are not finite are dropped.
    ///
    /// # Errors
    /// [`ModelError`] when the parts do not fit each other or no triangle is left.
    pub fn new(mut parts: ModelParts) -> Result<Self, ModelError> {
        let num_triangles = parts.triangles.len();
        let check = |what, actual, expected| {
            if actual == expected {
                Ok(())
            } else {
                Err(ModelError::Length {
                    what,
                    expected,
                    actual,
                })
            }
        };
        let num_materials = parts.materials.len();
        check(
            "materials of triangles",
            parts.materials_of_triangles.len(),
            num_triangles,
        )?;
        check(
            "triples of coordinates",
            parts.corners_uv.len(),
            num_triangles,
        )?;
        if !parts.vertex_srgb.is_empty() {
            let num_vertices = parts.positions_m.len();
            check("vertex colours", parts.vertex_srgb.len(), num_vertices)?;
        }
        let mut of_triangles = parts.materials_of_triangles.iter().enumerate();
        if let Some((triangle, &material)) =
            of_triangles.find(|(_, material)| **material as usize >= num_materials)
        {
            return Err(ModelError::Material {
                triangle,
                material,
                num_materials,
            });
        }

        // An index that is out of range is left for the mesh to refuse.
        let is_whole = |corners: &[u32; 3]| {
            corners.iter().all(|&v| {
                let position = parts.positions_m.get(v as usize);
                position.is_none_or(|p| p.coords.iter().all(|c| c.is_finite()))
            })
        };
        let kept: Vec<bool> = parts.triangles.iter().map(is_whole).collect();
        keep(&mut parts.triangles, &kept);
        keep(&mut parts.materials_of_triangles, &kept);
        keep(&mut parts.corners_uv, &kept);
        if parts.triangles.is_empty() {
            return Err(ModelError::Empty);
        }
        let (mesh, _) = TriMesh::from_soup(
            std::mem::take(&mut parts.positions_m),
            std::mem::take(&mut parts.triangles),
        )?;
        Ok(Self {
            num_dropped_triangles: num_triangles - mesh.num_triangles(),
            mesh,
            parts,
        })
    }

    /// The mesh.
    pub fn mesh(&self) -> &TriMesh {
        &self.mesh
    }

    /// A triangle's material.
    pub fn material_of(&self, triangle: usize) -> &Material {
        &self.parts.materials[self.parts.materials_of_triangles[triangle] as usize]
    }

    /// A triangle's texture coordinates, v down.
    pub fn corners_uv(&self, triangle: usize) -> &[[f32; 2]; 3] {
        &self.parts.corners_uv[triangle]
    }

    /// Colours of the vertices, where they have some.
    pub fn vertex_srgb(&self) -> Option<&[[u8; 3]]> {
        let colors = &self.parts.vertex_srgb;
        (!colors.is_empty()).then_some(colors)
    }

    /// Triangles left out because a vertex was not finite.
    pub fn num_dropped_triangles(&self) -> usize {
        self.num_dropped_triangles
    }

    /// The same model in another frame.
    #[must_use]
    pub fn transformed(mut self, dst_from_src: &RigidTransform) -> Self {
        self.mesh = self.mesh.transformed(dst_from_src);
        self
    }
}

fn keep<T>(values: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    values.retain(|_| kept.next().is_some_and(|&is_kept| is_kept));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> ModelParts {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        ModelParts {
            positions_m: corners.map(|[x, y]| Point3::new(x, y, 0.0)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            materials_of_triangles: vec![0, 1],
            corners_uv: vec![[[0.25; 2]; 3], [[0.75; 2]; 3]],
            materials: vec![Material::default(); 2],
            vertex_srgb: Vec::new(),
        }
    }

    #[test]
    fn attributes_stay_with_their_triangles() {
        let mut parts = square();
        parts.positions_m[1].z = f64::NAN;
        let model = TexturedModel::new(parts).unwrap();
        assert_eq!(model.num_dropped_triangles(), 1);
        assert_eq!(model.mesh().triangles(), &[[0, 2, 3]]);
        assert_eq!(model.corners_uv(0), &[[0.75; 2]; 3]);
    }

    #[test]
    fn parts_that_do_not_fit_are_refused() {
        let refuse = |change: &dyn Fn(&mut ModelParts)| {
            let mut parts = square();
            change(&mut parts);
            TexturedModel::new(parts).unwrap_err().to_string()
        };
        assert_eq!(
            refuse(&|p| p.materials_of_triangles[1] = 2),
            "triangle 1 has material 2 of 2"
        );
        assert!(refuse(&|p| p.triangles[0][1] = 9).contains('9'));
        assert!(refuse(&|p| p.vertex_srgb.push([0; 3])).contains("vertex colours"));
        assert!(refuse(&|p| p.corners_uv.truncate(1)).contains("coordinates"));
        let empty = TexturedModel::new(ModelParts::default()).unwrap_err();
        assert_eq!(empty, ModelError::Empty);
    }
}
