//! How many texels the mesh gets: one density for all of it, taken from the images, or the paper's
//! plates.
//!
//! A texel should be about as large as the best pixel that sees it. One density for all charts
//! keeps the texture evenly sharp and its seams free of jumps in resolution; the paper's plates,
//! each scaled to fill its square, spread over three orders of magnitude (method, 1.3).

use crate::mesh::TriMesh;

/// What decides how many texels there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum SizeRule {
    /// One density for all charts, taken from the images and lowered to the budget.
    #[default]
    Density,
    /// Square plates of a side that goes by the images' size, each filled by itself.
    Paper,
}

/// Side of a plate for images whose longer side is `longer_side_px` (the paper's supplement gives it
/// for 480, 960 and 1920 pixels); what lies between gets the plate of the next larger one.
pub fn paper_plate_texel(longer_side_px: u32) -> u32 {
    match longer_side_px {
        0..=480 => 512,
        481..=960 => 1024,
        _ => 2048,
    }
}

/// How dense texels lie on the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensityParams {
    /// Texels per metre; 0 takes them from the images.
    pub texels_per_m: f64,
    /// Share of the seen area whose best pixels are no smaller than a texel, [0, 1]; the rest
    /// loses some detail.
    pub area_quantile: f64,
    /// Never more texels per metre than this.
    pub max_texels_per_m: f64,
}

impl Default for DensityParams {
    fn default() -> Self {
        Self {
            texels_per_m: 0.0,
            area_quantile: 0.8,
            max_texels_per_m: 4000.0,
        }
    }
}

/// Density of a mesh that no frame sees: a texel per centimetre shows its (filled) colour.
const UNSEEN_TEXELS_PER_M: f64 = 100.0;

/// The density that the images ask for, before any budget, texels per metre.
///
/// `best_texels_per_m` has, per triangle, the resolution of its best view; 0 where unseen.
pub fn wanted_texels_per_m(
    mesh: &TriMesh,
    best_texels_per_m: &[f32],
    params: &DensityParams,
) -> f64 {
    if params.texels_per_m > 0.0 {
        return params.texels_per_m;
    }
    let mut seen: Vec<(f32, f64)> = mesh
        .triangle_ids()
        .zip(best_texels_per_m)
        .filter(|(_, density)| density.is_finite() && **density > 0.0)
        .map(|(triangle, density)| (*density, mesh.area_m2(triangle)))
        .collect();
    seen.sort_by(|a, b| a.0.total_cmp(&b.0));
    let seen_area_m2: f64 = seen.iter().map(|(_, area)| area).sum();
    let mut area_m2 = 0.0;
    for (density, area) in &seen {
        area_m2 += area;
        if area_m2 >= params.area_quantile * seen_area_m2 {
            return f64::from(*density).clamp(1.0, params.max_texels_per_m);
        }
    }
    UNSEEN_TEXELS_PER_M.min(params.max_texels_per_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn two_triangles() -> TriMesh {
        // The second has three times the area of the first.
        let positions = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [3.0, 0.0]]
            .map(|[x, y]| Point3::new(x, y, 0.0))
            .to_vec();
        TriMesh::from_soup(positions, vec![[0, 1, 2], [0, 3, 2]])
            .unwrap()
            .0
    }

    #[test]
    fn the_quantile_is_weighted_by_area() {
        let mesh = two_triangles();
        let quantile = |area_quantile| {
            let params = DensityParams {
                area_quantile,
                ..DensityParams::default()
            };
            wanted_texels_per_m(&mesh, &[100.0, 300.0], &params)
        };
        assert_eq!(quantile(0.2), 100.0);
        assert_eq!(quantile(0.3), 300.0);
        assert_eq!(quantile(1.0), 300.0);
    }

    #[test]
    fn plates_are_those_of_the_paper() {
        assert_eq!([480, 960, 1920].map(paper_plate_texel), [512, 1024, 2048]);
        assert_eq!([0, 640, 1440].map(paper_plate_texel), [512, 1024, 2048]);
    }

    #[test]
    fn unseen_meshes_and_fixed_densities_have_one_too() {
        let mesh = two_triangles();
        let auto = DensityParams::default();
        assert_eq!(wanted_texels_per_m(&mesh, &[0.0, f32::NAN], &auto), 100.0);
        let fixed = DensityParams {
            texels_per_m: 250.0,
            ..auto
        };
        assert_eq!(wanted_texels_per_m(&mesh, &[100.0, 300.0], &fixed), 250.0);
    }
}
