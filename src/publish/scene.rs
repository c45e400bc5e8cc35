//! `~/scene`: pieces as GLB files within a Foxglove scene.
//!
//! Foxglove and Lichtblick turn a glTF model's y up to the z up of ROS; the files' root node turns it
//! the other way, as glTF wants. An entity of a name replaces the one before; what changes gets a new
//! name here, so that who comes late can follow from any whole state on.

use crate::atlas::{
    AtlasLayout, AtlasTexture, ChartId, PlacedChart, SharedPage, TexelRect, TexturePage,
};
use crate::export::{EncodedPages, ExportError, NormalMode, PageFormat, TexturedMesh, glb};
use crate::geom::Stamp;
use crate::mesh::TriMesh;
use crate::wire::geometry::WirePose;
use crate::wire::scene_update::{self, ModelPrimitive, SceneEntity, SceneEntityDeletion};
use crate::wire::{Message, SceneUpdate};

use super::pieces::{Piece, Step};
use super::viewer::Format;
use super::{PublishError, Snapshot, crop};

/// Pieces of a snapshot as entities.
pub(super) struct SceneFormat<'a> {
    pub(super) snapshot: &'a Snapshot<'a>,
    pub(super) textures: PageFormat,
}

impl Format for SceneFormat<'_> {
    /// A GLB file.
    type Built = Vec<u8>;
    const WHAT: &'static str = "a scene";

    fn build(&self, piece: &Piece, page: &TexturePage) -> Result<Vec<u8>, PublishError> {
        piece_glb(piece, page, self.textures)
    }

    fn message(&self, steps: &[Step<Vec<u8>>]) -> Vec<u8> {
        update(self.snapshot, steps)
    }

    fn deletion_of_all(&self) -> Vec<u8> {
        SceneUpdate {
            deletions: vec![deletion(scene_update::ALL, String::new())],
            entities: Vec::new(),
        }
        .encode()
    }

    fn max_removed(&self, max_bytes: usize) -> usize {
        (max_bytes / DELETION_BYTES).max(2) - 1
    }
}

/// Names of entities.
fn entity_id(name: u32) -> String {
    format!("veneer_{name:010}")
}

/// Only entities older than a deletion are deleted, and a state may be painted anew at the stamp of
/// the one before: the end of time is later than both.
const END_OF_TIME: Stamp = Stamp::from_nanos(i64::MAX);

fn deletion(kind: u8, id: String) -> SceneEntityDeletion<'static> {
    SceneEntityDeletion {
        timestamp: END_OF_TIME,
        kind,
        id: id.into(),
    }
}

/// Bytes of a deletion, padding included.
const DELETION_BYTES: usize = 48;

/// What some steps delete and add. Deletions come first in it, whatever the order: names
/// are never used twice.
fn update(snapshot: &Snapshot<'_>, steps: &[Step<Vec<u8>>]) -> Vec<u8> {
    let removed = steps.iter().flat_map(|step| &step.removed);
    let added = steps.iter().filter_map(|step| step.added.as_ref());
    SceneUpdate {
        deletions: removed
            .map(|&name| deletion(scene_update::MATCHING_ID, entity_id(name)))
            .collect(),
        entities: added
            .map(|(name, file)| entity(snapshot, *name, file))
            .collect(),
    }
    .encode()
}

fn entity<'a>(snapshot: &Snapshot<'a>, name: u32, file: &'a [u8]) -> SceneEntity<'a> {
    let model = ModelPrimitive {
        pose: WirePose::IDENTITY,
        scale: [1.0; 3],
        color: [1.0; 4],
        has_color: false,
        url: "",
        media_type: "model/gltf-binary",
        data: file.into(),
    };
    SceneEntity {
        timestamp: snapshot.stamp,
        frame_id: snapshot.frame_id,
        id: entity_id(name).into(),
        lifetime: (0, 0),
        frame_locked: true,
        metadata: Vec::new(),
        models: vec![model],
    }
}

/// A piece as a GLB file of its own.
fn piece_glb(
    piece: &Piece,
    page: &TexturePage,
    format: PageFormat,
) -> Result<Vec<u8>, PublishError> {
    let indexed = piece.indexed();
    let positions_m = indexed.positions_m.into_iter().map(Into::into).collect();
    let (mesh, _) = TriMesh::from_soup(positions_m, indexed.triangles)
        .map_err(|error| unexpected(piece, format, error.to_string()))?;
    let TexelRect {
        x,
        y,
        width,
        height,
    } = piece.crop;
    let layout = AtlasLayout {
        page_size_texel: [width, height],
        num_pages: 1,
        texels_per_m: 1.0,
        charts: vec![PlacedChart::whole_rect(
            0,
            TexelRect {
                x: 0,
                y: 0,
                width,
                height,
            },
            1.0,
            mesh.triangle_ids().collect(),
        )],
        chart_of_triangle: vec![ChartId(0); mesh.num_triangles()],
        corners_texel: piece
            .triangles
            .iter()
            .map(|t| t.corners_texel.map(|[u, v]| [u - x as f32, v - y as f32]))
            .collect(),
    };
    let texture = AtlasTexture {
        pages: vec![SharedPage::from(TexturePage {
            srgb: crop::texels(page, &piece.crop),
            ..TexturePage::blank(width, height)
        })],
    };
    let textured = TexturedMesh::new(&mesh, &layout, &texture)?;
    let pages = EncodedPages::encode(&texture, format)?;
    let mut file = Vec::new();
    glb::write(&textured, &pages, "veneer", NormalMode::Smooth, &mut file)
        .map_err(|error| unexpected(piece, format, error.to_string()))?;
    Ok(file)
}

fn unexpected(piece: &Piece, format: PageFormat, reason: String) -> PublishError {
    PublishError::Export(ExportError::Encode {
        page: piece.page as usize,
        width: piece.crop.width,
        height: piece.crop.height,
        format: format.mime_type(),
        reason,
    })
}
