//! The layout's charts as they are sent; one that is too large for a message in several parts.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::atlas::PlacedChart;
use crate::export::TexturedMesh;
use crate::mesh::TriangleId;
use crate::publish::digest::{Digest, Digester};
use crate::wire::textured_mesh_block::TexturedChart;

/// All charts in the layout's order, without their names.
pub(super) fn all(textured: &TexturedMesh<'_>, max_bytes: usize) -> Vec<(Digest, TexturedChart)> {
    let charts: Vec<Vec<(Digest, TexturedChart)>> = triangles_by_chart(textured)
        .par_iter()
        .zip(&textured.layout().charts)
        .map(|(triangles, chart)| parts(textured, chart, triangles, max_bytes))
        .collect();
    charts.into_iter().flatten().collect()
}

/// By `chart_of_triangle`, which is what the exports go by.
fn triangles_by_chart(textured: &TexturedMesh<'_>) -> Vec<Vec<TriangleId>> {
    let layout = textured.layout();
    let mut triangles_by_chart = vec![Vec::new(); layout.charts.len()];
    for (triangle, chart) in textured
        .mesh()
        .triangle_ids()
        .zip(&layout.chart_of_triangle)
    {
        triangles_by_chart[chart.index()].push(triangle);
    }
    triangles_by_chart
}

/// Bytes of a vertex with its coordinates.
const VERTEX_BYTES: usize = 32;
/// Bytes of a triangle's indices.
const TRIANGLE_BYTES: usize = 12;

fn parts(
    textured: &TexturedMesh<'_>,
    chart: &PlacedChart,
    triangles: &[TriangleId],
    max_bytes: usize,
) -> Vec<(Digest, TexturedChart)> {
    let mut parts = Vec::new();
    let mut part = Part::new(chart);
    for &triangle in triangles {
        let most = part.chart.max_bytes() + 3 * VERTEX_BYTES + TRIANGLE_BYTES;
        if most > max_bytes && !part.chart.triangles.is_empty() {
            parts.push(std::mem::replace(&mut part, Part::new(chart)).finish());
        }
        part.push(textured, triangle);
    }
    if !part.chart.triangles.is_empty() {
        parts.push(part.finish());
    }
    parts
}

struct Part {
    chart: TexturedChart,
    /// Vertices by mesh vertex and bits of u and v.
    vertices: BTreeMap<(u32, [u32; 2]), u32>,
}

impl Part {
    fn new(chart: &PlacedChart) -> Self {
        Self {
            chart: TexturedChart {
                id: 0,
                page: chart.page,
                rect: chart.rect,
                vertices_m: Vec::new(),
                uvs: Vec::new(),
                triangles: Vec::new(),
            },
            vertices: BTreeMap::new(),
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "a part has no more vertices than bytes of a message"
    )]
    fn push(&mut self, textured: &TexturedMesh<'_>, triangle: TriangleId) {
        let vertices = textured.mesh().triangles()[triangle.index()];
        for (vertex, uv) in vertices.into_iter().zip(textured.corners_uv(triangle)) {
            let chart = &mut self.chart;
            let index = *self
                .vertices
                .entry((vertex, uv.map(f32::to_bits)))
                .or_insert_with(|| {
                    let position_m = textured.mesh().positions_m()[vertex as usize];
                    chart.vertices_m.push(position_m.into());
                    chart.uvs.extend(uv);
                    chart.vertices_m.len() as u32 - 1
                });
            chart.triangles.push(index);
        }
    }

    fn finish(self) -> (Digest, TexturedChart) {
        let chart = self.chart;
        let mut digester = Digester::new();
        for number in [
            chart.page,
            chart.rect.x,
            chart.rect.y,
            chart.rect.width,
            chart.rect.height,
        ] {
            digester.number(number.into());
        }
        digester.number(chart.vertices_m.len() as u64);
        for coordinate in chart.vertices_m.as_flattened() {
            digester.number(coordinate.to_bits());
        }
        for coordinate in &chart.uvs {
            digester.number(coordinate.to_bits().into());
        }
        for &index in &chart.triangles {
            digester.number(index.into());
        }
        (digester.finish(), chart)
    }
}
