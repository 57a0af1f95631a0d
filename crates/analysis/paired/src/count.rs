//! Counts of successful rollouts.

use serde::{Deserialize, Serialize};

use crate::outcomes::Outcome;

/// Number of successes among the rollouts with a result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    /// Successes.
    pub successes: u64,
    /// Rollouts with a result.
    pub n: u64,
}

impl Count {
    /// Returns the success rate; `None` without a rollout.
    pub fn rate(&self) -> Option<f64> {
        (self.n > 0).then(|| self.successes as f64 / self.n as f64)
    }

    pub(crate) fn add(&mut self, outcome: Outcome) {
        if let Some(success) = outcome.success() {
            self.n += 1;
            self.successes += u64::from(success);
        }
    }
}
