//! Which pixels read which texels, tile by tile.

use rayon::prelude::*;

use super::{Footprint, TexelAddress};

const NO_SLOT: u32 = u32::MAX;

/// Contributions of pixels by tile: workspace of [`Texels::step`].
#[derive(Clone, Debug, Default)]
pub(super) struct Bins {
    /// Per tile: its bin, or [`NO_SLOT`].
    slot_of_tile: Vec<u32>,
    /// Per bin: its tile and how many contributions it has.
    pub(super) touched: Vec<(usize, usize)>,
    /// Per bin: where it begins; one more for the end.
    begin: Vec<usize>,
    /// Pixel · 4 + corner, bin by bin.
    entry: Vec<u32>,
}

impl Bins {
    pub(super) fn new(num_tiles: usize) -> Self {
        Self {
            slot_of_tile: vec![NO_SLOT; num_tiles],
            ..Self::default()
        }
    }

    /// Sorts what the footprints read, where a pixel's reading of a texel `counts`.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "an image has less than 2³⁰ pixels, and no more bins than tiles"
    )]
    pub(super) fn fill(
        &mut self,
        footprints: &[Footprint],
        counts: impl Fn(usize, TexelAddress) -> bool,
    ) {
        self.touched.clear();
        let counts = &counts;
        let reads = || {
            footprints
                .iter()
                .enumerate()
                .flat_map(move |(pixel, footprint)| {
                    let pairs = footprint.texel.iter().zip(&footprint.weight).enumerate();
                    pairs
                        .filter(move |(_, (texel, weight))| {
                            **weight > 0.0 && counts(pixel, **texel)
                        })
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

    /// The bin of a tile.
    pub(super) fn slot_of_tile(&self) -> impl IndexedParallelIterator<Item = Option<usize>> {
        let slots = self.slot_of_tile.par_iter();
        slots.map(|&slot| (slot != NO_SLOT).then_some(slot as usize))
    }

    pub(super) fn entries(&self, slot: usize) -> &[u32] {
        &self.entry[self.begin[slot]..self.begin[slot + 1]]
    }

    pub(super) fn clear(&mut self) {
        for &(tile, _) in &self.touched {
            self.slot_of_tile[tile] = NO_SLOT;
        }
    }
}

/// The gradient by the texels of one tile, from the entries of its bin in their order.
pub(super) fn scatter(
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
