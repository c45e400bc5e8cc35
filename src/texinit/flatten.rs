//! Charts in the plane.

use crate::mesh::TriangleId;

/// How far a chart's flattening is from an isometry.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ChartDistortion {
    /// Mean over triangles of the ratio of singular values, ≥ 1.
    pub quasi_conformal_mean: f64,
    /// Largest ratio.
    pub quasi_conformal_max: f64,
    /// Smallest ratio of flat to surface area.
    pub area_ratio_min: f64,
    /// Largest ratio of flat to surface area.
    pub area_ratio_max: f64,
}

/// A connected set of triangles laid out in the plane.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatChart {
    /// Its triangles.
    pub triangles: Vec<TriangleId>,
    /// Per triangle of `triangles`: its corners, metres, y up, counter-clockwise.
    pub corners_m: Vec<[[f64; 2]; 3]>,
    /// How far from an isometry it is.
    pub distortion: ChartDistortion,
}
