//! How evenly a layout spreads its texels over the surface.

use super::layout::AtlasLayout;
use crate::mesh::TriMesh;

/// Density of the texture over the surface, from each triangle's area on its page and in space.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct DensitySpread {
    /// Texels per square metre: a twentieth of the triangles has less, a twentieth has more.
    pub texels_per_m2_by_triangle: [f64; 2],
    /// The same of the surface's area.
    pub texels_per_m2_by_area: [f64; 2],
    /// Share of the triangles whose area on the page is below that of one texel.
    pub subtexel_share: f64,
}

/// The quantiles of [`DensitySpread`].
const QUANTILES: [f64; 2] = [0.05, 0.95];

impl DensitySpread {
    /// Of a mesh's layout. Triangles without area in space have no density and are left out of the
    /// quantiles.
    pub fn of(mesh: &TriMesh, layout: &AtlasLayout) -> Self {
        let mut num_subtexel = 0usize;
        let mut densities = Vec::with_capacity(mesh.num_triangles());
        for (triangle, corners) in mesh.triangle_ids().zip(&layout.corners_texel) {
            let [a, b, c] = corners.map(|corner| corner.map(f64::from));
            let doubled = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            let num_texels = 0.5 * doubled.abs();
            num_subtexel += usize::from(num_texels < 1.0);
            let area_m2 = mesh.area_m2(triangle);
            if area_m2.is_finite() && area_m2 > 0.0 {
                densities.push((num_texels / area_m2, area_m2));
            }
        }
        densities.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        Self {
            texels_per_m2_by_triangle: QUANTILES.map(|q| quantile(&densities, q, |_| 1.0)),
            texels_per_m2_by_area: QUANTILES.map(|q| quantile(&densities, q, |area_m2| area_m2)),
            subtexel_share: num_subtexel as f64 / (mesh.num_triangles().max(1)) as f64,
        }
    }
}

/// The smallest value that has at least that share of the weight at or below it; 0 of none.
fn quantile(sorted: &[(f64, f64)], share: f64, weight: impl Fn(f64) -> f64) -> f64 {
    let total: f64 = sorted.iter().map(|(_, area)| weight(*area)).sum();
    let mut sum = 0.0;
    for (value, area) in sorted {
        sum += weight(*area);
        if sum >= share * total {
            return *value;
        }
    }
    sorted.last().map_or(0.0, |(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::super::layout::ChartId;
    use super::*;

    #[test]
    fn quantiles_go_by_number_or_by_area() {
        // Nineteen triangles of half a square metre at 4 texels per m², one of 50 m² at 0.01.
        let mut positions = Vec::new();
        let mut corners_texel = Vec::new();
        for k in 0..20 {
            let (x, side_m, side_texel) = if k < 19 {
                (f64::from(k) * 2.0, 1.0, 2.0)
            } else {
                (100.0, 10.0, 1.0)
            };
            let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
            positions.extend(corners.map(|[u, v]| Point3::new(x + u * side_m, v * side_m, 0.0)));
            corners_texel.push(corners.map(|c| c.map(|v| v as f32 * side_texel)));
        }
        let triangles = (0..20).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        let mesh = TriMesh::from_soup(positions, triangles).unwrap().0;
        let layout = AtlasLayout {
            page_size_texel: [64, 64],
            num_pages: 1,
            texels_per_m: 2.0,
            charts: vec![],
            chart_of_triangle: vec![ChartId(0); 20],
            corners_texel,
        };
        let spread = DensitySpread::of(&mesh, &layout);
        assert_eq!(spread.texels_per_m2_by_triangle, [0.01, 4.0]);
        // The large one has 50 of 59.5 m².
        assert_eq!(spread.texels_per_m2_by_area, [0.01, 4.0]);
        assert_eq!(spread.subtexel_share, 0.05);
    }
}
