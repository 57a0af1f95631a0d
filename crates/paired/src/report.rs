//! A report: its cells, its nominal success, and the options that it is computed with.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Axis, AxisSet, Condition, Directions, Level, Measure, Suite, TaskRef};
use serde::{Deserialize, Serialize};

use crate::bootstrap::{Bootstrap, Interval};
use crate::bounds::Bounds;
use crate::findings::Finding;
use crate::gate::{Gate, SuiteGate};
use crate::inference::Inference;
use crate::inference::estimate::{Estimate, Scale, share};
use crate::inference::sample::{Row, Sample};
use crate::measures::Measures;
use crate::outcomes::{Count, Records};
use crate::replication::{Components, Flips};

#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Caveats printed at the top, one sentence each, such as a different asset pack, a
    /// privileged policy, or mixed versions.
    pub notes: Vec<String>,
    pub bootstrap: Bootstrap,
    /// The policy's published nominal success rate, a fraction, for the gate.
    pub published_nominal: Option<f64>,
    /// Published nominal success rates of single suites, fractions; each suite gets a gate.
    pub published_by_suite: Vec<(Suite, f64)>,
    /// Nominal successes reported by another source; used if no nominal rollout is
    /// recorded.
    pub reported_nominal: Option<Count>,
    pub directions: Directions,
    /// Measures that are overstated, because the campaign stopped when they were large.
    pub overstated: BTreeSet<Measure>,
}

/// The statistics of one policy's records.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The caller's notes.
    pub notes: Vec<String>,
    pub axes: Vec<Axis>,
    /// Nominal success; absent if the campaign runs no nominal rollouts.
    pub nominal: Option<Nominal>,
    /// The reproduction gate; absent if no published figure is known.
    pub gate: Option<Gate>,
    /// The gates of single suites whose published figures are known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub suite_gates: Vec<SuiteGate>,
    /// Measures whose values in `cells` are overstated, because the campaign stopped when
    /// they were large.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub overstated: BTreeSet<Measure>,
    #[serde(default, skip_serializing_if = "Directions::is_shared")]
    pub directions: Directions,
    pub cells: Vec<Cell>,
    pub by_task: Vec<TaskSuccess>,
    /// Rollouts whose outcome differs between replicates, by condition; empty without replicates.
    pub flips: BTreeMap<Condition, Flips>,
    /// Variance components by level; empty without replicates.
    pub components: Vec<Components>,
    /// Sentences about the figures, see [`findings`](fn@crate::findings).
    pub findings: Vec<Finding>,
    /// Quarantined rollouts, which no rate includes: `ID` or `ID#rK`.
    pub quarantined: Vec<String>,
    pub bootstrap: Bootstrap,
}

impl Report {
    /// Returns the assignment of directions of all these reports; `None` if they differ, or if
    /// there is no report.
    pub fn common_directions<'a>(
        reports: impl IntoIterator<Item = &'a Self>,
    ) -> Option<Directions> {
        let mut directions = reports.into_iter().map(|report| report.directions);
        let first = directions.next()?;
        directions.all(|other| other == first).then_some(first)
    }
}

/// Nominal rollouts of all replicates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Nominal {
    pub source: NominalSource,
    pub count: Count,
    /// `count` of each replicate; empty if there is only one.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_replicate: BTreeMap<u32, Count>,
    pub gap: Gap,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NominalSource {
    /// Nominal rollouts among the records.
    Records,
    /// A count reported by another source.
    Reported,
}

/// One level, with the configurations of all replicates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    pub level: Level,
    /// Success under each single axis over all results, including those of incomplete
    /// configurations.
    pub alone: BTreeMap<Axis, SingleAxis>,
    /// Success under proper subsets of two or more axes, over all results; empty if the
    /// campaign runs none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub subsets: BTreeMap<AxisSet, Count>,
    /// Success of the simultaneous rollouts over all their results; absent if the campaign runs no
    /// simultaneous rollouts.
    pub simultaneous: Option<Count>,
    /// `simultaneous` of each replicate; empty if there is only one.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_replicate: BTreeMap<u32, Count>,
    /// Counts of complete configurations, over which the paired measures are computed.
    pub completeness: Completeness,
    /// Paired measures; absent if no configuration is complete or the campaign runs no
    /// simultaneous rollouts.
    pub paired: Option<Measures>,
    /// Paired measures over the solvable configurations, whose nominal rollout succeeded.
    pub solvable: Option<Measures>,
    /// Worst and best case over the configurations without a missing rollout; absent if none of
    /// them has a quarantined rollout.
    pub bounds: Option<Bounds>,
    /// Intraclass correlation of configurations of a task, see
    /// [`task_correlation`](crate::design::task_correlation).
    pub task_correlation: Option<f64>,
    /// Inference about the paired measures; absent while no configuration is complete.
    pub inference: Option<Inference>,
    /// The smallest |I| detectable with the complete configurations and their `r_d`, a fraction;
    /// see [`minimum_detectable_effect`](crate::design::minimum_detectable_effect).
    pub minimum_detectable_i: Option<f64>,
}

/// One axis alone at one level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SingleAxis {
    pub count: Count,
    /// 1 − success / nominal success; absent if either is unknown or nominal success is 0.
    pub nominal_relative_loss: Option<f64>,
}

/// Numbers of configurations of a cell with and without all their outcomes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Completeness {
    /// Configurations that have all their outcomes.
    pub complete: u64,
    /// All configurations of the cell.
    pub expected: u64,
    /// Numbers of missing and quarantined outcomes, for each condition that has any.
    pub gaps: BTreeMap<Condition, Gap>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// Rollouts without a result yet.
    pub missing: u64,
    /// Rollouts in quarantine.
    pub quarantined: u64,
}

/// Success of one task under one condition at one level, over all replicates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSuccess {
    /// The level; L0 for nominal rollouts.
    pub level: Level,
    pub condition: Condition,
    pub task: TaskRef,
    #[serde(flatten)]
    pub count: Count,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SuiteRow {
    /// The level; L0 for nominal rollouts.
    pub level: Level,
    pub condition: Condition,
    /// Rollouts of each suite; empty if only their sum was reported.
    pub suites: BTreeMap<Suite, Count>,
    pub all: Count,
    /// 95 % interval of the rate of `all`, about new tasks of these suites.
    pub ci95: Option<Interval>,
}

impl SuiteRow {
    /// Returns `nominal`, or a name such as `L2 camera`.
    pub fn name(&self) -> String {
        match self.condition {
            Condition::Nominal => self.condition.name().to_owned(),
            condition => format!("{} {}", self.level, condition.name()),
        }
    }

    /// Returns the mean of the suites' rates; `None` if one is unknown.
    pub fn mean(&self) -> Option<f64> {
        let first = self.suites.values().next()?;
        if self.suites.values().all(|suite| suite.n == first.n) {
            // The same value, without another rounding.
            return self.all.rate();
        }
        let sum: Option<f64> = self.suites.values().map(Count::rate).sum();
        sum.map(|sum| sum / self.suites.len() as f64)
    }
}

/// Counts the results of every task, by level (nominal first) and condition.
pub(crate) fn of_each_task(records: &Records) -> Vec<TaskSuccess> {
    let mut counts: BTreeMap<(Level, Condition, TaskRef), Count> = BTreeMap::new();
    for (&(_, id), &outcome) in &records.outcomes {
        if !matches!(id.condition(), Condition::Subset(_) | Condition::Variant) {
            counts.entry((id.level(), id.condition(), id.task())).or_default().add(outcome);
        }
    }
    let row = |((level, condition, task), count)| TaskSuccess { level, condition, task, count };
    counts.into_iter().map(row).collect()
}

impl Report {
    /// Returns the suites whose tasks have rollouts.
    pub fn suites(&self) -> Vec<Suite> {
        let suites: BTreeSet<Suite> = self.by_task.iter().map(|row| row.task.suite()).collect();
        suites.into_iter().collect()
    }

    /// Returns the success of each suite under every condition at every level, nominal first.
    pub fn suite_rows(&self) -> Vec<SuiteRow> {
        let of_condition =
            |a: &TaskSuccess, b: &TaskSuccess| (a.level, a.condition) == (b.level, b.condition);
        let rows = self.by_task.chunk_by(of_condition).map(|tasks| {
            let mut suites: BTreeMap<Suite, Count> = BTreeMap::new();
            let mut all = Count::default();
            for TaskSuccess { task, count, .. } in tasks {
                for sum in [suites.entry(task.suite()).or_default(), &mut all] {
                    sum.successes += count.successes;
                    sum.n += count.n;
                }
            }
            let counts = tasks.iter().filter(|row| row.count.n > 0).map(|row| Row {
                task: row.task,
                direction: 0,
                values: vec![row.count.n as f64, row.count.successes as f64],
            });
            let sample = Sample::new(&counts.collect::<Vec<_>>(), Directions::Own);
            let rate = sample.and_then(|sample| Estimate::of(&sample, Scale::Share, &share(1, 0)));
            SuiteRow {
                level: tasks[0].level,
                condition: tasks[0].condition,
                suites,
                all,
                ci95: rate.and_then(|rate| rate.new_tasks),
            }
        });
        let reported = self.nominal.iter().filter(|of| of.source == NominalSource::Reported);
        let reported = reported.map(|nominal| SuiteRow {
            level: Level::L0,
            condition: Condition::Nominal,
            suites: BTreeMap::new(),
            all: nominal.count,
            ci95: None,
        });
        reported.chain(rows).collect()
    }
}
