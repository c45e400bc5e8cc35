//! How far a flattening is from the surface.

use nalgebra::Point3;

/// Triangles thinner than this (area over squared perimeter) have no meaningful shape to compare.
const MIN_THICKNESS: f64 = 1e-9;

/// What a triangle that is flattened to a line counts as.
const MAX_QUASI_CONFORMAL: f64 = 1e6;

/// Stretch of one chart. Means are weighted by area on the surface; triangles of no area are left
/// out; a chart of such triangles alone has all ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChartDistortion {
    /// Mean over the area of the ratio of a triangle's larger to its smaller stretch; 1 is
    /// conformal.
    pub quasi_conformal_mean: f64,
    /// The largest such ratio.
    pub quasi_conformal_max: f64,
    /// The least ratio of a triangle's flat area to its area on the surface.
    pub area_ratio_min: f64,
    /// The largest such ratio.
    pub area_ratio_max: f64,
}

impl Default for ChartDistortion {
    fn default() -> Self {
        Self {
            quasi_conformal_mean: 1.0,
            quasi_conformal_max: 1.0,
            area_ratio_min: 1.0,
            area_ratio_max: 1.0,
        }
    }
}

/// The distortion of one triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stretch {
    /// m² on the surface.
    pub(crate) area_m2: f64,
    /// Larger over smaller singular value of the map.
    pub(crate) quasi_conformal: f64,
    /// Flat area over surface area; negative when flipped.
    pub(crate) area_ratio: f64,
}

/// None when the triangle has no area.
pub(crate) fn stretch(corners_m: &[Point3<f64>; 3], flat_m: &[[f64; 2]; 3]) -> Option<Stretch> {
    let [a, b, c] = corners_m;
    let (along, other) = (b - a, c - a);
    let perimeter = along.norm() + other.norm() + (c - b).norm();
    let area_m2 = 0.5 * along.cross(&other).norm();
    if !area_m2.is_normal() || area_m2 <= MIN_THICKNESS * perimeter * perimeter {
        return None;
    }
    let length = along.norm();
    let [x, y] = [along.dot(&other) / length, 2.0 * area_m2 / length];
    let edge = |k: usize| [flat_m[k][0] - flat_m[0][0], flat_m[k][1] - flat_m[0][1]];
    let first = edge(1).map(|e| e / length);
    let second = [0, 1].map(|i| (edge(2)[i] - first[i] * x) / y);
    // Singular values of a 2×2 matrix are half the sum and difference of these.
    let rigid = (first[0] + second[1]).hypot(first[1] - second[0]);
    let mirrored = (first[0] - second[1]).hypot(first[1] + second[0]);
    let (larger, smaller) = (rigid + mirrored, (rigid - mirrored).abs());
    Some(Stretch {
        area_m2,
        quasi_conformal: (larger / smaller).min(MAX_QUASI_CONFORMAL),
        area_ratio: first[0] * second[1] - first[1] * second[0],
    })
}

/// Twice the signed area.
pub(crate) fn doubled_area(flat_m: &[[f64; 2]; 3]) -> f64 {
    let [a, b, c] = flat_m;
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// A chart's distortion from its triangles'.
pub(crate) fn summarize(stretches: &[Stretch]) -> ChartDistortion {
    let mut summary = ChartDistortion {
        area_ratio_min: f64::MAX,
        area_ratio_max: 0.0,
        ..Default::default()
    };
    let (mut area, mut weighted) = (0.0, 0.0);
    for stretch in stretches {
        area += stretch.area_m2;
        weighted += stretch.area_m2 * stretch.quasi_conformal;
        summary.quasi_conformal_max = summary.quasi_conformal_max.max(stretch.quasi_conformal);
        summary.area_ratio_min = summary.area_ratio_min.min(stretch.area_ratio);
        summary.area_ratio_max = summary.area_ratio_max.max(stretch.area_ratio);
    }
    if stretches.is_empty() {
        return ChartDistortion::default();
    }
    summary.quasi_conformal_mean = weighted / area;
    summary
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_stretch_is_measured() {
        let corners = [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [1.0, 1.0, 1.0]].map(Point3::from);
        let flat = [[0.0, 0.0], [0.0, 6.0], [-2.0, 3.0]];
        let stretch = stretch(&corners, &flat).unwrap();
        assert!((stretch.quasi_conformal - 1.5).abs() < 1e-12);
        assert!((stretch.area_ratio - 6.0).abs() < 1e-12);
        assert!((stretch.area_m2 - 1.0).abs() < 1e-12);
    }
}
