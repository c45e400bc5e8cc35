//! A mesh from a file, whatever its format.

use std::path::{Path, PathBuf};

use nalgebra::Point3;

use crate::mesh::{MeshError, SoupReport, TriMesh};

use super::obj::{self, ObjError};
use super::ply::{self, PlyError};

/// Why a mesh file was refused.
#[derive(Debug, thiserror::Error)]
pub enum MeshFileError {
    /// The file cannot be read.
    #[error("cannot read the mesh {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The ending is neither `.ply` nor `.obj`.
    #[error("the mesh {path} is neither .ply nor .obj")]
    Format {
        /// The file.
        path: PathBuf,
    },
    /// The PLY file is damaged or holds no mesh.
    #[error("the mesh {path} is refused: {source}")]
    Ply {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: PlyError,
    },
    /// The OBJ file is damaged or holds no mesh.
    #[error("the mesh {path} is refused: {source}")]
    Obj {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: ObjError,
    },
    /// The indices and vertices do not make a mesh.
    #[error("the mesh {path} is refused: {source}")]
    Mesh {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: MeshError,
    },
}

/// What was left out of a mesh file, and what was changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MeshFileReport {
    /// Faces of more than three corners that were cut into triangles.
    pub num_cut_polygons: usize,
    /// Faces of fewer than three corners, left out.
    pub num_incomplete_faces: usize,
    /// What was not finite, left out.
    pub soup: SoupReport,
}

/// Vertices and faces as a file has them, cut into triangles but not checked.
#[derive(Debug, Default)]
pub struct Polygons {
    /// Vertex positions in metres.
    pub positions_m: Vec<Point3<f64>>,
    /// Vertex indices, not checked against the vertices.
    pub triangles: Vec<[u32; 3]>,
    /// Faces of more than three corners.
    pub num_cut_polygons: usize,
    /// Faces of fewer than three corners.
    pub num_incomplete_faces: usize,
}

impl Polygons {
    pub(super) fn reserve(&mut self, num_faces: usize) {
        self.triangles.reserve(num_faces);
    }

    /// Adds a face as a fan around its first corner (right for convex faces).
    pub(super) fn push(&mut self, corners: &[u32]) {
        let [first, rest @ ..] = corners else {
            self.num_incomplete_faces += 1;
            return;
        };
        self.triangles
            .extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
        match corners.len() {
            0..3 => self.num_incomplete_faces += 1,
            3 => {}
            _ => self.num_cut_polygons += 1,
        }
    }

    /// The mesh, and what was left out of it.
    ///
    /// # Errors
    /// [`MeshError`] when an index names no vertex.
    pub fn into_mesh(self) -> Result<(TriMesh, MeshFileReport), MeshError> {
        let (mesh, soup) = TriMesh::from_soup(self.positions_m, self.triangles)?;
        let report = MeshFileReport {
            num_cut_polygons: self.num_cut_polygons,
            num_incomplete_faces: self.num_incomplete_faces,
            soup,
        };
        Ok((mesh, report))
    }
}

/// Reads a `.ply` or `.obj` file (by its ending). Positions are in metres in the file's own frame.
///
/// # Errors
/// [`MeshFileError`] when the file cannot be read or is damaged.
pub fn read(path: &Path) -> Result<(TriMesh, MeshFileReport), MeshFileError> {
    let path = path.to_owned();
    let ending = path
        .extension()
        .map(|ending| ending.to_ascii_lowercase())
        .unwrap_or_default();
    if ending != "ply" && ending != "obj" {
        return Err(MeshFileError::Format { path });
    }
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(source) => return Err(MeshFileError::Read { path, source }),
    };
    let polygons = if ending == "ply" {
        ply::parse(&bytes).map_err(|source| MeshFileError::Ply {
            path: path.clone(),
            source,
        })?
    } else {
        obj::parse(&bytes).map_err(|source| MeshFileError::Obj {
            path: path.clone(),
            source,
        })?
    };
    polygons
        .into_mesh()
        .map_err(|source| MeshFileError::Mesh { path, source })
}
