//! The other end of `~/textured_mesh`: puts blocks together to the textured mesh again.
//!
//! A block is kept until all of its revision are there; then they are applied together. Blocks may
//! come in any order and twice. A revision whose base is not held, or of which blocks are missing when
//! a newer one begins, is left out; the next whole one is taken again. What is held after a revision
//! is exactly what its publisher had: the texels of every page, and for each triangle its corners in
//! space and on its page.
//!
//! Nothing that a block says drives an allocation beyond [`MirrorLimits`].

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Point3;

use crate::atlas::{AtlasLayout, AtlasTexture, ChartId, PlacedChart, TexelRect, TexturePage};
use crate::geom::Stamp;
use crate::mesh::{MeshError, TriMesh};
use crate::wire::TexturedMeshBlock;
use crate::wire::textured_mesh_block::{TextureTile, TexturedChart};

/// What a mirror accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MirrorLimits {
    /// Texels of all pages; each takes 3 bytes here.
    pub max_texels: u64,
    /// Bytes of the blocks of a revision, as they came.
    pub max_revision_bytes: usize,
}

impl Default for MirrorLimits {
    fn default() -> Self {
        Self {
            max_texels: 1 << 28,
            max_revision_bytes: 1 << 30,
        }
    }
}

/// Why a block was refused. What is held stays as it was.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MirrorError {
    /// Index, count or revisions contradict each other.
    #[error(
        "block {block_index} of {num_blocks}, revision {revision} upon {base_revision}, contradicts itself or those before"
    )]
    Inconsistent {
        /// Place of the block.
        block_index: u32,
        /// Blocks of the revision.
        num_blocks: u32,
        /// The revision.
        revision: u64,
        /// Its base.
        base_revision: u64,
    },
    /// More than the mirror accepts.
    #[error("{what} = {value} is beyond the limit of {limit}")]
    Limit {
        /// What.
        what: &'static str,
        /// How much of it.
        value: u64,
        /// How much may be.
        limit: u64,
    },
    /// A chart that is there is added, or one that is not there removed.
    #[error("chart {id} is {problem}")]
    Chart {
        /// Its name.
        id: u32,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A tile lies outside its page, or its file is not what it says.
    #[error("tile of {width}x{height} at ({x}, {y}) of page {page}: {reason}")]
    Tile {
        /// Which page.
        page: u32,
        /// Left column.
        x: u32,
        /// Top row.
        y: u32,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// What is wrong.
        reason: String,
    },
    /// The mesh has more vertices than 32 bits can name.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// What became of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Applied {
    /// It is kept until the rest of its revision is there.
    Waiting,
    /// It completed this revision, which is now held.
    Revision(u64),
    /// It belongs to a revision that is held already, or whose base is not held.
    Useless,
}

/// The textured mesh of a publisher, as far as its blocks arrived.
#[derive(Clone, Debug)]
pub struct Mirror {
    limits: MirrorLimits,
    held: Held,
    pending: Option<Pending>,
}

/// A state that is whole.
#[derive(Clone, Debug, PartialEq, Default)]
struct Held {
    session: u64,
    revision: u64,
    stamp: Stamp,
    frame_id: String,
    page_size_texel: [u32; 2],
    pages: Vec<Vec<[u8; 3]>>,
    charts: BTreeMap<u32, TexturedChart>,
}

/// Blocks of a revision that is not complete.
#[derive(Clone, Debug)]
struct Pending {
    session: u64,
    revision: u64,
    base_revision: u64,
    num_blocks: u32,
    num_bytes: usize,
    blocks: BTreeMap<u32, PendingBlock>,
}

/// A block that owns its data.
#[derive(Clone, Debug)]
struct PendingBlock {
    stamp: Stamp,
    frame_id: String,
    page_size_texel: [u32; 2],
    num_pages: u32,
    removed_chart_ids: Vec<u32>,
    charts: Vec<TexturedChart>,
    tiles: Vec<OwnedTile>,
}

/// What all blocks of a revision have in common: page size, frame, pages.
type Shape<'a> = ([u32; 2], &'a str, u32);

impl PendingBlock {
    fn shape(&self) -> Shape<'_> {
        (self.page_size_texel, &self.frame_id, self.num_pages)
    }
}

#[derive(Clone, Debug)]
struct OwnedTile {
    page: u32,
    rect: TexelRect,
    srgb: Vec<[u8; 3]>,
}

impl Mirror {
    /// A mirror that holds nothing.
    pub fn new(limits: MirrorLimits) -> Self {
        Self {
            limits,
            held: Held::default(),
            pending: None,
        }
    }

    /// The revision that is held; `None` before the first whole one.
    pub fn revision(&self) -> Option<u64> {
        (self.held.revision > 0).then_some(self.held.revision)
    }

    /// The session of what is held.
    pub fn session(&self) -> u64 {
        self.held.session
    }

    /// When the newest data in what is held was taken.
    pub fn stamp(&self) -> Stamp {
        self.held.stamp
    }

    /// The frame of the vertices.
    pub fn frame_id(&self) -> &str {
        &self.held.frame_id
    }

    /// Width and height of every page, texels.
    pub fn page_size_texel(&self) -> [u32; 2] {
        self.held.page_size_texel
    }

    /// sRGB texels of each page, row by row.
    pub fn pages(&self) -> &[Vec<[u8; 3]>] {
        &self.held.pages
    }

    /// The charts by their names.
    pub fn charts(&self) -> impl Iterator<Item = &TexturedChart> {
        self.held.charts.values()
    }

    /// Whether two mirrors hold the same, to the bit.
    pub fn holds_same_as(&self, other: &Self) -> bool {
        self.held == other.held
    }

    /// Takes a block.
    ///
    /// # Errors
    /// [`MirrorError`]; the block, and with it its revision, is left out.
    pub fn apply(&mut self, block: &TexturedMeshBlock<'_>) -> Result<Applied, MirrorError> {
        let applied = self.try_apply(block);
        if applied.is_err() {
            self.pending = None;
        }
        applied
    }

    fn try_apply(&mut self, block: &TexturedMeshBlock<'_>) -> Result<Applied, MirrorError> {
        let inconsistent = || MirrorError::Inconsistent {
            block_index: block.block_index,
            num_blocks: block.num_blocks,
            revision: block.revision,
            base_revision: block.base_revision,
        };
        if block.block_index >= block.num_blocks || block.revision == 0 {
            return Err(inconsistent());
        }
        let held = (self.held.session, self.held.revision);
        if held == (block.session, block.revision) {
            return Ok(Applied::Useless);
        }
        if block.base_revision != 0 && held != (block.session, block.base_revision) {
            return Ok(Applied::Useless);
        }
        let is_outrun = self.pending.as_ref().is_some_and(|pending| {
            pending.session == block.session && pending.revision > block.revision
        });
        if is_outrun {
            return Ok(Applied::Useless);
        }
        let key = (block.session, block.revision, block.base_revision);
        let mut pending = match self.pending.take() {
            Some(pending) if (pending.session, pending.revision, pending.base_revision) == key => {
                pending
            }
            _ => Pending {
                session: block.session,
                revision: block.revision,
                base_revision: block.base_revision,
                num_blocks: block.num_blocks,
                num_bytes: 0,
                blocks: BTreeMap::new(),
            },
        };
        if pending.num_blocks != block.num_blocks {
            return Err(inconsistent());
        }
        if !pending.blocks.contains_key(&block.block_index) {
            pending.num_bytes += num_bytes(block);
            limit(
                "bytes of a revision",
                pending.num_bytes as u64,
                self.limits.max_revision_bytes as u64,
            )?;
            let owned = self.own(block)?;
            pending.blocks.insert(block.block_index, owned);
        }
        if pending.blocks.len() < pending.num_blocks as usize {
            self.pending = Some(pending);
            return Ok(Applied::Waiting);
        }
        let revision = pending.revision;
        self.check(&pending)?;
        self.complete(pending);
        Ok(Applied::Revision(revision))
    }

    /// The block with its tiles decoded.
    fn own(&self, block: &TexturedMeshBlock<'_>) -> Result<PendingBlock, MirrorError> {
        let [width, height] = block.page_size_texel.map(u64::from);
        let num_texels = width
            .saturating_mul(height)
            .saturating_mul(block.num_pages.into());
        limit("texels of all pages", num_texels, self.limits.max_texels)?;
        for chart in &block.charts {
            check_chart(chart, block.num_pages)?;
        }
        let tiles = block.tiles.iter().map(|tile| decode_tile(tile, block));
        Ok(PendingBlock {
            stamp: block.header.stamp,
            frame_id: block.header.frame_id.to_owned(),
            page_size_texel: block.page_size_texel,
            num_pages: block.num_pages,
            removed_chart_ids: block.removed_chart_ids.clone(),
            charts: block.charts.clone(),
            tiles: tiles.collect::<Result<_, _>>()?,
        })
    }

    /// Whether a complete revision can be applied to what is held.
    fn check(&self, pending: &Pending) -> Result<(), MirrorError> {
        let is_whole = pending.base_revision == 0;
        let mut shapes = pending.blocks.iter().map(|(&index, b)| (index, b.shape()));
        let Some((_, first)) = shapes.next() else {
            return Ok(());
        };
        let differs = |shape: &Shape<'_>| *shape != first;
        let changes_pages = !is_whole && first.0 != self.held.page_size_texel;
        let other = shapes.find(|(_, shape)| differs(shape));
        if let Some(block_index) = other.map(|(i, _)| i).or(changes_pages.then_some(0)) {
            return Err(MirrorError::Inconsistent {
                block_index,
                num_blocks: pending.num_blocks,
                revision: pending.revision,
                base_revision: pending.base_revision,
            });
        }
        let refused = |id, problem| Err(MirrorError::Chart { id, problem });
        let is_held = |id: u32| !is_whole && self.held.charts.contains_key(&id);
        let mut removed = BTreeSet::new();
        for &id in pending.blocks.values().flat_map(|b| &b.removed_chart_ids) {
            if !is_held(id) || !removed.insert(id) {
                return refused(id, "to be removed, but not there");
            }
        }
        let mut added = BTreeSet::new();
        for chart in pending.blocks.values().flat_map(|block| &block.charts) {
            let is_there = is_held(chart.id) && !removed.contains(&chart.id);
            if is_there || !added.insert(chart.id) {
                return refused(chart.id, "to be added, but there already");
            }
        }
        Ok(())
    }

    /// Applies a revision that was checked.
    fn complete(&mut self, pending: Pending) {
        if pending.base_revision == 0 {
            self.held = Held::default();
        }
        let held = &mut self.held;
        held.session = pending.session;
        held.revision = pending.revision;
        for block in pending.blocks.into_values() {
            held.stamp = block.stamp;
            held.page_size_texel = block.page_size_texel;
            let [width, height] = block.page_size_texel.map(|side| side as usize);
            held.pages
                .resize_with(block.num_pages as usize, || vec![[0; 3]; width * height]);
            for id in block.removed_chart_ids {
                held.charts.remove(&id);
            }
            for chart in block.charts {
                held.charts.insert(chart.id, chart);
            }
            for tile in block.tiles {
                let page = &mut held.pages[tile.page as usize];
                let rows = tile.srgb.chunks_exact(tile.rect.width as usize);
                for (row, y) in rows.zip(tile.rect.y as usize..) {
                    let start = y * width + tile.rect.x as usize;
                    page[start..start + row.len()].copy_from_slice(row);
                }
            }
            held.frame_id = block.frame_id;
        }
    }

    /// The textured mesh that is held, in the form that [`crate::export`] writes: charts by their
    /// names, vertices shared within a chart only.
    ///
    /// # Errors
    /// [`MirrorError::Mesh`] when there are more vertices than 32 bits can name.
    pub fn to_textured(&self) -> Result<(TriMesh, AtlasLayout, AtlasTexture), MirrorError> {
        let held = &self.held;
        let mut positions_m = Vec::new();
        let mut triangles = Vec::new();
        let mut layout = AtlasLayout {
            page_size_texel: held.page_size_texel,
            num_pages: u32::try_from(held.pages.len()).unwrap_or(u32::MAX),
            texels_per_m: 1.0,
            charts: Vec::new(),
            chart_of_triangle: Vec::new(),
            corners_texel: Vec::new(),
        };
        for (chart_id, chart) in (0u32..).zip(held.charts.values()) {
            let too_large = MeshError::TooLarge {
                num_vertices: positions_m.len() + chart.vertices_m.len(),
                num_triangles: triangles.len() + chart.triangles.len() / 3,
            };
            // A chart's indices are within its vertices, so that all sums below fit if this one does.
            let end = u32::try_from(positions_m.len() + chart.vertices_m.len());
            let (Ok(first), Ok(_)) = (u32::try_from(positions_m.len()), end) else {
                return Err(too_large.into());
            };
            positions_m.extend(chart.vertices_m.iter().copied().map(Point3::from));
            let first_triangle = triangles.len();
            for corners in chart.triangles.as_chunks::<3>().0 {
                triangles.push(corners.map(|vertex| first + vertex));
                layout.corners_texel.push(corners.map(|vertex| {
                    let uv = &chart.uvs[2 * vertex as usize..][..2];
                    let [width, height] = held.page_size_texel;
                    [texel_of(uv[0], width), texel_of(uv[1], height)]
                }));
            }
            let new_triangles = first_triangle..triangles.len();
            layout
                .chart_of_triangle
                .extend(new_triangles.clone().map(|_| ChartId(chart_id)));
            let ids = new_triangles.filter_map(|t| u32::try_from(t).ok());
            layout.charts.push(PlacedChart::whole_rect(
                chart.page,
                chart.rect,
                1.0,
                ids.map(crate::mesh::TriangleId).collect(),
            ));
        }
        let (mesh, _) = TriMesh::from_soup(positions_m, triangles)?;
        let [width, height] = held.page_size_texel;
        let pages = held.pages.iter().map(|srgb| TexturePage {
            srgb: srgb.clone(),
            ..TexturePage::blank(width, height)
        });
        let texture = pages.collect();
        Ok((mesh, layout, texture))
    }
}

fn limit(what: &'static str, value: u64, limit: u64) -> Result<(), MirrorError> {
    if value <= limit {
        return Ok(());
    }
    Err(MirrorError::Limit { what, value, limit })
}

/// What a block takes, roughly.
fn num_bytes(block: &TexturedMeshBlock<'_>) -> usize {
    let charts: usize = block.charts.iter().map(TexturedChart::max_bytes).sum();
    let tiles = block.tiles.iter().map(|tile| {
        let num_texels = tile.rect.width as usize * tile.rect.height as usize;
        num_texels.saturating_mul(3)
    });
    let tiles = tiles.fold(0, usize::saturating_add);
    charts.saturating_add(tiles) + 4 * block.removed_chart_ids.len() + 64
}

fn check_chart(chart: &TexturedChart, num_pages: u32) -> Result<(), MirrorError> {
    let problem = |problem| MirrorError::Chart {
        id: chart.id,
        problem,
    };
    let num_vertices = chart.vertices_m.len();
    if chart.page >= num_pages {
        return Err(problem("on a page that is not there"));
    }
    if chart.uvs.len() != 2 * num_vertices {
        return Err(problem("without a coordinate for each vertex"));
    }
    if !chart.triangles.len().is_multiple_of(3) {
        return Err(problem("with an incomplete triangle"));
    }
    if chart.triangles.iter().any(|&v| v as usize >= num_vertices) {
        return Err(problem("with a vertex index that is out of range"));
    }
    let is_finite = chart
        .vertices_m
        .as_flattened()
        .iter()
        .all(|c| c.is_finite());
    if !is_finite || !chart.uvs.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Err(problem("with a vertex nowhere, or off its page"));
    }
    Ok(())
}

fn decode_tile(
    tile: &TextureTile<'_>,
    block: &TexturedMeshBlock<'_>,
) -> Result<OwnedTile, MirrorError> {
    let TexelRect {
        x,
        y,
        width,
        height,
    } = tile.rect;
    let problem = |reason: String| MirrorError::Tile {
        page: tile.page,
        x,
        y,
        width,
        height,
        reason,
    };
    let [page_width, page_height] = block.page_size_texel;
    let is_on_page = tile.page < block.num_pages
        && x.checked_add(width).is_some_and(|end| end <= page_width)
        && y.checked_add(height).is_some_and(|end| end <= page_height)
        && width > 0
        && height > 0;
    if !is_on_page {
        return Err(problem("is not on a page".to_owned()));
    }
    let format = match tile.format {
        "png" => image::ImageFormat::Png,
        "jpeg" => image::ImageFormat::Jpeg,
        other => return Err(problem(format!("has the format '{other}'"))),
    };
    let mut reader = image::ImageReader::new(std::io::Cursor::new(tile.data.as_ref()));
    reader.set_format(format);
    // A file that says it is larger than its tile is refused before anything is allocated for it.
    let mut limits = image::Limits::no_limits();
    limits.max_image_width = Some(width);
    limits.max_image_height = Some(height);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| problem(e.to_string()))?;
    if (decoded.width(), decoded.height()) != (width, height) {
        return Err(problem(format!(
            "holds an image of {}x{}",
            decoded.width(),
            decoded.height()
        )));
    }
    let bytes = decoded.into_rgb8().into_raw();
    let (srgb, _) = bytes.as_chunks::<3>();
    Ok(OwnedTile {
        page: tile.page,
        rect: tile.rect,
        srgb: srgb.to_vec(),
    })
}

/// The texel coordinate whose share of the page's side is exactly `share`. Division rounds, so that
/// the product may be a neighbour of it.
pub(super) fn texel_of(share: f32, side_texel: u32) -> f32 {
    let side = side_texel as f32;
    let near = share * side;
    let candidates = [
        near,
        near.next_up(),
        near.next_down(),
        near.next_up().next_up(),
        near.next_down().next_down(),
    ];
    candidates
        .into_iter()
        .find(|&texel| texel / side == share && (0.0..=side).contains(&texel))
        .unwrap_or_else(|| near.clamp(0.0, side))
}
