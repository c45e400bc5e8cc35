//! Colours around each chart: every texel that a chart owns and no triangle paints gets the
//! colour of the nearest painted texel of the same chart, so that bilinear lookup and mipmaps never mix
//! in what lies beyond. Runs after the fill of unseen texels.
//!
//! Nearest by Euclid, exactly, in time linear in the area of the charts' rectangles: Meijster, Roerdink,
//! Hesselink, "A general algorithm for computing distance transforms in linear time", 2000. Of
//! equals the left, then the upper one. No texel is owned by two charts, so charts are done in
//! parallel and the result does not depend on the thread count.

use std::ops::Range;

use rayon::prelude::*;

use super::layout::{AtlasLayout, PlacedChart, TexelRect};
use super::texture::{AtlasTexture, TexelSource, TextureMismatch, TexturePage};

/// What [`dilate_gutters`] did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct GutterReport {
    /// Texels that got a colour.
    pub num_gutter_texels: usize,
    /// Charts without any painted texel, left as they were.
    pub num_blank_charts: usize,
}

/// Charts done at a time; bounds what is held before it is written.
const CHARTS_PER_BATCH: usize = 256;

/// Paints the texels that each chart owns whose source is [`TexelSource::NONE`] or
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
    let charts: Vec<&PlacedChart> = layout.charts.iter().collect();
    Ok(dilate_gutters_of(&charts, texture))
}

/// [`dilate_gutters`] around some charts of the texture's layout.
pub(crate) fn dilate_gutters_of(
    charts: &[&PlacedChart],
    texture: &mut AtlasTexture,
) -> GutterReport {
    let mut report = GutterReport::default();
    for batch in charts.chunks(CHARTS_PER_BATCH) {
        let gutters: Vec<Option<Gutter>> = batch
            .par_iter()
            .map(|chart| Gutter::of(chart, texture.pages.get(chart.page as usize)?))
            .collect();
        for (chart, gutter) in batch.iter().zip(gutters) {
            let Some(gutter) = gutter else {
                report.num_blank_charts += 1;
                continue;
            };
            report.num_gutter_texels += gutter.copies.len();
            if let Some(page) = texture.pages.get_mut(chart.page as usize) {
                gutter.paint(page.to_mut());
            }
        }
    }
    report
}

/// Which texel each one around a chart repeats; as long as the same ones of the chart are painted and it
/// stays where it is.
#[derive(Debug)]
pub(crate) struct Gutter {
    copies: Vec<Copy>,
}

impl Gutter {
    /// Around a chart on its page; `None` where nothing of the chart is painted.
    pub(crate) fn of(chart: &PlacedChart, page: &TexturePage) -> Option<Self> {
        let copies = nearest_painted(page, &clipped(chart, page), chart)?;
        Some(Self { copies })
    }

    /// Paints it.
    pub(crate) fn paint(&self, page: &mut TexturePage) {
        for Copy { from, to } in &self.copies {
            let to = *to as usize;
            page.srgb[to] = page.srgb[*from as usize];
            page.source[to] = TexelSource::GUTTER;
            page.confidence[to] = 0;
        }
    }

    /// Bytes that it takes.
    pub(crate) fn num_bytes(&self) -> usize {
        size_of_val(&*self.copies)
    }
}

/// Indices of two texels of a page.
#[derive(Debug)]
struct Copy {
    from: u32,
    to: u32,
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

/// No painted texel in the column.
const NO_ROW: u32 = u32::MAX;

/// For each unpainted texel of the chart, the nearest painted one of the chart; nothing when all
/// are unpainted. `rect` is the part of the chart's rectangle on the page.
fn nearest_painted(page: &TexturePage, rect: &TexelRect, chart: &PlacedChart) -> Option<Vec<Copy>> {
    let own_spans = own_spans_by_row(rect, chart);
    let nearest_rows = nearest_row_in_column(page, rect, &own_spans);
    let width = rect.width as usize;
    let mut envelope = Vec::with_capacity(width);
    let mut copies = Vec::new();
    let page_index = |row: u32, column: u32| (rect.y + row) * page.width + rect.x + column;
    let with_rows = own_spans
        .iter()
        .zip(nearest_rows.chunks_exact(width.max(1)));
    for (row, (spans, rows)) in (0u32..).zip(with_rows) {
        let is_unpainted = |column: u32| rows[column as usize] != row;
        if !spans.iter().cloned().flatten().any(is_unpainted) {
            continue;
        }
        lower_envelope(row, rows, &mut envelope);
        let mut current = envelope.first()?;
        let mut following = envelope.iter().skip(1).peekable();
        for column in spans.iter().cloned().flatten() {
            while let Some(next) = following.next_if(|next| next.first_column <= column) {
                current = next;
            }
            if is_unpainted(column) {
                copies.push(Copy {
                    from: page_index(rows[current.column as usize], current.column),
                    to: page_index(row, column),
                });
            }
        }
    }
    let is_blank = copies.is_empty() && nearest_rows.iter().all(|&row| row == NO_ROW);
    (!is_blank).then_some(copies)
}

/// Per row of the rectangle: the columns that the chart owns, both counted from its upper left.
fn own_spans_by_row(rect: &TexelRect, chart: &PlacedChart) -> Vec<Vec<Range<u32>>> {
    let mut spans = vec![Vec::new(); rect.height as usize];
    for (y, first, len) in chart.own_spans() {
        let columns = (first - rect.x).min(rect.width)..(first - rect.x + len).min(rect.width);
        if let Some(row) = spans.get_mut((y - rect.y) as usize) {
            row.push(columns);
        }
    }
    spans
}

/// Per texel of the rectangle: the row of the nearest texel of its column that the chart owns and
/// a triangle paints, the upper one of two.
fn nearest_row_in_column(
    page: &TexturePage,
    rect: &TexelRect,
    own_spans: &[Vec<Range<u32>>],
) -> Vec<u32> {
    let width = rect.width as usize;
    let mut nearest = Vec::with_capacity(width * rect.height as usize);
    let mut above = vec![NO_ROW; width];
    for (row, spans) in (0..rect.height).zip(own_spans) {
        let start = (rect.y + row) as usize * page.width as usize + rect.x as usize;
        let sources = &page.source[start..start + width];
        for span in spans {
            let span = span.start as usize..span.end as usize;
            for (above, &source) in above[span.clone()].iter_mut().zip(&sources[span]) {
                if is_painted(source) {
                    *above = row;
                }
            }
        }
        nearest.extend_from_slice(&above);
    }
    let mut below = vec![NO_ROW; width];
    for (row, rows) in (0..rect.height)
        .zip(nearest.chunks_exact_mut(width.max(1)))
        .rev()
    {
        for (below, nearest) in below.iter_mut().zip(rows) {
            if *nearest == row {
                *below = row;
            } else if *below != NO_ROW && (*nearest == NO_ROW || *below - row < row - *nearest) {
                *nearest = *below;
            }
        }
    }
    nearest
}

/// A stretch of a row whose nearest painted texel is in one column.
struct Stretch {
    column: u32,
    /// Where the stretch begins; it ends where the next one does.
    first_column: u32,
}

/// The stretches of a row from left to right, given each column's nearest painted row.
fn lower_envelope(row: u32, nearest_rows: &[u32], envelope: &mut Vec<Stretch>) {
    envelope.clear();
    let height = |column: u32| {
        let distance = i64::from(nearest_rows[column as usize]) - i64::from(row);
        distance * distance
    };
    let painted = (0u32..)
        .zip(nearest_rows)
        .filter(|(_, nearest)| **nearest != NO_ROW);
    for (column, _) in painted {
        let mut first_column = 0;
        while let Some(last) = envelope.last() {
            let (i, u) = (i64::from(last.column), i64::from(column));
            // The last column that is no farther from `last` than from this one.
            let separator =
                (u * u - i * i + height(column) - height(last.column)).div_euclid(2 * (u - i));
            if separator >= i64::from(last.first_column) {
                first_column = separator + 1;
                break;
            }
            envelope.pop();
        }
        if let Ok(first_column) = u32::try_from(first_column)
            && (first_column as usize) < nearest_rows.len()
        {
            envelope.push(Stretch {
                column,
                first_column,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::layout::ChartId;
    use super::*;

    const SIDE: u32 = 48;

    fn layout(rects: &[TexelRect]) -> AtlasLayout {
        let chart = |rect: &TexelRect| PlacedChart::whole_rect(0, *rect, 1.0, vec![]);
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
        AtlasTexture::from_iter([page])
    }

    proptest! {
        #[test]
        fn each_texel_of_the_rectangle_has_the_nearest_colour(
            texels in proptest::collection::vec((4u32..24, 2u32..30), 1..60),
        ) {
            let rect = TexelRect { x: 2, y: 1, width: 25, height: 31 };
            let right = TexelRect { x: 27, y: 0, width: 10, height: 40 };
            let before = painted_texture(&texels);
            let mut after = before.clone();
            let report = dilate_gutters(&layout(&[rect, right]), &mut after).unwrap();
            prop_assert_eq!(report.num_blank_charts, 1);
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
                    prop_assert!(taken == nearest, "{} is not {}", taken, nearest);
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
            height: 300,
        };
        let mut texture = painted_texture(&[(0, 0), (1, 0), (41, 47)]);
        let report = dilate_gutters(&layout(&[full, off]), &mut texture).unwrap();
        assert_eq!(
            report,
            GutterReport {
                num_gutter_texels: 7,
                num_blank_charts: 0
            }
        );
        let wrong = dilate_gutters(&layout(&[]), &mut AtlasTexture::default());
        assert!(wrong.is_err());
    }
}
