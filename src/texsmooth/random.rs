//! Seeded draws for the optimisation: a value is a function of (seed, step, purpose), so that a run
//! that goes on from a checkpoint draws what the whole run would have drawn.
//!
//! The mixer is the finaliser of SplitMix64 (Steele, Lea, Flood 2014).

/// What a draw is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    View,
    Partner,
    CropX,
    CropY,
    /// A pixel that the crop shows.
    Pixel,
}

/// The draws of one step.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepDraws {
    seed: u64,
    step: u64,
}

impl StepDraws {
    pub(super) fn new(seed: u64, step: u64) -> Self {
        Self { seed, step }
    }

    /// Draws of the same step, for another attempt at it; attempt 0 draws what there were.
    pub(super) fn again(self, attempt: u64) -> Self {
        let seed = match attempt {
            0 => self.seed,
            _ => mix(self.seed ^ mix(attempt)),
        };
        Self { seed, ..self }
    }

    /// Uniform in `0..num`; 0 for none.
    pub(super) fn below(self, purpose: Purpose, num: usize) -> usize {
        let bits = mix(self.seed ^ mix(self.step.wrapping_mul(16) + purpose as u64));
        let scaled = u128::from(bits) * num as u128;
        #[expect(clippy::cast_possible_truncation, reason = "less than `num`")]
        let drawn = (scaled >> 64) as usize;
        drawn
    }
}

fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_are_even_and_independent_of_order() {
        let mut counts = [0usize; 7];
        for step in 0..7000 {
            counts[StepDraws::new(3, step).below(Purpose::View, 7)] += 1;
        }
        assert!(counts.iter().all(|n| (900..1100).contains(n)), "{counts:?}");
        let draw = |step| StepDraws::new(3, step).below(Purpose::CropX, 1000);
        let forward: Vec<_> = (0..9).map(draw).collect();
        let mut backward: Vec<_> = (0..9).rev().map(draw).collect();
        backward.reverse();
        assert_eq!(forward, backward);
        assert_eq!(StepDraws::new(1, 1).below(Purpose::View, 0), 0);
        let attempt = |n| StepDraws::new(3, 5).again(n).below(Purpose::View, 1 << 40);
        assert_eq!(
            attempt(0),
            StepDraws::new(3, 5).below(Purpose::View, 1 << 40)
        );
        assert!(attempt(0) != attempt(1) && attempt(1) != attempt(2));
    }
}
