//! The services of mesh_msgs, by which mesh_tools fetches what it shows.
//!
//! What they give out is cut so small that it reaches clients on this host ([`MAX_LOCAL_BYTES`]);
//! to others nearly every answer is too long, see [`super::super::server`]. mesh_msgs has no answer
//! that says no: a client that asks for what is not there gets none.

use std::sync::{Arc, Mutex, PoisonError};

use crate::publish::{MeshPiece, PublishError, mesh_pieces};
use crate::wire::service::Service;
use crate::wire::service::mesh::{
    GetGeometry, GetGeometryResponse, GetMaterials, GetMaterialsResponse, GetTexture,
    GetTextureResponse, GetUuids, GetUuidsResponse, GetVertexColors, GetVertexColorsResponse,
};
use crate::wire::{Message, WireError, WireHeader};

use super::super::control::Control;
use super::super::engine::Painting;
use super::super::error::NodeError;
use super::super::output::mesh_params;
use super::Services;

/// Why a request got no answer.
#[derive(Debug, thiserror::Error)]
enum MeshError {
    #[error("nothing was painted yet")]
    NothingPainted,
    #[error("there is no mesh '{0}' any more; ask get_uuids")]
    NoSuchMesh(String),
    #[error("a mesh has one texture, number 0; {0} was asked for")]
    NoSuchTexture(u32),
    #[error(transparent)]
    Publish(#[from] PublishError),
    #[error(transparent)]
    Wire(#[from] WireError),
}

/// The meshes of the painting that was asked for last.
#[derive(Default)]
struct Shelf {
    made: Mutex<Option<Shelved>>,
}

/// The meshes of one painting.
#[derive(Clone)]
struct Shelved {
    painting: Arc<Painting>,
    pieces: Arc<Vec<MeshPiece>>,
}

impl Shelf {
    /// Of the present painting, cut where they are not yet.
    fn present(&self, control: &Control) -> Result<Shelved, MeshError> {
        let painting = control.shared.last_painted();
        let painting = painting.ok_or(MeshError::NothingPainted)?;
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(shelved) = made.as_ref()
            && Arc::ptr_eq(&shelved.painting, &painting)
        {
            return Ok(shelved.clone());
        }
        let params = mesh_params(control.shared.config().publish);
        let pieces = Arc::new(mesh_pieces(&painting.snapshot(), &params)?);
        let shelved = Shelved { painting, pieces };
        *made = Some(shelved.clone());
        Ok(shelved)
    }
}

impl Shelved {
    fn header(&self) -> WireHeader<'_> {
        let snapshot = self.painting.snapshot();
        WireHeader {
            stamp: snapshot.stamp,
            frame_id: snapshot.frame_id,
        }
    }

    fn piece(&self, uuid: String) -> Result<&MeshPiece, MeshError> {
        let found = self.pieces.iter().find(|piece| piece.uuid() == uuid);
        found.ok_or(MeshError::NoSuchMesh(uuid))
    }

    fn uuids(&self) -> GetUuidsResponse {
        GetUuidsResponse {
            uuids: self.pieces.iter().map(|p| p.uuid().to_owned()).collect(),
        }
    }
}

impl Services<'_> {
    pub(super) fn offer_meshes(&mut self) -> Result<(), NodeError> {
        let shelf = Arc::new(Shelf::default());
        self.serve_mesh::<GetUuids>(&shelf, "get_uuids", |shelved, _| {
            Ok(shelved.uuids().encode())
        })?;
        self.serve_mesh::<GetGeometry>(&shelf, "get_geometry", |shelved, request| {
            let geometry = shelved.piece(request.uuid)?.geometry(shelved.header());
            Ok(GetGeometryResponse(geometry).encode())
        })?;
        self.serve_mesh::<GetMaterials>(&shelf, "get_materials", |shelved, request| {
            let materials = shelved.piece(request.uuid)?.materials(shelved.header());
            Ok(GetMaterialsResponse(materials).encode())
        })?;
        self.serve_mesh::<GetTexture>(&shelf, "get_texture", |shelved, request| {
            let piece = shelved.piece(request.uuid)?;
            let texture = piece.texture(shelved.header(), request.texture_index);
            let texture = texture.ok_or(MeshError::NoSuchTexture(request.texture_index))?;
            Ok(GetTextureResponse(texture).encode())
        })?;
        self.serve_mesh::<GetVertexColors>(&shelf, "get_vertex_colors", |shelved, request| {
            let colors = shelved.piece(request.uuid)?.vertex_colors(shelved.header());
            Ok(GetVertexColorsResponse(colors).encode())
        })
    }

    fn serve_mesh<S: Service>(
        &mut self,
        shelf: &Arc<Shelf>,
        name: &'static str,
        answer: fn(&Shelved, S::Request) -> Result<Vec<u8>, MeshError>,
    ) -> Result<(), NodeError>
    where
        S::Request: 'static,
    {
        let shelf = Arc::clone(shelf);
        self.serve_bytes(name, S::TYPE_NAME, move |control, bytes, longest| {
            let shelf = Arc::clone(&shelf);
            let work = move || {
                let request = S::Request::decode(&bytes)?;
                answer(&shelf.present(&control)?, request)
            };
            async move {
                let made = smol::unblock(work).await;
                let made = made.inspect_err(|error| tracing::warn!("~/{name}: {error}"));
                made.ok().filter(|bytes| is_short(name, bytes, longest))
            }
        })
    }
}

fn is_short(name: &str, answer: &[u8], longest: usize) -> bool {
    let is_short = answer.len() <= longest;
    if !is_short {
        tracing::warn!(
            "~/{name}: an answer of {} bytes does not reach its client, {longest} would: run the client on this host and keep it to the loopback, see docs/topics.md",
            answer.len()
        );
    }
    is_short
}
