//! `visualization_msgs/Marker`: triangle lists, keyed by namespace and id as rviz keys them.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Point3;

use crate::geom::RigidTransform;
use crate::ingest::event::MeshBlockKey;
use crate::ingest::{Header, MeshUpdate};
use crate::mesh::{MeshError, SoupReport, TriMesh};

use super::cdr::{CdrReader, CdrWriter};
use super::compressed_image::CompressedImage;
use super::error::WireError;
use super::geometry::{self, WirePose};
use super::header::WireHeader;
use super::{Message, schema};

/// `type` of a triangle list.
pub const TRIANGLE_LIST: i32 = 11;
/// `action` that adds or replaces.
pub const ADD: i32 = 0;
/// `action` that removes one marker.
pub const DELETE: i32 = 2;
/// `action` that removes all.
pub const DELETE_ALL: i32 = 3;

/// `visualization_msgs/Marker`.
#[derive(Clone, Debug, PartialEq)]
pub struct Marker<'a> {
    /// Stamp, and the frame of the pose.
    pub header: WireHeader<'a>,
    /// Namespace of the id.
    pub ns: &'a str,
    /// Identity within the namespace.
    pub id: i32,
    /// What is drawn; [`TRIANGLE_LIST`] is what matters here.
    pub kind: i32,
    /// [`ADD`], [`DELETE`] or [`DELETE_ALL`].
    pub action: i32,
    /// Pose of the points' frame.
    pub pose: WirePose,
    /// Factor on the points along each axis.
    pub scale: [f64; 3],
    /// RGBA in [0, 1].
    pub color: [f32; 4],
    /// Seconds and nanoseconds until it vanishes; 0 = never.
    pub lifetime: (i32, u32),
    /// Whether it moves with its frame.
    pub frame_locked: bool,
    /// Corners, three a triangle.
    pub points: Vec<[f64; 3]>,
    /// Colours of the corners or triangles; may be empty.
    pub colors: Vec<[f32; 4]>,
    /// What follows in the message, where its release has these fields.
    pub tail: MarkerTail<'a>,
}

/// The fields that Humble and later put behind the colours (older releases have only `text`,
/// `mesh_resource` and `mesh_use_embedded_materials`).
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerTail<'a> {
    /// Where the texture is.
    pub texture_resource: &'a str,
    /// The texture itself.
    pub texture: CompressedImage<'a>,
    /// Texture coordinates, one a point.
    pub uv_coordinates: Vec<[f32; 2]>,
    /// Text to show.
    pub text: &'a str,
    /// Where the mesh is.
    pub mesh_resource: &'a str,
    /// Name of the mesh file.
    pub mesh_filename: &'a str,
    /// The mesh file.
    pub mesh_data: &'a [u8],
    /// Whether the mesh file brings its materials.
    pub mesh_use_embedded_materials: bool,
}

impl Default for MarkerTail<'_> {
    fn default() -> Self {
        Self {
            texture_resource: "",
            texture: CompressedImage {
                header: WireHeader::default(),
                format: "".into(),
                data: (&[][..]).into(),
            },
            uv_coordinates: Vec::new(),
            text: "",
            mesh_resource: "",
            mesh_filename: "",
            mesh_data: &[],
            mesh_use_embedded_materials: false,
        }
    }
}

/// Bytes of a marker whose strings and sequences are empty, without its tail.
pub(super) const MIN_BYTES: usize = 140;

impl<'a> Message<'a> for Marker<'a> {
    const TYPE_NAME: &'static str = "visualization_msgs/msg/Marker";
    const SCHEMA: &'static str = schema::MARKER;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            ns: reader.string("ns")?,
            id: reader.scalar("id")?,
            kind: reader.scalar("type")?,
            action: reader.scalar("action")?,
            pose: WirePose::read(reader, "pose.position", "pose.orientation")?,
            scale: reader.array("scale")?,
            color: reader.array("color")?,
            lifetime: (
                reader.scalar("lifetime.sec")?,
                reader.scalar("lifetime.nanosec")?,
            ),
            frame_locked: reader.bool("frame_locked")?,
            points: reader.tuples("points")?,
            colors: reader.tuples("colors")?,
            tail: MarkerTail {
                texture_resource: reader.string("texture_resource")?,
                texture: CompressedImage::read(reader)?,
                uv_coordinates: reader.tuples("uv_coordinates")?,
                text: reader.string("text")?,
                mesh_resource: reader.string("mesh_resource")?,
                mesh_filename: reader.string("mesh_file.filename")?,
                mesh_data: reader.bytes("mesh_file.data")?,
                mesh_use_embedded_materials: reader.bool("mesh_use_embedded_materials")?,
            },
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.string(self.ns);
        writer.scalar(self.id);
        writer.scalar(self.kind);
        writer.scalar(self.action);
        self.pose.write(writer);
        writer.array(&self.scale);
        writer.array(&self.color);
        writer.scalar(self.lifetime.0);
        writer.scalar(self.lifetime.1);
        writer.bool(self.frame_locked);
        writer.tuples(&self.points);
        writer.tuples(&self.colors);
        writer.string(self.tail.texture_resource);
        self.tail.texture.write(writer);
        writer.tuples(&self.tail.uv_coordinates);
        writer.string(self.tail.text);
        writer.string(self.tail.mesh_resource);
        writer.string(self.tail.mesh_filename);
        writer.bytes(self.tail.mesh_data);
        writer.bool(self.tail.mesh_use_embedded_materials);
    }
}

impl<'a> Marker<'a> {
    /// A triangle list of a mesh, white, in the header's frame.
    pub fn from_mesh(header: WireHeader<'a>, ns: &'a str, id: i32, mesh: &TriMesh) -> Self {
        let corners = mesh.triangle_ids().flat_map(|t| mesh.corners_m(t));
        Self {
            header,
            ns,
            id,
            kind: TRIANGLE_LIST,
            action: ADD,
            pose: WirePose::IDENTITY,
            scale: [1.0; 3],
            color: [1.0; 4],
            lifetime: (0, 0),
            frame_locked: false,
            points: corners.map(|p| [p.x, p.y, p.z]).collect(),
            colors: Vec::new(),
            tail: MarkerTail::default(),
        }
    }

    fn name(&self) -> String {
        format!("marker '{}'/{}", self.ns, self.id)
    }

    /// The points in the header's frame, three vertices of its own for each triangle.
    fn to_mesh(&self) -> Result<(TriMesh, SoupReport), WireError> {
        if !self.points.len().is_multiple_of(3) {
            return Err(WireError::Mesh {
                block: self.name(),
                error: MeshError::IncompleteTriangle {
                    num_indices: self.points.len(),
                },
            });
        }
        if self.scale.iter().any(|s| !s.is_finite() || *s == 0.0) {
            return Err(WireError::Field {
                field: "scale",
                reason: format!(
                    "{:?} of {} flattens its triangles (rviz refuses it too)",
                    self.scale,
                    self.name()
                ),
            });
        }
        let frame_from_points = self.pose_or_identity()?;
        let [sx, sy, sz] = self.scale;
        let scaled = |&[x, y, z]: &[f64; 3]| {
            frame_from_points.transform_point(&Point3::new(x * sx, y * sy, z * sz))
        };
        let points: Vec<[f64; 3]> = self.points.iter().map(|p| scaled(p).into()).collect();
        let num_points = u32::try_from(points.len()).map_err(|_| WireError::Mesh {
            block: self.name(),
            error: MeshError::TooLarge {
                num_vertices: points.len(),
                num_triangles: points.len() / 3,
            },
        })?;
        let triangles = (0..num_points / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]);
        geometry::mesh(|| self.name(), &points, triangles.collect())
    }

    /// An all-zero orientation, the usual sign of a pose nobody set, is the identity, as in rviz.
    fn pose_or_identity(&self) -> Result<RigidTransform, WireError> {
        let mut pose = self.pose;
        if pose.quaternion_xyzw == [0.0; 4] {
            pose.quaternion_xyzw = WirePose::IDENTITY.quaternion_xyzw;
        }
        pose.to_transform().map_err(|error| WireError::Frame {
            field: format!("pose of {}", self.name()),
            error,
        })
    }
}

/// The triangle lists of one topic so far: turns ADD, DELETE and DELETEALL into mesh updates.
#[derive(Clone, Debug, Default)]
pub struct MarkerSet {
    /// Number of each namespace, in the order of appearance: the first part of a block's key.
    namespaces: BTreeMap<String, i64>,
    /// Blocks that are there.
    present: BTreeSet<(i64, i32)>,
}

/// An update and the header it is for.
pub type HeadedUpdate = (Header, MeshUpdate, SoupReport);

impl MarkerSet {
    /// The updates that `markers` make, in order; neighbours in one frame are joined. A marker
    /// that cannot be used is left out and its reason given.
    pub fn apply(&mut self, markers: &[Marker<'_>]) -> (Vec<HeadedUpdate>, Vec<WireError>) {
        let mut updates: Vec<HeadedUpdate> = Vec::new();
        let mut refused = Vec::new();
        for marker in markers {
            match self.change(marker) {
                Ok(Some((update, report))) => join(&mut updates, marker, update, report),
                Ok(None) => {}
                Err(error) => refused.push(error),
            }
        }
        (updates, refused)
    }

    fn change(
        &mut self,
        marker: &Marker<'_>,
    ) -> Result<Option<(MeshUpdate, SoupReport)>, WireError> {
        let block = |key, mesh| MeshUpdate::Blocks {
            clear: false,
            blocks: vec![(key, mesh)],
        };
        match (marker.action, marker.kind) {
            (ADD, TRIANGLE_LIST) => {
                let (mesh, report) = marker.to_mesh()?;
                let key = self.key(marker);
                self.present.insert(key);
                Ok(Some((block(block_key(key), mesh), report)))
            }
            // A marker of another kind takes the place of a triangle list of the same name.
            (ADD | DELETE, _) => {
                let key = self.key(marker);
                let was_there = self.present.remove(&key);
                let removal = block(block_key(key), TriMesh::default());
                Ok(was_there.then(|| (removal, SoupReport::default())))
            }
            (DELETE_ALL, _) => {
                let was_any = !self.present.is_empty();
                self.present.clear();
                let clear = MeshUpdate::Blocks {
                    clear: true,
                    blocks: Vec::new(),
                };
                Ok(was_any.then(|| (clear, SoupReport::default())))
            }
            (action, _) => Err(WireError::Field {
                field: "action",
                reason: format!("{action} of {} is unknown", marker.name()),
            }),
        }
    }

    fn key(&mut self, marker: &Marker<'_>) -> (i64, i32) {
        let next = i64::try_from(self.namespaces.len()).unwrap_or(i64::MAX);
        let namespace = match self.namespaces.get(marker.ns) {
            Some(&number) => number,
            None => *self.namespaces.entry(marker.ns.to_owned()).or_insert(next),
        };
        (namespace, marker.id)
    }
}

fn block_key((namespace, id): (i64, i32)) -> MeshBlockKey {
    MeshBlockKey([namespace, i64::from(id), 0])
}

fn join(
    updates: &mut Vec<HeadedUpdate>,
    marker: &Marker<'_>,
    update: MeshUpdate,
    report: SoupReport,
) {
    let header = marker.header.to_header();
    let clears = matches!(update, MeshUpdate::Blocks { clear: true, .. });
    if let (
        Some((last, MeshUpdate::Blocks { blocks, .. }, total)),
        MeshUpdate::Blocks { blocks: new, .. },
    ) = (updates.last_mut(), &update)
        && last.frame_id == header.frame_id
        && !clears
    {
        blocks.extend(new.iter().cloned());
        *total = geometry::add_reports(*total, report);
        return;
    }
    updates.push((header, update, report));
}
