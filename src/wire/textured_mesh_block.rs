//! `veneer/TexturedMeshBlock`: a part of a revision of the textured mesh, only what changed.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, schema};
use crate::atlas::TexelRect;

/// `veneer/TexturedChart`.
#[derive(Clone, Debug, PartialEq)]
pub struct TexturedChart {
    /// Names the chart within its session.
    pub id: u32,
    /// Page of the atlas.
    pub page: u32,
    /// The chart's rectangle on the page.
    pub rect: TexelRect,
    /// Vertices, metres, in the frame of the block's header.
    pub vertices_m: Vec<[f64; 3]>,
    /// u and v of each vertex in [0, 1] of the page, v down.
    pub uvs: Vec<f32>,
    /// Vertex indices, three a triangle.
    pub triangles: Vec<u32>,
}

/// `veneer/TextureTile`.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureTile<'a> {
    /// Page of the atlas.
    pub page: u32,
    /// The tile's rectangle on the page.
    pub rect: TexelRect,
    /// `png`, `jpeg` or `ktx2`.
    pub format: &'a str,
    /// The image file.
    pub data: std::borrow::Cow<'a, [u8]>,
}

/// `veneer/TexturedMeshBlock`.
#[derive(Clone, Debug, PartialEq)]
pub struct TexturedMeshBlock<'a> {
    /// When the newest data was taken, and the frame of the vertices.
    pub header: WireHeader<'a>,
    /// Drawn anew when the publisher starts or is reset.
    pub session: u64,
    /// Counts the states of the session, from 1.
    pub revision: u64,
    /// The revision that is changed; 0 for none.
    pub base_revision: u64,
    /// Place among the blocks of the revision.
    pub block_index: u32,
    /// Blocks of the revision.
    pub num_blocks: u32,
    /// Width and height of every page, texels.
    pub page_size_texel: [u32; 2],
    /// Pages of the atlas.
    pub num_pages: u32,
    /// Charts of the base that are no longer there.
    pub removed_chart_ids: Vec<u32>,
    /// Charts that are new.
    pub charts: Vec<TexturedChart>,
    /// Texels that are new.
    pub tiles: Vec<TextureTile<'a>>,
}

/// Six numbers and three empty sequences.
const MIN_CHART_BYTES: usize = 36;
/// Five numbers, an empty string and an empty sequence.
const MIN_TILE_BYTES: usize = 28;

fn write_rect(writer: &mut CdrWriter, rect: &TexelRect) {
    writer.array(&[rect.x, rect.y, rect.width, rect.height]);
}

impl TexturedChart {
    fn read(reader: &mut CdrReader<'_>) -> Result<Self, WireError> {
        Ok(Self {
            id: reader.scalar("charts.id")?,
            page: reader.scalar("charts.page")?,
            rect: TexelRect {
                x: reader.scalar("charts.x")?,
                y: reader.scalar("charts.y")?,
                width: reader.scalar("charts.width")?,
                height: reader.scalar("charts.height")?,
            },
            vertices_m: reader.tuples("charts.vertices")?,
            uvs: reader.scalars("charts.uvs")?,
            triangles: reader.scalars("charts.triangles")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.scalar(self.id);
        writer.scalar(self.page);
        write_rect(writer, &self.rect);
        writer.tuples(&self.vertices_m);
        writer.scalars(&self.uvs);
        writer.scalars(&self.triangles);
    }

    /// The most bytes it takes in a message, padding included.
    pub fn max_bytes(&self) -> usize {
        // Up to 3 bytes before the numbers, 4 before the 8-byte coordinates.
        MIN_CHART_BYTES
            + 8
            + size_of_val(self.vertices_m.as_slice())
            + 4 * (self.uvs.len() + self.triangles.len())
    }
}

impl<'a> TextureTile<'a> {
    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            page: reader.scalar("tiles.page")?,
            rect: TexelRect {
                x: reader.scalar("tiles.x")?,
                y: reader.scalar("tiles.y")?,
                width: reader.scalar("tiles.width")?,
                height: reader.scalar("tiles.height")?,
            },
            format: reader.string("tiles.format")?,
            data: reader.bytes("tiles.data")?.into(),
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.scalar(self.page);
        write_rect(writer, &self.rect);
        writer.string(self.format);
        writer.bytes(&self.data);
    }

    /// The most bytes it takes in a message, padding included.
    pub fn max_bytes(&self) -> usize {
        MIN_TILE_BYTES + 8 + self.format.len() + self.data.len()
    }
}

impl<'a> Message<'a> for TexturedMeshBlock<'a> {
    const TYPE_NAME: &'static str = "veneer/msg/TexturedMeshBlock";
    const SCHEMA: &'static str = schema::TEXTURED_MESH_BLOCK;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            session: reader.scalar("session")?,
            revision: reader.scalar("revision")?,
            base_revision: reader.scalar("base_revision")?,
            block_index: reader.scalar("block_index")?,
            num_blocks: reader.scalar("num_blocks")?,
            page_size_texel: [reader.scalar("page_width")?, reader.scalar("page_height")?],
            num_pages: reader.scalar("num_pages")?,
            removed_chart_ids: reader.scalars("removed_chart_ids")?,
            charts: reader.sequence("charts", MIN_CHART_BYTES, TexturedChart::read)?,
            tiles: reader.sequence("tiles", MIN_TILE_BYTES, TextureTile::read)?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.scalar(self.session);
        writer.scalar(self.revision);
        writer.scalar(self.base_revision);
        writer.scalar(self.block_index);
        writer.scalar(self.num_blocks);
        writer.array(&self.page_size_texel);
        writer.scalar(self.num_pages);
        writer.scalars(&self.removed_chart_ids);
        writer.sequence_len(self.charts.len());
        for chart in &self.charts {
            chart.write(writer);
        }
        writer.sequence_len(self.tiles.len());
        for tile in &self.tiles {
            tile.write(writer);
        }
    }
}
