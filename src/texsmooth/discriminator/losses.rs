//! Masked means of the logistic loss, and their gradients.

/// Which side of the sigmoid a loss is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// −log D = log(1 + e^−z).
    Real,
    /// −log(1 − D) = log(1 + e^z).
    Fake,
}

/// The mean loss of logits over the places that count; 0 where none does.
pub(super) fn mean_loss(logits: &[f32], counts: &[f32], side: Side) -> f32 {
    let (mut sum, mut total) = (0.0f64, 0.0f64);
    for (&logit, &count) in logits.iter().zip(counts) {
        let z = f64::from(signed(logit, side));
        // log(1 + e^z) without overflow.
        sum += f64::from(count) * (z.max(0.0) + (-z.abs()).exp().ln_1p());
        total += f64::from(count);
    }
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let mean = (sum / total) as f32;
    if total > 0.0 { mean } else { 0.0 }
}

/// How many places count.
pub(super) fn total(counts: &[f32]) -> f32 {
    counts.iter().sum()
}

/// The gradient of [`mean_loss`] by some of the logits, with `total` places that count.
pub(super) fn gradient(logits: &[f32], counts: &[f32], total: f32, side: Side, out: &mut [f32]) {
    let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
    for ((out, &logit), &count) in out.iter_mut().zip(logits).zip(counts) {
        let sigmoid = 1.0 / (1.0 + (-signed(logit, side)).exp());
        let slope = match side {
            Side::Real => -sigmoid,
            Side::Fake => sigmoid,
        };
        *out = count * scale * slope;
    }
}

fn signed(logit: f32, side: Side) -> f32 {
    match side {
        Side::Real => -logit,
        Side::Fake => logit,
    }
}
