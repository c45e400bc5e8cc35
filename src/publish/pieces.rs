//! The textured mesh cut into pieces, each with a texture of its own, so that a piece fits into a
//! message.
//!
//! A binary tree over each page: a node has the triangles whose centre on the page lies in its
//! rectangle, and with them the texels around them, cut out of the page. What does not fit is divided at
//! the middle of its rectangle, so that a change stays in the rectangles that it touches. A triangle that alone
//! is too large is divided at the middles of its edges, in the plane and in space alike.

use std::collections::BTreeSet;

use rayon::prelude::*;

use crate::atlas::{PageTrace, TexelRect, TexturePage};
use crate::export::{ExportError, TexturedMesh};

use super::digest::{Digest, Digester};
use super::sent::Change;
use super::{Content, PublishError, PublishParams, crop};

/// Texels around the triangles that filtering may reach.
const MARGIN_TEXEL: u32 = 2;

/// A triangle in space and on its page.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PieceTriangle {
    /// Corners, metres.
    pub(super) corners_m: [[f64; 3]; 3],
    /// Corners on the page, texels.
    pub(super) corners_texel: [[f32; 2]; 3],
}

/// Pieces with their places, as [`in_steps`] takes them.
pub(super) fn placed<T>(cut: Vec<CutPiece<T>>) -> Vec<(Digest, Place, (Place, Option<T>))> {
    cut.into_iter()
        .map(|(digest, place, built)| (digest, place, (place, built)))
        .collect()
}

/// Some triangles of one page, and the part of it that they need.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    pub(super) page: u32,
    pub(super) crop: TexelRect,
    pub(super) triangles: Vec<PieceTriangle>,
}

/// Where a piece lies in the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    page: u32,
    crop: TexelRect,
}

/// A piece that a message can hold: its digest, its place, and what was built of it unless it is known.
pub(super) type CutPiece<T> = (Digest, Place, Option<T>);

impl Place {
    /// Whether the middle of the other lies here.
    fn is_over(&self, other: &Self) -> bool {
        let contains = |start: u32, length: u32, other_start: u32, other_length: u32| {
            (start..start + length).contains(&(other_start + other_length / 2))
        };
        let (a, b) = (&self.crop, &other.crop);
        self.page == other.page
            && contains(a.x, a.width, b.x, b.width)
            && contains(a.y, a.height, b.y, b.height)
    }
}

/// A step from one state of the pieces to the next: names that go, then what comes.
pub(super) struct Step<T> {
    pub(super) removed: Vec<u32>,
    pub(super) added: Option<(u32, T)>,
}

/// A change in steps, so that a piece goes only when the one in its place comes: a viewer never shows a
/// hole where there is none. What nothing takes the place of goes first.
pub(super) fn in_steps<T>(change: Change<(Place, Option<T>), Place>) -> Vec<Step<T>> {
    let mut waiting = change.removed;
    let mut steps: Vec<Step<T>> = Vec::new();
    for (name, (place, built)) in change.added {
        // What is known but doubled was sent once, which is enough.
        let Some(built) = built else { continue };
        let (removed, rest) = waiting
            .into_iter()
            .partition(|(_, gone): &(u32, Place)| place.is_over(gone));
        waiting = rest;
        steps.push(Step {
            removed: names(removed),
            added: Some((name, built)),
        });
    }
    if !waiting.is_empty() {
        let first = Step {
            removed: names(waiting),
            added: None,
        };
        steps.insert(0, first);
    }
    steps
}

/// Steps that go together into one message each, in order. `length` is that of a message with one step;
/// a step that is longer than a message is taken apart, `max_removed` names to a message.
pub(super) fn grouped<T>(
    steps: Vec<Step<T>>,
    max_bytes: usize,
    max_removed: usize,
    length: &dyn Fn(&Step<T>) -> usize,
) -> Vec<Vec<Step<T>>> {
    let mut groups: Vec<Vec<Step<T>>> = Vec::new();
    let mut num_free = 0;
    let mut push = |step: Step<T>| {
        // Elements are aligned to at most 8 bytes.
        let num_bytes = length(&step) + 8;
        match groups.last_mut() {
            Some(group) if num_bytes <= num_free => group.push(step),
            _ => {
                groups.push(vec![step]);
                num_free = max_bytes;
            }
        }
        num_free = num_free.saturating_sub(num_bytes);
    };
    for step in steps {
        if length(&step) <= max_bytes {
            push(step);
            continue;
        }
        for removed in step.removed.chunks(max_removed.max(1)) {
            push(Step {
                removed: removed.to_vec(),
                added: None,
            });
        }
        if let Some(added) = step.added {
            push(Step {
                removed: Vec::new(),
                added: Some(added),
            });
        }
    }
    groups
}

fn names(removed: Vec<(u32, Place)>) -> Vec<u32> {
    removed.into_iter().map(|(name, _)| name).collect()
}

/// Makes what a message needs of a piece; `None` when that is too long.
pub(super) type Build<'a, T> =
    dyn Fn(&Piece, &TexturePage) -> Result<Option<T>, PublishError> + Sync + 'a;

/// The pieces that were cut last, page by page: where a page is as it was, so are they.
#[derive(Debug, Default)]
pub(super) struct Pieces {
    pages: Vec<CutPage>,
    /// Whether a rectangle that was too large once is divided from then on, without being built to see. Then
    /// pieces depend on what was before, and a change costs building what is sent and no more.
    stay_divided: bool,
}

/// A page and its pieces.
#[derive(Debug, Default)]
struct CutPage {
    /// `None` where they are those of no page.
    of: Option<(PageTrace, Digest)>,
    pieces: Vec<(Digest, Place)>,
    /// What was found too large for a piece, so that it need not be built again.
    too_large: TooLarge,
}

/// By content and by rectangle.
#[derive(Clone, Debug, Default)]
struct TooLarge {
    digests: BTreeSet<Digest>,
    regions: BTreeSet<[u32; 4]>,
}

impl PieceTriangle {
    /// Where its centre lies on the page.
    fn center_texel(&self) -> [f32; 2] {
        let [a, b, c] = self.corners_texel;
        [0, 1].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0)
    }

    /// Four of its shape.
    fn quarters(&self) -> [Self; 4] {
        let [a, b, c] = [0, 1, 2].map(|i| (self.corners_m[i], self.corners_texel[i]));
        let middle = |p: ([f64; 3], [f32; 2]), q: ([f64; 3], [f32; 2])| {
            (
                [0, 1, 2].map(|i| p.0[i] * 0.5 + q.0[i] * 0.5),
                [0, 1].map(|i| p.1[i] * 0.5 + q.1[i] * 0.5),
            )
        };
        let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]].map(|corners| Self {
            corners_m: corners.map(|(m, _)| m),
            corners_texel: corners.map(|(_, texel)| texel),
        })
    }
}

impl Piece {
    /// The corners of a triangle in [0, 1] of the crop, v down.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "rounding to f32 is what the messages have"
    )]
    pub(super) fn corners_uv(&self, triangle: &PieceTriangle) -> [[f32; 2]; 3] {
        let TexelRect {
            x,
            y,
            width,
            height,
        } = self.crop;
        triangle.corners_texel.map(|[u, v]| {
            [
                ((f64::from(u) - f64::from(x)) / f64::from(width)) as f32,
                ((f64::from(v) - f64::from(y)) / f64::from(height)) as f32,
            ]
        })
    }

    fn digest(&self, page: &TexturePage) -> Digest {
        let mut digester = Digester::new();
        let crop = &self.crop;
        for number in [self.page, crop.x, crop.y, crop.width, crop.height] {
            digester.number(number.into());
        }
        digester.number(self.triangles.len() as u64);
        for triangle in &self.triangles {
            for coordinate in triangle.corners_m.as_flattened() {
                digester.number(coordinate.to_bits());
            }
            for coordinate in triangle.corners_texel.as_flattened() {
                digester.number(coordinate.to_bits().into());
            }
        }
        for row in crop::rows(page, crop) {
            digester.bytes(row.as_flattened());
        }
        digester.finish()
    }
}

/// The texels that the triangles touch and a margin around them.
fn needed_texels(page: &TexturePage, triangles: &[PieceTriangle]) -> TexelRect {
    let (mut lowest, mut highest) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for corner in triangles.iter().flat_map(|t| t.corners_texel) {
        for axis in 0..2 {
            lowest[axis] = corner[axis].min(lowest[axis]);
            highest[axis] = corner[axis].max(highest[axis]);
        }
    }
    let [(x, width), (y, height)] = [(0, page.width), (1, page.height)].map(|(axis, side)| {
        let (low, high) = (lowest[axis], highest[axis]);
        let first = whole(low.floor())
            .saturating_sub(MARGIN_TEXEL)
            .min(side - 1);
        let end = whole(high.ceil()).saturating_add(MARGIN_TEXEL).min(side);
        (first, end.saturating_sub(first).max(1))
    });
    TexelRect {
        x,
        y,
        width,
        height,
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast saturates, and corners lie on the page"
)]
fn whole(coordinate: f32) -> u32 {
    coordinate as u32
}

/// A rectangle of a page and the triangles in it.
struct Node {
    page: u32,
    region: Region,
    triangles: Vec<PieceTriangle>,
}

/// Upper left corner and size, texels.
#[derive(Clone, Copy)]
struct Region {
    low: [f32; 2],
    size: [f32; 2],
}

impl Region {
    /// Names it.
    fn bits(&self) -> [u32; 4] {
        [self.low[0], self.low[1], self.size[0], self.size[1]].map(f32::to_bits)
    }

    /// The axis across which it is divided.
    fn axis(&self) -> usize {
        usize::from(self.size[1] > self.size[0])
    }

    /// Which half holds a point.
    fn half_of(&self, point: [f32; 2]) -> usize {
        let axis = self.axis();
        usize::from(point[axis] >= self.low[axis] + self.size[axis] * 0.5)
    }

    fn half(&self, index: usize) -> Self {
        let axis = self.axis();
        let mut half = *self;
        half.size[axis] *= 0.5;
        if index == 1 {
            half.low[axis] += half.size[axis];
        }
        half
    }
}

enum Judged<T> {
    Piece(CutPiece<T>),
    TooLarge(Digest, Node),
    /// So much too large that it was not tried, or too large before.
    FarTooLarge(Node),
}

/// Smaller rectangles are not divided; their triangles are, by number.
const SMALLEST_REGION_TEXEL: f32 = 0.25;

impl Pieces {
    /// Of which those divided once stay so.
    pub(super) fn staying_divided() -> Self {
        Self {
            pages: Vec::new(),
            stay_divided: true,
        }
    }

    /// Cuts the mesh into pieces for which `build` gives something, page by page. Of pieces that `is_known`
    /// nothing is built. The order within a page depends on it only.
    ///
    /// # Errors
    /// What `build` fails with, and [`PublishError::DoesNotFit`] when a small triangle does not fit.
    pub(super) fn cut<T: Send>(
        &mut self,
        content: &Content<'_>,
        params: &PublishParams,
        is_known: &(dyn Fn(Digest) -> bool + Sync),
        build: &Build<'_, T>,
    ) -> Result<Vec<CutPiece<T>>, PublishError> {
        let textured = &content.textured;
        let mut before = std::mem::take(&mut self.pages);
        before.resize_with(textured.texture().pages.len(), CutPage::default);
        let pages = textured.texture().pages.iter().zip(charts_by_page(content));
        let mut cut: Vec<Vec<CutPiece<T>>> = Vec::with_capacity(before.len());
        let mut is_as_it_was = Vec::with_capacity(before.len());
        for ((page, charts), before) in pages.zip(&mut before) {
            let is_same =
                matches!(&before.of, Some((trace, of)) if trace.is_of(page) && *of == charts);
            let is_same = is_same && before.pieces.iter().all(|(digest, _)| is_known(*digest));
            before.of = Some((page.trace(), charts));
            is_as_it_was.push(is_same);
            let known = before.pieces.iter().filter(|_| is_same);
            cut.push(
                known
                    .map(|&(digest, place)| (digest, place, None))
                    .collect(),
            );
        }
        let mut nodes = roots(content, &is_as_it_was);
        let mut too_large = vec![TooLarge::default(); before.len()];
        if self.stay_divided {
            for (now, before) in too_large.iter_mut().zip(&before) {
                now.regions.clone_from(&before.too_large.regions);
            }
        }
        while !nodes.is_empty() {
            let judged: Vec<Result<Judged<T>, PublishError>> = nodes
                .into_par_iter()
                .map(|node| {
                    let too_large = &before[node.page as usize].too_large;
                    judge(node, textured, params, too_large, is_known, build)
                })
                .collect();
            nodes = Vec::new();
            for result in judged {
                match result? {
                    Judged::Piece(piece) => cut[piece.1.page as usize].push(piece),
                    Judged::TooLarge(digest, node) => {
                        let too_large = &mut too_large[node.page as usize];
                        too_large.digests.insert(digest);
                        if self.stay_divided {
                            too_large.regions.insert(node.region.bits());
                        }
                        divide(node, params, &mut nodes)?;
                    }
                    Judged::FarTooLarge(node) => divide(node, params, &mut nodes)?,
                }
            }
        }
        let found = cut.iter().zip(too_large).zip(is_as_it_was);
        for (before, ((cut, too_large), is_as_it_was)) in before.iter_mut().zip(found) {
            if !is_as_it_was {
                before.pieces = cut
                    .iter()
                    .map(|&(digest, place, _)| (digest, place))
                    .collect();
                before.too_large = too_large;
            }
        }
        self.pages = before;
        Ok(cut.into_iter().flatten().collect())
    }
}

/// What stands for the charts of each page.
fn charts_by_page(content: &Content<'_>) -> Vec<Digest> {
    let layout = content.textured.layout();
    let mut digesters: Vec<Digester> = (0..layout.num_pages).map(|_| Digester::new()).collect();
    for (placed, key) in layout.charts.iter().zip(&*content.keys) {
        if let Some(digester) = digesters.get_mut(placed.page as usize) {
            digester.bytes(&key.to_le_bytes());
        }
    }
    digesters.iter().map(Digester::finish).collect()
}

/// All triangles of each page that is not as it was.
fn roots(content: &Content<'_>, is_as_it_was: &[bool]) -> Vec<Node> {
    let (mesh, layout) = (content.textured.mesh(), content.textured.layout());
    let [width, height] = layout.page_size_texel;
    // Powers of two, so that the middles stay where they are when a page grows taller.
    let region = Region {
        low: [0.0; 2],
        size: [width, height].map(|side| side.next_power_of_two() as f32),
    };
    let mut roots: Vec<Node> = (0..layout.num_pages)
        .map(|page| Node {
            page,
            region,
            triangles: Vec::new(),
        })
        .collect();
    if !is_as_it_was.contains(&false) {
        return Vec::new();
    }
    let page_of = |chart: usize| layout.charts[chart].page as usize;
    content.for_each_triangle(
        |chart| !is_as_it_was[page_of(chart)],
        |chart, triangle| {
            roots[page_of(chart)].triangles.push(PieceTriangle {
                corners_m: mesh.corners_m(triangle).map(Into::into),
                corners_texel: layout.corners_texel[triangle.index()],
            });
        },
    );
    roots.retain(|root| !root.triangles.is_empty());
    roots
}

/// Least bytes of a triangle in any message: three indices.
const MIN_TRIANGLE_BYTES: usize = 6;
/// Texels that a byte may stand for, at most, where encoding is worth a try.
const MAX_TEXELS_PER_BYTE: usize = 8;

fn judge<T>(
    node: Node,
    textured: &TexturedMesh<'_>,
    params: &PublishParams,
    too_large: &TooLarge,
    is_known: &(dyn Fn(Digest) -> bool + Sync),
    build: &Build<'_, T>,
) -> Result<Judged<T>, PublishError> {
    let page = &textured.texture().pages[node.page as usize];
    // One triangle is divided only where it must be.
    let was_too_large = node.triangles.len() > 1 && too_large.regions.contains(&node.region.bits());
    let least_bytes = node.triangles.len() * MIN_TRIANGLE_BYTES;
    if was_too_large || least_bytes > params.max_message_bytes {
        return Ok(Judged::FarTooLarge(node));
    }
    let crop = needed_texels(page, &node.triangles);
    let num_texels = crop.width as usize * crop.height as usize;
    if least_bytes + num_texels / MAX_TEXELS_PER_BYTE > params.max_message_bytes {
        return Ok(Judged::FarTooLarge(node));
    }
    let piece = Piece {
        page: node.page,
        crop,
        triangles: node.triangles,
    };
    let digest = piece.digest(page);
    let place = Place {
        page: piece.page,
        crop: piece.crop,
    };
    if is_known(digest) {
        return Ok(Judged::Piece((digest, place, None)));
    }
    if !too_large.digests.contains(&digest)
        && let Some(built) = build(&piece, page)?
    {
        return Ok(Judged::Piece((digest, place, Some(built))));
    }
    let node = Node {
        page: piece.page,
        region: node.region,
        triangles: piece.triangles,
    };
    Ok(Judged::TooLarge(digest, node))
}

/// A triangle that needs no more texels than this on a side is not divided.
const SMALL_TRIANGLE_TEXEL: f32 = 16.0;

/// Appends the parts of a node.
fn divide(node: Node, params: &PublishParams, nodes: &mut Vec<Node>) -> Result<(), PublishError> {
    let Node {
        page,
        mut region,
        triangles,
    } = node;
    if let [triangle] = triangles.as_slice() {
        return divide_triangle(page, triangle, params, nodes);
    }
    while region.size[region.axis()] >= SMALLEST_REGION_TEXEL {
        let (upper, lower): (Vec<_>, Vec<_>) = triangles
            .iter()
            .partition(|triangle| region.half_of(triangle.center_texel()) == 0);
        // The same triangles in a smaller rectangle are no smaller.
        if lower.is_empty() || upper.is_empty() {
            region = region.half(usize::from(upper.is_empty()));
            continue;
        }
        for (index, triangles) in [upper, lower].into_iter().enumerate() {
            nodes.push(Node {
                page,
                region: region.half(index),
                triangles,
            });
        }
        return Ok(());
    }
    for half in triangles.chunks(triangles.len().div_ceil(2)) {
        nodes.push(Node {
            page,
            region,
            triangles: half.to_vec(),
        });
    }
    Ok(())
}

fn divide_triangle(
    page: u32,
    triangle: &PieceTriangle,
    params: &PublishParams,
    nodes: &mut Vec<Node>,
) -> Result<(), PublishError> {
    let extent = |axis: usize| {
        let [a, b, c] = triangle.corners_texel.map(|corner| corner[axis]);
        let low = a.min(b).min(c);
        (low, a.max(b).max(c) - low)
    };
    let [(x, width), (y, height)] = [extent(0), extent(1)];
    if width.max(height) <= SMALL_TRIANGLE_TEXEL {
        return Err(PublishError::DoesNotFit {
            what: "a small triangle with its texels",
            needed_bytes: params.max_message_bytes + 1,
            max_message_bytes: params.max_message_bytes,
        });
    }
    nodes.push(Node {
        page,
        region: Region {
            low: [x, y],
            size: [width, height],
        },
        triangles: triangle.quarters().to_vec(),
    });
    Ok(())
}

/// Vertices of a piece that triangles share.
pub(super) struct Indexed {
    /// Positions, metres; each place once.
    pub(super) positions_m: Vec<[f64; 3]>,
    /// Indices into them.
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Piece {
    /// Its triangles over shared vertices, in the order of first appearance.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a piece has fewer vertices than a message has bytes"
    )]
    pub(super) fn indexed(&self) -> Indexed {
        let mut vertices = std::collections::BTreeMap::new();
        let mut positions_m = Vec::new();
        let triangles = self
            .triangles
            .iter()
            .map(|triangle| {
                triangle.corners_m.map(|position_m| {
                    *vertices
                        .entry(position_m.map(f64::to_bits))
                        .or_insert_with(|| {
                            positions_m.push(position_m);
                            positions_m.len() as u32 - 1
                        })
                })
            })
            .collect();
        Indexed {
            positions_m,
            triangles,
        }
    }

    /// Its texture as an image file.
    pub(super) fn encode_texture(
        &self,
        page: &TexturePage,
        format: crate::export::PageFormat,
    ) -> Result<Vec<u8>, ExportError> {
        crop::encode(self.page as usize, page, &self.crop, format)
    }
}
