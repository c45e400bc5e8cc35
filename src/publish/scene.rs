//! `~/scene`: pieces as GLB files within a Foxglove scene.
//!
//! Foxglove and Lichtblick turn a glTF model's y up to the z up of ROS; the files' root node turns it
//! the other way, as glTF wants. An entity of a name replaces the one before; what changes gets a new
//! name here, so that who comes late can follow from any whole state on.

use crate::atlas::{AtlasLayout, AtlasTexture, ChartId, PlacedChart, TexelRect, TexturePage};
use crate::export::{EncodedPages, ExportError, NormalMode, PageFormat, TexturedMesh, glb};
use crate::geom::Stamp;
use crate::mesh::TriMesh;
use crate::wire::geometry::WirePose;
use crate::wire::scene_update::{self, ModelPrimitive, SceneEntity, SceneEntityDeletion};
use crate::wire::{Message, SceneUpdate};

use super::pieces::{self, Piece, Place, TooLarge};
use super::sent::Sent;
use super::{PublishError, PublishParams, Snapshot, crop};

/// What readers hold.
#[derive(Debug, Default)]
pub(super) struct Scene {
    scene: Option<(u64, String)>,
    sent: Sent<Place>,
    too_large: TooLarge,
    num_since_whole: usize,
}

impl Scene {
    pub(super) fn forget(&mut self) {
        self.scene = None;
        self.num_since_whole = 0;
    }

    pub(super) fn num_since_whole(&self) -> usize {
        self.num_since_whole
    }

    pub(super) fn publish(
        &mut self,
        snapshot: &Snapshot<'_>,
        textured: &TexturedMesh<'_>,
        params: &PublishParams,
    ) -> Result<Vec<Vec<u8>>, PublishError> {
        let now = Some((snapshot.session, snapshot.frame_id.to_owned()));
        if self.scene == now {
            let messages = self.publish_change(snapshot, textured, params)?;
            let num_kept = self.num_since_whole + messages.len();
            if num_kept <= params.history_messages {
                self.num_since_whole = num_kept;
                return Ok(messages);
            }
        }
        self.sent.clear();
        let all = SceneUpdate {
            deletions: vec![deletion(scene_update::ALL, String::new())],
            entities: Vec::new(),
        };
        let mut messages = vec![params.checked("a scene", all.encode())?];
        messages.extend(self.publish_change(snapshot, textured, params)?);
        self.scene = now;
        self.num_since_whole = messages.len();
        Ok(messages)
    }

    fn publish_change(
        &mut self,
        snapshot: &Snapshot<'_>,
        textured: &TexturedMesh<'_>,
        params: &PublishParams,
    ) -> Result<Vec<Vec<u8>>, PublishError> {
        let sent = &self.sent;
        let cut = pieces::cut(
            textured,
            params,
            &mut self.too_large,
            &|digest| sent.contains(digest),
            &|piece, page| {
                let file = piece_glb(piece, page, params.viewer_format)?;
                let fits = entity(snapshot, 0, &file, &[]).len() <= params.max_message_bytes;
                Ok(fits.then_some(file))
            },
        )?;
        let change = self.sent.change(pieces::placed(cut))?;
        let mut messages = Vec::new();
        for step in pieces::in_steps(change) {
            let Some((name, file)) = step.added else {
                messages.extend(deletions(&step.removed, params)?);
                continue;
            };
            let added = entity(snapshot, name, &file, &step.removed);
            if added.len() <= params.max_message_bytes {
                messages.push(added);
                continue;
            }
            messages.extend(deletions(&step.removed, params)?);
            messages.push(params.checked("a scene", entity(snapshot, name, &file, &[]))?);
        }
        Ok(messages)
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

fn deletions_of(names: &[u32]) -> Vec<SceneEntityDeletion<'static>> {
    let ids = names.iter().map(|&name| entity_id(name));
    ids.map(|id| deletion(scene_update::MATCHING_ID, id))
        .collect()
}

/// Bytes of a deletion, padding included.
const DELETION_BYTES: usize = 48;

fn deletions(names: &[u32], params: &PublishParams) -> Result<Vec<Vec<u8>>, PublishError> {
    let per_message = (params.max_message_bytes / DELETION_BYTES).max(2) - 1;
    let messages = names.chunks(per_message).map(|names| {
        let update = SceneUpdate {
            deletions: deletions_of(names),
            entities: Vec::new(),
        };
        params.checked("a scene", update.encode())
    });
    messages.collect()
}

/// A piece as an entity, after the deletion of others.
fn entity(snapshot: &Snapshot<'_>, name: u32, file: &[u8], removed: &[u32]) -> Vec<u8> {
    let model = ModelPrimitive {
        pose: WirePose::IDENTITY,
        scale: [1.0; 3],
        color: [1.0; 4],
        has_color: false,
        url: "",
        media_type: "model/gltf-binary",
        data: file.into(),
    };
    let entity = SceneEntity {
        timestamp: snapshot.stamp,
        frame_id: snapshot.frame_id,
        id: entity_id(name).into(),
        lifetime: (0, 0),
        frame_locked: true,
        metadata: Vec::new(),
        models: vec![model],
    };
    SceneUpdate {
        deletions: deletions_of(removed),
        entities: vec![entity],
    }
    .encode()
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
        pages: vec![TexturePage {
            srgb: crop::texels(page, &piece.crop),
            ..TexturePage::blank(width, height)
        }],
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
