//! Whether a flattening is good enough, and which triangles are to blame where it is not.

use nalgebra::Point3;

use super::distortion::{Stretch, doubled_area};
use super::{ChartMode, FlattenParams};

/// Area-weighted share of a chart at each end that the stretch bound ignores.
const STRETCH_TAIL: f64 = 0.01;

/// A triangle with less of its area than this is flipped or crushed and leaves its chart.
const MIN_AREA_RATIO: f64 = 0.02;

/// So does one with a larger quasi-conformal error.
const MAX_KEPT_DILATATION: f64 = 20.0;

/// Why a flattening is not taken; the last two with the triangles to blame.
pub(crate) enum Rejected {
    NotADisk,
    Solver,
    Flipped(Vec<bool>),
    Distorted(Vec<bool>),
}

/// Scales the chart so that its flat area is its area on the surface.
pub(crate) fn scale_to_area(
    surface: &[[Point3<f64>; 3]],
    corners_m: &mut [[[f64; 2]; 3]],
) -> Option<()> {
    let area: f64 = surface
        .iter()
        .map(|[a, b, c]| (b - a).cross(&(c - a)).norm())
        .sum();
    let flat: f64 = corners_m.iter().map(doubled_area).sum();
    // A chart of no area keeps its lengths.
    let scale = if area > 0.0 {
        (area / flat).sqrt()
    } else {
        1.0
    };
    if !scale.is_finite() {
        return None;
    }
    for coordinate in corners_m.iter_mut().flatten().flatten() {
        *coordinate *= scale;
    }
    Some(())
}

/// Whether the flattening is good enough. Whole components are taken as they come.
pub(crate) fn judge(stretches: &[Option<Stretch>], params: &FlattenParams) -> Result<(), Rejected> {
    if params.mode == ChartMode::Paper {
        return Ok(());
    }
    let limit2 = params.max_stretch * params.max_stretch;
    let blame = |is_bad: &dyn Fn(&Stretch) -> bool| {
        let blamed = stretches.iter().map(|s| s.as_ref().is_some_and(is_bad));
        blamed.collect::<Vec<bool>>()
    };
    let is_out = |s: &Stretch| s.area_ratio * limit2 < 1.0 || s.area_ratio > limit2;
    let mut known: Vec<&Stretch> = stretches.iter().flatten().collect();
    let area: f64 = known.iter().map(|s| s.area_m2).sum();
    let flipped: f64 = known
        .iter()
        .filter(|s| s.area_ratio <= 0.0)
        .map(|s| s.area_m2)
        .sum();
    if flipped > params.max_flipped_share * area {
        return Err(Rejected::Flipped(blame(&is_out)));
    }
    let dilatation: f64 = known
        .iter()
        .map(|s| s.area_m2 * s.quasi_conformal.min(10.0))
        .sum();
    if dilatation > params.max_quasi_conformal_mean * area {
        let limit = params.max_quasi_conformal_mean;
        return Err(Rejected::Distorted(blame(&|s| s.quasi_conformal > limit)));
    }
    known.sort_by(|a, b| a.area_ratio.total_cmp(&b.area_ratio));
    let ratios: Vec<(f64, f64)> = known.iter().map(|s| (s.area_ratio, s.area_m2)).collect();
    let low = past_tail(ratios.iter(), area);
    let high = past_tail(ratios.iter().rev(), area);
    if low * limit2 < 1.0 || high > limit2 {
        return Err(Rejected::Distorted(blame(&is_out)));
    }
    Ok(())
}

/// The first ratio beyond the tail of the area, in the order given as (ratio, area).
fn past_tail<'a>(ratios: impl Iterator<Item = &'a (f64, f64)>, area: f64) -> f64 {
    let mut passed = 0.0;
    for (ratio, own) in ratios {
        passed += own;
        if passed > STRETCH_TAIL * area {
            return *ratio;
        }
    }
    1.0
}

/// Whether a triangle is flipped or crushed, so that it must leave its chart.
pub(crate) fn is_crushed(corners_m: &[[f64; 2]; 3], stretch: Option<&Stretch>) -> bool {
    match stretch {
        Some(s) => s.area_ratio < MIN_AREA_RATIO || s.quasi_conformal > MAX_KEPT_DILATATION,
        None => doubled_area(corners_m) < 0.0,
    }
}
