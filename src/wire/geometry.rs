//! The shared parts of `geometry_msgs`: points, quaternions, poses.

use nalgebra::Point3;

use crate::geom::{FrameError, RigidTransform};
use crate::mesh::{MeshError, SoupReport, TriMesh};

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;

/// `geometry_msgs/Pose`, and with the same layout `geometry_msgs/Transform`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WirePose {
    /// Position (translation), metres.
    pub position_m: [f64; 3],
    /// Orientation (rotation) x, y, z, w.
    pub quaternion_xyzw: [f64; 4],
}

impl WirePose {
    /// The pose of a frame in itself.
    pub const IDENTITY: Self = Self {
        position_m: [0.0; 3],
        quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
    };

    pub(super) const NUM_BYTES: usize = 56;

    pub(super) fn read(
        reader: &mut CdrReader<'_>,
        position: &'static str,
        orientation: &'static str,
    ) -> Result<Self, WireError> {
        Ok(Self {
            position_m: reader.array(position)?,
            quaternion_xyzw: reader.array(orientation)?,
        })
    }

    pub(super) fn write(&self, writer: &mut CdrWriter) {
        writer.array(&self.position_m);
        writer.array(&self.quaternion_xyzw);
    }

    /// The transform that maps a point given in the posed frame to the frame of the pose.
    ///
    /// # Errors
    /// [`FrameError`] when a component is not finite or the quaternion is not a rotation.
    pub fn to_transform(&self) -> Result<RigidTransform, FrameError> {
        RigidTransform::try_from_quaternion(self.quaternion_xyzw, self.position_m)
    }
}

impl From<&RigidTransform> for WirePose {
    fn from(transform: &RigidTransform) -> Self {
        Self {
            position_m: (*transform.translation()).into(),
            quaternion_xyzw: transform.quaternion_xyzw(),
        }
    }
}

/// A mesh of wire vertices and index triples; `block` names it in the error.
pub(super) fn mesh<T: Copy + Into<f64>>(
    block: impl FnOnce() -> String,
    vertices_m: &[[T; 3]],
    triangles: Vec<[u32; 3]>,
) -> Result<(TriMesh, SoupReport), WireError> {
    let positions_m = vertices_m
        .iter()
        .map(|v| Point3::from(v.map(Into::into)))
        .collect();
    TriMesh::from_soup(positions_m, triangles).map_err(|error| WireError::Mesh {
        block: block(),
        error,
    })
}

/// Index triples of a flat list.
pub(super) fn triples(
    block: impl FnOnce() -> String,
    indices: &[u32],
) -> Result<Vec<[u32; 3]>, WireError> {
    let (triples, rest) = indices.as_chunks::<3>();
    if rest.is_empty() {
        return Ok(triples.to_vec());
    }
    Err(WireError::Mesh {
        block: block(),
        error: MeshError::IncompleteTriangle {
            num_indices: indices.len(),
        },
    })
}

/// The sum of two reports.
pub(super) fn add_reports(a: SoupReport, b: SoupReport) -> SoupReport {
    SoupReport {
        num_non_finite_vertices: a.num_non_finite_vertices + b.num_non_finite_vertices,
        num_dropped_triangles: a.num_dropped_triangles + b.num_dropped_triangles,
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "Point32 is what the message has"
)]
/// Positions as `geometry_msgs/Point32`.
pub(super) fn points32(mesh: &TriMesh) -> Vec<[f32; 3]> {
    let positions = mesh.positions_m().iter();
    positions
        .map(|p| [p.x as f32, p.y as f32, p.z as f32])
        .collect()
}

/// Positions as `geometry_msgs/Point`.
pub(super) fn points64(mesh: &TriMesh) -> Vec<[f64; 3]> {
    mesh.positions_m().iter().map(|p| [p.x, p.y, p.z]).collect()
}
