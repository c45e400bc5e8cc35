//! What stands for a chart: where it lies and what surface it is of, in 128 bits.

use rayon::prelude::*;
use xxhash_rust::xxh3::Xxh3;

use super::layout::{AtlasLayout, PlacedChart};
use crate::mesh::{TriMesh, TriangleId};

/// Equal for charts of equal page, rectangle, and corners of their triangles, in space and on the page, in
/// their order; to the bit. By XXH3 with 128 bits: others are equal by chance never, by malice perhaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChartKey(u128);

impl ChartKey {
    /// Of a chart with some triangles of the layout.
    pub fn of(
        mesh: &TriMesh,
        layout: &AtlasLayout,
        placed: &PlacedChart,
        triangles: impl IntoIterator<Item = TriangleId>,
    ) -> Self {
        let mut hash = Xxh3::new();
        let rect = &placed.rect;
        for number in [placed.page, rect.x, rect.y, rect.width, rect.height] {
            hash.update(&number.to_le_bytes());
        }
        for triangle in triangles {
            let mut bytes = [0; 96];
            let corners_m = mesh.corners_m(triangle);
            let coordinates = corners_m.iter().flat_map(|corner| corner.iter());
            for (bytes, coordinate) in bytes.chunks_exact_mut(8).zip(coordinates) {
                bytes.copy_from_slice(&coordinate.to_bits().to_le_bytes());
            }
            let texels = layout.corners_texel[triangle.index()].as_flattened();
            for (bytes, coordinate) in bytes[72..].chunks_exact_mut(4).zip(texels) {
                bytes.copy_from_slice(&coordinate.to_bits().to_le_bytes());
            }
            hash.update(&bytes);
        }
        Self(hash.digest128())
    }

    /// Of all charts of a layout, with the triangles that name them.
    pub fn of_all(mesh: &TriMesh, layout: &AtlasLayout) -> Vec<Self> {
        let triangles = layout.triangles_by_chart();
        let charts = layout.charts.par_iter().zip(&triangles);
        charts
            .map(|(placed, triangles)| Self::of(mesh, layout, placed, triangles.iter().copied()))
            .collect()
    }

    /// Its bytes.
    pub fn to_le_bytes(self) -> [u8; 16] {
        self.0.to_le_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::{ChartId, TexelRect};
    use nalgebra::Point3;

    fn made() -> (TriMesh, AtlasLayout) {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let positions_m = corners.map(|[x, y]| Point3::new(x, y, 0.0)).to_vec();
        let (mesh, _) = TriMesh::from_soup(positions_m, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let rect = TexelRect {
            x: 0,
            y: 0,
            width: 8,
            height: 8,
        };
        let triangles = mesh.triangle_ids().collect();
        let layout = AtlasLayout {
            page_size_texel: [8; 2],
            num_pages: 1,
            texels_per_m: 4.0,
            charts: vec![PlacedChart::whole_rect(0, rect, 4.0, triangles)],
            chart_of_triangle: vec![ChartId(0); 2],
            corners_texel: vec![[[1.0, 1.0], [5.0, 1.0], [5.0, 5.0]]; 2],
        };
        (mesh, layout)
    }

    #[test]
    fn a_key_is_of_place_and_shape_and_nothing_else() {
        let (mesh, layout) = made();
        let [key] = *ChartKey::of_all(&mesh, &layout) else {
            panic!("a key per chart");
        };
        let is_same =
            |mesh: &TriMesh, layout: &AtlasLayout| ChartKey::of_all(mesh, layout) == [key];
        // Vertices have other numbers, one that nothing names comes first.
        let mut positions_m = vec![Point3::new(9.0, 9.0, 9.0)];
        positions_m.extend_from_slice(mesh.positions_m());
        let shifted = mesh
            .triangles()
            .iter()
            .map(|corners| corners.map(|v| v + 1));
        let (renumbered, _) = TriMesh::from_soup(positions_m, shifted.collect()).unwrap();
        assert!(is_same(&renumbered, &layout));

        let mut positions_m = mesh.positions_m().to_vec();
        positions_m[3].z = 1e-9;
        let (moved, _) = TriMesh::from_soup(positions_m, mesh.triangles().to_vec()).unwrap();
        assert!(!is_same(&moved, &layout));
        let others: [fn(&mut AtlasLayout); 5] = [
            |layout| layout.charts[0].page = 1,
            |layout| layout.charts[0].rect.x = 4,
            |layout| layout.charts[0].rect.height = 4,
            |layout| layout.corners_texel[1][2][1] = 5.000_001,
            |layout| layout.corners_texel[0].rotate_left(1),
        ];
        for (number, change) in others.into_iter().enumerate() {
            let mut other = layout.clone();
            change(&mut other);
            assert!(!is_same(&mesh, &other), "{number}");
        }
    }
}
