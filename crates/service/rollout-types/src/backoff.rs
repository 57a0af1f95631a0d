//! Waiting times before something that failed is tried again: longer after
//! every failure in a row, and not in step with others.

use std::time::Duration;

/// The waits between two attempts at something: doubled after every failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waits {
    /// Wait after the first failure.
    pub first: Duration,
    /// Wait after many failures.
    pub longest: Duration,
}

/// Failures in a row, and how long to wait after the next one.
#[derive(Clone, Debug)]
pub struct Backoff {
    waits: Waits,
    failures: u32,
    random: u64,
}

impl Waits {
    /// Waits of one second to a minute: for machines that call one another.
    pub const USUAL: Waits = Waits {
        first: Duration::from_secs(1),
        longest: Duration::from_secs(60),
    };

    /// The wait after the `failures`-th failure in a row. `random` is spread
    /// over all its values; it takes off up to half, so that what failed
    /// together does not come back together. Nought takes off nothing.
    pub fn after(self, failures: u32, random: u32) -> Duration {
        let doublings = failures.saturating_sub(1).min(16);
        let full = self.first.saturating_mul(1 << doublings).min(self.longest);
        let share = f64::from(random) / f64::from(u32::MAX);
        full.mul_f64(1.0 - share / 2.0)
    }
}

impl Backoff {
    /// No failures yet; jitter that follows from `seed`.
    pub fn new(waits: Waits, seed: u64) -> Self {
        Self {
            waits,
            failures: 0,
            random: seed,
        }
    }

    /// Failures in a row so far.
    pub fn failures(&self) -> u32 {
        self.failures
    }

    /// Counts a failure and says how long to wait after it.
    pub fn next_wait(&mut self) -> Duration {
        self.failures = self.failures.saturating_add(1);
        let random = (self.draw() >> 32) as u32;
        self.waits.after(self.failures, random)
    }

    /// Forgets the failures, after a success.
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
    fn waits_double_up_to_a_minute_and_start_again_after_a_success() {
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
    fn two_that_failed_together_do_not_wait_in_step() {
        let waits = [1, 2].map(|seed| Backoff::new(Waits::USUAL, seed).next_wait());
        assert_ne!(waits[0], waits[1]);
    }

    #[test]
    fn without_chance_the_waits_are_whole() {
        assert_eq!(Waits::USUAL.after(3, 0), Duration::from_secs(4));
        assert_eq!(Waits::USUAL.after(u32::MAX, 0), Duration::from_secs(60));
    }
}
