//! Seeded randomness without state: a value is a function of (seed, stream name, index).
//!
//! The mixer is the finaliser of SplitMix64 (Steele, Lea, Flood 2014). Because nothing is drawn in
//! sequence, a value does not depend on the order of evaluation nor on the number of threads.

/// A named family of random values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stream(u64);

impl Stream {
    /// The stream `name` of a seed; two names give independent streams.
    pub(super) fn new(seed: u64, name: &str) -> Self {
        // FNV-1a over the name.
        let name_hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
        });
        Self(mix(seed ^ mix(name_hash)))
    }

    /// The sub-stream `index`.
    pub(super) fn sub(self, index: u64) -> Self {
        Self(self.bits(index))
    }

    /// 64 random bits.
    pub(super) fn bits(self, index: u64) -> u64 {
        mix(self.0 ^ mix(index))
    }

    /// Uniform in [0, 1).
    pub(super) fn uniform(self, index: u64) -> f64 {
        (self.bits(index) >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    pub(super) fn range(self, index: u64, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform(index)
    }

    /// Mean 0, standard deviation 1: the sum of eight 16-bit uniforms (Irwin–Hall), which is
    /// normal to 1 % of its density within three deviations and never beyond 4.9.
    pub(super) fn gaussian(self, index: u64) -> f64 {
        let a = self.bits(index.wrapping_mul(2));
        let b = self.bits(index.wrapping_mul(2).wrapping_add(1));
        let lanes = |bits: u64| (0..4).map(move |lane| (bits >> (16 * lane)) & 0xffff);
        let sum: u64 = lanes(a).chain(lanes(b)).sum();
        // A sum of eight uniforms on 0..=65535 has mean 4·65535 and variance 8·(65536² − 1)/12.
        (sum as f64 - 4.0 * 65_535.0) / 53_509.93
    }

    /// Smooth in `time`, mean 0, within [-1, 1], with features one unit of time long.
    pub(super) fn walk(self, time: f64) -> f64 {
        let cell = time.floor();
        let f = time - cell;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a wrapped lattice index is as good as any"
        )]
        let cell = cell as i64 as u64;
        let at = |i: u64| 2.0 * self.uniform(i) - 1.0;
        let w = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
        at(cell) + w * (at(cell.wrapping_add(1)) - at(cell))
    }
}

/// Finaliser of SplitMix64: a bijection of 64 bits with full avalanche.
pub(super) fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Gradientless lattice ("value") noise in [-1, 1] with quintic interpolation; features are one
/// unit wide in both coordinates.
pub(super) fn lattice_noise([x, y]: [f64; 2], salt: u32) -> f32 {
    let (cell_x, cell_y) = (x.floor(), y.floor());
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a wrapped lattice index is as good as any"
    )]
    let (i, j) = (cell_x as i64 as u32, cell_y as i64 as u32);
    #[expect(clippy::cast_possible_truncation, reason = "fractions in [0, 1)")]
    let (fx, fy) = ((x - cell_x) as f32, (y - cell_y) as f32);
    let quintic = |f: f32| f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let (wx, wy) = (quintic(fx), quintic(fy));
    let (i1, j1) = (i.wrapping_add(1), j.wrapping_add(1));
    let top = lattice_value(i, j, salt);
    let top = top + wx * (lattice_value(i1, j, salt) - top);
    let bottom = lattice_value(i, j1, salt);
    let bottom = bottom + wx * (lattice_value(i1, j1, salt) - bottom);
    top + wy * (bottom - top)
}

/// Random value in [-1, 1] of a lattice cell.
pub(super) fn lattice_value(i: u32, j: u32, salt: u32) -> f32 {
    let mut h = i
        .wrapping_mul(0x9e37_79b1)
        .wrapping_add(j.wrapping_mul(0x85eb_ca77))
        ^ salt;
    h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
    h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    h ^= h >> 16;
    (h >> 8) as f32 * (2.0 / 16_777_215.0) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussian_has_unit_moments() {
        let stream = Stream::new(7, "test");
        let n = 100_000u64;
        let values: Vec<f64> = (0..n).map(|i| stream.gaussian(i)).collect();
        let mean = values.iter().sum::<f64>() / n as f64;
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n as f64;
        assert!(mean.abs() < 0.01, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.02, "variance {variance}");
        let lag = values.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n as f64;
        assert!(lag.abs() < 0.02, "correlation of neighbours {lag}");
    }

    #[test]
    fn streams_differ_by_name_and_seed() {
        let a = Stream::new(1, "pose");
        assert_ne!(a.bits(0), Stream::new(2, "pose").bits(0));
        assert_ne!(a.bits(0), Stream::new(1, "depth").bits(0));
        assert_eq!(a.bits(5), Stream::new(1, "pose").bits(5));
    }

    #[test]
    fn lattice_noise_is_continuous_across_cells() {
        for k in 0..50 {
            let y = f64::from(k) * 0.37 - 5.0;
            let before = lattice_noise([3.0 - 1e-9, y], 9);
            let after = lattice_noise([3.0 + 1e-9, y], 9);
            assert!((before - after).abs() < 1e-6);
            assert!(after.abs() <= 1.0);
        }
    }
}
