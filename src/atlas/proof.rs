//! The check that a layout gives no texel to two triangles, made without trusting the packer.

use rayon::prelude::*;

use super::layout::AtlasLayout;
use super::texels::for_each_texel_within;

/// Number of texels whose centre more than one triangle owns, over all pages; 0 for every layout
/// that [`super::pack()`] returns. It goes by corners alone, not by cells. Texels outside a
/// page belong to nobody.
pub fn num_shared_texels(layout: &AtlasLayout) -> usize {
    let shared_by_page: Vec<usize> = (0..layout.num_pages)
        .into_par_iter()
        .map(|page| num_shared_texels_of_page(layout, page))
        .collect();
    shared_by_page.iter().sum()
}

fn num_shared_texels_of_page(layout: &AtlasLayout, page: u32) -> usize {
    let [width, height] = layout.page_size_texel.map(|side| side as usize);
    let mut is_owned = TexelSet::new(width, height);
    let mut is_shared = TexelSet::new(width, height);
    for (corners, chart) in layout.corners_texel.iter().zip(&layout.chart_of_triangle) {
        if layout.charts.get(chart.index()).map(|c| c.page) == Some(page) {
            for_each_texel_within(corners, layout.page_size_texel, |x, y, _| {
                if !is_owned.insert(x, y) {
                    is_shared.insert(x, y);
                }
            });
        }
    }
    is_shared.len()
}

/// One bit per texel of a rectangle.
pub(crate) struct TexelSet {
    width: usize,
    words: Vec<u64>,
}

impl TexelSet {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            words: vec![0; (width * height).div_ceil(64)],
        }
    }

    /// Adds a texel; whether it was not there before.
    pub(crate) fn insert(&mut self, x: u32, y: u32) -> bool {
        let index = y as usize * self.width + x as usize;
        let bit = 1 << (index % 64);
        let word = &mut self.words[index / 64];
        let is_new = *word & bit == 0;
        *word |= bit;
        is_new
    }

    pub(crate) fn len(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::layout::{ChartId, PlacedChart, TexelRect};
    use super::*;
    use crate::mesh::TriangleId;

    fn two_triangles(second: [[f32; 2]; 3], pages: [u32; 2]) -> AtlasLayout {
        let rect = TexelRect {
            x: 0,
            y: 0,
            width: 16,
            height: 16,
        };
        let chart = |page: u32, triangle: u32| {
            PlacedChart::whole_rect(page, rect, 1.0, vec![TriangleId(triangle)])
        };
        AtlasLayout {
            page_size_texel: [16, 16],
            num_pages: 2,
            texels_per_m: 1.0,
            charts: vec![chart(pages[0], 0), chart(pages[1], 1)],
            chart_of_triangle: vec![ChartId(0), ChartId(1)],
            corners_texel: vec![[[0.0, 0.0], [8.0, 0.0], [8.0, 8.0]], second],
        }
    }

    #[test]
    fn an_overlap_is_counted_and_a_shared_edge_is_not() {
        let beside = [[0.0, 0.0], [8.0, 8.0], [0.0, 8.0]];
        assert_eq!(num_shared_texels(&two_triangles(beside, [0, 0])), 0);
        // Moved right by two texels it takes two diagonals of the first triangle.
        let moved = beside.map(|[x, y]| [x + 2.0, y]);
        assert_eq!(num_shared_texels(&two_triangles(moved, [0, 0])), 6 + 6);
        assert_eq!(num_shared_texels(&two_triangles(moved, [0, 1])), 0);
    }
}
