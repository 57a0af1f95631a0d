//! From records to a report: groups them into cells, keeps the complete
//! configurations, and says what is left out. The formulas are in `measures`.

use std::collections::{BTreeMap, BTreeSet};

use protocol::{Axis, Condition, Level, RolloutId, TaskRef};
use serde::{Deserialize, Serialize};

use crate::bootstrap::Bootstrap;
use crate::measures::{Configuration, Measures};
use crate::outcomes::{Outcome, Record};

/// What the caller decides.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// What a reader must know first, one sentence each: another asset pack, a
    /// privileged policy, mixed versions. Printed at the top.
    pub notes: Vec<String>,
    /// How intervals are made.
    pub bootstrap: Bootstrap,
}

/// Everything that is said of one policy's records.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The caller's notes.
    pub notes: Vec<String>,
    /// Axes that were perturbed alone, in the protocol's order.
    pub axes: Vec<Axis>,
    /// Nominal success, per replicate.
    pub nominal: Vec<Nominal>,
    /// Cells, by replicate and level.
    pub cells: Vec<Cell>,
    /// Each further replicate against the first.
    pub replication: Vec<Replication>,
    /// Rollouts set aside, in no rate: `ID` or `ID#rK`.
    pub quarantined: Vec<String>,
    /// How the intervals were made.
    pub bootstrap: Bootstrap,
}

/// Successes among rollouts with a result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    /// Successes.
    pub successes: u64,
    /// Rollouts with a result.
    pub n: u64,
}

/// Nominal rollouts of one replicate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Nominal {
    /// The replicate.
    pub replicate: u32,
    /// What succeeded.
    pub count: Count,
    /// What is left out.
    pub gap: Gap,
}

/// One level of one replicate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// The replicate.
    pub replicate: u32,
    /// The level.
    pub level: Level,
    /// Success of each axis alone over all its results, complete configuration
    /// or not.
    pub alone: BTreeMap<Axis, SingleAxis>,
    /// Success of the combination over all its results; absent where the
    /// campaign combines nothing.
    pub together: Option<Count>,
    /// How many configurations the paired measures are of.
    pub completeness: Completeness,
    /// The paired measures; absent while no configuration is complete, or
    /// where the campaign combines nothing.
    pub paired: Option<Measures>,
    /// The same on configurations whose nominal rollout succeeded: what was
    /// solvable to begin with.
    pub solvable: Option<Measures>,
}

/// One axis alone at one level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SingleAxis {
    /// What succeeded.
    pub count: Count,
    /// 1 − success / nominal success; absent where either is unknown or the
    /// nominal success is nought.
    pub clean_relative_loss: Option<f64>,
}

/// How many configurations of a cell have all their outcomes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Completeness {
    /// Those that have.
    pub complete: u64,
    /// All.
    pub expected: u64,
    /// What the others lack, by condition.
    pub gaps: BTreeMap<Condition, Gap>,
}

/// Rollouts without an outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// No result yet.
    pub missing: u64,
    /// Set aside.
    pub quarantined: u64,
}

/// A further replicate against the first, over what both have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replication {
    /// The replicate that is compared with replicate 0.
    pub replicate: u32,
    /// Rollouts with an outcome in both.
    pub compared: u64,
    /// Those whose outcomes differ.
    pub flipped: u64,
    /// By how much `i` is larger than in replicate 0, per level where both
    /// have it.
    pub i_difference: BTreeMap<Level, f64>,
}

/// The same rollout and replicate twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("report on {id}, replicate {replicate}: it is recorded twice, keep one")]
pub struct DuplicateRecord {
    /// The rollout.
    pub id: RolloutId,
    /// The replicate.
    pub replicate: u32,
}

/// Reports on one policy's records. Every expanded rollout should be among
/// them, also those without a result: what is expected is read from them.
///
/// # Errors
/// If a rollout and replicate is recorded twice.
pub fn report(records: &[Record], options: &Options) -> Result<Report, DuplicateRecord> {
    let grouped = Grouped::new(records)?;
    let nominal: Vec<Nominal> = grouped
        .replicates
        .iter()
        .filter_map(|&replicate| grouped.nominal(replicate))
        .collect();
    let mut cells = Vec::new();
    for &replicate in &grouped.replicates {
        for &level in &grouped.levels {
            cells.push(grouped.cell(replicate, level, &options.bootstrap));
        }
    }
    let later = grouped
        .replicates
        .iter()
        .filter(|&&replicate| replicate > 0);
    let replication = later.map(|&replicate| grouped.replication(replicate, &cells));
    Ok(Report {
        notes: options.notes.clone(),
        replication: replication.collect(),
        axes: grouped.axes.iter().copied().collect(),
        nominal,
        cells,
        quarantined: grouped.quarantined(),
        bootstrap: options.bootstrap,
    })
}

type Key = (TaskRef, u16);

/// The records by what they are compared with.
struct Grouped {
    outcomes: BTreeMap<(u32, RolloutId), Outcome>,
    /// Initial states of the configurations.
    init_ids: BTreeMap<(Level, Key), u16>,
    replicates: BTreeSet<u32>,
    levels: BTreeSet<Level>,
    axes: BTreeSet<Axis>,
    combines: bool,
}

impl Grouped {
    fn new(records: &[Record]) -> Result<Self, DuplicateRecord> {
        let mut grouped = Self {
            outcomes: BTreeMap::new(),
            init_ids: BTreeMap::new(),
            replicates: BTreeSet::new(),
            levels: BTreeSet::new(),
            axes: BTreeSet::new(),
            combines: false,
        };
        for record in records {
            let (id, replicate) = (record.id, record.replicate);
            let known = grouped.outcomes.insert((replicate, id), record.outcome);
            if known.is_some() {
                return Err(DuplicateRecord { id, replicate });
            }
            grouped.replicates.insert(replicate);
            match id.condition() {
                Condition::Clean => continue,
                Condition::Single(axis) => {
                    grouped.axes.insert(axis);
                }
                Condition::Combination => grouped.combines = true,
            }
            grouped.levels.insert(id.level());
            let key = (id.task(), id.number());
            grouped.init_ids.insert((id.level(), key), record.init_id);
        }
        Ok(grouped)
    }

    fn outcome(&self, replicate: u32, id: RolloutId) -> Outcome {
        let outcome = self.outcomes.get(&(replicate, id));
        outcome.copied().unwrap_or(Outcome::Missing)
    }

    /// The outcome of a configuration under a condition.
    fn perturbed(&self, replicate: u32, condition: Condition, level: Level, key: Key) -> Outcome {
        RolloutId::perturbed(key.0, condition, level, key.1)
            .map_or(Outcome::Missing, |id| self.outcome(replicate, id))
    }

    fn nominal(&self, replicate: u32) -> Option<Nominal> {
        let mut nominal = Nominal {
            replicate,
            count: Count::default(),
            gap: Gap::default(),
        };
        let of_replicate = self
            .outcomes
            .iter()
            .filter(|((r, id), _)| *r == replicate && id.condition() == Condition::Clean);
        let mut any = false;
        for (_, &outcome) in of_replicate {
            any = true;
            nominal.count.add(outcome);
            nominal.gap.add(outcome);
        }
        any.then_some(nominal)
    }

    fn cell(&self, replicate: u32, level: Level, bootstrap: &Bootstrap) -> Cell {
        let clean = self
            .nominal(replicate)
            .and_then(|nominal| nominal.count.rate());
        let mut conditions: Vec<Condition> =
            self.axes.iter().copied().map(Condition::Single).collect();
        if self.combines {
            conditions.push(Condition::Combination);
        }
        let keys = self.init_ids.iter().filter(|((l, _), _)| *l == level);
        let keys: Vec<(Key, u16)> = keys.map(|(&(_, key), &init_id)| (key, init_id)).collect();

        let mut counts = BTreeMap::new();
        let mut gaps = BTreeMap::new();
        for &condition in &conditions {
            let (mut count, mut gap) = (Count::default(), Gap::default());
            for &(key, _) in &keys {
                let outcome = self.perturbed(replicate, condition, level, key);
                count.add(outcome);
                gap.add(outcome);
            }
            counts.insert(condition, count);
            if gap != Gap::default() {
                gaps.insert(condition, gap);
            }
        }

        let complete: Vec<(Configuration, bool)> = keys
            .iter()
            .filter_map(|&(key, init_id)| {
                let solvable = self.outcome(replicate, RolloutId::clean(key.0, init_id));
                let configuration = self.configuration(replicate, level, key)?;
                Some((configuration, solvable == Outcome::Success))
            })
            .collect();
        let all: Vec<Configuration> = complete.iter().map(|(c, _)| c.clone()).collect();
        let solvable = complete.into_iter().filter(|(_, solvable)| *solvable);
        let solvable: Vec<Configuration> = solvable.map(|(c, _)| c).collect();
        Cell {
            replicate,
            level,
            alone: self
                .axes
                .iter()
                .map(|&axis| {
                    let count = counts[&Condition::Single(axis)];
                    (axis, SingleAxis::new(count, clean))
                })
                .collect(),
            together: counts.get(&Condition::Combination).copied(),
            completeness: Completeness {
                complete: all.len() as u64,
                expected: keys.len() as u64,
                gaps,
            },
            paired: Measures::of(&all, bootstrap),
            solvable: Measures::of(&solvable, bootstrap),
        }
    }

    /// A configuration, if all its outcomes are known.
    fn configuration(&self, replicate: u32, level: Level, key: Key) -> Option<Configuration> {
        let success = |condition| self.perturbed(replicate, condition, level, key).success();
        let together = self
            .combines
            .then(|| success(Condition::Combination))
            .flatten()?;
        let mut alone = BTreeMap::new();
        for &axis in &self.axes {
            alone.insert(axis, success(Condition::Single(axis))?);
        }
        Some(Configuration {
            task: key.0,
            alone,
            together,
        })
    }

    fn replication(&self, replicate: u32, cells: &[Cell]) -> Replication {
        let (mut compared, mut flipped) = (0, 0);
        for (&(of, id), outcome) in &self.outcomes {
            let first = self.outcome(0, id);
            if let (true, Some(now), Some(then)) =
                (of == replicate, outcome.success(), first.success())
            {
                compared += 1;
                flipped += u64::from(now != then);
            }
        }
        let i_of = |replicate: u32, level: Level| {
            let mut cells = cells.iter();
            let cell = cells.find(|cell| (cell.replicate, cell.level) == (replicate, level))?;
            cell.paired.as_ref().map(|measures| measures.i)
        };
        let i_difference = self
            .levels
            .iter()
            .filter_map(|&level| Some((level, i_of(replicate, level)? - i_of(0, level)?)));
        Replication {
            replicate,
            compared,
            flipped,
            i_difference: i_difference.collect(),
        }
    }

    fn quarantined(&self) -> Vec<String> {
        let aside = self.outcomes.iter();
        let aside = aside.filter(|(_, outcome)| **outcome == Outcome::Quarantined);
        aside
            .map(|((replicate, id), _)| match replicate {
                0 => id.to_string(),
                k => format!("{id}#r{k}"),
            })
            .collect()
    }
}

impl Count {
    /// The success rate; none of no rollout.
    pub fn rate(&self) -> Option<f64> {
        (self.n > 0).then(|| self.successes as f64 / self.n as f64)
    }

    fn add(&mut self, outcome: Outcome) {
        if let Some(success) = outcome.success() {
            self.n += 1;
            self.successes += u64::from(success);
        }
    }
}

impl Gap {
    fn add(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Missing => self.missing += 1,
            Outcome::Quarantined => self.quarantined += 1,
            Outcome::Success | Outcome::Failure => {}
        }
    }
}

impl SingleAxis {
    fn new(count: Count, clean: Option<f64>) -> Self {
        let loss = |rate: f64| {
            let clean = clean.filter(|&clean| clean > 0.0)?;
            Some(1.0 - rate / clean)
        };
        Self {
            count,
            clean_relative_loss: count.rate().and_then(loss),
        }
    }
}
