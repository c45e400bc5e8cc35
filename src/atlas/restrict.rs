//! A part of a textured mesh, on the same pages.

use super::layout::{AtlasLayout, ChartId, PlacedChart};
use crate::mesh::{TriMesh, TriangleId};

/// The triangles that `keep` says yes to, with their charts where they were. Charts and vertices that
/// are left without a triangle go; the others keep their order, charts their texels.
pub fn restrict(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    keep: impl Fn(TriangleId) -> bool,
) -> (TriMesh, AtlasLayout) {
    let kept: Vec<TriangleId> = mesh.triangle_ids().filter(|&t| keep(t)).collect();
    let mut new_of_old = vec![None; mesh.num_triangles()];
    for (new, old) in (0u32..).zip(&kept) {
        new_of_old[old.index()] = Some(TriangleId(new));
    }

    let mut charts = Vec::new();
    let mut chart_of_triangle = vec![ChartId(0); kept.len()];
    for chart in &layout.charts {
        let renumbered = chart.triangles.iter().map(|t| new_of_old[t.index()]);
        let triangles: Vec<TriangleId> = renumbered.flatten().collect();
        if triangles.is_empty() {
            continue;
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "no more charts than before"
        )]
        let id = ChartId(charts.len() as u32);
        for triangle in &triangles {
            chart_of_triangle[triangle.index()] = id;
        }
        charts.push(PlacedChart {
            triangles,
            cells: chart.cells.clone(),
            ..*chart
        });
    }
    let layout = AtlasLayout {
        charts,
        chart_of_triangle,
        corners_texel: kept
            .iter()
            .map(|old| layout.corners_texel[old.index()])
            .collect(),
        ..*layout
    };
    (mesh.filtered(keep), layout)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::TexelRect;
    use nalgebra::Point3;

    fn rect(x: u32) -> TexelRect {
        TexelRect {
            x,
            y: 0,
            width: 4,
            height: 4,
        }
    }

    #[test]
    fn what_stays_lies_where_it_lay() {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [2.0, 0.0]];
        let positions = corners.map(|[x, y]| Point3::new(x, y, 0.0)).to_vec();
        let triangles = vec![[0, 1, 2], [0, 2, 3], [1, 4, 2]];
        let (mesh, _) = TriMesh::from_soup(positions, triangles).expect("valid");
        let of_chart = |x, triangles: &[u32]| {
            let triangles = triangles.iter().map(|&t| TriangleId(t)).collect();
            PlacedChart::whole_rect(0, rect(x), 1.0, triangles)
        };
        let layout = AtlasLayout {
            page_size_texel: [16, 16],
            num_pages: 1,
            texels_per_m: 1.0,
            charts: vec![of_chart(0, &[1]), of_chart(4, &[2, 0])],
            chart_of_triangle: vec![ChartId(1), ChartId(0), ChartId(1)],
            corners_texel: (0..3u8)
                .map(|t| [[f32::from(t), 0.0], [1.0, 0.0], [1.0, 1.0]])
                .collect(),
        };
        let (part, part_layout) = restrict(&mesh, &layout, |triangle| triangle.0 != 1);
        assert_eq!(part.num_triangles(), 2);
        assert_eq!(part.num_vertices(), 4);
        for (new, old) in [(0, 0), (1, 2)].map(|(n, o)| (TriangleId(n), TriangleId(o))) {
            assert_eq!(part.corners_m(new), mesh.corners_m(old));
            assert_eq!(part_layout.corners_uv(new), layout.corners_uv(old));
        }
        assert_eq!(part_layout.charts.len(), 1);
        assert_eq!(part_layout.charts[0].rect, rect(4));
        assert_eq!(
            part_layout.charts[0].triangles,
            [TriangleId(1), TriangleId(0)]
        );
        assert_eq!(part_layout.chart_of_triangle, [ChartId(0); 2]);

        let whole = restrict(&mesh, &layout, |_| true);
        assert_eq!(whole, (mesh, layout));
    }
}
