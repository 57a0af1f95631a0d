//! Evaluation of records into a report: groups them into cells, computes
//! the paired measures over the complete configurations and counts the missing outcomes. The
//! formulas are in `measures`.

use std::collections::BTreeMap;

use benchmark::{AxisSet, Condition, Level, Suite, TaskRef};

use crate::bootstrap::Bootstrap;
use crate::bounds::Bounds;
use crate::design::{PairedDesign, minimum_detectable_effect, task_correlation};
use crate::findings::findings;
use crate::gate::{Gate, SuiteGate};
use crate::inference::Inference;
use crate::measures::{Configuration, Measures};
use crate::outcomes::{Count, DuplicateRecord, Matched, Outcome, Record, Records};
use crate::replication::{Components, flips};
use crate::report::{
    Cell, Completeness, Gap, Nominal, NominalSource, Options, Report, SingleAxis, of_each_task,
};

/// Reports on one policy's records. `records` should hold every planned rollout, including
/// those without a result, because the expected conditions are derived from them.
pub fn report(records: &[Record], options: &Options) -> Result<Report, DuplicateRecord> {
    Ok(report_of(&Records::new(records)?, options))
}

pub fn report_of(records: &Records, options: &Options) -> Report {
    let reported = options.reported_nominal.map(|count| Nominal {
        source: NominalSource::Reported,
        count,
        by_replicate: BTreeMap::new(),
        gap: Gap::default(),
    });
    let nominal = nominal(records).or(reported);
    let nominal_count = nominal.as_ref().map_or(Count::default(), |nominal| nominal.count);
    let cells = records.configurations().chunk_by(|a, b| a.level == b.level);
    let placebo = cells.clone().find(|matched| matched[0].level == Level::L0);
    let cells = cells.map(|matched| {
        let inference = Inference::of(matched, placebo, options.directions);
        Cell { inference, ..cell(records, matched, nominal_count.rate(), &options.bootstrap) }
    });
    let cells = cells.collect();
    let mut report = Report {
        findings: Vec::new(),
        components: Components::of_each(records.configurations()),
        notes: options.notes.clone(),
        overstated: options.overstated.clone(),
        directions: options.directions,
        axes: records.axes().collect(),
        gate: options
            .published_nominal
            .map(|rate| Gate::new(rate, nominal_count).with_tasks(&nominal_by_task(records, None))),
        suite_gates: options
            .published_by_suite
            .iter()
            .map(|&(suite, published)| SuiteGate {
                suite,
                gate: Gate::of_suite(published, nominal_of_suite(records, suite))
                    .with_tasks(&nominal_by_task(records, Some(suite))),
            })
            .collect(),
        nominal,
        cells,
        by_task: of_each_task(records),
        flips: flips(records),
        quarantined: quarantined(records),
        bootstrap: options.bootstrap,
    };
    report.findings = findings(&report);
    report
}

fn nominal(records: &Records) -> Option<Nominal> {
    let (mut count, mut gap) = (Count::default(), Gap::default());
    let nominal =
        records.outcomes.iter().filter(|((_, id), _)| id.condition() == Condition::Nominal);
    let outcomes: Vec<(u32, Outcome)> = nominal.map(|((k, _), outcome)| (*k, *outcome)).collect();
    for (_, outcome) in &outcomes {
        count.add(*outcome);
        gap.add(*outcome);
    }
    let (source, by_replicate) = (NominalSource::Records, by_replicate(&outcomes));
    (!outcomes.is_empty()).then_some(Nominal { source, count, by_replicate, gap })
}

/// Counts the outcomes of each replicate; empty if there is only one.
fn by_replicate(outcomes: &[(u32, Outcome)]) -> BTreeMap<u32, Count> {
    let mut counts: BTreeMap<u32, Count> = BTreeMap::new();
    for (replicate, outcome) in outcomes {
        counts.entry(*replicate).or_default().add(*outcome);
    }
    if counts.len() > 1 { counts } else { BTreeMap::new() }
}

fn nominal_of_suite(records: &Records, suite: Suite) -> Count {
    let tasks = nominal_by_task(records, Some(suite));
    tasks.iter().fold(Count::default(), |sum, task| Count {
        successes: sum.successes + task.successes,
        n: sum.n + task.n,
    })
}

fn nominal_by_task(records: &Records, suite: Option<Suite>) -> Vec<Count> {
    let mut tasks: BTreeMap<TaskRef, Count> = BTreeMap::new();
    for (&(_, id), &outcome) in &records.outcomes {
        let is_nominal = id.condition() == Condition::Nominal;
        if is_nominal && suite.is_none_or(|suite| id.task().suite() == suite) {
            tasks.entry(id.task()).or_default().add(outcome);
        }
    }
    tasks.into_values().collect()
}

fn cell(
    records: &Records,
    matched: &[Matched],
    nominal_rate: Option<f64>,
    bootstrap: &Bootstrap,
) -> Cell {
    let axes = matched[0].alone.keys().copied();
    let mut conditions: Vec<Condition> = axes.clone().map(Condition::Single).collect();
    if records.has_simultaneous {
        conditions.push(Condition::Simultaneous);
    }
    let mut counts = BTreeMap::new();
    let mut gaps = BTreeMap::new();
    for &condition in &conditions {
        let (mut count, mut gap) = (Count::default(), Gap::default());
        for matched in matched {
            count.add(matched.outcome(condition));
            gap.add(matched.outcome(condition));
        }
        counts.insert(condition, count);
        if gap != Gap::default() {
            gaps.insert(condition, gap);
        }
    }
    let simultaneous = matched.iter().filter(|_| records.has_simultaneous);
    let simultaneous: Vec<_> = simultaneous.map(|m| (m.replicate, m.simultaneous)).collect();
    let complete: Vec<Configuration> = matched.iter().filter_map(Matched::configuration).collect();
    let solvable = matched.iter().filter(|m| m.nominal == Outcome::Success);
    let solvable: Vec<Configuration> = solvable.filter_map(Matched::configuration).collect();
    let alone = axes.map(|axis| {
        let count = counts[&Condition::Single(axis)];
        (axis, SingleAxis::new(count, nominal_rate))
    });
    let paired = Measures::of(&complete, bootstrap);
    let task_correlation = task_correlation(&complete);
    let minimum_detectable_i = paired.as_ref().and_then(|measures| {
        minimum_detectable_effect(&PairedDesign {
            tasks: measures.tasks as u32,
            configs_per_task: measures.n as f64 / measures.tasks as f64,
            r_d: measures.r_d,
            task_correlation: task_correlation?,
        })
    });
    Cell {
        level: matched[0].level,
        alone: alone.collect(),
        subsets: subsets(matched),
        simultaneous: counts.get(&Condition::Simultaneous).copied(),
        by_replicate: by_replicate(&simultaneous),
        completeness: Completeness {
            complete: complete.len() as u64,
            expected: matched.len() as u64,
            gaps,
        },
        paired,
        solvable: Measures::of(&solvable, bootstrap),
        bounds: Bounds::of(matched),
        task_correlation,
        inference: None,
        minimum_detectable_i,
    }
}

/// Counts the outcomes under each subset of the axes. A subset may run for some configurations
/// only, so that the numbers of rollouts may differ between subsets.
fn subsets(matched: &[Matched]) -> BTreeMap<AxisSet, Count> {
    let mut counts: BTreeMap<AxisSet, Count> = BTreeMap::new();
    for (&axes, &outcome) in matched.iter().flat_map(|matched| &matched.subsets) {
        counts.entry(axes).or_default().add(outcome);
    }
    counts
}

fn quarantined(records: &Records) -> Vec<String> {
    let outcomes = records.outcomes.iter();
    outcomes
        .filter(|(_, outcome)| **outcome == Outcome::Quarantined)
        .map(|((replicate, id), _)| match replicate {
            0 => id.to_string(),
            k => format!("{id}#r{k}"),
        })
        .collect()
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
    fn new(count: Count, nominal_rate: Option<f64>) -> Self {
        let loss = |rate: f64| {
            let nominal_rate = nominal_rate.filter(|&nominal_rate| nominal_rate > 0.0)?;
            Some(1.0 - rate / nominal_rate)
        };
        Self { count, nominal_relative_loss: count.rate().and_then(loss) }
    }
}
