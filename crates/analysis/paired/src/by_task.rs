//! Success of every task, and of every suite with the suites' mean, as LIBERO's tables have it.

use std::collections::{BTreeMap, BTreeSet};

use libero_ctrl::{Condition, Level, Suite, TaskRef};
use serde::{Deserialize, Serialize};

use crate::count::Count;
use crate::outcomes::Records;
use crate::report::Report;

/// Success of one task under one condition at one level, over all replicates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSuccess {
    /// The level; L0 for nominal rollouts.
    pub level: Level,
    /// The condition.
    pub condition: Condition,
    /// The task.
    pub task: TaskRef,
    /// Rollouts and their successes.
    #[serde(flatten)]
    pub count: Count,
}

/// Success under one condition at one level.
#[derive(Clone, Debug, PartialEq)]
pub struct SuiteRow {
    /// `nominal`, or a name such as `L2 camera`.
    pub name: String,
    /// The level; L0 for nominal rollouts.
    pub level: Level,
    /// The condition.
    pub condition: Condition,
    /// Success rate of each suite, in the order of [`Report::suites`].
    pub suites: Vec<Option<f64>>,
    /// Mean of the suites' rates; `None` if one is unknown.
    pub mean: Option<f64>,
}

/// Counts the results of every task, by level (nominal first) and condition.
pub(crate) fn of_each(records: &Records) -> Vec<TaskSuccess> {
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

    /// Returns the success of each suite under every condition at every level.
    pub fn suite_rows(&self) -> Vec<SuiteRow> {
        let of_condition =
            |a: &TaskSuccess, b: &TaskSuccess| (a.level, a.condition) == (b.level, b.condition);
        let rows = self.by_task.chunk_by(of_condition).map(|tasks| {
            let (level, condition) = (tasks[0].level, tasks[0].condition);
            let rate = |suite: &Suite| {
                let of_suite = tasks.iter().filter(|row| row.task.suite() == *suite);
                let sum = of_suite.fold(Count::default(), |sum, row| Count {
                    successes: sum.successes + row.count.successes,
                    n: sum.n + row.count.n,
                });
                sum.rate()
            };
            let suites: Vec<Option<f64>> = self.suites().iter().map(rate).collect();
            let sum: Option<f64> = suites.iter().copied().sum();
            SuiteRow {
                name: match condition {
                    Condition::Clean => condition.label().to_owned(),
                    _ => format!("{level} {}", condition.label()),
                },
                level,
                condition,
                mean: sum.map(|sum| sum / suites.len() as f64),
                suites,
            }
        });
        rows.collect()
    }
}
