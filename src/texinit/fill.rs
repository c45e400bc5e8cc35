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
use crate::texinit::flatten::cut::find;

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
    let coverage = coverage(layout, texture, mesh.num_triangles());
    if coverage.iter().all(|triangle| triangle.num_unpainted == 0) {
        return Ok(FillReport::of(&coverage));
    }
    let is_wanted: Vec<bool> = coverage.iter().map(|c| !c.is_complete()).collect();
    let surface = Surface {
        mesh,
        representative: &equal_representatives(mesh.positions_m()),
    };
    let part = FillPart {
        coverage: &coverage,
        is_wanted: &is_wanted,
        is_stale: &vec![true; coverage.len()],
    };
    let lent = &mut LentColours::default();
    let (mut report, _) = fill_triangles(&surface, layout, texture, &part, lent, params);
    let FillReport {
        num_painted_texels,
        num_unpainted_triangles,
        ..
    } = FillReport::of(&coverage);
    report.num_painted_texels = num_painted_texels;
    report.num_unpainted_triangles = num_unpainted_triangles;
    Ok(report)
}

impl FillReport {
    /// What is there before anything is filled.
    fn of(coverage: &[Coverage]) -> Self {
        let is_unpainted = |c: &&Coverage| c.num_painted == 0 && c.num_unpainted > 0;
        Self {
            num_painted_texels: coverage.iter().map(|c| c.num_painted as usize).sum(),
            num_unpainted_triangles: coverage.iter().filter(is_unpainted).count(),
            ..Self::default()
        }
    }
}

/// A mesh, and for each of its vertices the one that stands for its position.
pub(crate) struct Surface<'a> {
    pub(crate) mesh: &'a TriMesh,
    pub(crate) representative: &'a [u32],
}

/// What is filled; all by triangle.
pub(crate) struct FillPart<'a> {
    pub(crate) coverage: &'a [Coverage],
    /// All, or whole regions ([`regions_at`]) of those that are not completely painted.
    pub(crate) is_wanted: &'a [bool],
    /// Those whose unpainted texels may show something else than what their corners lent them last.
    pub(crate) is_stale: &'a [bool],
}

/// The colours that vertices lent to the triangles that were filled at them last, by number in the mesh.
///
/// A triangle's texels depend on the three of its corners, in bytes, and on nothing else: where these
/// are those of the last time nothing is written.
#[derive(Debug, Default)]
pub(crate) struct LentColours(Vec<Option<Lent>>);

/// A vertex's colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Lent {
    /// No painted texel is connected.
    Neutral,
    Srgb([u8; 3]),
}

impl Lent {
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    fn of(linear: Option<[f64; 3]>) -> Self {
        linear.map_or(Self::Neutral, |linear| {
            Self::Srgb(linear.map(|channel| srgb_from_linear(channel as f32)))
        })
    }
}

impl LentColours {
    /// Vertices have other numbers.
    pub(crate) fn forget(&mut self) {
        self.0.clear();
    }

    /// Takes the colours of the vertices; per vertex of the mesh, of `num_vertices`, whether it has another.
    fn renew(
        &mut self,
        vertices: &diffusion::SurfaceVertices<'_>,
        now: &[Lent],
        num_vertices: usize,
    ) -> Vec<bool> {
        let mut is_other = vec![false; num_vertices];
        self.0.resize(num_vertices, None);
        for (vertex, &lent) in vertices.of_mesh().iter().zip(now) {
            let vertex = *vertex as usize;
            is_other[vertex] = self.0[vertex].replace(lent) != Some(lent);
        }
        is_other
    }
}

/// Fills the wanted triangles; per triangle whether it got other texels.
pub(crate) fn fill_triangles(
    surface: &Surface<'_>,
    layout: &AtlasLayout,
    texture: &mut AtlasTexture,
    part: &FillPart<'_>,
    lent: &mut LentColours,
    params: &FillParams,
) -> (FillReport, Vec<bool>) {
    let mut report = FillReport::default();
    let mut colours = VertexColours::of_wanted(surface, part.is_wanted);
    colours.add_painted(layout, texture, part.coverage);
    let solved = diffusion::diffuse(surface.mesh, &colours.vertices, colours.means(), params);
    report.num_diffused_vertices = solved.num_diffused;
    report.num_sweeps = solved.num_sweeps;
    let now: Vec<Lent> = solved.linear.into_iter().map(Lent::of).collect();
    let is_other = lent.renew(&colours.vertices, &now, surface.mesh.num_vertices());
    let wanted = part.is_wanted.par_iter().zip(part.coverage).enumerate();
    let is_written = wanted.map(|(triangle, (is_wanted, coverage))| {
        let is_other = |corner: &u32| is_other[surface.representative[*corner as usize] as usize];
        let mut corners = surface.mesh.triangles()[triangle].iter();
        let has_to_be_filled = *is_wanted && coverage.num_unpainted > 0;
        has_to_be_filled && (part.is_stale[triangle] || corners.any(is_other))
    });
    let is_written: Vec<bool> = is_written.collect();
    let filling = Filling {
        layout,
        is_written: &is_written,
        colours: &colours,
        lent: &now,
        neutral_srgb: params.neutral_srgb,
    };
    filling.paint(texture, &mut report);
    (report, is_written)
}

/// Which triangles are in a region with one of the given vertices: triangles that are not
/// completely painted are in one region where they share a vertex.
pub(crate) fn regions_at(
    surface: &Surface<'_>,
    coverage: &[Coverage],
    is_seed: &[bool],
) -> Vec<bool> {
    let corners_of = |triangle: usize| {
        let corners = surface.mesh.triangles()[triangle];
        corners.map(|corner| surface.representative[corner as usize])
    };
    let open: Vec<usize> = (0..coverage.len())
        .filter(|&triangle| !coverage[triangle].is_complete())
        .collect();
    let mut set: Vec<u32> = (0_u32..).take(surface.mesh.num_vertices()).collect();
    for &triangle in &open {
        let [a, b, c] = corners_of(triangle);
        for (one, other) in [(a, b), (b, c)] {
            let (one, other) = (find(&mut set, one), find(&mut set, other));
            set[one.max(other) as usize] = one.min(other);
        }
    }
    let mut is_wanted_set = vec![false; surface.mesh.num_vertices()];
    for (vertex, _) in (0_u32..).zip(is_seed).filter(|(_, is_seed)| **is_seed) {
        let representative = surface.representative[vertex as usize];
        is_wanted_set[find(&mut set, representative) as usize] = true;
    }
    let mut is_wanted = vec![false; coverage.len()];
    for triangle in open {
        is_wanted[triangle] = is_wanted_set[find(&mut set, corners_of(triangle)[0]) as usize];
    }
    is_wanted
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

    fn is_complete(self) -> bool {
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

fn coverage(layout: &AtlasLayout, texture: &AtlasTexture, num_triangles: usize) -> Vec<Coverage> {
    let of_chart = |chart: &PlacedChart| -> Vec<Coverage> {
        let Some(page) = texture.pages.get(chart.page as usize) else {
            return Vec::new();
        };
        let of_triangle = |triangle: &TriangleId| {
            let corners = layout.corners_texel.get(triangle.index());
            corners.map_or_else(Coverage::default, |corners| Coverage::of(corners, page))
        };
        chart.triangles.iter().map(of_triangle).collect()
    };
    let by_chart: Vec<Vec<Coverage>> = layout.charts.par_iter().map(of_chart).collect();
    let mut coverage = vec![Coverage::default(); num_triangles];
    for (chart, of_triangles) in layout.charts.iter().zip(by_chart) {
        for (triangle, found) in chart.triangles.iter().zip(of_triangles) {
            if let Some(slot) = coverage.get_mut(triangle.index()) {
                *slot = found;
            }
        }
    }
    coverage
}

/// Vertices of triangles that are not completely painted, by position.
struct VertexColours<'a> {
    vertices: diffusion::SurfaceVertices<'a>,
    /// Per vertex: weighted sum of linear colours, and of weights.
    sums: Vec<[f64; 4]>,
}

impl<'a> VertexColours<'a> {
    fn of_wanted(surface: &Surface<'a>, is_wanted: &[bool]) -> Self {
        let vertices =
            diffusion::SurfaceVertices::of(surface.mesh, surface.representative, is_wanted);
        Self {
            sums: vec![[0.0; 4]; vertices.len()],
            vertices,
        }
    }

    /// Adds the painted texels around each vertex, weighted by the square of their barycentric.
    fn add_painted(&mut self, layout: &AtlasLayout, texture: &AtlasTexture, coverage: &[Coverage]) {
        let touches = |triangle: &TriangleId| {
            let is_painted = coverage
                .get(triangle.index())
                .is_some_and(|c| c.num_painted > 0);
            is_painted
                && self
                    .vertices
                    .of_triangle(*triangle)
                    .iter()
                    .any(Option::is_some)
        };
        let of_chart = |chart: &PlacedChart| -> Vec<(TriangleId, [[f64; 4]; 3])> {
            let Some(page) = texture.pages.get(chart.page as usize) else {
                return Vec::new();
            };
            let sums_of = |&triangle: &TriangleId| {
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
            let touching = chart.triangles.iter().filter(|t| touches(t));
            touching.map(sums_of).collect()
        };
        let by_chart: Vec<_> = layout.charts.par_iter().map(of_chart).collect();
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
    is_written: &'a [bool],
    colours: &'a VertexColours<'a>,
    /// Per vertex.
    lent: &'a [Lent],
    neutral_srgb: [u8; 3],
}

impl Filling<'_> {
    fn paint(&self, texture: &mut AtlasTexture, report: &mut FillReport) {
        let is_written = |chart: &&PlacedChart| chart.triangles.iter().any(|t| self.is_written(*t));
        let charts: Vec<&PlacedChart> = self.layout.charts.iter().filter(is_written).collect();
        for batch in charts.chunks(CHARTS_PER_BATCH) {
            let by_chart: Vec<FilledChart> = batch
                .par_iter()
                .map(|chart| self.fill_chart(chart, texture))
                .collect();
            for filled in &by_chart {
                report.num_neutral_texels += filled.num_neutral;
                report.num_diffused_texels += filled.texels.len() - filled.num_neutral;
            }
            let pages = texture.pages.par_iter_mut();
            pages.enumerate().for_each(|(number, page)| {
                let on_page = batch.iter().zip(&by_chart);
                let on_page = on_page.filter(|(chart, _)| chart.page as usize == number);
                let on_page: Vec<&FilledChart> = on_page.map(|(_, filled)| filled).collect();
                if on_page.iter().any(|filled| !filled.texels.is_empty()) {
                    write(&on_page, page.to_mut());
                }
            });
        }
    }

    fn is_written(&self, triangle: TriangleId) -> bool {
        self.is_written.get(triangle.index()) == Some(&true)
    }

    fn fill_chart(&self, chart: &PlacedChart, texture: &AtlasTexture) -> FilledChart {
        let mut filled = FilledChart::default();
        let Some(page) = texture.pages.get(chart.page as usize) else {
            return filled;
        };
        let written = |triangle: &&TriangleId| self.is_written(**triangle);
        for &triangle in chart.triangles.iter().filter(written) {
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
