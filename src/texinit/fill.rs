//! Colours for texels that no frame painted: spread over the surface from where it is painted.
//!
//! Vertices of triangles with unpainted texels get a colour in linear light: the mean of the painted texels
//! of their triangles, weighted towards the vertex; where there are none, a harmonic blend of their
//! neighbours' along the mesh's edges ([`diffusion`]; vertices of equal position count as one, so it
//! crosses charts and cuts). Unpainted texels interpolate their triangle's vertices, whose colours are
//! rounded to bytes before. A component of the surface without any painted texel becomes neutral.
//!
//! Texels filled earlier ([`TexelSource::DIFFUSED`]) are filled anew; painted ones never change.
//! Runs after colour transfer and before the gutters. Charts are done in parallel, the diffusion
//! in a fixed order; the result does not depend on the thread count.

mod diffusion;

use rayon::prelude::*;

use crate::atlas::{
    AtlasLayout, AtlasTexture, PlacedChart, TexelSource, TextureMismatch, TexturePage,
    for_each_texel_within,
};
use crate::geom::color::{linear_from_srgb, srgb_from_linear};
use crate::mesh::weld::equal_representatives;
use crate::mesh::{TriMesh, TriangleId};

/// How unseen texels are filled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FillParams {
    /// Sweeps of over-relaxation at most, forth and back in turn.
    pub max_sweeps: usize,
    /// Over-relaxation, 1 (none) to 2 (exclusive).
    pub over_relaxation: f64,
    /// Colour of surfaces that nothing painted is connected to.
    pub neutral_srgb: [u8; 3],
}

impl Default for FillParams {
    fn default() -> Self {
        Self {
            max_sweeps: 64,
            over_relaxation: 1.8,
            neutral_srgb: [128; 3],
        }
    }
}

/// Why nothing was filled.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FillError {
    /// The texture is not the layout's.
    #[error(transparent)]
    Texture(#[from] TextureMismatch),
    /// The layout is not the mesh's.
    #[error("layout of {num_placed} triangles for a mesh of {num_triangles}")]
    Layout {
        /// Triangles of the layout.
        num_placed: usize,
        /// Triangles of the mesh.
        num_triangles: usize,
    },
    /// The over-relaxation diverges.
    #[error("over-relaxation of {over_relaxation} is not in 1..2")]
    OverRelaxation {
        /// As given.
        over_relaxation: f64,
    },
}

/// What [`fill_unseen`] did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct FillReport {
    /// Owned texels that were painted before.
    pub num_painted_texels: usize,
    /// Texels filled from painted ones.
    pub num_diffused_texels: usize,
    /// Texels of surfaces that nothing painted is connected to.
    pub num_neutral_texels: usize,
    /// Triangles that own texels, none of them painted.
    pub num_unpainted_triangles: usize,
    /// Vertices whose colour was diffused.
    pub num_diffused_vertices: usize,
    /// Sweeps done.
    pub num_sweeps: usize,
}

/// Paints every owned texel that is not painted yet, as [`TexelSource::DIFFUSED`] with
/// confidence 0.
///
/// # Errors
/// [`FillError`] when texture, layout and mesh are not of each other, or a parameter is out of
/// range.
pub fn fill_unseen(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &mut AtlasTexture,
    params: &FillParams,
) -> Result<FillReport, FillError> {
    check(mesh, layout, texture, params)?;
    let by_chart = coverage(layout, texture);
    let (mut wanted, mut report) = (Vec::new(), FillReport::default());
    for (chart, coverage) in by_chart.iter().enumerate() {
        report.add_painted(coverage);
        let of_mesh = layout.charts[chart]
            .triangles
            .iter()
            .map(|t| t.index() < mesh.num_triangles());
        let incomplete = (0_u32..).zip(coverage).zip(of_mesh);
        let incomplete = incomplete.filter(|((_, c), is_of_mesh)| *is_of_mesh && !c.is_complete());
        let numbers = incomplete.map(|((number, _), _)| number).collect();
        wanted.push(ChartPart { chart, numbers });
    }
    let is_unpainted = |coverage: &Coverage| coverage.num_unpainted > 0;
    if !by_chart.iter().flatten().any(is_unpainted) {
        return Ok(report);
    }
    let surface = Surface {
        mesh,
        representative: Some(&equal_representatives(mesh.positions_m())),
    };
    let coverage: Vec<&[Coverage]> = by_chart.iter().map(Vec::as_slice).collect();
    let part = FillPart {
        coverage: &coverage,
        wanted: &wanted,
        lenders: &(0..layout.charts.len()).collect::<Vec<_>>(),
        is_stale: &|_| true,
    };
    let lent = &mut LentColours::default();
    let (filled, _) = fill_triangles(&surface, layout, texture, &part, lent, params);
    Ok(FillReport {
        num_painted_texels: report.num_painted_texels,
        num_unpainted_triangles: report.num_unpainted_triangles,
        ..filled
    })
}

impl FillReport {
    /// Counts what is there of a chart before anything is filled.
    fn add_painted(&mut self, coverage: &[Coverage]) {
        let is_unpainted = |c: &&Coverage| c.num_painted == 0 && c.num_unpainted > 0;
        let num_painted = coverage.iter().map(|c| c.num_painted as usize);
        self.num_painted_texels += num_painted.sum::<usize>();
        self.num_unpainted_triangles += coverage.iter().filter(is_unpainted).count();
    }
}

/// A mesh, and for each of its vertices the one that stands for its position.
pub(crate) struct Surface<'a> {
    pub(crate) mesh: &'a TriMesh,
    /// `None` where each stands for itself.
    pub(crate) representative: Option<&'a [u32]>,
}

impl Surface<'_> {
    /// The vertices that stand for a triangle's corners.
    fn corners(&self, triangle: TriangleId) -> [u32; 3] {
        let corners = self.mesh.triangles()[triangle.index()];
        match self.representative {
            Some(representative) => corners.map(|vertex| representative[vertex as usize]),
            None => corners,
        }
    }
}

/// Some triangles of a chart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ChartPart {
    /// Which of the layout's charts.
    pub(crate) chart: usize,
    /// Their numbers in the chart, ascending.
    pub(crate) numbers: Vec<u32>,
}

impl ChartPart {
    fn triangles<'a>(&'a self, layout: &'a AtlasLayout) -> impl Iterator<Item = TriangleId> + 'a {
        let placed = &layout.charts[self.chart].triangles;
        self.numbers.iter().map(|&number| placed[number as usize])
    }
}

/// What is filled.
pub(crate) struct FillPart<'a> {
    /// By chart, of each of its triangles.
    pub(crate) coverage: &'a [&'a [Coverage]],
    /// All triangles that are not completely painted, or whole regions of them: two are in one region where
    /// they share a vertex. Ascending by chart.
    pub(crate) wanted: &'a [ChartPart],
    /// All charts with painted texels at vertices of those, ascending; others may be among them.
    pub(crate) lenders: &'a [usize],
    /// Of those wanted, the ones whose unpainted texels may show something else than what their corners lent
    /// them last.
    pub(crate) is_stale: &'a (dyn Fn(TriangleId) -> bool + Sync),
}

/// The colours that vertices lent to the triangles that were filled at them last, by number in the mesh.
///
/// A triangle's texels depend on the three of its corners, in bytes, and on nothing else: where these
/// are those of the last time nothing is written.
#[derive(Debug, Default)]
pub(crate) struct LentColours {
    of_vertex: Vec<Option<Lent>>,
    /// As long as the mesh has vertices, for finding those of a part; kept, as parts are small beside it.
    scratch: diffusion::VertexNumbers,
}

/// Steps in which bytes are lent far from what is painted: there each texel that is painted moves all colours by
/// a little, and all would have to be written and published anew for it.
const FAR_STEP: u8 = 4;

/// A vertex's colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Lent {
    /// No painted texel is connected.
    Neutral,
    Srgb([u8; 3]),
}

impl Lent {
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    fn of(linear: Option<[f64; 3]>, is_far: bool) -> Self {
        let step = if is_far { FAR_STEP } else { 1 };
        let byte = |channel: f64| {
            let byte = srgb_from_linear(channel as f32);
            (byte / step * step).saturating_add(step / 2)
        };
        linear.map_or(Self::Neutral, |linear| Self::Srgb(linear.map(byte)))
    }
}

impl LentColours {
    /// Vertices have other numbers.
    pub(crate) fn forget(&mut self) {
        self.of_vertex.clear();
    }

    /// Takes the colours of the vertices of a part; per vertex of it, whether it has another.
    fn renew(
        &mut self,
        vertices: &diffusion::SurfaceVertices<'_>,
        now: &[Lent],
        num_vertices: usize,
    ) -> Vec<bool> {
        self.of_vertex.resize(num_vertices, None);
        let renewed = vertices.of_mesh().iter().zip(now).map(|(vertex, &lent)| {
            let before = self.of_vertex[*vertex as usize].replace(lent);
            before != Some(lent)
        });
        renewed.collect()
    }
}

/// Fills the wanted triangles; also returns the charts that got other texels, ascending.
pub(crate) fn fill_triangles(
    surface: &Surface<'_>,
    layout: &AtlasLayout,
    texture: &mut AtlasTexture,
    part: &FillPart<'_>,
    lent: &mut LentColours,
    params: &FillParams,
) -> (FillReport, Vec<usize>) {
    let mut report = FillReport::default();
    let numbers = std::mem::take(&mut lent.scratch);
    let mut colours = VertexColours::of_wanted(surface, layout, part.wanted, numbers);
    colours.add_painted(layout, texture, part);
    let solved = diffusion::diffuse(surface, &colours.vertices, colours.means(), params);
    report.num_diffused_vertices = solved.num_diffused;
    report.num_sweeps = solved.num_sweeps;
    let colours_now = solved.linear.into_iter().zip(solved.is_far);
    let now: Vec<Lent> = colours_now
        .map(|(linear, is_far)| Lent::of(linear, is_far))
        .collect();
    let is_other = lent.renew(&colours.vertices, &now, surface.mesh.num_vertices());
    let filling = Filling {
        layout,
        colours: &colours,
        lent: &now,
        neutral_srgb: params.neutral_srgb,
    };
    let written = filling.written(part, &is_other);
    filling.paint(&written, texture, &mut report);
    lent.scratch = colours.vertices.into_numbers();
    (report, written.iter().map(|part| part.chart).collect())
}

fn check(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &AtlasTexture,
    params: &FillParams,
) -> Result<(), FillError> {
    texture.check_fits(layout)?;
    if layout.corners_texel.len() != mesh.num_triangles() {
        return Err(FillError::Layout {
            num_placed: layout.corners_texel.len(),
            num_triangles: mesh.num_triangles(),
        });
    }
    if !(1.0..2.0).contains(&params.over_relaxation) {
        return Err(FillError::OverRelaxation {
            over_relaxation: params.over_relaxation,
        });
    }
    Ok(())
}

/// How many of a triangle's texels are painted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Coverage {
    num_painted: u32,
    num_unpainted: u32,
}

impl Coverage {
    /// Of a triangle on a page of the given size.
    pub(crate) fn of(corners_texel: &[[f32; 2]; 3], page: &TexturePage) -> Self {
        let mut coverage = Self::default();
        for_each_texel_within(corners_texel, [page.width, page.height], |x, y, _| {
            if is_painted(page.source[(y * page.width + x) as usize]) {
                coverage.num_painted += 1;
            } else {
                coverage.num_unpainted += 1;
            }
        });
        coverage
    }

    /// Of a triangle all of whose texels are painted.
    pub(crate) fn complete(num_texels: u32) -> Self {
        Self {
            num_painted: num_texels,
            num_unpainted: 0,
        }
    }

    pub(crate) fn is_complete(self) -> bool {
        self.num_unpainted == 0 && self.num_painted > 0
    }
}

fn is_painted(source: TexelSource) -> bool {
    ![
        TexelSource::NONE,
        TexelSource::DIFFUSED,
        TexelSource::GUTTER,
    ]
    .contains(&source)
}

/// Calls `visit(index in the page, barycentric)` for each texel of a triangle.
fn for_each_index(
    layout: &AtlasLayout,
    triangle: TriangleId,
    mut visit: impl FnMut(usize, [f32; 3]),
) {
    let width = layout.page_size_texel[0] as usize;
    if let Some(corners) = layout.corners_texel.get(triangle.index()) {
        for_each_texel_within(corners, layout.page_size_texel, |x, y, weights| {
            visit(y as usize * width + x as usize, weights);
        });
    }
}

/// By chart, of each of its triangles.
fn coverage(layout: &AtlasLayout, texture: &AtlasTexture) -> Vec<Vec<Coverage>> {
    let of_chart = |chart: &PlacedChart| -> Vec<Coverage> {
        let page = texture.pages.get(chart.page as usize);
        let of_triangle = |triangle: &TriangleId| {
            let corners = layout.corners_texel.get(triangle.index());
            let known = corners.zip(page);
            known.map_or_else(Coverage::default, |(corners, page)| {
                Coverage::of(corners, page)
            })
        };
        chart.triangles.iter().map(of_triangle).collect()
    };
    layout.charts.par_iter().map(of_chart).collect()
}

/// Vertices of triangles that are not completely painted, by position.
struct VertexColours<'a> {
    vertices: diffusion::SurfaceVertices<'a>,
    /// Per vertex: weighted sum of linear colours, and of weights.
    sums: Vec<[f64; 4]>,
}

impl<'a> VertexColours<'a> {
    fn of_wanted(
        surface: &'a Surface<'a>,
        layout: &AtlasLayout,
        wanted: &[ChartPart],
        numbers: diffusion::VertexNumbers,
    ) -> Self {
        let wanted = wanted.iter().flat_map(|part| part.triangles(layout));
        let vertices = diffusion::SurfaceVertices::of(surface, wanted.collect(), numbers);
        Self {
            sums: vec![[0.0; 4]; vertices.len()],
            vertices,
        }
    }

    /// Adds the painted texels around each vertex, weighted by the square of their barycentric.
    fn add_painted(&mut self, layout: &AtlasLayout, texture: &AtlasTexture, part: &FillPart<'_>) {
        let touches = |triangle: TriangleId| {
            let corners = self.vertices.of_triangle(triangle);
            corners.iter().any(Option::is_some)
        };
        let of_chart = |chart: &usize| -> Vec<(TriangleId, [[f64; 4]; 3])> {
            let (placed, coverage) = (&layout.charts[*chart], part.coverage[*chart]);
            let Some(page) = texture.pages.get(placed.page as usize) else {
                return Vec::new();
            };
            let sums_of = |triangle: TriangleId| {
                let mut sums = [[0.0; 4]; 3];
                for_each_index(layout, triangle, |index, barycentric| {
                    if is_painted(page.source[index]) {
                        let linear = page.srgb[index].map(|byte| f64::from(linear_from_srgb(byte)));
                        for (sum, weight) in sums.iter_mut().zip(barycentric) {
                            let weight = f64::from(weight) * f64::from(weight);
                            let [r, g, b] = linear.map(|channel| channel * weight);
                            add(sum, [r, g, b, weight]);
                        }
                    }
                });
                (triangle, sums)
            };
            let painted = placed.triangles.iter().zip(coverage);
            let painted = painted.filter(|(_, coverage)| coverage.num_painted > 0);
            let touching = painted
                .map(|(triangle, _)| *triangle)
                .filter(|t| touches(*t));
            touching.map(sums_of).collect()
        };
        let by_chart: Vec<_> = part.lenders.par_iter().map(of_chart).collect();
        for (triangle, sums) in by_chart.into_iter().flatten() {
            for (vertex, sum) in self.vertices.of_triangle(triangle).into_iter().zip(sums) {
                if let Some(vertex) = vertex {
                    add(&mut self.sums[vertex], sum);
                }
            }
        }
    }

    /// Per vertex: its linear colour, where painted texels give one.
    fn means(&self) -> Vec<Option<[f64; 3]>> {
        self.sums
            .iter()
            .map(|&[r, g, b, weight]| {
                (weight > 0.0).then(|| [r, g, b].map(|channel| channel / weight))
            })
            .collect()
    }
}

fn add(sum: &mut [f64; 4], term: [f64; 4]) {
    for (sum, term) in sum.iter_mut().zip(term) {
        *sum += term;
    }
}

/// A texel of a page, and its new colour.
#[derive(Clone, Copy)]
struct Filled {
    texel: u32,
    srgb: [u8; 3],
}

/// What a chart's texels become.
#[derive(Default)]
struct FilledChart {
    /// First and last row that it fills; none where it fills nothing.
    rows: Option<[usize; 2]>,
    texels: Vec<Filled>,
    num_neutral: usize,
}

/// Charts done at a time; bounds what is held before it is written.
const CHARTS_PER_BATCH: usize = 256;

/// Rows of a page that one task writes.
const BAND_ROWS: usize = 128;

/// What filling reads.
struct Filling<'a> {
    layout: &'a AtlasLayout,
    colours: &'a VertexColours<'a>,
    /// Per vertex.
    lent: &'a [Lent],
    neutral_srgb: [u8; 3],
}

impl Filling<'_> {
    /// Those of the wanted triangles that get other texels; `is_other` by vertex of the part. Charts without any
    /// are left out.
    fn written(&self, part: &FillPart<'_>, is_other: &[bool]) -> Vec<ChartPart> {
        let of_chart = |wanted: &ChartPart| {
            let (placed, coverage) = (
                &self.layout.charts[wanted.chart],
                part.coverage[wanted.chart],
            );
            let is_written = |number: &&u32| {
                let triangle = placed.triangles[**number as usize];
                let corners = self.colours.vertices.of_triangle(triangle);
                let mut lent = corners.into_iter().flatten();
                coverage[**number as usize].num_unpainted > 0
                    && ((part.is_stale)(triangle) || lent.any(|vertex| is_other[vertex]))
            };
            ChartPart {
                chart: wanted.chart,
                numbers: wanted.numbers.iter().filter(is_written).copied().collect(),
            }
        };
        let mut written: Vec<ChartPart> = part.wanted.par_iter().map(of_chart).collect();
        written.retain(|part| !part.numbers.is_empty());
        written
    }

    fn paint(&self, written: &[ChartPart], texture: &mut AtlasTexture, report: &mut FillReport) {
        for batch in written.chunks(CHARTS_PER_BATCH) {
            let by_chart: Vec<FilledChart> = batch
                .par_iter()
                .map(|part| self.fill_chart(part, texture))
                .collect();
            for filled in &by_chart {
                report.num_neutral_texels += filled.num_neutral;
                report.num_diffused_texels += filled.texels.len() - filled.num_neutral;
            }
            let pages = texture.pages.par_iter_mut();
            pages.enumerate().for_each(|(number, page)| {
                let on_page = batch.iter().zip(&by_chart);
                let on_page =
                    on_page.filter(|(part, _)| self.chart_of(part).page as usize == number);
                let on_page: Vec<&FilledChart> = on_page.map(|(_, filled)| filled).collect();
                if on_page.iter().any(|filled| !filled.texels.is_empty()) {
                    write(&on_page, page.to_mut());
                }
            });
        }
    }

    fn chart_of(&self, part: &ChartPart) -> &PlacedChart {
        &self.layout.charts[part.chart]
    }

    fn fill_chart(&self, part: &ChartPart, texture: &AtlasTexture) -> FilledChart {
        let mut filled = FilledChart::default();
        let Some(page) = texture.pages.get(self.chart_of(part).page as usize) else {
            return filled;
        };
        for triangle in part.triangles(self.layout) {
            let corners = self
                .colours
                .vertices
                .of_triangle(triangle)
                .map(|vertex| vertex.map_or(Lent::Neutral, |v| self.lent[v]));
            let blend = match corners {
                [Lent::Srgb(a), Lent::Srgb(b), Lent::Srgb(c)] => Some(Blend::new([a, b, c])),
                _ => None,
            };
            for_each_index(self.layout, triangle, |index, weights| {
                if is_painted(page.source[index]) {
                    return;
                }
                let row = index / (page.width as usize).max(1);
                let [first, last] = filled.rows.unwrap_or([row; 2]);
                filled.rows = Some([first.min(row), last.max(row)]);
                filled.num_neutral += usize::from(blend.is_none());
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "a page has 32 bits of texels"
                )]
                filled.texels.push(Filled {
                    texel: index as u32,
                    srgb: match &blend {
                        Some(blend) => blend.at(weights),
                        None => self.neutral_srgb,
                    },
                });
            });
        }
        filled
    }
}

/// Writes the texels of charts to their page, band by band.
fn write(charts: &[&FilledChart], page: &mut TexturePage) {
    let band_len = BAND_ROWS * (page.width as usize).max(1);
    let srgb = page.srgb.par_chunks_mut(band_len);
    let source = page.source.par_chunks_mut(band_len);
    let confidence = page.confidence.par_chunks_mut(band_len);
    let bands = srgb.zip(source).zip(confidence).enumerate();
    bands.for_each(|(band, ((srgb, source), confidence))| {
        let (first, rows) = (band * band_len, band * BAND_ROWS..(band + 1) * BAND_ROWS);
        let meets = |filled: &&&FilledChart| {
            let reach = filled.rows;
            reach.is_some_and(|[top, bottom]| top < rows.end && bottom >= rows.start)
        };
        for texel in charts
            .iter()
            .filter(meets)
            .flat_map(|filled| &filled.texels)
        {
            let index = (texel.texel as usize).wrapping_sub(first);
            if let Some(srgb) = srgb.get_mut(index) {
                *srgb = texel.srgb;
                source[index] = TexelSource::DIFFUSED;
                confidence[index] = 0;
            }
        }
    });
}

/// The colours at a triangle's corners, by channel.
struct Blend([[f32; 3]; 3]);

impl Blend {
    fn new(corners: [[u8; 3]; 3]) -> Self {
        let linear = |channel: usize| corners.map(|srgb| linear_from_srgb(srgb[channel]));
        Self([0, 1, 2].map(linear))
    }

    fn at(&self, weights: [f32; 3]) -> [u8; 3] {
        self.0
            .map(|[a, b, c]| srgb_from_linear(a * weights[0] + b * weights[1] + c * weights[2]))
    }
}

#[cfg(test)]
mod tests;
