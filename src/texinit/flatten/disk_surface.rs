//! One connected surface flattened to a boundary of the caller's choice: the conformal maps of
//! Sawhney and Crane (2018) by themselves, without charts, bounds or splitting.
//!
//! A [`DiskSurface`] is a mesh made manifold, its small holes filled and what then remains cut, so
//! that it is a disk with one boundary loop ([`super::cut`]). Its boundary vertices are listed in
//! order, the surface on the left; [`Boundary`] gives each a log scale factor or an exterior angle,
//! in that order. What comes out is not scaled to the surface's area: lengths are those that the
//! boundary asks for, metres.
//!
//! A conformal map scales lengths at every point by e^u. On a mesh this holds in the limit of small
//! triangles; [`DiskMap::distortion`] says how well it holds, [`DiskMap::closure`] how far the
//! boundary asked for was from closing.

use super::bff::{BffError, Boundary, Closure, flatten_disk};
use super::chart_solve::in_mesh_order;
use super::cut::{Disk, make_disk};
use super::distortion::{ChartDistortion, Stretch, stretch, summarize};
use super::laplacian::{Metric, edge_weights};
use crate::mesh::components::components;
use crate::mesh::{Manifold, MeshError, TriMesh};

/// Why a surface was not flattened.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DiskError {
    /// The mesh is empty or falls into pieces (a triangle that names a position twice is one).
    #[error("a mesh of {num_pieces} pieces is not one connected surface")]
    NotConnected {
        /// How many pieces.
        num_pieces: usize,
    },
    /// It is no disk even after it was cut.
    #[error("the surface could not be cut to a disk")]
    NotADisk,
    /// As many numbers are needed as there are boundary vertices.
    #[error("{num_given} boundary values for {num_boundary} boundary vertices")]
    WrongCount {
        /// How many there were.
        num_given: usize,
        /// How many boundary vertices there are.
        num_boundary: usize,
    },
    /// A boundary value is not finite.
    #[error("boundary value {index} is {value}")]
    NotFinite {
        /// Which.
        index: usize,
        /// What it is.
        value: f64,
    },
    /// The mesh cannot be indexed.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The map could not be computed.
    #[error(transparent)]
    Solve(#[from] BffError),
}

/// A mesh as a topological disk.
#[derive(Debug, Clone)]
pub struct DiskSurface {
    manifold: Manifold,
    disk: Disk,
    mesh_vertices: Vec<Option<u32>>,
    boundary: Vec<u32>,
}

/// A disk in the plane.
#[derive(Debug, Clone, PartialEq)]
pub struct DiskMap {
    /// Per triangle of the mesh, its corners in the mesh's corner order, metres, y up;
    /// counter-clockwise where the mesh's orientation was kept.
    pub corners_m: Vec<[[f64; 2]; 3]>,
    /// Per vertex of the disk, the log scale factor u that was solved for.
    pub log_scale: Vec<f64>,
    /// How far it is from the surface, lengths and areas as they are.
    pub distortion: ChartDistortion,
    /// How well its boundary closed.
    pub closure: Closure,
}

impl DiskSurface {
    /// Makes a connected mesh a disk.
    ///
    /// # Errors
    /// [`DiskError`] when it is not connected or cannot be cut to a disk.
    pub fn new(mesh: &TriMesh) -> Result<Self, DiskError> {
        let manifold = Manifold::new(mesh)?;
        let (_, num_pieces) = components(manifold.mates());
        if num_pieces != 1 {
            return Err(DiskError::NotConnected {
                num_pieces: num_pieces as usize,
            });
        }
        let corners_m = mesh
            .triangle_ids()
            .map(|t| manifold.oriented_corners_m(mesh, t))
            .collect();
        let disk = make_disk(corners_m, manifold.mates().to_vec()).ok_or(DiskError::NotADisk)?;
        let mut mesh_vertices = vec![None; disk.num_vertices];
        for (triangle, local) in mesh.triangle_ids().zip(&disk.vertices) {
            let welded = manifold.welded_triangles()[triangle.index()];
            for (&local, global) in local.iter().zip(in_mesh_order(welded, triangle, &manifold)) {
                mesh_vertices[local as usize] = Some(global);
            }
        }
        let start = |&h: &u32| disk.vertices[h as usize / 3][h as usize % 3];
        let boundary = disk.boundary.iter().map(start).collect();
        Ok(Self {
            manifold,
            disk,
            mesh_vertices,
            boundary,
        })
    }

    /// Boundary vertices of the disk in order, the surface on the left.
    pub fn boundary(&self) -> &[u32] {
        &self.boundary
    }

    /// Per vertex of the disk the vertex of the mesh that it is (several may be copies of one, along
    /// a cut); none at the centre of a hole that was filled.
    pub fn mesh_vertices(&self) -> &[Option<u32>] {
        &self.mesh_vertices
    }

    /// The cotangent Laplacian's off-diagonal weights, each edge once as (vertex, vertex,
    /// ½ (cot α + cot β)) in vertices of the disk.
    ///
    /// # Errors
    /// [`DiskError::Solve`] where lengths are zero or not finite.
    pub fn laplacian(&self) -> Result<Vec<(u32, u32, f64)>, DiskError> {
        let metric = Metric::new(&self.disk.corners_m).ok_or(BffError::NoMetric)?;
        Ok(edge_weights(&self.disk.mates, &self.disk.vertices, &metric))
    }

    /// Flattens it to the given boundary.
    ///
    /// # Errors
    /// [`DiskError`] when the boundary's values are too few, too many or not finite, or when the
    /// map cannot be computed: above all when no curve of such angles and lengths closes.
    pub fn flatten(&self, boundary: Boundary<'_>) -> Result<DiskMap, DiskError> {
        if let Boundary::LogScale(values) | Boundary::ExteriorAngles(values) = boundary {
            if values.len() != self.boundary.len() {
                return Err(DiskError::WrongCount {
                    num_given: values.len(),
                    num_boundary: self.boundary.len(),
                });
            }
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                return Err(DiskError::NotFinite {
                    index,
                    value: values[index],
                });
            }
        }
        let flat = flatten_disk(&self.disk, boundary)?;
        let oriented: Vec<[[f64; 2]; 3]> = self.disk.vertices[..self.disk.num_real]
            .iter()
            .map(|corners| corners.map(|v| flat.points_m[v as usize]))
            .collect();
        let stretches: Vec<Stretch> = self
            .disk
            .corners_m
            .iter()
            .zip(&oriented)
            .filter_map(|(surface, flat)| stretch(surface, flat))
            .collect();
        Ok(DiskMap {
            corners_m: (0_u32..)
                .map(crate::mesh::TriangleId)
                .zip(oriented)
                .map(|(triangle, corners)| in_mesh_order(corners, triangle, &self.manifold))
                .collect(),
            log_scale: flat.log_scale,
            distortion: summarize(&stretches),
            closure: flat.closure,
        })
    }
}
