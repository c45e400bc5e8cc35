//! Colours around each chart: every texel of a chart's rectangle that no triangle paints gets the
//! colour of a near painted texel of the same chart, so that bilinear lookup and mipmaps never mix
//! in what lies beyond. Runs after the fill of unseen texels.
//!
//! Texels are reached ring by ring (8-neighbours) from the painted ones; each takes, among the
//! painted texels that its already reached neighbours go back to, the nearest by Euclid, the first
//! of equals by row, then column. That is the nearest painted texel but for rare ties of a
//! fraction of a texel. Time is linear in the rectangles' area. Rectangles are disjoint, so charts
//! are done in parallel and the result does not depend on the thread count.

use rayon::prelude::*;

use super::layout::{AtlasLayout, PlacedChart, TexelRect};
use super::texture::{AtlasTexture, TexelSource, TextureMismatch, TexturePage};

/// What [`dilate_gutters`] did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct GutterReport {
    /// Texels that got a colour.
    pub num_gutter_texels: usize,
    /// Rectangles without any painted texel, left as they were.
    pub num_blank_rects: usize,
}

/// Charts done at a time; bounds what is held before it is written.
const CHARTS_PER_BATCH: usize = 256;

/// Paints the texels of each chart's rectangle whose source is [`TexelSource::NONE`] or
/// [`TexelSource::GUTTER`], as [`TexelSource::GUTTER`] with confidence 0. Nothing else changes;
/// done twice it gives the same.
///
/// # Errors
/// [`TextureMismatch`] when the texture was not made for the layout.
pub fn dilate_gutters(
    layout: &AtlasLayout,
    texture: &mut AtlasTexture,
) -> Result<GutterReport, TextureMismatch> {
    texture.check_fits(layout)?;
    let mut report = GutterReport::default();
    for batch in layout.charts.chunks(CHARTS_PER_BATCH) {
        let copies_by_chart: Vec<Option<Vec<Copy>>> = batch
            .par_iter()
            .map(|chart| {
                let page = texture.pages.get(chart.page as usize)?;
                nearest_painted(page, &clipped(chart, page))
            })
            .collect();
        for (chart, copies) in batch.iter().zip(copies_by_chart) {
            let Some(copies) = copies else {
                report.num_blank_rects += 1;
                continue;
            };
            report.num_gutter_texels += copies.len();
            if let Some(page) = texture.pages.get_mut(chart.page as usize) {
                for copy in copies {
                    page.srgb[copy.to] = page.srgb[copy.from];
                    page.source[copy.to] = TexelSource::GUTTER;
                    page.confidence[copy.to] = 0;
                }
            }
        }
    }
    Ok(report)
}

/// Indices of two texels of a page.
struct Copy {
    from: usize,
    to: usize,
}

/// The part of the rectangle that lies on the page.
fn clipped(chart: &PlacedChart, page: &TexturePage) -> TexelRect {
    let TexelRect {
        x,
        y,
        width,
        height,
    } = chart.rect;
    let (x, y) = (x.min(page.width), y.min(page.height));
    TexelRect {
        x,
        y,
        width: width.min(page.width - x),
        height: height.min(page.height - y),
    }
}

fn is_painted(source: TexelSource) -> bool {
    source != TexelSource::NONE && source != TexelSource::GUTTER
}

/// No painted texel is known yet.
const UNREACHED: u32 = u32::MAX;
/// In the ring that is being reached.
const PENDING: u32 = u32::MAX - 1;

/// For each unpainted texel of the rectangle, a nearest painted one; nothing when all are
/// unpainted.
fn nearest_painted(page: &TexturePage, rect: &TexelRect) -> Option<Vec<Copy>> {
    let mut field = NearestField::new(page, rect);
    let mut front = field.border();
    if front.is_empty() && field.nearest.first().is_none_or(|&n| n == UNREACHED) {
        return None;
    }
    let mut copies = Vec::new();
    let page_index = |texel: u32| {
        let (row, column) = (texel / rect.width, texel % rect.width);
        (rect.y + row) as usize * page.width as usize + (rect.x + column) as usize
    };
    while !front.is_empty() {
        let ring = field.next_ring(&front);
        let nearest: Vec<u32> = ring
            .iter()
            .map(|&t| field.nearest_of_neighbours(t))
            .collect();
        for (&texel, &painted) in ring.iter().zip(&nearest) {
            field.nearest[texel as usize] = painted;
            copies.push(Copy {
                from: page_index(painted),
                to: page_index(texel),
            });
        }
        front = ring;
    }
    Some(copies)
}

/// Per texel of a rectangle, row-major: the painted texel it goes back to.
struct NearestField {
    width: u32,
    height: u32,
    nearest: Vec<u32>,
}

impl NearestField {
    fn new(page: &TexturePage, rect: &TexelRect) -> Self {
        let mut nearest = Vec::with_capacity(rect.width as usize * rect.height as usize);
        for (row, y) in (0u32..).zip(rect.y..rect.y + rect.height) {
            let start = y as usize * page.width as usize + rect.x as usize;
            let sources = &page.source[start..start + rect.width as usize];
            let first = row * rect.width;
            nearest.extend((first..).zip(sources).map(|(texel, &source)| {
                if is_painted(source) { texel } else { UNREACHED }
            }));
        }
        Self {
            width: rect.width,
            height: rect.height,
            nearest,
        }
    }

    fn for_each_neighbour(&self, texel: u32, mut visit: impl FnMut(u32)) {
        let (row, column) = (texel / self.width, texel % self.width);
        for y in row.saturating_sub(1)..=(row + 1).min(self.height - 1) {
            for x in column.saturating_sub(1)..=(column + 1).min(self.width - 1) {
                let neighbour = y * self.width + x;
                if neighbour != texel {
                    visit(neighbour);
                }
            }
        }
    }

    /// Painted texels with an unpainted neighbour.
    fn border(&self) -> Vec<u32> {
        (0u32..)
            .zip(&self.nearest)
            .filter(|(_, nearest)| **nearest != UNREACHED)
            .filter(|(texel, _)| {
                let mut is_border = false;
                self.for_each_neighbour(*texel, |n| {
                    is_border |= self.nearest[n as usize] == UNREACHED;
                });
                is_border
            })
            .map(|(texel, _)| texel)
            .collect()
    }

    /// The unreached neighbours of the front, each once, marked as pending.
    fn next_ring(&mut self, front: &[u32]) -> Vec<u32> {
        let mut ring = Vec::new();
        for &texel in front {
            let before = ring.len();
            self.for_each_neighbour(texel, |neighbour| {
                if self.nearest[neighbour as usize] == UNREACHED {
                    ring.push(neighbour);
                }
            });
            for &neighbour in &ring[before..] {
                self.nearest[neighbour as usize] = PENDING;
            }
        }
        ring
    }

    fn nearest_of_neighbours(&self, texel: u32) -> u32 {
        let at = |t: u32| (t % self.width, t / self.width);
        let (x, y) = at(texel);
        let mut best = (u64::MAX, UNREACHED);
        self.for_each_neighbour(texel, |neighbour| {
            let painted = self.nearest[neighbour as usize];
            if painted < PENDING {
                let (px, py) = at(painted);
                let square = |d: u32| u64::from(d) * u64::from(d);
                best = best.min((square(x.abs_diff(px)) + square(y.abs_diff(py)), painted));
            }
        });
        best.1
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::layout::ChartId;
    use super::*;

    const SIDE: u32 = 48;

    fn layout(rects: &[TexelRect]) -> AtlasLayout {
        let chart = |rect: &TexelRect| PlacedChart {
            page: 0,
            rect: *rect,
            triangles: vec![],
        };
        AtlasLayout {
            page_size_texel: [SIDE; 2],
            num_pages: 1,
            texels_per_m: 1.0,
            charts: rects.iter().map(chart).collect(),
            chart_of_triangle: Vec::<ChartId>::new(),
            corners_texel: vec![],
        }
    }

    fn painted_texture(texels: &[(u32, u32)]) -> AtlasTexture {
        let mut page = TexturePage::blank(SIDE, SIDE);
        for &(x, y) in texels {
            let index = (y * SIDE + x) as usize;
            page.srgb[index] = [u8::try_from(x).unwrap(), u8::try_from(y).unwrap(), 7];
            page.source[index] = TexelSource::keyframe(3);
            page.confidence[index] = 200;
        }
        AtlasTexture { pages: vec![page] }
    }

    proptest! {
        #[test]
        fn each_texel_of_the_rectangle_has_a_near_colour(
            texels in proptest::collection::vec((4u32..24, 2u32..30), 1..60),
        ) {
            let rect = TexelRect { x: 2, y: 1, width: 25, height: 31 };
            let right = TexelRect { x: 27, y: 0, width: 10, height: 40 };
            let before = painted_texture(&texels);
            let mut after = before.clone();
            let report = dilate_gutters(&layout(&[rect, right]), &mut after).unwrap();
            prop_assert_eq!(report.num_blank_rects, 1);
            for y in 0..SIDE {
                for x in 0..SIDE {
                    let index = (y * SIDE + x) as usize;
                    let inside = (2..27).contains(&x) && (1..32).contains(&y);
                    let [old, new] = [&before, &after].map(|t| &t.pages[0]);
                    if !inside || is_painted(old.source[index]) {
                        prop_assert_eq!(old.srgb[index], new.srgb[index]);
                        prop_assert_eq!(old.source[index], new.source[index]);
                        prop_assert_eq!(old.confidence[index], new.confidence[index]);
                        continue;
                    }
                    prop_assert_eq!(new.source[index], TexelSource::GUTTER);
                    let distance_to = |(px, py): (u32, u32)| {
                        f64::from(x.abs_diff(px)).hypot(f64::from(y.abs_diff(py)))
                    };
                    let [px, py, blue] = new.srgb[index];
                    prop_assert_eq!(blue, 7);
                    let taken = distance_to((px.into(), py.into()));
                    let nearest = texels.iter().map(|t| distance_to(*t)).fold(f64::MAX, f64::min);
                    prop_assert!(taken <= nearest + 0.5, "{} is not {}", taken, nearest);
                }
            }
            let once = after.clone();
            dilate_gutters(&layout(&[rect, right]), &mut after).unwrap();
            prop_assert!(once == after);
        }
    }

    #[test]
    fn a_full_rectangle_and_one_off_the_page_are_harmless() {
        let full = TexelRect {
            x: 0,
            y: 0,
            width: 2,
            height: 1,
        };
        let off = TexelRect {
            x: 40,
            y: 47,
            width: 90,
            height: u32::MAX,
        };
        let mut texture = painted_texture(&[(0, 0), (1, 0), (41, 47)]);
        let report = dilate_gutters(&layout(&[full, off]), &mut texture).unwrap();
        assert_eq!(
            report,
            GutterReport {
                num_gutter_texels: 7,
                num_blank_rects: 0
            }
        );
        let wrong = dilate_gutters(&layout(&[]), &mut AtlasTexture::default());
        assert!(wrong.is_err());
    }
}
