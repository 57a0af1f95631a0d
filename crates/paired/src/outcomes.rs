//! Records of rollouts, and their matching by configuration.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Axis, AxisSet, Condition, Level, RolloutId, TaskRef};
use serde::{Deserialize, Serialize};

use crate::measures::Configuration;

/// Outcome of a rollout, if it has ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The goal held within the step budget.
    Success,
    /// The task failed.
    Failure,
    /// Planned, without a result so far.
    #[default]
    Missing,
    /// Quarantined after too many failed attempts, or skipped: listed, and excluded from all rates.
    Quarantined,
}

impl Outcome {
    /// Returns true if the task succeeded; `None` without a result.
    pub const fn success(self) -> Option<bool> {
        match self {
            Self::Success => Some(true),
            Self::Failure => Some(false),
            Self::Missing | Self::Quarantined => None,
        }
    }

    /// Returns the smallest and largest number of successes that a rollout may count as;
    /// `None` if it is missing.
    pub(crate) const fn possible_successes(self) -> Option<[i64; 2]> {
        match self {
            Self::Missing => None,
            Self::Quarantined => Some([0, 1]),
            Self::Success => Some([1, 1]),
            Self::Failure => Some([0, 0]),
        }
    }
}

impl From<bool> for Outcome {
    fn from(success: bool) -> Self {
        if success { Self::Success } else { Self::Failure }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    pub id: RolloutId,
    /// Initial state at the start of the rollout; pairs a configuration with its nominal
    /// rollout.
    pub init_id: u16,
    /// Number of the replicate, from 0.
    pub replicate: u32,
    pub outcome: Outcome,
}

/// Error: the same rollout and replicate is recorded twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("report on {id}: replicate {replicate} is recorded twice; keep one record")]
pub struct DuplicateRecord {
    pub id: RolloutId,
    pub replicate: u32,
}

/// One configuration at one level in one replicate, with the outcomes of its rollouts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Matched {
    pub replicate: u32,
    pub level: Level,
    pub task: TaskRef,
    pub config: u16,
    /// The initial state of all its rollouts.
    pub init_id: u16,
    /// Outcome of the nominal rollout from the same initial state; also missing if the
    /// campaign runs no nominal rollouts.
    pub nominal: Outcome,
    /// Outcome under each axis alone, for all axes of the campaign; an axis that is not combined is
    /// absent at levels at which the campaign does not run it.
    pub alone: BTreeMap<Axis, Outcome>,
    /// Outcomes under proper subsets of two or more axes, as far as recorded.
    pub subsets: BTreeMap<AxisSet, Outcome>,
    /// Outcome under simultaneous perturbation; also missing if the campaign runs no
    /// simultaneous rollouts.
    pub simultaneous: Outcome,
}

/// Effect of simultaneous perturbation on the outcome expected from the axes alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Transition {
    /// Every axis alone succeeds, and so does the simultaneous rollout.
    StillSucceeds,
    /// Some axis alone fails, and so does the simultaneous rollout.
    StillFails,
    /// Every axis alone succeeds, the simultaneous rollout fails: counted in
    /// [`Measures::b`](crate::Measures::b).
    Emergent,
    /// Some axis alone fails, the simultaneous rollout succeeds: counted in
    /// [`Measures::c`](crate::Measures::c).
    Compensated,
}

impl Transition {
    pub const ALL: [Self; 4] =
        [Self::StillSucceeds, Self::StillFails, Self::Emergent, Self::Compensated];

    /// Returns the transition from the conjunction of the axes' successes to the
    /// success of the simultaneous rollout.
    pub const fn between(conjunction: bool, simultaneous: bool) -> Self {
        match (conjunction, simultaneous) {
            (true, true) => Self::StillSucceeds,
            (false, false) => Self::StillFails,
            (true, false) => Self::Emergent,
            (false, true) => Self::Compensated,
        }
    }

    /// Name in tables: `still succeeds`, `still fails`, `emergent`,
    /// `compensated`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::StillSucceeds => "still succeeds",
            Self::StillFails => "still fails",
            Self::Emergent => "emergent",
            Self::Compensated => "compensated",
        }
    }
}

impl Matched {
    /// Returns the outcome under each of the axes that simultaneous perturbation combines.
    pub fn combined(&self) -> impl Iterator<Item = (Axis, Outcome)> {
        let alone = self.alone.iter().map(|(axis, outcome)| (*axis, *outcome));
        alone.filter(|(axis, _)| axis.def().is_combined)
    }

    /// Returns the complete configuration; `None` if its outcome under an axis alone or under
    /// simultaneous perturbation is unknown.
    pub fn configuration(&self) -> Option<Configuration> {
        let mut alone = BTreeMap::new();
        for (axis, outcome) in self.combined() {
            alone.insert(axis, outcome.success()?);
        }
        Some(Configuration { task: self.task, alone, simultaneous: self.simultaneous.success()? })
    }

    /// Returns the transition; `None` if the configuration is not complete.
    pub fn transition(&self) -> Option<Transition> {
        let configuration = self.configuration()?;
        let conjunction = configuration.conjunction();
        Some(Transition::between(conjunction, configuration.simultaneous))
    }

    /// Returns every transition that the possible outcomes of quarantined rollouts allow:
    /// exactly one if no rollout is quarantined. `None` if a rollout is missing.
    pub fn possible_transitions(&self) -> Option<Vec<Transition>> {
        let mut conjunction = [1, 1];
        for (_, outcome) in self.combined() {
            let [fewest, most] = outcome.possible_successes()?;
            conjunction = [conjunction[0] * fewest, conjunction[1] * most];
        }
        let simultaneous = self.simultaneous.possible_successes()?;
        let is_possible =
            |success: bool, [fewest, most]: [i64; 2]| (fewest..=most).contains(&i64::from(success));
        let mut possible = Vec::new();
        for (alone, together) in [(true, true), (false, false), (true, false), (false, true)] {
            if is_possible(alone, conjunction) && is_possible(together, simultaneous) {
                possible.push(Transition::between(alone, together));
            }
        }
        Some(possible)
    }

    pub fn outcome(&self, condition: Condition) -> Outcome {
        match condition {
            Condition::Nominal => self.nominal,
            Condition::Single(axis) => self.alone.get(&axis).copied().unwrap_or_default(),
            Condition::Subset(axes) => self.subsets.get(&axes).copied().unwrap_or_default(),
            Condition::Simultaneous => self.simultaneous,
            // Variants belong to no configuration.
            Condition::Variant => Outcome::Missing,
        }
    }
}

#[derive(Clone, Debug, Default)]
pub struct Records {
    pub(crate) outcomes: BTreeMap<(u32, RolloutId), Outcome>,
    /// Axes that are perturbed alone, each with the levels of its rollouts.
    pub(crate) alone: BTreeMap<Axis, BTreeSet<Level>>,
    /// True if simultaneous rollouts are recorded.
    pub(crate) has_simultaneous: bool,
    pub(crate) matched: Vec<Matched>,
}

impl Records {
    pub fn new(records: &[Record]) -> Result<Self, DuplicateRecord> {
        let mut matching = Self::default();
        for record in records {
            let (id, replicate) = (record.id, record.replicate);
            let earlier = matching.outcomes.insert((replicate, id), record.outcome);
            if earlier.is_some() {
                return Err(DuplicateRecord { id, replicate });
            }
            match id.condition() {
                Condition::Nominal | Condition::Subset(_) | Condition::Variant => {}
                Condition::Single(axis) => {
                    matching.alone.entry(axis).or_default().insert(id.level());
                }
                Condition::Simultaneous => matching.has_simultaneous = true,
            }
        }
        matching.matched = matching.matched(records);
        Ok(matching)
    }

    /// Returns every configuration with at least one recorded perturbed rollout, ordered
    /// by level, replicate, task and number.
    pub fn configurations(&self) -> &[Matched] {
        &self.matched
    }

    /// Returns the axes that were perturbed alone and are combined, in the protocol's order.
    pub fn axes(&self) -> impl Iterator<Item = Axis> {
        self.alone.keys().copied().filter(|axis| axis.def().is_combined)
    }

    /// Returns true if simultaneous rollouts are recorded.
    pub fn has_simultaneous(&self) -> bool {
        self.has_simultaneous
    }

    /// Returns the outcome of a rollout; [`Outcome::Missing`] if it is not recorded.
    pub(crate) fn outcome(&self, replicate: u32, id: RolloutId) -> Outcome {
        let outcome = self.outcomes.get(&(replicate, id));
        outcome.copied().unwrap_or_default()
    }

    /// Returns true if a rollout of a configuration has not ended, including its nominal
    /// rollout if the campaign runs one.
    pub(crate) fn is_open(&self, matched: &Matched) -> bool {
        let nominal = RolloutId::nominal(matched.task, matched.init_id);
        let nominal = self.outcomes.get(&(matched.replicate, nominal));
        let perturbed = matched.alone.values().chain(matched.subsets.values());
        let mut outcomes = perturbed.chain([&matched.simultaneous]).chain(nominal);
        outcomes.any(|outcome| *outcome == Outcome::Missing)
    }

    fn matched(&self, records: &[Record]) -> Vec<Matched> {
        let mut matched = BTreeMap::new();
        for &Record { id, init_id, replicate, outcome } in records {
            let Some(config) = id.config() else { continue };
            let key = (id.level(), replicate, id.task(), config);
            let entry = matched.entry(key).or_insert_with(|| Matched {
                replicate,
                level: id.level(),
                task: id.task(),
                config,
                init_id,
                nominal: self.outcome(replicate, RolloutId::nominal(id.task(), init_id)),
                alone: (self.alone.iter())
                    .filter(|(axis, at)| axis.def().is_combined || at.contains(&id.level()))
                    .map(|(axis, _)| (*axis, Outcome::Missing))
                    .collect(),
                subsets: BTreeMap::new(),
                simultaneous: Outcome::Missing,
            });
            match id.condition() {
                Condition::Single(axis) => {
                    entry.alone.insert(axis, outcome);
                }
                Condition::Subset(axes) => {
                    entry.subsets.insert(axes, outcome);
                }
                Condition::Simultaneous => entry.simultaneous = outcome,
                Condition::Nominal | Condition::Variant => {}
            }
        }
        matched.into_values().collect()
    }
}

/// Number of successes among the rollouts with a result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    pub successes: u64,
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
