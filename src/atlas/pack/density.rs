//! The density at which charts keep to a budget, foreseen from their sizes, so that they need not be
//! packed to find it.
//!
//! A chart of area A and perimeter P, widened by r on all sides, has about A + P·r + π·r² (Steiner's
//! formula, exact for convex shapes). P is taken from the rectangle around the chart; what that
//! misses is corrected by one factor for all, from what the charts are found to need.

use super::PackParams;
use super::shape::ChartFrame;

/// Share of the budget that footprints are to fill.
const WANTED_FILL: f64 = 0.94;
/// What is near enough to it.
const FILL_RANGE: std::ops::RangeInclusive<f64> = 0.925..=0.955;
/// How often [`corrected`] is asked at most.
pub(super) const MAX_CORRECTIONS: usize = 3;

/// Texels that the charts are expected to need.
fn expected_texels(frames: &[ChartFrame], texels_per_m: f64, params: &PackParams) -> f64 {
    // The gutter, and half a cell for rounding to whole ones.
    let reach = f64::from(params.gutter_texel) + 0.5 * f64::from(params.cell_texel());
    let of_frame = |frame: &ChartFrame| {
        let texels_per_m = texels_per_m * frame.scale(texels_per_m, params.room_texel());
        let perimeter_m = 2.0 * (frame.extent_m[0] + frame.extent_m[1]);
        frame.area_m2 * texels_per_m * texels_per_m
            + perimeter_m * texels_per_m * reach
            + std::f64::consts::PI * reach * reach
    };
    frames.iter().map(of_frame).sum()
}

/// The density wanted where it may fit, else the largest at which the charts are expected to fit.
pub(super) fn first_guess(frames: &[ChartFrame], wanted: f64, params: &PackParams) -> f64 {
    let budget = params.max_texels as f64;
    if expected_texels(frames, wanted, params) <= budget {
        return wanted;
    }
    largest_within(frames, wanted, WANTED_FILL * budget, params)
}

/// A better density, given what the charts needed at `texels_per_m`; nothing when that one will do.
pub(super) fn corrected(
    frames: &[ChartFrame],
    wanted: f64,
    texels_per_m: f64,
    num_texels: f64,
    params: &PackParams,
) -> Option<f64> {
    let budget = params.max_texels as f64;
    let fill = num_texels / budget;
    let is_near_enough = if texels_per_m < wanted {
        FILL_RANGE.contains(&fill)
    } else {
        fill <= *FILL_RANGE.end()
    };
    if is_near_enough {
        return None;
    }
    let factor = num_texels / expected_texels(frames, texels_per_m, params).max(1.0);
    let target = WANTED_FILL * budget / factor.max(1e-3);
    Some(largest_within(frames, wanted, target, params))
}

/// The largest density up to the one wanted at which no more than `max_texels` are expected; the
/// least there is when the gutters alone are.
fn largest_within(frames: &[ChartFrame], wanted: f64, max_texels: f64, params: &PackParams) -> f64 {
    // First the power of two: a mesh in the wrong unit may be off by many.
    const MAX_HALVINGS: usize = 200;
    let fits = |texels_per_m: f64| expected_texels(frames, texels_per_m, params) <= max_texels;
    if fits(wanted) {
        return wanted;
    }
    let mut low = 0.5 * wanted;
    for _ in 0..MAX_HALVINGS {
        if fits(low) {
            break;
        }
        low *= 0.5;
    }
    let mut high = 2.0 * low;
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if fits(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}
