//! `~/markers`: pieces as textured triangle lists, for rviz2 as it ships (Humble and later).
//!
//! rviz2 reads a texture from the marker itself when `texture_resource` is `embedded://NAME` and
//! `texture.format` a bare `png` or `jpg`; it wants one coordinate for each point, no indices, v down.
//! Adding a marker again under its name would stack another texture upon it, and textures of one name
//! share their picture: a piece that changes is deleted, and added under a new name.

use crate::atlas::TexturePage;
use crate::export::PageFormat;
use crate::wire::geometry::WirePose;
use crate::wire::marker::{self, Marker, MarkerTail};
use crate::wire::{CompressedImage, MarkerArray, Message};

use super::pieces::{Piece, Step};
use super::viewer::Format;
use super::{PublishError, Snapshot};

/// Namespace of all markers.
const NAMESPACE: &str = "veneer";

/// Pieces of a snapshot as markers.
pub(super) struct MarkerFormat<'a> {
    pub(super) snapshot: &'a Snapshot<'a>,
    pub(super) textures: PageFormat,
}

/// What a marker is made of.
pub(super) struct Textured {
    piece: Piece,
    file: Vec<u8>,
}

impl Format for MarkerFormat<'_> {
    type Built = Textured;
    const WHAT: &'static str = "a marker";

    fn build(&self, piece: &Piece, page: &TexturePage) -> Result<Textured, PublishError> {
        Ok(Textured {
            piece: piece.clone(),
            file: piece.encode_texture(page, self.textures)?,
        })
    }

    fn message(&self, steps: &[Step<Textured>]) -> Vec<u8> {
        array(self.snapshot, steps, self.textures)
    }

    fn deletion_of_all(&self) -> Vec<u8> {
        let markers = vec![blank(self.snapshot, 0, marker::DELETE_ALL)];
        MarkerArray { markers }.encode()
    }

    fn max_removed(&self, max_bytes: usize) -> usize {
        // One deletion and its padding to the next.
        max_bytes / (self.deletion_of_all().len() + 8)
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
