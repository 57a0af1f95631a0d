//! Exponential back-off with jitter.

use std::time::Duration;

/// Bounds of a back-off, which doubles after every failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waits {
    /// Back-off after the first failure.
    pub first: Duration,
    pub longest: Duration,
}

/// Number of failures in a row, and the resulting back-off.
#[derive(Clone, Debug)]
pub struct Backoff {
    waits: Waits,
    failures: u32,
    random: u64,
}

impl Waits {
    /// Back-off of one second up to a minute, for calls between machines.
    pub const USUAL: Waits =
        Waits { first: Duration::from_secs(1), longest: Duration::from_secs(60) };

    /// Returns the back-off after the `failures`-th failure in a row. `random` is uniform over
    /// `u32` and shortens the back-off by up to half, so that clients that failed together do not
    /// retry together. A `random` of 0 shortens nothing.
    pub fn after(self, failures: u32, random: u32) -> Duration {
        let doublings = failures.saturating_sub(1).min(16);
        let full = self.first.saturating_mul(1 << doublings).min(self.longest);
        let share = f64::from(random) / f64::from(u32::MAX);
        full.mul_f64(1.0 - share / 2.0)
    }
}

impl Backoff {
    /// Starts without failures; the jitter is seeded with `seed`.
    pub fn new(waits: Waits, seed: u64) -> Self {
        Self { waits, failures: 0, random: seed }
    }

    pub fn failures(&self) -> u32 {
        self.failures
    }

    pub fn next_wait(&mut self) -> Duration {
        self.failures = self.failures.saturating_add(1);
        let random = (self.draw() >> 32) as u32;
        self.waits.after(self.failures, random)
    }

    pub fn reset(&mut self) {
        self.failures = 0;
    }

    /// SplitMix64 (Steele, Lea and Flood, 2014).
    fn draw(&mut self) -> u64 {
        self.random = self.random.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.random ^ (self.random >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_backoff_doubles_up_to_a_minute_and_restarts_after_a_success() {
        for seed in 0..200 {
            let mut backoff = Backoff::new(Waits::USUAL, seed);
            for expected in [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0, 60.0] {
                let wait = backoff.next_wait().as_secs_f64();
                assert!((0.5 * expected..=expected).contains(&wait), "seed {seed}");
            }
            assert_eq!(backoff.failures(), 9);
            backoff.reset();
            assert!(backoff.next_wait() <= Waits::USUAL.first);
        }
    }

    #[test]
    fn clients_that_failed_together_retry_at_different_times() {
        let waits = [1, 2].map(|seed| Backoff::new(Waits::USUAL, seed).next_wait());
        assert_ne!(waits[0], waits[1]);
    }

    #[test]
    fn without_jitter_the_backoff_has_its_full_length() {
        assert_eq!(Waits::USUAL.after(3, 0), Duration::from_secs(4));
        assert_eq!(Waits::USUAL.after(u32::MAX, 0), Duration::from_secs(60));
    }
}
