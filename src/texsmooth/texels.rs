//! The texture while it is optimised: values, and the moments of Adam, in tiles.
//!
//! Values are sRGB in [−1, 1] (ECCV 2022, section 3.2), unclamped until they are written back.
//! Tiles are 64×64; one without a painted texel has no memory, and moments come with a tile's first
//! step, so that what is not seen costs nothing. Texel centres are at halves.
//!
//! * [`Texels::footprint`] and [`Texels::gather`]: the bilinear lookup at a position of a page, over
//!   the painted ones of the four texels around it.
//! * [`Texels::step`]: its transpose, and a step of Adam (Kingma and Ba 2015) on the texels that
//!   were looked up, each with a count of its own steps for the correction of bias. Contributions are
//!   binned by tile in the order of the pixels, and each tile adds up its own in that order: the same
//!   bits for any thread count.

use rayon::prelude::*;

use crate::atlas::{AtlasTexture, TexelSource};

/// Texels along the side of a tile.
pub(super) const TILE_TEXEL: usize = 64;
const TILE_AREA: usize = TILE_TEXEL * TILE_TEXEL;
/// Pixels to a parallel piece of the lookup.
const CHUNK_PIXELS: usize = 4096;
const NO_SLOT: u32 = u32::MAX;

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
    /// NaN where nothing is painted; empty when that is everywhere.
    pub(super) value: Vec<[f32; 3]>,
    /// Where the value came from before the first step; empty when nothing is painted.
    source: Vec<TexelSource>,
    pub(super) moments: Option<Box<Moments>>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Moments {
    pub(super) first: Vec<[f32; 3]>,
    pub(super) second: Vec<[f32; 3]>,
    /// Steps that each texel has made.
    pub(super) num_steps: Vec<u16>,
}

impl Moments {
    fn new() -> Self {
        Self {
            first: vec![[0.0; 3]; TILE_AREA],
            second: vec![[0.0; 3]; TILE_AREA],
            num_steps: vec![0; TILE_AREA],
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

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Texels {
    pages: Vec<Page>,
    pub(super) tiles: Vec<Tile>,
    bins: Bins,
}

/// Contributions of pixels by tile: workspace of [`Texels::step`].
#[derive(Clone, Debug, Default)]
struct Bins {
    /// Per tile: its bin, or [`NO_SLOT`].
    slot_of_tile: Vec<u32>,
    /// Per bin: its tile and how many contributions it has.
    touched: Vec<(usize, usize)>,
    /// Per bin: where it begins; one more for the end.
    begin: Vec<usize>,
    /// Pixel · 4 + corner, bin by bin.
    entry: Vec<u32>,
}

impl Texels {
    /// The painted texels of an atlas; `None` when it has more than 2³² texels.
    pub(super) fn from_texture(texture: &AtlasTexture) -> Option<Self> {
        let mut pages = Vec::with_capacity(texture.pages.len());
        let mut tiles = Vec::new();
        for page in &texture.pages {
            let size_texel = [page.width as usize, page.height as usize];
            let tile_columns = size_texel[0].div_ceil(TILE_TEXEL);
            let first_tile = tiles.len();
            let num_tiles = tile_columns * size_texel[1].div_ceil(TILE_TEXEL);
            let made: Vec<Tile> = (0..num_tiles)
                .into_par_iter()
                .map(|tile| {
                    let corner = [tile % tile_columns, tile / tile_columns].map(|t| t * TILE_TEXEL);
                    let mut value = vec![[f32::NAN; 3]; TILE_AREA];
                    let mut source = vec![TexelSource::NONE; TILE_AREA];
                    let mut is_painted = false;
                    for_each_place(corner, size_texel, |place, index| {
                        if page.source[index] != TexelSource::NONE {
                            value[place] = page.srgb[index].map(from_byte);
                            source[place] = page.source[index];
                            is_painted = true;
                        }
                    });
                    if !is_painted {
                        return Tile::default();
                    }
                    Tile {
                        value,
                        source,
                        moments: None,
                    }
                })
                .collect();
            tiles.extend(made);
            pages.push(Page {
                size_texel,
                tile_columns,
                first_tile,
            });
        }
        if tiles.len() > u32::MAX as usize / TILE_AREA {
            return None;
        }
        let bins = Bins {
            slot_of_tile: vec![NO_SLOT; tiles.len()],
            ..Bins::default()
        };
        Some(Self { pages, tiles, bins })
    }

    /// Writes the texels that have made a step, clamped; the others stay byte for byte.
    pub(super) fn write_back(&self, texture: &mut AtlasTexture) -> TexelSteps {
        let mut written = TexelSteps::default();
        for (page, target) in self.pages.iter().zip(&mut texture.pages) {
            let num_rows = page.size_texel[1].div_ceil(TILE_TEXEL);
            for tile_index in 0..page.tile_columns * num_rows {
                let tile = &self.tiles[page.first_tile + tile_index];
                let Some(moments) = &tile.moments else {
                    continue;
                };
                let corner = [
                    tile_index % page.tile_columns,
                    tile_index / page.tile_columns,
                ]
                .map(|t| t * TILE_TEXEL);
                for_each_place(corner, page.size_texel, |place, index| {
                    if moments.num_steps[place] > 0 {
                        target.srgb[index] = tile.value[place].map(to_byte);
                        written.num_texels += 1;
                        written.num_steps += u64::from(moments.num_steps[place]);
                    }
                });
            }
        }
        written
    }

    /// Sets every painted texel to one value, as if nothing had been painted (AdvTex-B).
    pub(super) fn fill(&mut self, value: f32) {
        for texel in self.tiles.iter_mut().flat_map(|tile| &mut tile.value) {
            if !texel[0].is_nan() {
                *texel = [value; 3];
            }
        }
    }

    /// What a bilinear lookup at a position of a page reads: the painted ones of four texels,
    /// clamped to the page. Nothing where the nearest texel is unpainted.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the page before the casts; addresses fit u32 by construction"
    )]
    pub(super) fn footprint(&self, page: usize, [x_texel, y_texel]: [f32; 2]) -> Footprint {
        let Some(page) = self.pages.get(page) else {
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
            let tile = page.first_tile + y / TILE_TEXEL * page.tile_columns + x / TILE_TEXEL;
            let place = y % TILE_TEXEL * TILE_TEXEL + x % TILE_TEXEL;
            let value = self.tiles[tile].value.get(place);
            if value.is_none_or(|value| value[0].is_nan()) {
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

    fn value(&self, address: TexelAddress) -> [f32; 3] {
        self.tiles[address.tile()].value[address.place()]
    }

    /// Values at the footprints, planar: `out[channel · n + pixel]`; −1 where there is none.
    pub(super) fn gather(&self, footprints: &[Footprint], out: &mut [f32]) {
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
                    let [r, g, b] = self.lookup(footprint);
                    (red[i], green[i], blue[i]) = (r, g, b);
                }
            });
    }

    fn lookup(&self, footprint: &Footprint) -> [f32; 3] {
        if !footprint.is_some() {
            return [-1.0; 3];
        }
        let mut sum = [0.0f32; 3];
        for (&texel, &weight) in footprint.texel.iter().zip(&footprint.weight) {
            if weight > 0.0 {
                let value = self.value(texel);
                for (sum, value) in sum.iter_mut().zip(value) {
                    *sum += weight * value;
                }
            }
        }
        sum
    }

    /// One step of Adam along the gradient by the values at the footprints (planar as in
    /// [`Self::gather`]) on the texels that they read.
    pub(super) fn step(&mut self, footprints: &[Footprint], gradient: &[f32], adam: &AdamStep) {
        debug_assert_eq!(gradient.len(), 3 * footprints.len());
        self.bins.fill(footprints);
        let Self { tiles, bins, .. } = self;
        let bins = &*bins;
        tiles
            .par_iter_mut()
            .zip(&bins.slot_of_tile)
            .filter(|(_, slot)| **slot != NO_SLOT)
            .for_each_init(
                || (vec![[0.0f32; 3]; TILE_AREA], vec![false; TILE_AREA]),
                |(sum, is_read), (tile, &slot)| {
                    let entries = bins.entries(slot as usize);
                    scatter(entries, footprints, gradient, sum, is_read);
                    tile.step(sum, is_read, adam);
                },
            );
        self.bins.clear();
    }
}

/// The gradient by the texels of one tile, from the entries of its bin in their order.
fn scatter(
    entries: &[u32],
    footprints: &[Footprint],
    gradient: &[f32],
    sum: &mut [[f32; 3]],
    is_read: &mut [bool],
) {
    sum.fill([0.0; 3]);
    is_read.fill(false);
    for &entry in entries {
        let (pixel, corner) = (entry as usize / 4, entry as usize % 4);
        let footprint = &footprints[pixel];
        let place = footprint.texel[corner].place();
        let weight = footprint.weight[corner];
        is_read[place] = true;
        for (channel, sum) in sum[place].iter_mut().enumerate() {
            *sum += weight * gradient[channel * footprints.len() + pixel];
        }
    }
}

impl Tile {
    fn step(&mut self, gradient: &[[f32; 3]], is_read: &[bool], adam: &AdamStep) {
        let moments = self.moments.get_or_insert_with(|| Box::new(Moments::new()));
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

impl Bins {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "an image has less than 2³⁰ pixels, and no more bins than tiles"
    )]
    fn fill(&mut self, footprints: &[Footprint]) {
        self.touched.clear();
        let reads = || {
            footprints
                .iter()
                .enumerate()
                .flat_map(|(pixel, footprint)| {
                    let pairs = footprint.texel.iter().zip(&footprint.weight).enumerate();
                    pairs
                        .filter(|(_, (_, weight))| **weight > 0.0)
                        .map(move |(corner, (texel, _))| (texel.tile(), pixel * 4 + corner))
                })
        };
        for (tile, _) in reads() {
            let slot = &mut self.slot_of_tile[tile];
            if *slot == NO_SLOT {
                *slot = self.touched.len() as u32;
                self.touched.push((tile, 0));
            }
            self.touched[*slot as usize].1 += 1;
        }
        self.begin.clear();
        self.begin.push(0);
        let mut end = 0;
        for &(_, count) in &self.touched {
            end += count;
            self.begin.push(end);
        }
        self.entry.clear();
        self.entry.resize(end, 0);
        let mut next = self.begin.clone();
        for (tile, entry) in reads() {
            let at = &mut next[self.slot_of_tile[tile] as usize];
            self.entry[*at] = entry as u32;
            *at += 1;
        }
    }

    fn entries(&self, slot: usize) -> &[u32] {
        &self.entry[self.begin[slot]..self.begin[slot + 1]]
    }

    fn clear(&mut self) {
        for &(tile, _) in &self.touched {
            self.slot_of_tile[tile] = NO_SLOT;
        }
    }
}

/// Calls with the place in the tile and the index on the page of each texel of the tile at `corner`.
fn for_each_place(
    corner: [usize; 2],
    [width, height]: [usize; 2],
    mut call: impl FnMut(usize, usize),
) {
    for y in corner[1]..height.min(corner[1] + TILE_TEXEL) {
        for x in corner[0]..width.min(corner[0] + TILE_TEXEL) {
            let place = (y - corner[1]) * TILE_TEXEL + x - corner[0];
            call(place, y * width + x);
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
