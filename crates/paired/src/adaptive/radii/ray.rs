//! Ray of one configuration under one condition, and the outcomes along it.

use crate::Outcome;
use benchmark::{Condition, Level, TaskRef};

use crate::adaptive::outcomes::Outcomes;

/// Direction of one configuration under one condition; radii are positions on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ray {
    pub condition: Condition,
    pub task: TaskRef,
    pub config: u16,
}

/// The outcomes along a ray by radius; the nominal rollout is at [`Level::L0`].
impl Outcomes<Level> {
    pub fn from_nominal(nominal: Outcome) -> Self {
        let mut outcomes = Self::default();
        outcomes.record_source(Level::L0, nominal);
        outcomes
    }

    pub fn nominal(&self) -> Outcome {
        self.at(Level::L0).unwrap_or_default()
    }

    /// Returns the outcome of the majority of results at a radius, which the source campaign and
    /// the campaign of further radii may both have. Without a majority it is missing while a
    /// rollout is pending, and quarantined otherwise. `None` if no campaign has a rollout there.
    pub fn at(&self, level: Level) -> Option<Outcome> {
        let tally = self.both(level);
        match tally.majority() {
            _ if tally.requested() == 0 => None,
            Some(success) => Some(Outcome::from(success)),
            None if tally.pending > 0 => Some(Outcome::Missing),
            None => Some(Outcome::Quarantined),
        }
    }

    /// Returns the radii beyond 0 with a rollout in either of these campaigns, and their outcomes,
    /// in ascending order.
    pub fn perturbed(&self) -> impl DoubleEndedIterator<Item = (Level, Outcome)> {
        let perturbed = self.points().filter(|level| *level != Level::L0);
        perturbed.filter_map(|level| Some((level, self.at(level)?)))
    }

    /// Returns the radii beyond 0 that are known to succeed, or to fail if `success` is false, in
    /// ascending order.
    pub(crate) fn levels(&self, success: bool) -> impl DoubleEndedIterator<Item = Level> {
        let matches = move |outcome: Outcome| outcome.success() == Some(success);
        self.perturbed().filter_map(move |(level, outcome)| matches(outcome).then_some(level))
    }
}
