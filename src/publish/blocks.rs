//! `~/textured_mesh`: what changed of the charts and of the pages, in blocks.

mod charts;
mod tiles;

use crate::wire::textured_mesh_block::{TextureTile, TexturedChart};
use crate::wire::{Message, TexturedMeshBlock};

use super::sent::Sent;
use super::{Content, PublishError, PublishParams, Snapshot};
use charts::KnownParts;
use tiles::Tiles;

/// What readers hold.
#[derive(Debug, Default)]
pub(super) struct Blocks {
    /// The last revision that went out; `None` when readers hold nothing.
    base: Option<Base>,
    charts: Sent<()>,
    parts: KnownParts,
    tiles: Tiles,
    num_since_whole: usize,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Base {
    session: u64,
    revision: u64,
    page_size_texel: [u32; 2],
    num_pages: u32,
    frame_id: String,
}

impl Base {
    fn of(snapshot: &Snapshot<'_>) -> Self {
        Self {
            session: snapshot.session,
            revision: snapshot.revision,
            page_size_texel: snapshot.layout.page_size_texel,
            num_pages: snapshot.layout.num_pages,
            frame_id: snapshot.frame_id.to_owned(),
        }
    }

    /// Whether a state can be told as a change of this one.
    fn can_become(&self, next: &Self) -> bool {
        self.session == next.session
            && self.page_size_texel == next.page_size_texel
            && self.frame_id == next.frame_id
    }
}

/// Everything that a revision says.
struct Revision<'a> {
    removed_chart_ids: Vec<u32>,
    charts: Vec<TexturedChart>,
    tiles: Vec<TextureTile<'a>>,
}

impl Blocks {
    pub(super) fn forget(&mut self) {
        self.base = None;
        self.num_since_whole = 0;
    }

    pub(super) fn num_since_whole(&self) -> usize {
        self.num_since_whole
    }

    pub(super) fn publish(
        &mut self,
        snapshot: &Snapshot<'_>,
        content: &Content<'_>,
        params: &PublishParams,
    ) -> Result<Vec<Vec<u8>>, PublishError> {
        let next = Base::of(snapshot);
        let base = self.base.take().filter(|base| base.can_become(&next));
        if let Some(base) = &base {
            let messages = self.publish_change(base, snapshot, content, params)?;
            let num_kept = self.num_since_whole + messages.len();
            if num_kept <= params.history_messages {
                if messages.is_empty() {
                    self.base = Some(base.clone());
                } else {
                    self.base = Some(next);
                    self.num_since_whole = num_kept;
                }
                return Ok(messages);
            }
        }
        self.charts.clear();
        self.tiles.clear();
        let revision = self.revision(content, params, room(snapshot, params)?)?;
        let messages = packed(snapshot, 0, revision, params)?;
        self.num_since_whole = messages.len();
        self.base = Some(next);
        Ok(messages)
    }

    fn publish_change(
        &mut self,
        base: &Base,
        snapshot: &Snapshot<'_>,
        content: &Content<'_>,
        params: &PublishParams,
    ) -> Result<Vec<Vec<u8>>, PublishError> {
        let revision = self.revision(content, params, room(snapshot, params)?)?;
        let is_change = !revision.removed_chart_ids.is_empty()
            || !revision.charts.is_empty()
            || !revision.tiles.is_empty()
            || base.num_pages != snapshot.layout.num_pages;
        if !is_change {
            return Ok(Vec::new());
        }
        if snapshot.revision <= base.revision {
            return Err(PublishError::NotNewer {
                session: snapshot.session,
                revision: snapshot.revision,
                published: base.revision,
            });
        }
        packed(snapshot, base.revision, revision, params)
    }

    fn revision(
        &mut self,
        content: &Content<'_>,
        params: &PublishParams,
        room: usize,
    ) -> Result<Revision<'static>, PublishError> {
        let is_sent = |digest| self.charts.contains(digest);
        let all = self.parts.all(content, room, &is_sent).into_iter();
        let change = self
            .charts
            .change(all.map(|(digest, chart)| (digest, (), chart)).collect())?;
        // What is not built was sent.
        let built = |(id, chart): (u32, Option<TexturedChart>)| Some((id, chart?));
        let charts = change.added.into_iter().filter_map(built);
        Ok(Revision {
            removed_chart_ids: change.removed.into_iter().map(|(id, ())| id).collect(),
            charts: charts
                .map(|(id, chart)| TexturedChart { id, ..chart })
                .collect(),
            tiles: self
                .tiles
                .changed(content.textured.texture(), params, room)?,
        })
    }
}

fn empty_block<'a>(snapshot: &Snapshot<'a>, base_revision: u64) -> TexturedMeshBlock<'a> {
    TexturedMeshBlock {
        header: snapshot.header(),
        session: snapshot.session,
        revision: snapshot.revision,
        base_revision,
        block_index: 0,
        num_blocks: 1,
        page_size_texel: snapshot.layout.page_size_texel,
        num_pages: snapshot.layout.num_pages,
        removed_chart_ids: Vec::new(),
        charts: Vec::new(),
        tiles: Vec::new(),
    }
}

/// Bytes that a block has for charts and tiles.
fn room(snapshot: &Snapshot<'_>, params: &PublishParams) -> Result<usize, PublishError> {
    let empty = empty_block(snapshot, 0).encode();
    let what = "an empty block of textured_mesh, with room for a few triangles,";
    let needed_bytes = empty.len() + MIN_ROOM;
    if needed_bytes > params.max_message_bytes {
        return Err(PublishError::DoesNotFit {
            what,
            needed_bytes,
            max_message_bytes: params.max_message_bytes,
        });
    }
    Ok(params.max_message_bytes - empty.len())
}

/// A chart of one triangle and a tile of some texels fit in here.
const MIN_ROOM: usize = 4096;

/// Fills block after block.
fn packed<'a>(
    snapshot: &Snapshot<'a>,
    base_revision: u64,
    revision: Revision<'a>,
    params: &PublishParams,
) -> Result<Vec<Vec<u8>>, PublishError> {
    let room = room(snapshot, params)?;
    let mut blocks = vec![empty_block(snapshot, base_revision)];
    let mut num_free = room;
    let mut take = |blocks: &mut Vec<TexturedMeshBlock<'a>>, num_bytes: usize| {
        if num_bytes > num_free {
            blocks.push(empty_block(snapshot, base_revision));
            num_free = room;
        }
        num_free = num_free.saturating_sub(num_bytes);
    };
    for id in revision.removed_chart_ids {
        take(&mut blocks, size_of::<u32>());
        last(&mut blocks).removed_chart_ids.push(id);
    }
    for chart in revision.charts {
        take(&mut blocks, chart.max_bytes());
        last(&mut blocks).charts.push(chart);
    }
    for tile in revision.tiles {
        take(&mut blocks, tile.max_bytes());
        last(&mut blocks).tiles.push(tile);
    }
    let num_blocks = u32::try_from(blocks.len()).unwrap_or(u32::MAX);
    let messages = (0..num_blocks).zip(blocks).map(|(block_index, block)| {
        let block = TexturedMeshBlock {
            block_index,
            num_blocks,
            ..block
        };
        params.checked("a block of textured_mesh", block.encode())
    });
    messages.collect()
}

#[expect(clippy::expect_used, reason = "there is a first block from the start")]
fn last<'a, 'b>(blocks: &'b mut [TexturedMeshBlock<'a>]) -> &'b mut TexturedMeshBlock<'a> {
    blocks.last_mut().expect("there is a block")
}
