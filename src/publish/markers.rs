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

use super::pieces::{self, Piece, Place, Step, TooLarge};
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
                let step = Step {
                    removed: Vec::new(),
                    added: Some((0, built)),
                };
                let message = array(snapshot, std::slice::from_ref(&step), params.viewer_format);
                let fits = message.len() <= params.max_message_bytes;
                Ok(step.added.filter(|_| fits).map(|(_, built)| built))
            },
        )?;
        let change = self.sent.change(pieces::placed(cut))?;
        let format = params.viewer_format;
        // One deletion and its padding to the next.
        let max_removed = params.max_message_bytes / (delete_all(snapshot).len() + 8);
        let groups = pieces::grouped(
            pieces::in_steps(change),
            params.max_message_bytes,
            max_removed,
            &|step| array(snapshot, std::slice::from_ref(step), format).len(),
        );
        let messages = groups.iter().map(|steps| {
            let message = array(snapshot, steps, format);
            params.checked("a marker", message)
        });
        messages.collect()
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

/// Textures of one name share their picture, across all of rviz2.
fn texture_name(snapshot: &Snapshot<'_>, name: u32) -> String {
    format!("embedded://veneer_{:016x}_{name:010}", snapshot.session)
}

/// What some steps delete and add, as a message.
fn array(snapshot: &Snapshot<'_>, steps: &[Step<Textured>], format: PageFormat) -> Vec<u8> {
    let resources: Vec<String> = steps
        .iter()
        .map(|step| {
            let added = step.added.as_ref();
            added.map_or_else(String::new, |(name, _)| texture_name(snapshot, *name))
        })
        .collect();
    let mut markers = Vec::new();
    for (step, resource) in steps.iter().zip(&resources) {
        let removed = step.removed.iter();
        markers.extend(removed.map(|&name| deletion(snapshot, name)));
        if let Some((name, built)) = &step.added {
            markers.push(marker(snapshot, *name, built, format, resource));
        }
    }
    MarkerArray { markers }.encode()
}

fn marker<'a>(
    snapshot: &Snapshot<'a>,
    name: u32,
    built: &'a Textured,
    format: PageFormat,
    resource: &'a str,
) -> Marker<'a> {
    let Textured { piece, file } = built;
    let origin_m = origin_m(piece);
    let relative = |[x, y, z]: [f64; 3]| [x - origin_m[0], y - origin_m[1], z - origin_m[2]];
    let triangles = || piece.triangles.iter();
    Marker {
        pose: WirePose {
            position_m: origin_m,
            ..WirePose::IDENTITY
        },
        points: triangles()
            .flat_map(|triangle| triangle.corners_m.map(relative))
            .collect(),
        tail: MarkerTail {
            texture_resource: resource,
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
    }
}
