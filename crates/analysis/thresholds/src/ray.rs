//! Ray of one configuration under one condition, and the outcomes along it.

use std::collections::BTreeMap;

use libero_ctrl::{Condition, Level, TaskRef};
use paired::Outcome;

/// Direction of one configuration under one condition; radii are positions on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ray {
    /// Condition: the perturbed axes.
    pub condition: Condition,
    /// The task.
    pub task: TaskRef,
    /// The configuration's number.
    pub config: u16,
}

/// The outcomes along a ray.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Known {
    nominal: Outcome,
    points: BTreeMap<Level, Outcome>,
    further: u32,
}

impl Known {
    /// Creates a ray from the outcome of its nominal rollout, at radius 0.
    pub fn new(nominal: Outcome) -> Self {
        Self {
            nominal,
            ..Self::default()
        }
    }

    /// Adds an outcome of the measured campaign.
    pub fn record(&mut self, level: Level, outcome: Outcome) {
        self.points.insert(level, outcome);
    }

    /// Adds a requested rollout, with [`Outcome::Missing`] while it has no result.
    pub fn record_further(&mut self, level: Level, outcome: Outcome) {
        self.record(level, outcome);
        self.further += 1;
    }

    /// Returns the outcome of the nominal rollout.
    pub const fn nominal(&self) -> Outcome {
        self.nominal
    }

    /// Returns the outcome of the rollout at a radius; `None` if none was requested.
    pub fn at(&self, level: Level) -> Option<Outcome> {
        self.points.get(&level).copied()
    }

    /// Returns the radii with a requested rollout and their outcomes, in ascending order.
    pub fn points(&self) -> impl Iterator<Item = (Level, Outcome)> {
        self.points
            .iter()
            .map(|(&level, &outcome)| (level, outcome))
    }

    /// Returns the number of rollouts requested beyond those of the measured campaign.
    pub const fn further(&self) -> u32 {
        self.further
    }

    /// Returns the radii whose outcome is known to be a success, or a failure, in ascending
    /// order.
    pub(crate) fn levels(&self, success: bool) -> impl DoubleEndedIterator<Item = Level> {
        let points = self.points.iter();
        let such = points.filter(move |(_, outcome)| outcome.success() == Some(success));
        such.map(|(&level, _)| level)
    }
}
