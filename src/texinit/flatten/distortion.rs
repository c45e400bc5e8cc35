//! How far a flattening is from the surface.

use nalgebra::Point3;

/// Triangles thinner than this (area over squared perimeter) have no meaningful shape to compare.
const MIN_THICKNESS: f64 = 1e-9;

/// What a triangle that is flattened to a line counts as.
const MAX_QUASI_CONFORMAL: f64 = 1e6;

/// And how much its surface is stretched out of the plane, at most.
const MAX_STRETCH: f64 = 1e6;

/// Distortion of one chart. Means are weighted by area on the surface; triangles of no area are left
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
    /// L² stretch (Sander et al. 2001): root mean square, over the area and both directions, of how
    /// far the map from the plane to the surface stretches lengths, as though flat and surface area
    /// were the same; 1 is isometric, and nothing is less.
    pub stretch_l2: f64,
    /// L∞ stretch (Sander et al. 2001): the most that lengths are stretched anywhere by the map from
    /// the plane to the surface, at the same scale; ≥ 1.
    pub stretch_linf: f64,
}

impl Default for ChartDistortion {
    fn default() -> Self {
        Self {
            quasi_conformal_mean: 1.0,
            quasi_conformal_max: 1.0,
            area_ratio_min: 1.0,
            area_ratio_max: 1.0,
            stretch_l2: 1.0,
            stretch_linf: 1.0,
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
    /// Larger and smaller singular value of the map from the plane to the surface.
    pub(crate) out_of_plane: [f64; 2],
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
    // Singular values of a 2×2 matrix are the sum and difference of these.
    let rigid = 0.5 * (first[0] + second[1]).hypot(first[1] - second[0]);
    let mirrored = 0.5 * (first[0] - second[1]).hypot(first[1] + second[0]);
    let (larger, smaller) = (rigid + mirrored, (rigid - mirrored).abs());
    Some(Stretch {
        area_m2,
        quasi_conformal: (larger / smaller).min(MAX_QUASI_CONFORMAL),
        area_ratio: first[0] * second[1] - first[1] * second[0],
        out_of_plane: [smaller, larger].map(|value| (1.0 / value).min(MAX_STRETCH)),
    })
}

/// Twice the signed area.
pub(crate) fn doubled_area(flat_m: &[[f64; 2]; 3]) -> f64 {
    let [a, b, c] = flat_m;
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Sums over triangles that a distortion is made of; sums of disjoint sets can be added.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DistortionSums {
    area_m2: f64,
    flat_area_m2: f64,
    quasi_conformal: f64,
    quasi_conformal_max: f64,
    area_ratio_min: f64,
    area_ratio_max: f64,
    squared_stretch: f64,
    largest_stretch: f64,
}

impl Default for DistortionSums {
    fn default() -> Self {
        Self {
            area_m2: 0.0,
            flat_area_m2: 0.0,
            quasi_conformal: 0.0,
            quasi_conformal_max: 1.0,
            area_ratio_min: f64::MAX,
            area_ratio_max: 0.0,
            squared_stretch: 0.0,
            largest_stretch: 0.0,
        }
    }
}

impl DistortionSums {
    /// Of some triangles.
    pub(crate) fn of(stretches: impl IntoIterator<Item = Stretch>) -> Self {
        let mut sums = Self::default();
        for stretch in stretches {
            let area = stretch.area_m2;
            let [larger, smaller] = stretch.out_of_plane;
            sums.add(&Self {
                area_m2: area,
                flat_area_m2: area * stretch.area_ratio.abs(),
                quasi_conformal: area * stretch.quasi_conformal,
                quasi_conformal_max: stretch.quasi_conformal,
                area_ratio_min: stretch.area_ratio,
                area_ratio_max: stretch.area_ratio,
                squared_stretch: 0.5 * area * (larger * larger + smaller * smaller),
                largest_stretch: larger,
            });
        }
        sums
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.area_m2 += other.area_m2;
        self.flat_area_m2 += other.flat_area_m2;
        self.quasi_conformal += other.quasi_conformal;
        self.quasi_conformal_max = self.quasi_conformal_max.max(other.quasi_conformal_max);
        self.area_ratio_min = self.area_ratio_min.min(other.area_ratio_min);
        self.area_ratio_max = self.area_ratio_max.max(other.area_ratio_max);
        self.squared_stretch += other.squared_stretch;
        self.largest_stretch = self.largest_stretch.max(other.largest_stretch);
    }

    /// All ones where there is no area.
    pub(crate) fn distortion(&self) -> ChartDistortion {
        if self.area_m2 <= 0.0 {
            return ChartDistortion::default();
        }
        let scale = if self.flat_area_m2 > 0.0 {
            (self.flat_area_m2 / self.area_m2).sqrt()
        } else {
            1.0
        };
        ChartDistortion {
            quasi_conformal_mean: self.quasi_conformal / self.area_m2,
            quasi_conformal_max: self.quasi_conformal_max,
            area_ratio_min: self.area_ratio_min,
            area_ratio_max: self.area_ratio_max,
            stretch_l2: scale * (self.squared_stretch / self.area_m2).sqrt(),
            stretch_linf: scale * self.largest_stretch,
        }
    }
}

/// A chart's distortion from its triangles'.
pub(crate) fn summarize(stretches: &[Stretch]) -> ChartDistortion {
    DistortionSums::of(stretches.iter().copied()).distortion()
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
        let [larger, smaller] = stretch.out_of_plane;
        assert!((larger - 0.5).abs() < 1e-12 && (smaller - 1.0 / 3.0).abs() < 1e-12);
    }

    /// The square [0, 1]² halved along its diagonal, mapped by `flat`.
    fn square(flat: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<Stretch> {
        let halves = [
            [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]],
            [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        ];
        let lifted = |[x, y]: [f64; 2]| Point3::new(0.6 * x, 0.8 * x, y);
        let one = |corners: [[f64; 2]; 3]| stretch(&corners.map(lifted), &corners.map(&flat));
        halves
            .into_iter()
            .map(|corners| one(corners).unwrap())
            .collect()
    }

    #[test]
    fn stretch_norms_are_those_of_a_known_map() {
        // Isometry and similarity: one and the same.
        for scale in [1.0, 7.0, 1e-3] {
            let distortion = summarize(&square(|[x, y]| [-scale * y, scale * x]));
            assert!((distortion.stretch_l2 - 1.0).abs() < 1e-12);
            assert!((distortion.stretch_linf - 1.0).abs() < 1e-12);
        }
        // x doubled: singular values of the way back 1 and ½, flat area 2.
        let doubled = summarize(&square(|[x, y]| [2.0 * x, y]));
        let expected = 2_f64.sqrt() * (0.5_f64 * (1.0 + 0.25)).sqrt();
        assert!((doubled.stretch_l2 - expected).abs() < 1e-12);
        assert!((doubled.stretch_linf - 2_f64.sqrt()).abs() < 1e-12);
        // A shear by s: singular values multiply to 1, their squares add up to 2 + s².
        let shear: f64 = 1.5;
        let sheared = summarize(&square(|[x, y]| [x + shear * y, y]));
        let sum = 2.0 + shear * shear;
        let largest = (0.5 * (sum + (sum * sum - 4.0).sqrt())).sqrt();
        assert!((sheared.stretch_l2 - (0.5 * sum).sqrt()).abs() < 1e-12);
        assert!((sheared.stretch_linf - largest).abs() < 1e-12);
        assert!((sheared.quasi_conformal_max - largest * largest).abs() < 1e-9);
    }

    /// Two charts of different scale: each is isometric up to scale, together they are not.
    #[test]
    fn sums_of_charts_are_taken_at_one_scale() {
        let mut sums = DistortionSums::of(square(|p| p));
        sums.add(&DistortionSums::of(square(|[x, y]| [2.0 * x, 2.0 * y])));
        let together = sums.distortion();
        let scale = 2.5_f64.sqrt();
        let expected = scale * (0.5_f64 * (1.0 + 0.25)).sqrt();
        assert!((together.stretch_l2 - expected).abs() < 1e-12);
        assert!((together.stretch_linf - scale).abs() < 1e-12);
        assert!((together.area_ratio_min - 1.0).abs() < 1e-12);
        assert!((together.area_ratio_max - 4.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_flattened_to_a_line_is_stretched_without_end_but_finite() {
        let line = summarize(&square(|[x, _]| [x, 0.0]));
        assert!(line.stretch_l2.is_finite() && line.quasi_conformal_max == MAX_QUASI_CONFORMAL);
        assert_eq!(
            DistortionSums::default().distortion(),
            ChartDistortion::default()
        );
    }
}
