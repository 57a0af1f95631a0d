//! Tasks of other simulators in a report: their names, their success, and seeds that do not repeat.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Condition, Level, Suite, TaskRef};
use paired::Count;
use serde::{Deserialize, Serialize};

use crate::analysis::Analysis;
use crate::block::{Rows, Table, cell, or_dash};
use crate::subject::Subject;
use crate::words::percent;

/// A task of another simulator.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SimulatedTask {
    /// `SIMULATOR/TASK`.
    pub name: String,
    /// Number of seeds from which several rollouts began without a perturbation in the simulator.
    pub seeds: u64,
    /// Number of those seeds from which they began with different observations.
    pub unrepeated: u64,
}

impl Subject {
    /// Returns a task's name: that of the simulator, or that of LIBERO.
    pub(crate) fn task_name(&self, task: TaskRef) -> String {
        let simulated = self.simulated.get(&task.index());
        let simulated = simulated.filter(|_| task.suite() == Suite::Simulated);
        simulated.map_or_else(|| task.to_string(), |simulated| simulated.name.clone())
    }
}

/// Warns of simulators that do not repeat a reset of the same seed.
pub(crate) fn paired_by_seed_only(subject: &Subject) -> Option<String> {
    let tasks = subject.simulated.values().filter(|task| task.unrepeated > 0);
    let tasks: Vec<String> = tasks
        .map(|SimulatedTask { name, seeds, unrepeated }| {
            format!("{unrepeated} of {seeds} of {name}")
        })
        .collect();
    let has_placebo = subject.records.iter().any(|record| record.id.is_placebo());
    let remedy = match has_placebo {
        true => "the placebo level L0 measures the effect of that alone",
        false => "add rows with `placebo`, which measure the effect of that alone",
    };
    (!tasks.is_empty()).then(|| {
        format!(
            "paired by seed only: rollouts of the same seed began with different observations, those \
             of {}; {remedy}",
            tasks.join(", ")
        )
    })
}

/// Success by benchmark and task, a row per level, L0 with the nominal rollouts; empty for a subject
/// in LIBERO.
pub(crate) fn by_task(analysis: &Analysis) -> Table {
    let mut rows: BTreeMap<(TaskRef, Level), BTreeMap<Condition, Count>> = BTreeMap::new();
    for of in analysis.report.by_task.iter().filter(|of| of.task.suite() == Suite::Simulated) {
        rows.entry((of.task, of.level)).or_default().insert(of.condition, of.count);
    }
    let conditions: BTreeSet<Condition> = rows.values().flat_map(|of| of.keys().copied()).collect();
    let name = format!("{}: success by benchmark and task, %", analysis.label);
    let mut table = Rows::new(name, rows)
        .key("task", |((task, _), _)| cell(analysis.subject.task_name(*task)))
        .key("level", |((_, level), _)| cell(level));
    for condition in conditions {
        table = table.column(condition.name(), "", "", move |(_, counts)| {
            or_dash(counts.get(&condition).and_then(Count::rate).map(percent))
        });
    }
    table.table()
}
