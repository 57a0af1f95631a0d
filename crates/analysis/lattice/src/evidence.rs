//! Verdict of a subset from its rollouts: a single outcome, or a sequential test.

use paired::{Count, Outcome, mcnemar_exact};
use serde::{Deserialize, Serialize};

/// The rollouts of one configuration under one subset of the axes: its
/// replicates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    /// Rollouts that succeeded.
    pub successes: u32,
    /// Rollouts that failed.
    pub failures: u32,
    /// Requested rollouts without a result.
    pub pending: u32,
    /// Quarantined rollouts: without a result, and never run again.
    pub quarantined: u32,
}

impl Tally {
    /// Returns the number of requested rollouts.
    pub const fn asked(&self) -> u32 {
        self.successes + self.failures + self.pending + self.quarantined
    }

    /// Returns the number of rollouts with a result and of successes among them.
    pub fn count(&self) -> Count {
        Count {
            successes: u64::from(self.successes),
            n: u64::from(self.successes) + u64::from(self.failures),
        }
    }

    /// Returns the outcome of the majority of rollouts; `None` for a tie.
    pub const fn majority(&self) -> Option<bool> {
        match (self.successes, self.failures) {
            (successes, failures) if successes > failures => Some(true),
            (successes, failures) if successes < failures => Some(false),
            _ => None,
        }
    }

    pub(crate) const fn add(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Success => self.successes += 1,
            Outcome::Failure => self.failures += 1,
            Outcome::Missing => self.pending += 1,
            Outcome::Quarantined => self.quarantined += 1,
        }
    }
}

/// Verdict of the rollouts under one subset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The rollout or the majority succeeds.
    Success,
    /// The rollout or the majority fails.
    Failure,
    /// No rollout was requested.
    NotRun,
    /// A requested rollout has no result.
    Pending,
    /// Undecided; more rollouts are needed.
    Short {
        /// Number of further replicates.
        more: u32,
    },
    /// Every rollout is quarantined: the outcome is unknown and no rollout runs again.
    Quarantined,
    /// Undecided after the largest allowed number of rollouts.
    Undecided,
}

impl Verdict {
    /// Returns true if the subset succeeds; `None` without a decision.
    pub const fn success(self) -> Option<bool> {
        match self {
            Self::Success => Some(true),
            Self::Failure => Some(false),
            _ => None,
        }
    }
}

/// Rule by which a verdict is reached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Evidence {
    /// The policy is deterministic: one result decides. Results that
    /// contradict each other leave the subset undecided.
    #[default]
    Once,
    /// The policy is stochastic: a test over replicates decides.
    Repeated(Repeats),
}

/// A sequential test of whether a subset succeeds more often than not.
///
/// Rollouts are requested in batches, with a test after each batch. A subset
/// succeeds if the hypothesis that its success probability is at most ½ is
/// rejected, and fails if the hypothesis that it is at least ½ is rejected. This is
/// equivalent to the Clopper–Pearson interval of its success rate lying above or
/// below ½. With at most m tests, each at level `error` / m (Bonferroni), a
/// verdict is wrong with a total probability of at most `error`, and at most
/// `error` / 2 unless the success probability is exactly ½.
///
/// The guarantee holds for each subset separately. It does not hold conditionally on
/// a configuration having been selected by its first outcomes; to restore it, exclude
/// those outcomes from the tallies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repeats {
    /// Rollouts per batch; at least 1.
    pub batch: u32,
    /// Largest number of rollouts of a subset; at least `batch`.
    pub most: u32,
    /// Largest probability of a wrong verdict.
    pub error: f64,
}

impl Default for Repeats {
    /// Eight equal outcomes decide; among 16 outcomes two may differ, among 24 five.
    fn default() -> Self {
        Self {
            batch: 8,
            most: 24,
            error: 0.05,
        }
    }
}

impl Repeats {
    /// Returns the default rule with at most `most` rollouts.
    pub fn up_to(most: u32) -> Self {
        let usual = Self::default();
        Self {
            batch: usual.batch.min(most),
            most,
            ..usual
        }
    }

    /// Returns the significance level of a single test.
    pub fn error_per_test(&self) -> f64 {
        self.error / f64::from(self.most.div_ceil(self.batch.max(1)).max(1))
    }

    fn verdict(&self, tally: &Tally) -> Verdict {
        let asked = tally.asked();
        if asked < self.batch {
            return Verdict::Short {
                more: self.batch - asked,
            };
        }
        let Count { successes, n } = tally.count();
        // McNemar's exact test is equivalent to the sign test of the two counts.
        let p = mcnemar_exact(successes, n - successes);
        match tally.majority() {
            Some(true) if p <= self.error_per_test() => Verdict::Success,
            Some(false) if p <= self.error_per_test() => Verdict::Failure,
            _ if asked < self.most => Verdict::Short {
                more: self.batch.max(1).min(self.most - asked),
            },
            _ if n == 0 => Verdict::Quarantined,
            _ => Verdict::Undecided,
        }
    }
}

impl Evidence {
    /// Returns the verdict of a tally of rollouts.
    pub fn verdict(&self, tally: &Tally) -> Verdict {
        let Tally {
            successes,
            failures,
            pending,
            ..
        } = *tally;
        match self {
            _ if tally.asked() == 0 => Verdict::NotRun,
            Self::Repeated(_) if pending > 0 => Verdict::Pending,
            Self::Repeated(repeats) => repeats.verdict(tally),
            Self::Once => match (successes > 0, failures > 0) {
                (true, false) => Verdict::Success,
                (false, true) => Verdict::Failure,
                (true, true) => Verdict::Undecided,
                (false, false) if pending > 0 => Verdict::Pending,
                (false, false) => Verdict::Quarantined,
            },
        }
    }

    /// Returns the number of rollouts in the first batch of a subset.
    pub(crate) fn first(&self) -> u32 {
        match self {
            Self::Once => 1,
            Self::Repeated(repeats) => repeats.batch.max(1),
        }
    }

    /// Returns the largest number of rollouts that may still be requested for a subset.
    pub(crate) fn remaining(&self, tally: &Tally) -> u32 {
        let most = match self {
            Self::Once => 1,
            Self::Repeated(repeats) => repeats.most.max(repeats.batch).max(1),
        };
        match self.verdict(tally) {
            Verdict::NotRun | Verdict::Pending | Verdict::Short { .. } => {
                most.saturating_sub(tally.asked())
            }
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::clopper_pearson;

    fn tally(successes: u32, failures: u32) -> Tally {
        Tally {
            successes,
            failures,
            ..Tally::default()
        }
    }

    #[test]
    fn one_result_decides_for_a_deterministic_policy() {
        let once = |successes, failures| Evidence::Once.verdict(&tally(successes, failures));
        assert_eq!(once(0, 0), Verdict::NotRun);
        assert_eq!(once(1, 0), Verdict::Success);
        assert_eq!(once(0, 1), Verdict::Failure);
        assert_eq!(once(1, 1), Verdict::Undecided);
        let quarantined = Tally {
            quarantined: 1,
            ..Tally::default()
        };
        assert_eq!(Evidence::Once.verdict(&quarantined), Verdict::Quarantined);
    }

    #[test]
    fn a_verdict_is_reached_exactly_where_the_interval_excludes_one_half() {
        let repeats = Repeats::default();
        for n in repeats.batch..=repeats.most {
            for successes in 0..=n {
                let tally = tally(successes, n - successes);
                let level = 1.0 - repeats.error_per_test();
                let [low, high] = clopper_pearson(tally.count(), level).expect("rollouts");
                let expected = (low > 0.5)
                    .then_some(true)
                    .or((high < 0.5).then_some(false));
                let verdict = Evidence::Repeated(repeats).verdict(&tally);
                assert_eq!(verdict.success(), expected, "{successes} of {n}");
            }
        }
    }

    /// Returns the probability that the sequential test decides *success*, by enumerating
    /// every reachable state: the numbers of rollouts and of successes so far.
    fn probability_of_success(repeats: Repeats, p: f64) -> f64 {
        let mut said = 0.0;
        let mut states = BTreeMap::from([((0, 0), 1.0)]);
        while let Some(((n, successes), weight)) = states.pop_first() {
            let more = match Evidence::Repeated(repeats).verdict(&tally(successes, n - successes)) {
                Verdict::Success => {
                    said += weight;
                    continue;
                }
                Verdict::NotRun => repeats.batch,
                Verdict::Short { more } => more,
                _ => continue,
            };
            let mut ways = 1.0;
            for k in 0..=more {
                let chance = ways * p.powi(k as i32) * (1.0 - p).powi((more - k) as i32);
                *states.entry((n + more, successes + k)).or_default() += weight * chance;
                ways *= f64::from(more - k) / f64::from(k + 1);
            }
        }
        said
    }

    #[test]
    fn a_wrong_verdict_is_as_rare_as_stated_and_a_right_one_usual() {
        for (batch, most, error) in [(8, 24, 0.05), (6, 6, 0.05), (5, 23, 0.1), (1, 30, 0.2)] {
            let repeats = Repeats { batch, most, error };
            for p in [0.0, 0.1, 0.3, 0.45, 0.5] {
                let wrong = probability_of_success(repeats, p);
                assert!(wrong <= error / 2.0, "{repeats:?} at {p}: {wrong}");
            }
        }
        let right = probability_of_success(Repeats::default(), 0.95);
        assert!(right > 0.999, "{right}");
    }

    #[test]
    fn nothing_is_asked_beyond_the_bound() {
        let repeated = Evidence::Repeated(Repeats::default());
        assert_eq!(repeated.verdict(&tally(3, 2)), Verdict::Short { more: 3 });
        assert_eq!(repeated.verdict(&tally(8, 0)), Verdict::Success);
        assert_eq!(repeated.verdict(&tally(4, 4)), Verdict::Short { more: 8 });
        assert_eq!(repeated.verdict(&tally(10, 11)), Verdict::Short { more: 3 });
        assert_eq!(repeated.verdict(&tally(12, 12)), Verdict::Undecided);
        assert_eq!(repeated.verdict(&tally(30, 29)), Verdict::Undecided);
    }
}
