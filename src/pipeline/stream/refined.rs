//! The texture that is shown where charts are refined: TexInit's, with refined charts over it.
//!
//! A chart that is new or changed shows TexInit's texels again and waits: to be levelled, where that is
//! asked for, then for steps of the optimisation ([`super::smoothed`]). Idle steps level what waits,
//! a bounded number of triangles at a time, beside what stands. What levelling added to triangles is
//! kept, so that those beside them can be levelled later as if all had been at once. It goes by the
//! photos, not by what stands in the texture, so that charts that are smooth already do not matter to it.
//!
//! Memory: 8 bytes per texel of the pages, and some 100 per triangle that levelling changed.

use std::collections::BTreeMap;

use crate::atlas::gutter::dilate_gutters_of;
use crate::atlas::{AtlasTexture, PlacedChart, TexelSource};
use crate::mesh::TriangleId;
use crate::photometric::{
    Levelled, PhotometricError, SeamParams, SeamPatch, SeamPhoto, SeamReport, Standing,
};
use crate::pipeline::RefineParams;
use crate::texinit::stream::{StreamChartId, StreamInit, StreamUpdate};
use crate::texsmooth::TexSmoothParams;

/// What a chart waits for that is new or changed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wanted {
    pub(super) has_seams: bool,
    /// Steps of the optimisation; see [`RefinedChart::num_steps`].
    pub(super) num_steps: usize,
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Refined {
    wanted: Wanted,
    texture: AtlasTexture,
    charts: BTreeMap<StreamChartId, RefinedChart>,
}

/// A chart as it is shown.
#[derive(Debug)]
struct RefinedChart {
    /// Where it lies; without its triangles.
    place: PlacedChart,
    /// What was added to its triangles, by their number in the chart, ascending; `None` while it waits
    /// for that.
    levelled: Option<Vec<(u32, Levelled)>>,
    /// Steps of the optimisation that it waits for, as many as all charts together would make; of these
    /// it makes its share.
    num_steps: usize,
}

impl Wanted {
    /// What the settings ask for.
    pub(super) fn by(refine: &RefineParams, smooth: &TexSmoothParams) -> Self {
        Self {
            has_seams: refine.seams.has_global || refine.seams.has_local,
            num_steps: smooth.num_steps,
        }
    }
}

impl Refined {
    /// Without charts so far; `None` where nothing is wanted.
    pub(super) fn new(wanted: Wanted) -> Option<Self> {
        let is_wanted = wanted.has_seams || wanted.num_steps > 0;
        is_wanted.then(|| Self {
            wanted,
            ..Self::default()
        })
    }

    /// The pages.
    pub(super) fn texture(&self) -> &AtlasTexture {
        &self.texture
    }

    /// The pages, the rest forgotten.
    pub(super) fn into_texture(self) -> AtlasTexture {
        self.texture
    }

    /// Charts that wait, for whatever it is.
    pub(super) fn num_waiting(&self) -> usize {
        let charts = self.charts.values();
        let waits = |chart: &&RefinedChart| chart.levelled.is_none() || chart.num_steps > 0;
        charts.filter(waits).count()
    }

    /// Whether a chart waits to be levelled.
    pub(super) fn has_unlevelled(&self) -> bool {
        self.charts.values().any(|chart| chart.levelled.is_none())
    }

    /// The most steps that a chart waits for.
    pub(super) fn most_steps(&self) -> usize {
        let charts = self.charts.values();
        charts.map(|chart| chart.num_steps).max().unwrap_or(0)
    }

    /// Steps that a chart waits for, and the texels that it owns.
    pub(super) fn steps_and_texels(&self, id: StreamChartId) -> (usize, u64) {
        let chart = self.charts.get(&id);
        chart.map_or((0, 0), |chart| (chart.num_steps, num_texels(&chart.place)))
    }

    /// Texels that charts own.
    pub(super) fn num_texels(&self) -> u64 {
        let charts = self.charts.values();
        charts.map(|chart| num_texels(&chart.place)).sum()
    }

    /// All charts wait for so many steps, or for more.
    pub(super) fn ask_for_steps(&mut self, num_steps: usize) {
        for chart in self.charts.values_mut() {
            chart.num_steps = chart.num_steps.max(num_steps);
        }
    }

    /// A chart has made so many of the steps that it waits for.
    pub(super) fn note_steps(&mut self, id: StreamChartId, num_made: usize) {
        if let Some(chart) = self.charts.get_mut(&id) {
            chart.num_steps = chart.num_steps.saturating_sub(num_made);
        }
    }

    /// The pages, of which charts that wait for steps may be written.
    pub(super) fn texture_mut(&mut self) -> &mut AtlasTexture {
        &mut self.texture
    }

    /// Takes over what an update changed; those charts wait from now on.
    pub(super) fn follow(&mut self, state: &StreamInit, update: &StreamUpdate) {
        let base = state.texture();
        let is_other = |id: &StreamChartId| {
            let lists = [&update.new_charts, &update.changed_charts];
            lists.iter().any(|list| list.binary_search(id).is_ok())
        };
        let ids: Vec<StreamChartId> = state.chart_ids().collect();
        let stays = |id: &StreamChartId| ids.binary_search(id).is_ok() && !is_other(id);
        let before = std::mem::take(&mut self.charts);
        let (standing, left): (BTreeMap<_, _>, BTreeMap<_, _>) =
            before.into_iter().partition(|(id, _)| stays(id));
        self.charts = standing;
        if self.has_same_pages(base) && !update.has_new_pages {
            for chart in left.values() {
                copy(base, &mut self.texture, &chart.place);
            }
            let num_known = self.texture.pages.len();
            self.texture
                .pages
                .extend_from_slice(&base.pages[num_known..]);
        } else {
            let shown = std::mem::replace(&mut self.texture, base.clone());
            for chart in self.charts.values() {
                copy(&shown, &mut self.texture, &chart.place);
            }
        }
        for (id, placed) in ids.iter().zip(&state.layout().charts) {
            if !self.charts.contains_key(id) {
                copy(base, &mut self.texture, placed);
                let place = PlacedChart {
                    triangles: Vec::new(),
                    cells: placed.cells.clone(),
                    ..*placed
                };
                let waiting = RefinedChart {
                    place,
                    levelled: (!self.wanted.has_seams).then(Vec::new),
                    num_steps: self.wanted.num_steps,
                };
                self.charts.insert(*id, waiting);
            }
        }
    }

    /// Whether the pages are the first of `base`'s.
    fn has_same_pages(&self, base: &AtlasTexture) -> bool {
        let size = |page: &crate::atlas::TexturePage| (page.width, page.height);
        let (own, base) = (self.texture.pages.iter(), base.pages.iter());
        own.len() <= base.len() && own.zip(base).all(|(own, base)| size(own) == size(base))
    }

    /// Levels charts that wait for it, those first that are there longest, until one more would make it more
    /// than `max_triangles`, but at least one; `photos_of` gives the photos of keyframes by number.
    /// `None` when none waits.
    ///
    /// # Errors
    /// [`PhotometricError`] for a parameter out of range.
    pub(super) fn level_some(
        &mut self,
        state: &StreamInit,
        max_triangles: usize,
        photos_of: impl FnOnce(&[u32]) -> Vec<Option<SeamPhoto>>,
        params: &SeamParams,
        has_gutters: bool,
    ) -> Result<Option<(StreamUpdate, SeamReport)>, PhotometricError> {
        let layout = state.layout();
        let charts: Vec<(StreamChartId, &PlacedChart)> =
            state.chart_ids().zip(&layout.charts).collect();
        let chosen = self.chosen(&charts, max_triangles);
        if chosen.is_empty() {
            return Ok(None);
        }
        let part = chosen.iter().flat_map(|index| &charts[*index].1.triangles);
        let label_of = |triangle| state.label_of(triangle);
        let patch = SeamPatch::around(state.mesh(), layout, part.copied(), label_of)?;
        let sources: Vec<TexelSource> = patch
            .frames()
            .iter()
            .map(|f| TexelSource::keyframe(*f))
            .collect();
        let photos = photos_of(patch.frames());
        let standing_of = |triangle: TriangleId| {
            let index = layout.chart_of_triangle[triangle.index()].index();
            if chosen.binary_search(&index).is_ok() {
                return Standing::Levelled;
            }
            let (id, placed) = charts[index];
            match self.charts.get(&id).and_then(|c| c.levelled.as_ref()) {
                None => Standing::Waiting,
                Some(levelled) => {
                    let number = triangle.0 - first_triangle(placed);
                    let index = levelled.binary_search_by_key(&number, |(number, _)| *number);
                    Standing::Fixed(index.ok().map(|index| &levelled[index].1))
                }
            }
        };
        let levelled = patch.level(standing_of, &sources, &photos, params, &mut self.texture);
        let (report, added) = levelled?;
        let mut added = added.into_iter().peekable();
        let mut update = StreamUpdate::default();
        for &index in &chosen {
            let (id, placed) = charts[index];
            let first = first_triangle(placed);
            let end = first as usize + placed.triangles.len();
            let own = std::iter::from_fn(|| added.next_if(|(triangle, _)| triangle.index() < end));
            let own = own.map(|(triangle, levelled)| (triangle.0 - first, levelled));
            if let Some(chart) = self.charts.get_mut(&id) {
                chart.levelled = Some(own.collect());
            }
            update.changed_charts.push(id);
            update.dirty_rects.push((placed.page, placed.rect));
        }
        if has_gutters {
            let placed: Vec<&PlacedChart> = chosen.iter().map(|index| charts[*index].1).collect();
            dilate_gutters_of(&placed, &mut self.texture);
        }
        Ok(Some((update, report)))
    }

    /// Indices of the charts that are levelled next, ascending.
    fn chosen(&self, charts: &[(StreamChartId, &PlacedChart)], max_triangles: usize) -> Vec<usize> {
        let mut num_triangles = 0;
        let waiting = charts.iter().enumerate().filter(|(_, (id, _))| {
            let chart = self.charts.get(id);
            chart.is_some_and(|chart| chart.levelled.is_none())
        });
        let fits = |(index, (_, placed)): (usize, &(StreamChartId, &PlacedChart))| {
            let is_first = num_triangles == 0;
            num_triangles += placed.triangles.len();
            (is_first || num_triangles <= max_triangles).then_some(index)
        };
        waiting.map_while(fits).collect()
    }
}

/// Charts have their triangles in a row.
fn first_triangle(placed: &PlacedChart) -> u32 {
    placed.triangles.first().map_or(0, |triangle| triangle.0)
}

/// Adds to an update that charts (ascending) show other texels, as far as they are there and it does not
/// tell of them anyway.
pub(super) fn tell(state: &StreamInit, ids: &[StreamChartId], update: &mut StreamUpdate) {
    let lists = [&update.new_charts, &update.changed_charts];
    let is_told = |id: &StreamChartId| lists.iter().any(|list| list.binary_search(id).is_ok());
    let untold: Vec<(StreamChartId, &PlacedChart)> = state
        .chart_ids()
        .zip(&state.layout().charts)
        .filter(|(id, _)| ids.binary_search(id).is_ok() && !is_told(id))
        .collect();
    for (id, placed) in untold {
        update.changed_charts.push(id);
        update.dirty_rects.push((placed.page, placed.rect));
    }
    update.changed_charts.sort_unstable();
}

fn num_texels(placed: &PlacedChart) -> u64 {
    placed.own_spans().map(|(_, _, len)| u64::from(len)).sum()
}

/// Copies the texels that a chart owns from one texture to another of the same pages.
fn copy(from: &AtlasTexture, to: &mut AtlasTexture, placed: &PlacedChart) {
    let page = placed.page as usize;
    let (Some(from), Some(to)) = (from.pages.get(page), to.pages.get_mut(page)) else {
        return;
    };
    let to = to.to_mut();
    let width = to.width;
    for (row, first, len) in placed.own_spans() {
        if row >= to.height || first >= width {
            continue;
        }
        let start = row as usize * width as usize + first as usize;
        let span = start..start + len.min(width - first) as usize;
        to.srgb[span.clone()].copy_from_slice(&from.srgb[span.clone()]);
        to.source[span.clone()].copy_from_slice(&from.source[span.clone()]);
        to.confidence[span.clone()].copy_from_slice(&from.confidence[span]);
    }
}
