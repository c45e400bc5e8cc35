//! `~/mesh_geometry`, `~/mesh_materials` and the services of mesh_msgs: pieces as meshes of their own.
//!
//! A mesh is named by its content: one that changes gets another uuid, and uuids stay true from one
//! run to the next. mesh_msgs has no message that removes a mesh; the service `get_uuids` lists those
//! that are. Coordinates of textures have v down.

use std::collections::{BTreeMap, BTreeSet};

use crate::atlas::TexturePage;
use crate::export::normals::smooth_normals;
use crate::mesh::TriMesh;
use crate::wire::mesh_materials::{MeshFaceCluster, MeshMaterial};
use crate::wire::{
    Image, MeshGeometryStamped, MeshMaterialsStamped, MeshTexture, MeshVertexColorsStamped,
    Message, WireHeader,
};

use super::digest::Digest;
use super::pieces::{CutPiece, Piece, Pieces};
use super::{Content, PublishError, PublishParams, Snapshot, crop};

/// A mesh of mesh_msgs: shape, look and texture, each short enough for a message.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshPiece {
    uuid: String,
    vertices_m: Vec<[f64; 3]>,
    vertex_normals: Vec<[f64; 3]>,
    tex_coords: Vec<[f32; 2]>,
    faces: Vec<[u32; 3]>,
    width_texel: u32,
    height_texel: u32,
    rgb: Vec<u8>,
}

/// The mesh cut into meshes of mesh_msgs, for its services: what `~/mesh_geometry` and
/// `~/mesh_materials` publish has the same uuids.
///
/// # Errors
/// As [`super::Publisher::publish`].
pub fn mesh_pieces(
    snapshot: &Snapshot<'_>,
    params: &PublishParams,
) -> Result<Vec<MeshPiece>, PublishError> {
    params.check()?;
    let cut = cut(
        snapshot,
        &snapshot.content()?,
        params,
        &mut Pieces::default(),
        &|_| false,
    )?;
    Ok(cut.into_iter().filter_map(|(_, _, piece)| piece).collect())
}

impl MeshPiece {
    fn new(piece: &Piece, page: &TexturePage) -> Self {
        let indexed = piece.indexed();
        let positions_m = indexed.positions_m.iter().copied().map(Into::into);
        // Normals of a mesh that cannot be: up.
        let normals = TriMesh::from_soup(positions_m.collect(), indexed.triangles.clone())
            .map(|(mesh, _)| smooth_normals(&mesh))
            .unwrap_or_else(|_| vec![[0.0, 0.0, 1.0]; indexed.positions_m.len()]);
        let mut mesh = Self {
            uuid: String::new(),
            vertices_m: Vec::new(),
            vertex_normals: Vec::new(),
            tex_coords: Vec::new(),
            faces: Vec::new(),
            width_texel: piece.crop.width,
            height_texel: piece.crop.height,
            rgb: crop::texels(page, &piece.crop).into_flattened(),
        };
        let mut vertices = BTreeMap::new();
        for (triangle, corners) in piece.triangles.iter().zip(indexed.triangles) {
            let uvs = piece.corners_uv(triangle);
            let corner = |i: usize| (corners[i], uvs[i]);
            let face = [corner(0), corner(1), corner(2)].map(|(place, uv)| {
                *vertices
                    .entry((place, uv.map(f32::to_bits)))
                    .or_insert_with(|| {
                        mesh.vertices_m.push(indexed.positions_m[place as usize]);
                        let normal = normals[place as usize].map(f64::from);
                        mesh.vertex_normals.push(normal);
                        mesh.tex_coords.push(uv);
                        // A piece has fewer vertices than a message has bytes.
                        u32::try_from(mesh.vertices_m.len() - 1).unwrap_or(u32::MAX)
                    })
            });
            mesh.faces.push(face);
        }
        mesh
    }

    /// Its name.
    pub fn uuid(&self) -> &str {
        &self.uuid
    }

    /// Its shape.
    pub fn geometry<'a>(&'a self, header: WireHeader<'a>) -> MeshGeometryStamped<'a> {
        MeshGeometryStamped {
            header,
            uuid: &self.uuid,
            vertices_m: self.vertices_m.clone(),
            vertex_normals: self.vertex_normals.clone(),
            faces: self.faces.clone(),
        }
    }

    /// Its look: one texture, number 0.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a piece has fewer faces than a message has bytes"
    )]
    pub fn materials<'a>(&'a self, header: WireHeader<'a>) -> MeshMaterialsStamped<'a> {
        MeshMaterialsStamped {
            header,
            uuid: &self.uuid,
            clusters: vec![MeshFaceCluster {
                face_indices: (0..self.faces.len() as u32).collect(),
                label: "",
            }],
            materials: vec![MeshMaterial {
                texture_index: 0,
                color: [1.0; 4],
                has_texture: true,
            }],
            cluster_materials: vec![0],
            vertex_tex_coords: self.tex_coords.clone(),
        }
    }

    /// Its texture; it has only number 0.
    pub fn texture<'a>(
        &'a self,
        header: WireHeader<'a>,
        texture_index: u32,
    ) -> Option<MeshTexture<'a>> {
        (texture_index == 0).then_some(MeshTexture {
            uuid: &self.uuid,
            texture_index,
            image: Image {
                header,
                height: self.height_texel,
                width: self.width_texel,
                encoding: "rgb8",
                is_bigendian: false,
                step: self.width_texel * 3,
                data: &self.rgb,
            },
        })
    }

    /// The colour of the texel at each vertex.
    pub fn vertex_colors<'a>(&'a self, header: WireHeader<'a>) -> MeshVertexColorsStamped<'a> {
        let colors = self.tex_coords.iter().map(|&[u, v]| {
            let texel = |share: f32, side: u32| {
                let index = f64::from(share) * f64::from(side);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "the cast saturates"
                )]
                let index = index as usize;
                index.min(side as usize - 1)
            };
            let row = texel(v, self.height_texel) * self.width_texel as usize;
            let start = 3 * (row + texel(u, self.width_texel));
            let channel = |c: usize| f32::from(self.rgb[start + c]) / 255.0;
            [channel(0), channel(1), channel(2), 1.0]
        });
        MeshVertexColorsStamped {
            header,
            uuid: &self.uuid,
            vertex_colors: colors.collect(),
        }
    }

    /// Whether all that is sent of it is short enough.
    fn fits(&self, header: WireHeader<'_>, params: &PublishParams) -> bool {
        // Vertices with normals take the most by far; the texture's length is known without copying.
        let texture = self.rgb.len() + header.frame_id.len() + self.uuid.len() + 128;
        texture <= params.max_message_bytes
            && self.geometry(header).encode().len() <= params.max_message_bytes
            && self.materials(header).encode().len() <= params.max_message_bytes
    }
}

/// Of the content, so that it is the same in every run.
fn uuid_of(piece: &MeshPiece, header: WireHeader<'_>) -> String {
    let mut hash = Fnv::default();
    hash.bytes(header.frame_id.as_bytes());
    for coordinate in piece.vertices_m.as_flattened() {
        hash.bytes(&coordinate.to_le_bytes());
    }
    for coordinate in piece.tex_coords.as_flattened() {
        hash.bytes(&coordinate.to_le_bytes());
    }
    for index in piece.faces.as_flattened() {
        hash.bytes(&index.to_le_bytes());
    }
    hash.bytes(&piece.width_texel.to_le_bytes());
    hash.bytes(&piece.rgb);
    format!("veneer-{:032x}", hash.0)
}

/// FNV-1a of 128 bits (Fowler, Noll, Vo; draft-eastlake-fnv): stays the same from release to release.
struct Fnv(u128);

impl Default for Fnv {
    fn default() -> Self {
        Self(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d)
    }
}

impl Fnv {
    fn bytes(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u128::from(byte)).wrapping_mul(0x0100_0000_0000_0000_0000_013b);
        }
    }
}

/// Bytes of a uuid, which is set when the piece is known to fit.
const UUID_BYTES: usize = 7 + 32;

fn cut(
    snapshot: &Snapshot<'_>,
    content: &Content<'_>,
    params: &PublishParams,
    pieces: &mut Pieces,
    is_known: &(dyn Fn(Digest) -> bool + Sync),
) -> Result<Vec<CutPiece<MeshPiece>>, PublishError> {
    let header = snapshot.header();
    pieces.cut(content, params, is_known, &|piece, page| {
        let num_texels = piece.crop.width as usize * piece.crop.height as usize;
        if num_texels * 3 > params.max_message_bytes {
            return Ok(None);
        }
        let mut mesh = MeshPiece::new(piece, page);
        mesh.uuid = "-".repeat(UUID_BYTES);
        if !mesh.fits(header, params) {
            return Ok(None);
        }
        mesh.uuid = uuid_of(&mesh, header);
        Ok(Some(mesh))
    })
}

/// What readers hold.
#[derive(Debug, Default)]
pub(super) struct Meshes {
    frame_id: String,
    geometry: Held,
    materials: Held,
    pieces: Pieces,
}

#[derive(Debug, Default)]
struct Held {
    digests: BTreeSet<Digest>,
    num_since_whole: usize,
}

impl Held {
    fn forget(&mut self) {
        *self = Self::default();
    }
}

/// Messages of `~/mesh_geometry` and of `~/mesh_materials`.
type Both = (Vec<Vec<u8>>, Vec<Vec<u8>>);

impl Meshes {
    pub(super) fn forget_geometry(&mut self) {
        self.geometry.forget();
    }

    pub(super) fn forget_materials(&mut self) {
        self.materials.forget();
    }

    pub(super) fn num_geometry_since_whole(&self) -> usize {
        self.geometry.num_since_whole
    }

    pub(super) fn num_materials_since_whole(&self) -> usize {
        self.materials.num_since_whole
    }

    pub(super) fn publish(
        &mut self,
        snapshot: &Snapshot<'_>,
        content: &Content<'_>,
        params: &PublishParams,
        [geometry, materials]: [bool; 2],
    ) -> Result<Both, PublishError> {
        if self.frame_id != snapshot.frame_id {
            self.geometry.forget();
            self.materials.forget();
            snapshot.frame_id.clone_into(&mut self.frame_id);
        }
        let mut cut = self.cut_unknown(snapshot, content, params, [geometry, materials])?;
        let num_built = cut.iter().filter(|(_, _, piece)| piece.is_some()).count();
        let overflows = |held: &Held| {
            !held.digests.is_empty() && held.num_since_whole + num_built > params.history_messages
        };
        let is_whole = [
            geometry && overflows(&self.geometry),
            materials && overflows(&self.materials),
        ];
        if is_whole.contains(&true) {
            if is_whole[0] {
                self.geometry.forget();
            }
            if is_whole[1] {
                self.materials.forget();
            }
            cut = self.cut_unknown(snapshot, content, params, [geometry, materials])?;
        }
        let header = snapshot.header();
        let mut messages: Both = (Vec::new(), Vec::new());
        for (digest, _, piece) in &cut {
            let Some(piece) = piece else { continue };
            if geometry && !self.geometry.digests.contains(digest) {
                messages.0.push(piece.geometry(header).encode());
            }
            if materials && !self.materials.digests.contains(digest) {
                messages.1.push(piece.materials(header).encode());
            }
        }
        let digests: BTreeSet<Digest> = cut.iter().map(|(digest, ..)| *digest).collect();
        if geometry {
            self.geometry.num_since_whole += messages.0.len();
            self.geometry.digests.clone_from(&digests);
        }
        if materials {
            self.materials.num_since_whole += messages.1.len();
            self.materials.digests = digests;
        }
        Ok(messages)
    }

    /// All pieces; those that every wanted topic has sent are not built.
    fn cut_unknown(
        &mut self,
        snapshot: &Snapshot<'_>,
        content: &Content<'_>,
        params: &PublishParams,
        [geometry, materials]: [bool; 2],
    ) -> Result<Vec<CutPiece<MeshPiece>>, PublishError> {
        let (held_geometry, held_materials) = (&self.geometry.digests, &self.materials.digests);
        let is_known = |digest| {
            (!geometry || held_geometry.contains(&digest))
                && (!materials || held_materials.contains(&digest))
        };
        cut(snapshot, content, params, &mut self.pieces, &is_known)
    }
}
