//! The texture while it is optimised: values, and the moments of Adam, in tiles.
//!
//! Values are sRGB in [−1, 1] (ECCV 2022, section 3.2), unclamped until they are written back.
//! Tiles are 64×64; one without a painted texel has no memory, and moments come with a tile's first
//! step, so that what is not seen costs nothing. Texel centres are at halves.
//!
//! Where only some charts may change, tiles without a texel of theirs have no memory either: lookups
//! there read the texture itself, and no step reaches them.
//!
//! * [`Texels::footprint`] and [`Texels::gather`]: the bilinear lookup at a position of a page, over
//!   the painted ones of the four texels around it.
//! * [`Texels::step`]: its transpose, and a step of Adam (Kingma and Ba 2015) on the texels that
//!   were looked up, each with a count of its own steps for the correction of bias. Contributions are
//!   binned by tile in the order of the pixels, and each tile adds up its own in that order: the same
//!   bits for any thread count.

mod bins;

use rayon::prelude::*;

use crate::atlas::{AtlasLayout, AtlasTexture, TexelSource};
use bins::{Bins, scatter};

/// Texels along the side of a tile.
pub(super) const TILE_TEXEL: usize = 64;
const TILE_AREA: usize = TILE_TEXEL * TILE_TEXEL;
/// Pixels to a parallel piece of the lookup.
const CHUNK_PIXELS: usize = 4096;

/// A texel: its tile among all tiles of all pages, and its place in the tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct TexelAddress(u32);

impl TexelAddress {
    fn tile(self) -> usize {
        self.0 as usize / TILE_AREA
    }

    fn place(self) -> usize {
        self.0 as usize % TILE_AREA
    }
}

/// The texels that one lookup reads, with weights that add up to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Footprint {
    texel: [TexelAddress; 4],
    weight: [f32; 4],
}

impl Footprint {
    /// A lookup of nothing.
    pub(super) const NONE: Self = Self {
        texel: [TexelAddress(0); 4],
        weight: [0.0; 4],
    };

    /// Whether it reads anything.
    pub(super) fn is_some(&self) -> bool {
        self.weight != [0.0; 4]
    }
}

/// Settings of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AdamStep {
    pub(super) learning_rate: f32,
    pub(super) betas: [f32; 2],
}

const EPSILON: f32 = 1e-8;

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Tile {
    /// NaN where nothing is painted; empty when that is everywhere, or when no texel may change.
    pub(super) value: Vec<[f32; 3]>,
    /// Where the value came from before the first step; as long as [`Self::value`].
    source: Vec<TexelSource>,
    /// Which texels must not change; empty when all may.
    pub(super) is_fixed: Vec<bool>,
    pub(super) moments: Option<Box<Moments>>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Moments {
    pub(super) first: Vec<[f32; 3]>,
    pub(super) second: Vec<[f32; 3]>,
    /// Steps that each texel has made.
    pub(super) num_steps: Vec<u16>,
    /// Whether there were any since the tile was written to the texture.
    pub(super) is_unwritten: bool,
}

impl Moments {
    fn new() -> Self {
        Self {
            first: vec![[0.0; 3]; TILE_AREA],
            second: vec![[0.0; 3]; TILE_AREA],
            num_steps: vec![0; TILE_AREA],
            is_unwritten: false,
        }
    }
}

/// Texels that have made a step, and their steps in all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct TexelSteps {
    pub(super) num_texels: u64,
    pub(super) num_steps: u64,
}

#[derive(Clone, Debug, PartialEq)]
struct Page {
    size_texel: [usize; 2],
    tile_columns: usize,
    first_tile: usize,
}

impl Page {
    fn tile(&self, x: usize, y: usize) -> usize {
        self.first_tile + y / TILE_TEXEL * self.tile_columns + x / TILE_TEXEL
    }

    /// The first column and row of a tile.
    fn corner(&self, tile: usize) -> [usize; 2] {
        let tile = tile - self.first_tile;
        [tile % self.tile_columns, tile / self.tile_columns].map(|t| t * TILE_TEXEL)
    }

    /// The index of a texel on the page.
    fn index(&self, address: TexelAddress) -> usize {
        let [x, y] = self.corner(address.tile());
        let place = address.place();
        (y + place / TILE_TEXEL) * self.size_texel[0] + x + place % TILE_TEXEL
    }

    /// Calls with the place in the tile and the index on the page of each texel of a tile.
    fn for_each_place(&self, tile: usize, mut call: impl FnMut(usize, usize)) {
        let [width, height] = self.size_texel;
        let corner = self.corner(tile);
        for y in corner[1]..height.min(corner[1] + TILE_TEXEL) {
            for x in corner[0]..width.min(corner[0] + TILE_TEXEL) {
                call(place_of(x, y), y * width + x);
            }
        }
    }
}

/// The place of a texel in its tile.
fn place_of(x: usize, y: usize) -> usize {
    y % TILE_TEXEL * TILE_TEXEL + x % TILE_TEXEL
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Texels {
    pages: Vec<Page>,
    pub(super) tiles: Vec<Tile>,
    bins: Bins,
}

impl Texels {
    /// The painted texels of an atlas; `None` when it has more than 2³² texels.
    pub(super) fn from_texture(texture: &AtlasTexture) -> Option<Self> {
        Self::new(texture, None)
    }

    /// The same where only the texels that some charts own may change, gutters included.
    pub(super) fn of_charts(
        texture: &AtlasTexture,
        layout: &AtlasLayout,
        may_change: &[bool],
    ) -> Option<Self> {
        Self::new(texture, Some((layout, may_change)))
    }

    fn new(texture: &AtlasTexture, part: Option<(&AtlasLayout, &[bool])>) -> Option<Self> {
        let mut pages = Vec::with_capacity(texture.pages.len());
        let mut num_tiles = 0;
        for page in &texture.pages {
            let size_texel = [page.width as usize, page.height as usize];
            let tile_columns = size_texel[0].div_ceil(TILE_TEXEL);
            pages.push(Page {
                size_texel,
                tile_columns,
                first_tile: num_tiles,
            });
            num_tiles += tile_columns * size_texel[1].div_ceil(TILE_TEXEL);
        }
        if num_tiles > u32::MAX as usize / TILE_AREA {
            return None;
        }
        let marks = part.map(|(layout, may_change)| {
            let mut marks = vec![Vec::new(); num_tiles];
            mark_fixed(&pages, layout, may_change, &mut marks);
            marks
        });
        let of_tile = |tile: usize| {
            let is_fixed = match &marks {
                Some(marks) if marks[tile].is_empty() => return Tile::default(),
                Some(marks) if marks[tile].contains(&true) => marks[tile].clone(),
                _ => Vec::new(),
            };
            Tile::new(texture, &pages, tile, is_fixed)
        };
        let tiles = (0..num_tiles).into_par_iter().map(of_tile).collect();
        Some(Self {
            pages,
            tiles,
            bins: Bins::new(num_tiles),
        })
    }

    /// Writes the texels that have made a step, clamped; the others stay byte for byte.
    pub(super) fn write_back(&mut self, texture: &mut AtlasTexture) {
        for (index, tile) in self.tiles.iter_mut().enumerate() {
            let Some(moments) = &mut tile.moments else {
                continue;
            };
            if !std::mem::take(&mut moments.is_unwritten) {
                continue;
            }
            let (number, page) = page_of(&self.pages, index);
            let target = &mut texture.pages[number].to_mut().srgb;
            page.for_each_place(index, |place, index| {
                if moments.num_steps[place] > 0 {
                    target[index] = tile.value[place].map(to_byte);
                }
            });
        }
    }

    /// Steps that were made.
    pub(super) fn steps_made(&self) -> TexelSteps {
        let moments = self.tiles.iter().filter_map(|tile| tile.moments.as_ref());
        let counts = moments.flat_map(|moments| &moments.num_steps);
        counts.fold(TexelSteps::default(), |made, &num| TexelSteps {
            num_texels: made.num_texels + u64::from(num > 0),
            num_steps: made.num_steps + u64::from(num),
        })
    }

    /// Sets every painted texel that may change to one value, as if nothing had been painted
    /// (AdvTex-B).
    pub(super) fn fill(&mut self, value: f32) {
        for tile in &mut self.tiles {
            for (place, texel) in tile.value.iter_mut().enumerate() {
                let is_fixed = tile.is_fixed.get(place) == Some(&true);
                if !texel[0].is_nan() && !is_fixed {
                    *texel = [value; 3];
                }
            }
        }
    }

    /// What a bilinear lookup at a position of a page of `texture`, which these were made from, reads:
    /// the painted ones of four texels, clamped to the page. Nothing where the nearest texel is
    /// unpainted.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the page before the casts; addresses fit u32 by construction"
    )]
    pub(super) fn footprint(
        &self,
        texture: &AtlasTexture,
        page: usize,
        [x_texel, y_texel]: [f32; 2],
    ) -> Footprint {
        let (Some(page), Some(recorded)) = (self.pages.get(page), texture.pages.get(page)) else {
            return Footprint::NONE;
        };
        let [width, height] = page.size_texel;
        if width == 0 || height == 0 || !(x_texel.is_finite() && y_texel.is_finite()) {
            return Footprint::NONE;
        }
        let x = (x_texel - 0.5).clamp(0.0, (width - 1) as f32);
        let y = (y_texel - 0.5).clamp(0.0, (height - 1) as f32);
        let (x0, y0) = (x as usize, y as usize);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let columns = [x0, (x0 + 1).min(width - 1)];
        let rows = [y0, (y0 + 1).min(height - 1)];
        let mut found = Footprint::NONE;
        let mut total = 0.0;
        let nearest = usize::from(fx >= 0.5) + 2 * usize::from(fy >= 0.5);
        for corner in 0..4 {
            let (x, y) = (columns[corner % 2], rows[corner / 2]);
            let (tile, place) = (page.tile(x, y), place_of(x, y));
            let is_painted = match self.tiles[tile].value.get(place) {
                Some(value) => !value[0].is_nan(),
                None => recorded.source[y * width + x] != TexelSource::NONE,
            };
            if !is_painted {
                if corner == nearest {
                    return Footprint::NONE;
                }
                continue;
            }
            let weight = [1.0 - fx, fx][corner % 2] * [1.0 - fy, fy][corner / 2];
            found.texel[corner] = TexelAddress((tile * TILE_AREA + place) as u32);
            found.weight[corner] = weight;
            total += weight;
        }
        found.weight.iter_mut().for_each(|weight| *weight /= total);
        found
    }

    /// Where the colour of the texel that counts most came from, before the first step.
    pub(super) fn source(&self, footprint: &Footprint) -> TexelSource {
        let mut most = 0;
        for corner in 1..4 {
            if footprint.weight[corner] > footprint.weight[most] {
                most = corner;
            }
        }
        let address = footprint.texel[most];
        let tile = &self.tiles[address.tile()];
        tile.source
            .get(address.place())
            .copied()
            .unwrap_or(TexelSource::NONE)
    }

    fn value(&self, texture: &AtlasTexture, address: TexelAddress) -> [f32; 3] {
        match self.tiles[address.tile()].value.get(address.place()) {
            Some(value) => *value,
            None => {
                let (number, page) = page_of(&self.pages, address.tile());
                texture.pages[number].srgb[page.index(address)].map(from_byte)
            }
        }
    }

    /// Values at the footprints, planar: `out[channel · n + pixel]`; −1 where there is none.
    pub(super) fn gather(&self, texture: &AtlasTexture, footprints: &[Footprint], out: &mut [f32]) {
        let num = footprints.len();
        debug_assert_eq!(out.len(), 3 * num);
        if num == 0 {
            return;
        }
        let (red, rest) = out.split_at_mut(num);
        let (green, blue) = rest.split_at_mut(num);
        red.par_chunks_mut(CHUNK_PIXELS)
            .zip(green.par_chunks_mut(CHUNK_PIXELS))
            .zip(blue.par_chunks_mut(CHUNK_PIXELS))
            .zip(footprints.par_chunks(CHUNK_PIXELS))
            .for_each(|(((red, green), blue), footprints)| {
                for (i, footprint) in footprints.iter().enumerate() {
                    let [r, g, b] = self.lookup(texture, footprint);
                    (red[i], green[i], blue[i]) = (r, g, b);
                }
            });
    }

    fn lookup(&self, texture: &AtlasTexture, footprint: &Footprint) -> [f32; 3] {
        if !footprint.is_some() {
            return [-1.0; 3];
        }
        let mut sum = [0.0f32; 3];
        for (&texel, &weight) in footprint.texel.iter().zip(&footprint.weight) {
            if weight > 0.0 {
                let value = self.value(texture, texel);
                for (sum, value) in sum.iter_mut().zip(value) {
                    *sum += weight * value;
                }
            }
        }
        sum
    }

    /// One step of Adam along the gradient by the values at the footprints (planar as in
    /// [`Self::gather`]) on the texels that they read and that may change. `is_fixed` says per pixel
    /// whether it is no reason for a step; empty when all are.
    pub(super) fn step(
        &mut self,
        footprints: &[Footprint],
        is_fixed: &[bool],
        gradient: &[f32],
        adam: &AdamStep,
    ) {
        debug_assert_eq!(gradient.len(), 3 * footprints.len());
        let Self { tiles, bins, .. } = self;
        bins.fill(footprints, |pixel, texel| {
            is_fixed.get(pixel) != Some(&true) && tiles[texel.tile()].may_change(texel.place())
        });
        let bins = &*bins;
        tiles
            .par_iter_mut()
            .zip(bins.slot_of_tile())
            .filter_map(|(tile, slot)| Some((tile, slot?)))
            .for_each_init(
                || (vec![[0.0f32; 3]; TILE_AREA], vec![false; TILE_AREA]),
                |(sum, is_read), (tile, slot)| {
                    let entries = bins.entries(slot);
                    scatter(entries, footprints, gradient, sum, is_read);
                    tile.step(sum, is_read, adam);
                },
            );
        self.bins.clear();
    }
}

/// The page that a tile is on, and its number.
fn page_of(pages: &[Page], tile: usize) -> (usize, &Page) {
    let number = pages.partition_point(|page| page.first_tile <= tile) - 1;
    (number, &pages[number])
}

/// Per tile that holds a texel of a chart that may change: which of its texels may not.
fn mark_fixed(pages: &[Page], layout: &AtlasLayout, may_change: &[bool], marks: &mut [Vec<bool>]) {
    let charts = layout.charts.iter().zip(may_change);
    for chart in charts.filter_map(|(chart, may_change)| may_change.then_some(chart)) {
        let Some(page) = pages.get(chart.page as usize) else {
            continue;
        };
        for (row, first, len) in chart.own_spans() {
            let y = row as usize;
            if y >= page.size_texel[1] {
                continue;
            }
            let columns = first as usize..((first + len) as usize).min(page.size_texel[0]);
            for x in columns {
                let mark = &mut marks[page.tile(x, y)];
                mark.resize(TILE_AREA, true);
                mark[place_of(x, y)] = false;
            }
        }
    }
}

impl Tile {
    /// A tile of a texture; without memory where nothing of it is painted.
    fn new(texture: &AtlasTexture, pages: &[Page], tile: usize, is_fixed: Vec<bool>) -> Self {
        let (number, page) = page_of(pages, tile);
        let recorded = &texture.pages[number];
        let mut value = vec![[f32::NAN; 3]; TILE_AREA];
        let mut source = vec![TexelSource::NONE; TILE_AREA];
        let mut is_painted = false;
        page.for_each_place(tile, |place, index| {
            if recorded.source[index] != TexelSource::NONE {
                value[place] = recorded.srgb[index].map(from_byte);
                source[place] = recorded.source[index];
                is_painted = true;
            }
        });
        if !is_painted {
            return Self::default();
        }
        Self {
            value,
            source,
            is_fixed,
            moments: None,
        }
    }

    fn may_change(&self, place: usize) -> bool {
        !self.value.is_empty() && self.is_fixed.get(place) != Some(&true)
    }

    fn step(&mut self, gradient: &[[f32; 3]], is_read: &[bool], adam: &AdamStep) {
        let moments = self.moments.get_or_insert_with(|| Box::new(Moments::new()));
        moments.is_unwritten = true;
        let [beta1, beta2] = adam.betas;
        for place in (0..TILE_AREA).filter(|&place| is_read[place]) {
            let count = moments.num_steps[place].saturating_add(1);
            moments.num_steps[place] = count;
            let correct1 = 1.0 - beta1.powi(i32::from(count));
            let correct2 = 1.0 - beta2.powi(i32::from(count));
            for (channel, &g) in gradient[place].iter().enumerate() {
                let first = &mut moments.first[place][channel];
                *first = beta1 * *first + (1.0 - beta1) * g;
                let second = &mut moments.second[place][channel];
                *second = beta2 * *second + (1.0 - beta2) * g * g;
                let size = (*second / correct2).sqrt() + EPSILON;
                self.value[place][channel] -= adam.learning_rate * (*first / correct1) / size;
            }
        }
    }
}

/// A byte's value in [−1, 1].
pub(super) fn from_byte(byte: u8) -> f32 {
    f32::from(byte) / 127.5 - 1.0
}

/// The nearest byte, clamped.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped; float to int casts saturate"
)]
pub(super) fn to_byte(value: f32) -> u8 {
    ((value + 1.0) * 127.5).round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests;
