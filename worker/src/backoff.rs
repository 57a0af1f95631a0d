//! Waiting longer after every failure, with jitter, so that many workers do not
//! knock in step.

use std::time::Duration;

/// The first wait.
pub const FIRST_WAIT: Duration = Duration::from_secs(1);
/// The longest wait.
pub const LONGEST_WAIT: Duration = Duration::from_secs(60);

/// Waits of 1, 2, 4, … 60 s, each shortened by up to a quarter.
#[derive(Clone, Debug)]
pub struct Backoff {
    failures: u32,
    random: u64,
}

impl Backoff {
    /// The waits that follow from `seed`.
    pub fn new(seed: u64) -> Self {
        Self {
            failures: 0,
            random: seed,
        }
    }

    /// How often in a row something has failed.
    pub fn failures(&self) -> u32 {
        self.failures
    }

    /// Counts a failure and says how long to wait after it.
    pub fn next_wait(&mut self) -> Duration {
        let doubled = FIRST_WAIT.saturating_mul(1 << self.failures.min(16));
        self.failures = self.failures.saturating_add(1);
        let jitter = (self.draw() >> 40) as f64 / (1_u64 << 24) as f64;
        doubled.min(LONGEST_WAIT).mul_f64(1.0 - 0.25 * jitter)
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
            let mut backoff = Backoff::new(seed);
            for expected in [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0, 60.0] {
                let wait = backoff.next_wait().as_secs_f64();
                assert!((0.75 * expected..=expected).contains(&wait), "seed {seed}");
            }
            assert_eq!(backoff.failures(), 9);
            backoff.reset();
            assert!(backoff.next_wait() <= FIRST_WAIT);
        }
    }

    #[test]
    fn workers_do_not_wait_in_step() {
        let waits = [1, 2].map(|seed| Backoff::new(seed).next_wait());
        assert_ne!(waits[0], waits[1]);
    }
}
