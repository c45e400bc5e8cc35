//! What a frame's sharpness and exposure are worth, against those of the other frames.

use crate::keyframe::FrameQuality;

use super::AssignParams;

/// Steps of sharpness in an octave that [`TypicalQuality::in_steps`] keeps.
const SHARPNESS_STEPS: f32 = 4.0;
/// Steps of luma between black and white that [`TypicalQuality::in_steps`] keeps.
const LUMA_STEPS: f32 = 64.0;

/// The median frame, figure by figure.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub(crate) struct TypicalQuality {
    sharpness: f32,
    mean_luma: f32,
}

impl TypicalQuality {
    pub(crate) fn of<'a>(frames: impl Iterator<Item = &'a FrameQuality> + Clone) -> Self {
        let median = |value: fn(&FrameQuality) -> f32| {
            let mut values: Vec<f32> = frames.clone().map(value).collect();
            values.sort_by(f32::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0)
        };
        Self {
            sharpness: median(|quality| quality.sharpness),
            mean_luma: median(|quality| quality.mean_luma),
        }
    }

    /// The same in steps, so that a frame more or less seldom changes it.
    pub(crate) fn in_steps(self) -> Self {
        let sharpness = if self.sharpness > 0.0 {
            ((SHARPNESS_STEPS * self.sharpness.log2()).round() / SHARPNESS_STEPS).exp2()
        } else {
            self.sharpness
        };
        Self {
            sharpness,
            mean_luma: (LUMA_STEPS * self.mean_luma).round() / LUMA_STEPS,
        }
    }

    /// What a frame's sharpness and exposure take off all its scores, ≤ 0.
    pub(crate) fn score(self, frame: &FrameQuality, params: &AssignParams) -> f32 {
        let FrameQuality {
            sharpness,
            mean_luma,
            clipped,
        } = *frame;
        let halvings = if self.sharpness > 0.0 && sharpness > 0.0 {
            (self.sharpness / sharpness).log2().clamp(0.0, 4.0)
        } else {
            0.0
        };
        let exposure = (mean_luma - self.mean_luma).abs() + clipped;
        let exposure = if exposure.is_finite() { exposure } else { 0.0 };
        -params.sharpness_weight * halvings - params.exposure_weight * exposure
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quality(sharpness: f32, mean_luma: f32) -> FrameQuality {
        FrameQuality {
            sharpness,
            mean_luma,
            clipped: 0.0,
        }
    }

    #[test]
    fn the_typical_frame_is_the_median_and_steps_stay_near_it() {
        let frames = [quality(1.0, 0.4), quality(8.0, 0.9), quality(2.1, 0.51)];
        let typical = TypicalQuality::of(frames.iter());
        assert_eq!((typical.sharpness, typical.mean_luma), (2.1, 0.51));
        let stepped = typical.in_steps();
        assert!((stepped.sharpness - 2.0).abs() < 1e-6);
        assert!((stepped.mean_luma - 33.0 / 64.0).abs() < 1e-6);
        assert_eq!(stepped.in_steps().mean_luma, stepped.mean_luma);
        let none = TypicalQuality::of([].iter()).in_steps();
        assert_eq!(none, TypicalQuality::default());
    }

    #[test]
    fn half_as_sharp_costs_a_weight() {
        let params = AssignParams::default();
        let typical = TypicalQuality::of([quality(2.0, 0.5)].iter());
        let score = |sharpness| typical.score(&quality(sharpness, 0.5), &params);
        assert_eq!(score(2.0), 0.0);
        assert_eq!(score(4.0), 0.0);
        assert!((score(1.0) + params.sharpness_weight).abs() < 1e-6);
    }
}
