//! The losses of many steps, for people: a running mean, and means by stretches of the run.

use super::adv_optim::StepLosses;

/// Losses smoothed for people: over about a hundred steps, and by stretches of the run.
pub(super) struct RunningMeans {
    pub(super) recent: StepLosses,
    num: usize,
    stretch: usize,
    sum: [f64; 4],
    num_in_stretch: usize,
    curve: Vec<(usize, StepLosses)>,
    last: usize,
}

impl RunningMeans {
    pub(super) fn new(num_steps: usize) -> Self {
        Self {
            recent: StepLosses::default(),
            num: 0,
            stretch: num_steps.div_ceil(100).max(1),
            sum: [0.0; 4],
            num_in_stretch: 0,
            curve: Vec::new(),
            last: 0,
        }
    }

    pub(super) fn add(&mut self, num_done: usize, losses: &StepLosses) {
        self.num += 1;
        let share = 1.0 / self.num.min(100) as f32;
        let blend = |old: f32, new: f32| old + share * (new - old);
        self.recent = StepLosses {
            l1: blend(self.recent.l1, losses.l1),
            adversarial: blend(self.recent.adversarial, losses.adversarial),
            real: blend(self.recent.real, losses.real),
            fake: blend(self.recent.fake, losses.fake),
            has_critic_stepped: losses.has_critic_stepped,
        };
        let values = [losses.l1, losses.adversarial, losses.real, losses.fake];
        for (sum, value) in self.sum.iter_mut().zip(values) {
            *sum += f64::from(value);
        }
        self.num_in_stretch += 1;
        self.last = num_done;
        if num_done.is_multiple_of(self.stretch) {
            self.end_stretch();
        }
    }

    fn end_stretch(&mut self) {
        if self.num_in_stretch == 0 {
            return;
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let [l1, adversarial, real, fake] = self
            .sum
            .map(|sum| (sum / self.num_in_stretch as f64) as f32);
        self.curve.push((
            self.last,
            StepLosses {
                l1,
                adversarial,
                real,
                fake,
                has_critic_stepped: false,
            },
        ));
        self.sum = [0.0; 4];
        self.num_in_stretch = 0;
    }

    pub(super) fn curve(mut self) -> Vec<(usize, StepLosses)> {
        self.end_stretch();
        self.curve
    }
}
