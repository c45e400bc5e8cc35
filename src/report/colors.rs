//! Colours of diagrams: scales, and labels that can be told apart.

use crate::atlas::TexelSource;

/// Behind everything that nothing was painted on.
pub const BACKGROUND: [u8; 3] = [32, 34, 38];
/// Texels that are copies of a chart's border.
pub const GUTTER: [u8; 3] = [58, 61, 67];
/// Painted from one keyframe.
pub const KEYFRAME: [u8; 3] = [74, 158, 116];
/// Painted with the mean over frames.
pub const MEAN: [u8; 3] = [86, 140, 204];
/// Spread from neighbours.
pub const DIFFUSED: [u8; 3] = [232, 150, 62];
/// Lines between charts.
pub const SEAM: [u8; 3] = [24, 26, 30];

/// Colour of a kind of source, for coverage pictures.
pub fn of_coverage(source: TexelSource) -> [u8; 3] {
    match source {
        TexelSource::NONE => BACKGROUND,
        TexelSource::GUTTER => GUTTER,
        TexelSource::MEAN => MEAN,
        TexelSource::DIFFUSED => DIFFUSED,
        _ => KEYFRAME,
    }
}

/// Colour of a source, one per keyframe; what is no keyframe is grey.
pub fn of_source(source: TexelSource) -> [u8; 3] {
    match source {
        TexelSource::NONE => BACKGROUND,
        TexelSource::GUTTER => GUTTER,
        TexelSource::MEAN => [150, 153, 158],
        TexelSource::DIFFUSED => [100, 103, 108],
        _ => source.as_keyframe().map_or(BACKGROUND, of_label),
    }
}

/// A colour for a number; neighbours in number are far apart in hue.
pub fn of_label(label: u32) -> [u8; 3] {
    // Steps of the golden ratio never come back to a hue that was used (Ankerl 2009).
    let hue = (f64::from(label) * 0.618_033_988_749_894_9).fract();
    let saturation = [0.42, 0.58, 0.50][(label % 3) as usize];
    let value = [0.93, 0.84, 0.72, 0.98][(label / 3 % 4) as usize];
    srgb_from_hsv(hue, saturation, value)
}

/// A soft colour for a chart.
pub fn of_chart(chart: u32) -> [u8; 3] {
    let hue = (f64::from(chart) * 0.618_033_988_749_894_9).fract();
    srgb_from_hsv(hue, [0.24, 0.34, 0.29][(chart % 3) as usize], 0.95)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "hue, saturation and value are in [0, 1]"
)]
fn srgb_from_hsv(hue: f64, saturation: f64, value: f64) -> [u8; 3] {
    [5.0, 3.0, 1.0].map(|n| {
        let k = (n + hue * 6.0) % 6.0;
        let c = value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0);
        (c * 255.0).round() as u8
    })
}

/// Viridis (van der Walt, Smith 2015) at nine points: dark is low.
const CONFIDENCE_STOPS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// Inferno (van der Walt, Smith 2015) at seven points: black is none.
const DIFFERENCE_STOPS: [[u8; 3]; 7] = [
    [0, 0, 4],
    [50, 10, 94],
    [120, 28, 109],
    [188, 55, 84],
    [237, 105, 37],
    [251, 180, 26],
    [252, 255, 164],
];

/// Colour of a confidence of 0 to 255.
pub fn of_confidence(confidence: u8) -> [u8; 3] {
    interpolate(&CONFIDENCE_STOPS, f32::from(confidence) / 255.0)
}

/// Largest difference that the scale of [`of_difference`] tells apart.
pub const MAX_DIFFERENCE: u8 = 64;

/// Colour of a difference of 0 to [`MAX_DIFFERENCE`]; larger ones look like it.
pub fn of_difference(difference: u8) -> [u8; 3] {
    interpolate(
        &DIFFERENCE_STOPS,
        f32::from(difference) / f32::from(MAX_DIFFERENCE),
    )
}

/// The scale of [`of_confidence`] as CSS stops.
pub(super) fn confidence_gradient() -> String {
    gradient(&CONFIDENCE_STOPS)
}

/// The scale of [`of_difference`] as CSS stops.
pub(super) fn difference_gradient() -> String {
    gradient(&DIFFERENCE_STOPS)
}

fn gradient(stops: &[[u8; 3]]) -> String {
    let stops: Vec<String> = stops.iter().map(|&stop| css(stop)).collect();
    format!("linear-gradient(90deg,{})", stops.join(","))
}

/// A colour as CSS writes it.
pub(super) fn css([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the stops before the casts"
)]
fn interpolate(stops: &[[u8; 3]], t: f32) -> [u8; 3] {
    let last = stops.len() - 1;
    let place = t.clamp(0.0, 1.0) * last as f32;
    let below = (place as usize).min(last.saturating_sub(1));
    let fraction = place - below as f32;
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(stops[below][c]), f32::from(stops[below + 1][c]));
        (a + fraction * (b - a)).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_end_at_their_stops() {
        assert_eq!(of_confidence(0), CONFIDENCE_STOPS[0]);
        assert_eq!(of_confidence(255), CONFIDENCE_STOPS[8]);
        assert_eq!(of_difference(0), DIFFERENCE_STOPS[0]);
        assert_eq!(of_difference(200), DIFFERENCE_STOPS[6]);
    }

    #[test]
    fn hues_are_where_they_belong() {
        assert_eq!(srgb_from_hsv(0.0, 1.0, 1.0), [255, 0, 0]);
        assert_eq!(srgb_from_hsv(1.0 / 3.0, 1.0, 1.0), [0, 255, 0]);
        assert_eq!(srgb_from_hsv(2.0 / 3.0, 1.0, 1.0), [0, 0, 255]);
        assert_eq!(srgb_from_hsv(0.5, 0.0, 0.5), [128; 3]);
    }

    #[test]
    fn neighbouring_labels_differ() {
        for label in 0..300 {
            let (a, b) = (of_label(label), of_label(label + 1));
            let distance: u32 = a.iter().zip(b).map(|(x, y)| u32::from(x.abs_diff(y))).sum();
            assert!(distance > 60, "{label}: {a:?} {b:?}");
        }
    }
}
