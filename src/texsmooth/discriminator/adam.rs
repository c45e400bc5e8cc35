//! Adam (Kingma and Ba 2015) on a layer's weights.

use rayon::prelude::*;

/// Numbers stepped together on a thread.
const CHUNK: usize = 16_384;
const EPSILON: f32 = 1e-8;

/// First and second moments of some numbers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Moments {
    pub(super) first: Vec<f32>,
    pub(super) second: Vec<f32>,
}

/// A step's settings and the corrections of bias at its number, counted from 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct AdamStep {
    learning_rate: f32,
    betas: [f32; 2],
    corrections: [f32; 2],
}

impl AdamStep {
    pub(super) fn new(learning_rate: f32, betas: [f32; 2], number: u64) -> Self {
        let number = i32::try_from(number).unwrap_or(i32::MAX);
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let correction = |beta: f32| (1.0 - f64::from(beta).powi(number)) as f32;
        Self {
            learning_rate,
            betas,
            corrections: betas.map(correction),
        }
    }

    /// Steps along a gradient; `None` stands for zeros.
    pub(super) fn apply(
        &self,
        values: &mut [f32],
        moments: &mut Moments,
        gradient: Option<&[f32]>,
    ) {
        values
            .par_chunks_mut(CHUNK)
            .zip(moments.first.par_chunks_mut(CHUNK))
            .zip(moments.second.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(chunk, ((values, first), second))| {
                let moved = values.iter_mut().zip(first).zip(second);
                if let Some(gradient) = gradient {
                    for (((value, first), second), g) in moved.zip(&gradient[chunk * CHUNK..]) {
                        self.step(value, first, second, *g);
                    }
                } else {
                    for ((value, first), second) in moved {
                        self.step(value, first, second, 0.0);
                    }
                }
            });
    }

    #[inline]
    fn step(&self, value: &mut f32, first: &mut f32, second: &mut f32, g: f32) {
        let [beta1, beta2] = self.betas;
        *first = beta1 * *first + (1.0 - beta1) * g;
        *second = beta2 * *second + (1.0 - beta2) * g * g;
        let size = (*second / self.corrections[1]).sqrt() + EPSILON;
        *value -= self.learning_rate * (*first / self.corrections[0]) / size;
    }
}

impl Moments {
    pub(super) fn new(num: usize) -> Self {
        Self {
            first: vec![0.0; num],
            second: vec![0.0; num],
        }
    }
}
