//! A byte rate kept: a token bucket without a clock of its own.

use std::time::{Duration, Instant};

/// Seconds of the rate that may go out at once after a silence.
const BURST_S: f64 = 0.1;

/// Says when the next bytes may go.
#[derive(Clone, Debug)]
pub struct Pacer {
    bytes_per_s: f64,
    /// Bytes that may go now; below zero after a message larger than the burst.
    allowance: f64,
    last: Instant,
}

impl Pacer {
    /// A full bucket.
    pub fn new(bytes_per_s: f64, now: Instant) -> Self {
        Self {
            bytes_per_s,
            allowance: bytes_per_s * BURST_S,
            last: now,
        }
    }

    /// From now on another rate.
    pub fn set_rate(&mut self, bytes_per_s: f64, now: Instant) {
        self.refill(now);
        self.bytes_per_s = bytes_per_s;
    }

    /// How long to wait until something may go; zero: now.
    pub fn delay(&mut self, now: Instant) -> Duration {
        self.refill(now);
        if self.allowance >= 0.0 {
            return Duration::ZERO;
        }
        Duration::from_secs_f64((-self.allowance / self.bytes_per_s).min(60.0))
    }

    /// Something went.
    pub fn spend(&mut self, num_bytes: usize) {
        self.allowance -= num_bytes as f64;
    }

    fn refill(&mut self, now: Instant) {
        let elapsed_s = now.saturating_duration_since(self.last).as_secs_f64();
        self.last = self.last.max(now);
        let most = self.bytes_per_s * BURST_S;
        self.allowance = (self.allowance + elapsed_s * self.bytes_per_s).min(most);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_kept_whatever_the_size_of_messages() {
        for num_bytes in [100, 10_000, 190_000] {
            let begun = Instant::now();
            let mut now = begun;
            let mut pacer = Pacer::new(1e6, now);
            let mut num_sent = 0;
            while now < begun + Duration::from_secs(5) {
                let delay = pacer.delay(now);
                if delay.is_zero() {
                    pacer.spend(num_bytes);
                    num_sent += num_bytes;
                } else {
                    now += delay;
                }
            }
            let rate = num_sent as f64 / 5.0;
            assert!((0.95e6..1.1e6).contains(&rate), "{num_bytes}: {rate}");
        }
    }

    #[test]
    fn silence_does_not_save_up_more_than_the_burst() {
        let begun = Instant::now();
        let mut pacer = Pacer::new(1e6, begun);
        let later = begun + Duration::from_secs(1000);
        let mut num_sent = 0;
        while pacer.delay(later).is_zero() {
            pacer.spend(1000);
            num_sent += 1000;
        }
        assert!(num_sent <= 101_000, "{num_sent}");
    }
}
