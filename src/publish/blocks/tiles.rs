//! The pages' texels in tiles of a fixed grid: those that changed, as image files.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::atlas::{AtlasTexture, PageTrace, SharedPage, TexelRect, TexturePage};
use crate::export::PageFormat;
use crate::publish::digest::{Digest, Digester};
use crate::publish::{PublishError, PublishParams, crop};
use crate::wire::textured_mesh_block::TextureTile;

/// Digests of what readers hold; tiles that are not here are black.
#[derive(Debug, Default)]
pub(super) struct Tiles {
    held: BTreeMap<(u32, u32, u32), Digest>,
    /// Pages as they were when their tiles were held against those.
    compared: Vec<PageTrace>,
}

/// A tile of the grid that is not what readers hold.
struct Changed {
    page: u32,
    rect: TexelRect,
    digest: Digest,
}

impl Tiles {
    pub(super) fn clear(&mut self) {
        self.held.clear();
        self.compared.clear();
    }

    /// Tiles that differ from what readers hold, who hold them from now on. A tile that is too long
    /// for a message is divided.
    pub(super) fn changed(
        &mut self,
        texture: &AtlasTexture,
        params: &PublishParams,
        max_bytes: usize,
    ) -> Result<Vec<TextureTile<'static>>, PublishError> {
        let num_pages = texture.pages.len();
        self.held
            .retain(|(page, ..), _| (*page as usize) < num_pages);
        let is_same = |page: &(u32, &SharedPage)| {
            let compared = self.compared.get(page.0 as usize);
            compared.is_some_and(|trace| trace.is_of(page.1))
        };
        let pages = (0_u32..).zip(&texture.pages).filter(|page| !is_same(page));
        let changed: Vec<Changed> = grid(pages, params.tile_texel)
            .into_par_iter()
            .filter_map(|(page, rect)| self.compare(&texture.pages[page as usize], page, rect))
            .collect();
        let tiles: Vec<Result<Vec<TextureTile<'static>>, PublishError>> = changed
            .par_iter()
            .map(|tile| {
                let page = &texture.pages[tile.page as usize];
                encode(page, tile.page, tile.rect, params, max_bytes)
            })
            .collect();
        let tiles: Vec<Vec<TextureTile<'static>>> = tiles.into_iter().collect::<Result<_, _>>()?;
        for tile in changed {
            let key = (tile.page, tile.rect.x, tile.rect.y);
            self.held.insert(key, tile.digest);
        }
        self.compared = texture.pages.iter().map(SharedPage::trace).collect();
        Ok(tiles.into_iter().flatten().collect())
    }

    fn compare(&self, page: &TexturePage, index: u32, rect: TexelRect) -> Option<Changed> {
        let mut digester = Digester::new();
        let mut is_black = true;
        for row in crop::rows(page, &rect) {
            let bytes = row.as_flattened();
            is_black = is_black && bytes.iter().all(|&byte| byte == 0);
            digester.bytes(bytes);
        }
        let digest = digester.finish();
        let is_held = match self.held.get(&(index, rect.x, rect.y)) {
            Some(held) => *held == digest,
            None => is_black,
        };
        (!is_held).then_some(Changed {
            page: index,
            rect,
            digest,
        })
    }
}

fn grid<'a>(
    pages: impl Iterator<Item = (u32, &'a SharedPage)>,
    tile_texel: u32,
) -> Vec<(u32, TexelRect)> {
    let mut tiles = Vec::new();
    let step = tile_texel as usize;
    for (index, page) in pages {
        for y in (0..page.height).step_by(step) {
            for x in (0..page.width).step_by(step) {
                let rect = TexelRect {
                    x,
                    y,
                    width: tile_texel.min(page.width - x),
                    height: tile_texel.min(page.height - y),
                };
                tiles.push((index, rect));
            }
        }
    }
    tiles
}

/// The word for the message.
fn format_word(format: PageFormat) -> &'static str {
    match format {
        PageFormat::Png => "png",
        PageFormat::Jpeg { .. } => "jpeg",
    }
}

fn encode(
    page: &TexturePage,
    index: u32,
    rect: TexelRect,
    params: &PublishParams,
    max_bytes: usize,
) -> Result<Vec<TextureTile<'static>>, PublishError> {
    let tile = TextureTile {
        page: index,
        rect,
        format: format_word(params.format),
        data: crop::encode(index as usize, page, &rect, params.format)?.into(),
    };
    if tile.max_bytes() <= max_bytes {
        return Ok(vec![tile]);
    }
    let Some(halves) = halves(&rect) else {
        return Err(PublishError::DoesNotFit {
            what: "a tile of one texel",
            needed_bytes: tile.max_bytes(),
            max_message_bytes: params.max_message_bytes,
        });
    };
    let mut tiles = Vec::new();
    for half in halves {
        tiles.extend(encode(page, index, half, params, max_bytes)?);
    }
    Ok(tiles)
}

/// The rectangle cut across its longer side.
fn halves(rect: &TexelRect) -> Option<[TexelRect; 2]> {
    let TexelRect {
        x,
        y,
        width,
        height,
    } = *rect;
    if width >= height && width > 1 {
        let left = width / 2;
        let right = TexelRect {
            x: x + left,
            width: width - left,
            ..*rect
        };
        return Some([
            TexelRect {
                width: left,
                ..*rect
            },
            right,
        ]);
    }
    let top = height / 2;
    (height > 1).then(|| {
        let bottom = TexelRect {
            y: y + top,
            height: height - top,
            ..*rect
        };
        [
            TexelRect {
                height: top,
                ..*rect
            },
            bottom,
        ]
    })
}
