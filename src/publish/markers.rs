//! `~/markers`: pieces as textured triangle lists, for rviz2 as it ships (Humble and later).
//!
//! rviz2 reads a texture from the marker itself when `texture_resource` is `embedded://NAME` and
//! `texture.format` a bare `png` or `jpg`; it wants one coordinate for each point, no indices, v down.
//! Adding a marker again under its name would stack another texture upon it, and textures of one name
//! share their picture: a piece that changes is deleted, and added under a new name.

use crate::export::{PageFormat, TexturedMesh};
use crate::wire::geometry::WirePose;
use crate::wire::marker::{self, Marker, MarkerTail};
use crate::wire::{CompressedImage, MarkerArray, Message};

use super::pieces::{self, Piece, Place, TooLarge};
use super::sent::Sent;
use super::{PublishError, PublishParams, Snapshot};

/// Namespace of all markers.
const NAMESPACE: &str = "veneer";

/// What readers hold.
#[derive(Debug, Default)]
pub(super) struct Markers {
    scene: Option<(u64, String)>,
    sent: Sent<Place>,
    too_large: TooLarge,
    num_since_whole: usize,
}

/// What a marker is made of.
struct Textured {
    piece: Piece,
    file: Vec<u8>,
}

impl Markers {
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
        let mut messages = vec![params.checked("a marker", delete_all(snapshot))?];
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
                let file = piece.encode_texture(page, params.viewer_format)?;
                let built = Textured {
                    piece: piece.clone(),
                    file,
                };
                let fits = marker(snapshot, 0, &built, params.viewer_format, &[]).len()
                    <= params.max_message_bytes;
                Ok(fits.then_some(built))
            },
        )?;
        let change = self.sent.change(pieces::placed(cut))?;
        let mut messages = Vec::new();
        for step in pieces::in_steps(change) {
            let Some((name, built)) = step.added else {
                messages.extend(deletions(snapshot, &step.removed, params)?);
                continue;
            };
            let added = marker(snapshot, name, &built, params.viewer_format, &step.removed);
            if added.len() <= params.max_message_bytes {
                messages.push(added);
                continue;
            }
            messages.extend(deletions(snapshot, &step.removed, params)?);
            let added = marker(snapshot, name, &built, params.viewer_format, &[]);
            messages.push(params.checked("a marker", added)?);
        }
        Ok(messages)
    }
}

fn blank<'a>(snapshot: &Snapshot<'a>, id: i32, action: i32) -> Marker<'a> {
    Marker {
        header: snapshot.header(),
        ns: NAMESPACE,
        id,
        kind: marker::TRIANGLE_LIST,
        action,
        pose: WirePose::IDENTITY,
        scale: [1.0; 3],
        color: [1.0; 4],
        lifetime: (0, 0),
        frame_locked: true,
        points: Vec::new(),
        colors: Vec::new(),
        tail: MarkerTail::default(),
    }
}

fn delete_all(snapshot: &Snapshot<'_>) -> Vec<u8> {
    let markers = vec![blank(snapshot, 0, marker::DELETE_ALL)];
    MarkerArray { markers }.encode()
}

fn deletion<'a>(snapshot: &Snapshot<'a>, name: u32) -> Marker<'a> {
    blank(snapshot, name.cast_signed(), marker::DELETE)
}

/// Deletions of the markers of these names, as many in a message as it holds.
fn deletions(
    snapshot: &Snapshot<'_>,
    names: &[u32],
    params: &PublishParams,
) -> Result<Vec<Vec<u8>>, PublishError> {
    // One marker and its padding to the next.
    let one = delete_all(snapshot).len() + 8;
    let per_message = (params.max_message_bytes / one).max(1);
    let messages = names.chunks(per_message).map(|names| {
        let array = MarkerArray {
            markers: names.iter().map(|&n| deletion(snapshot, n)).collect(),
        };
        params.checked("a marker", array.encode())
    });
    messages.collect()
}

/// Beyond this distance from the frame's origin points are relative to a pose of their own: rviz2
/// draws in single precision.
const MAX_ABSOLUTE_COORDINATE_M: f64 = 1000.0;

/// The frame's origin, or a place near a piece that is far from it, in whole metres.
fn origin_m(piece: &Piece) -> [f64; 3] {
    let corners = || piece.triangles.iter().flat_map(|t| t.corners_m);
    let is_near = corners()
        .flatten()
        .all(|coordinate| coordinate.abs() <= MAX_ABSOLUTE_COORDINATE_M);
    match corners().next() {
        Some(corner) if !is_near => corner.map(f64::round),
        _ => [0.0; 3],
    }
}

/// A piece as a marker, after the deletion of others.
fn marker(
    snapshot: &Snapshot<'_>,
    name: u32,
    built: &Textured,
    format: PageFormat,
    removed: &[u32],
) -> Vec<u8> {
    let Textured { piece, file } = built;
    let origin_m = origin_m(piece);
    let relative = |[x, y, z]: [f64; 3]| [x - origin_m[0], y - origin_m[1], z - origin_m[2]];
    let triangles = || piece.triangles.iter();
    // Textures of one name share their picture, across all of rviz2.
    let resource = format!("embedded://veneer_{:016x}_{name:010}", snapshot.session);
    let added = Marker {
        pose: WirePose {
            position_m: origin_m,
            ..WirePose::IDENTITY
        },
        points: triangles()
            .flat_map(|triangle| triangle.corners_m.map(relative))
            .collect(),
        tail: MarkerTail {
            texture_resource: &resource,
            texture: CompressedImage {
                header: snapshot.header(),
                format: match format {
                    PageFormat::Png => "png".into(),
                    PageFormat::Jpeg { .. } => "jpg".into(),
                },
                data: file.into(),
            },
            uv_coordinates: triangles()
                .flat_map(|triangle| piece.corners_uv(triangle))
                .collect(),
            ..MarkerTail::default()
        },
        ..blank(snapshot, name.cast_signed(), marker::ADD)
    };
    let mut markers: Vec<Marker<'_>> = removed.iter().map(|&n| deletion(snapshot, n)).collect();
    markers.push(added);
    MarkerArray { markers }.encode()
}
