//! Colours for texels that no frame painted: spread over the surface from where it is painted.
//!
//! Vertices of triangles with unpainted texels get a colour in linear light: the mean of the
//! painted texels of their triangles, weighted towards the vertex; where there are none, a
//! harmonic blend of their neighbours' along the mesh's edges ([`diffusion`]; vertices of equal
//! position count as one, so it crosses charts and cuts). Unpainted texels interpolate their
//! triangle's vertices. A component of the surface without any painted texel becomes neutral.
//!
//! Texels filled earlier ([`TexelSource::DIFFUSED`]) are filled anew; painted ones never change.
//! Runs after colour transfer and before the gutters. Charts are done in parallel, the diffusion
//! in a fixed order; the result does not depend on the thread count.

mod diffusion;

use rayon::prelude::*;

use crate::atlas::{
    AtlasLayout, AtlasTexture, PlacedChart, TexelSource, TextureMismatch, for_each_texel_within,
};
use crate::geom::color::{linear_from_srgb, srgb_from_linear};
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
    let coverage = coverage(layout, texture, mesh.num_triangles());
    let mut report = FillReport::default();
    for triangle in &coverage {
        report.num_painted_texels += triangle.num_painted;
        report.num_unpainted_triangles +=
            usize::from(triangle.num_painted == 0 && triangle.num_unpainted > 0);
    }
    if coverage.iter().all(|triangle| triangle.num_unpainted == 0) {
        return Ok(report);
    }
    let mut colours = VertexColours::of_unpainted(mesh, &coverage);
    colours.add_painted(layout, texture, &coverage);
    let solved = diffusion::diffuse(mesh, &colours.vertices, colours.means(), params);
    report.num_diffused_vertices = solved.num_diffused;
    report.num_sweeps = solved.num_sweeps;
    paint(
        layout,
        texture,
        &coverage,
        &colours,
        &solved.linear,
        params,
        &mut report,
    );
    Ok(report)
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
#[derive(Clone, Copy, Default)]
struct Coverage {
    num_painted: usize,
    num_unpainted: usize,
}

impl Coverage {
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
        let of_triangle = |&triangle: &TriangleId| {
            let mut coverage = Coverage::default();
            for_each_index(layout, triangle, |index, _| {
                if is_painted(page.source[index]) {
                    coverage.num_painted += 1;
                } else {
                    coverage.num_unpainted += 1;
                }
            });
            coverage
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
struct VertexColours {
    vertices: diffusion::SurfaceVertices,
    /// Per vertex: weighted sum of linear colours, and of weights.
    sums: Vec<[f64; 4]>,
}

impl VertexColours {
    fn of_unpainted(mesh: &TriMesh, coverage: &[Coverage]) -> Self {
        let is_wanted = |triangle: usize| !coverage[triangle].is_complete();
        let vertices = diffusion::SurfaceVertices::of(mesh, is_wanted);
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

/// A texel of a page and its new colour; none when it is neutral.
type Filled = (usize, Option<[u8; 3]>);

/// Charts done at a time; bounds what is held before it is written.
const CHARTS_PER_BATCH: usize = 256;

fn paint(
    layout: &AtlasLayout,
    texture: &mut AtlasTexture,
    coverage: &[Coverage],
    colours: &VertexColours,
    linear: &[Option<[f64; 3]>],
    params: &FillParams,
    report: &mut FillReport,
) {
    for batch in layout.charts.chunks(CHARTS_PER_BATCH) {
        let by_chart: Vec<Vec<Filled>> = batch
            .par_iter()
            .map(|chart| fill_chart(chart, layout, texture, coverage, colours, linear))
            .collect();
        for (chart, filled) in batch.iter().zip(by_chart) {
            let Some(page) = texture.pages.get_mut(chart.page as usize) else {
                continue;
            };
            for (index, srgb) in filled {
                page.srgb[index] = srgb.unwrap_or(params.neutral_srgb);
                page.source[index] = TexelSource::DIFFUSED;
                page.confidence[index] = 0;
                match srgb {
                    Some(_) => report.num_diffused_texels += 1,
                    None => report.num_neutral_texels += 1,
                }
            }
        }
    }
}

fn fill_chart(
    chart: &PlacedChart,
    layout: &AtlasLayout,
    texture: &AtlasTexture,
    coverage: &[Coverage],
    colours: &VertexColours,
    linear: &[Option<[f64; 3]>],
) -> Vec<Filled> {
    let mut filled = Vec::new();
    let Some(page) = texture.pages.get(chart.page as usize) else {
        return filled;
    };
    for &triangle in &chart.triangles {
        if coverage
            .get(triangle.index())
            .is_none_or(|c| c.num_unpainted == 0)
        {
            continue;
        }
        let [a, b, c] = colours
            .vertices
            .of_triangle(triangle)
            .map(|vertex| vertex.and_then(|v| linear[v]));
        for_each_index(layout, triangle, |index, weights| {
            if is_painted(page.source[index]) {
                return;
            }
            let srgb = match (a, b, c) {
                (Some(a), Some(b), Some(c)) => Some(blend([a, b, c], weights)),
                _ => None,
            };
            filled.push((index, srgb));
        });
    }
    filled
}

fn blend(linear: [[f64; 3]; 3], weights: [f32; 3]) -> [u8; 3] {
    std::array::from_fn(|channel| {
        let value: f64 = (0..3)
            .map(|corner| linear[corner][channel] * f64::from(weights[corner]))
            .sum();
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let value = value as f32;
        srgb_from_linear(value)
    })
}

#[cfg(test)]
mod tests;
