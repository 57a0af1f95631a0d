//! Outcomes of one search by point.

use std::collections::BTreeMap;

use crate::{Count, Outcome};
use serde::{Deserialize, Serialize};

/// Rollouts at one point of a search, which are replicates of one another, counted by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    pub successes: u32,
    pub failures: u32,
    /// Rollouts without a result so far.
    pub pending: u32,
    /// Quarantined rollouts: without a result, and not run again unless an operator retries them.
    pub quarantined: u32,
}

impl Tally {
    /// Returns the number of all these rollouts, with or without a result.
    pub const fn requested(&self) -> u32 {
        self.successes + self.failures + self.pending + self.quarantined
    }

    /// Returns the number of rollouts with a result and of successes among them.
    pub fn count(&self) -> Count {
        Count {
            successes: u64::from(self.successes),
            n: u64::from(self.successes) + u64::from(self.failures),
        }
    }

    /// Returns true if most rollouts with a result succeed; `None` for a tie or without a result.
    pub const fn majority(&self) -> Option<bool> {
        match (self.successes, self.failures) {
            (successes, failures) if successes > failures => Some(true),
            (successes, failures) if successes < failures => Some(false),
            _ => None,
        }
    }

    const fn add(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Success => self.successes += 1,
            Outcome::Failure => self.failures += 1,
            Outcome::Missing => self.pending += 1,
            Outcome::Quarantined => self.quarantined += 1,
        }
    }
}

/// Outcomes of one search by point: a subset of the axes, or a radius. The tallies of the source
/// campaign are separate from those of requested rollouts: only requested rollouts count against
/// the budget. Where the source's outcomes selected the hypotheses to test, only requested rollouts
/// are evidence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcomes<P>(BTreeMap<P, Tallies>);

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Tallies {
    source: Tally,
    requests: Tally,
}

impl<P> Default for Outcomes<P> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl<P: Copy + Ord> Outcomes<P> {
    pub fn record_source(&mut self, point: P, outcome: Outcome) {
        self.0.entry(point).or_default().source.add(outcome);
    }

    /// Adds a requested rollout, with [`Outcome::Missing`] while it has no result.
    pub fn record(&mut self, point: P, outcome: Outcome) {
        self.0.entry(point).or_default().requests.add(outcome);
    }

    fn tallies(&self, point: P) -> Tallies {
        self.0.get(&point).copied().unwrap_or_default()
    }

    pub fn source(&self, point: P) -> Tally {
        self.tallies(point).source
    }

    pub fn requests(&self, point: P) -> Tally {
        self.tallies(point).requests
    }

    pub fn both(&self, point: P) -> Tally {
        let Tallies { source, requests } = self.tallies(point);
        Tally {
            successes: source.successes + requests.successes,
            failures: source.failures + requests.failures,
            pending: source.pending + requests.pending,
            quarantined: source.quarantined + requests.quarantined,
        }
    }

    /// Returns the points with a rollout in either campaign, in order.
    pub fn points(&self) -> impl DoubleEndedIterator<Item = P> {
        self.0.keys().copied()
    }

    /// Returns the number of rollouts requested beyond those of the source campaign.
    pub fn requested(&self) -> u32 {
        self.0.values().map(|tallies| tallies.requests.requested()).sum()
    }
}
