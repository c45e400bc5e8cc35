//! The layout's charts as they are sent; one that is too large for a message in several parts.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::atlas::{ChartKey, PlacedChart};
use crate::export::TexturedMesh;
use crate::mesh::TriangleId;
use crate::publish::Content;
use crate::publish::digest::{Digest, Digester};
use crate::wire::textured_mesh_block::TexturedChart;

/// Digests of the parts of charts, so that what was sent need not be built again to be told.
#[derive(Debug, Default)]
pub(super) struct KnownParts {
    by_chart: BTreeMap<ChartKey, Vec<Digest>>,
    max_bytes: usize,
}

impl KnownParts {
    /// The parts of all charts in the layout's order, without their names; none of `max_bytes` or more. Those
    /// of charts all of whose parts are sent are not built.
    pub(super) fn all(
        &mut self,
        content: &Content<'_>,
        max_bytes: usize,
        is_sent: &dyn Fn(Digest) -> bool,
    ) -> Vec<(Digest, Option<TexturedChart>)> {
        let Content { textured, keys, .. } = content;
        let mut before = std::mem::take(&mut self.by_chart);
        if std::mem::replace(&mut self.max_bytes, max_bytes) != max_bytes {
            before.clear();
        }
        let mut known: Vec<Option<Vec<Digest>>> = keys
            .iter()
            // Removed, so that of two equal charts one is built: it is not known that both were sent.
            .map(|key| {
                before
                    .remove(key)
                    .filter(|parts| parts.iter().all(|&d| is_sent(d)))
            })
            .collect();
        let mut triangles = vec![Vec::new(); known.len()];
        if known.contains(&None) {
            let is_unknown = |chart: usize| known[chart].is_none();
            content.for_each_triangle(is_unknown, |chart, triangle| {
                triangles[chart].push(triangle)
            });
        }
        let charts = textured.layout().charts.par_iter();
        let built: Vec<Vec<(Digest, Option<TexturedChart>)>> = charts
            .zip(&triangles)
            .zip(&mut known)
            .map(|((chart, triangles), known)| match known.take() {
                Some(known) => known.into_iter().map(|digest| (digest, None)).collect(),
                None => {
                    let parts = parts(textured, chart, triangles, max_bytes).into_iter();
                    parts.map(|(digest, part)| (digest, Some(part))).collect()
                }
            })
            .collect();
        for (key, parts) in keys.iter().zip(&built) {
            let digests = parts.iter().map(|(digest, _)| *digest).collect();
            self.by_chart.insert(*key, digests);
        }
        built.into_iter().flatten().collect()
    }
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
