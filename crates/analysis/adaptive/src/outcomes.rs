//! Outcomes of one search by point.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Add;

use paired::{Count, Outcome};
use serde::{Deserialize, Serialize};

/// Counts of the rollouts at one point of a search: its replicates.
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

    const fn add_outcome(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Success => self.successes += 1,
            Outcome::Failure => self.failures += 1,
            Outcome::Missing => self.pending += 1,
            Outcome::Quarantined => self.quarantined += 1,
        }
    }
}

impl Add for Tally {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            successes: self.successes + other.successes,
            failures: self.failures + other.failures,
            pending: self.pending + other.pending,
            quarantined: self.quarantined + other.quarantined,
        }
    }
}

/// Outcomes of one search by point: a subset of the axes, or a radius. Those of the source
/// campaign and those of the campaign that runs the requests stay apart, because a budget
/// pays for the latter only, and only they are evidence if the former select what is tested.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcomes<P> {
    source: BTreeMap<P, Tally>,
    own: BTreeMap<P, Tally>,
}

impl<P> Default for Outcomes<P> {
    fn default() -> Self {
        Self {
            source: BTreeMap::new(),
            own: BTreeMap::new(),
        }
    }
}

impl<P: Copy + Ord> Outcomes<P> {
    /// Adds a rollout of the source campaign.
    pub fn record_source(&mut self, point: P, outcome: Outcome) {
        self.source.entry(point).or_default().add_outcome(outcome);
    }

    /// Adds a requested rollout, with [`Outcome::Missing`] while it has no result.
    pub fn record(&mut self, point: P, outcome: Outcome) {
        self.own.entry(point).or_default().add_outcome(outcome);
    }

    /// Returns the tally of the source campaign's rollouts at a point.
    pub fn source(&self, point: P) -> Tally {
        self.source.get(&point).copied().unwrap_or_default()
    }

    /// Returns the tally of the requested rollouts at a point.
    pub fn own(&self, point: P) -> Tally {
        self.own.get(&point).copied().unwrap_or_default()
    }

    /// Returns the tally of both campaigns' rollouts at a point.
    pub fn both(&self, point: P) -> Tally {
        self.source(point) + self.own(point)
    }

    /// Returns the points with a rollout in either campaign.
    pub fn points(&self) -> BTreeSet<P> {
        self.source.keys().chain(self.own.keys()).copied().collect()
    }

    /// Returns the number of rollouts requested beyond those of the source campaign.
    pub fn requested(&self) -> u32 {
        self.own.values().map(Tally::asked).sum()
    }
}
