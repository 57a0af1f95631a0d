//! Evaluation of records into a report: groups them into cells, computes
//! the paired measures over the complete configurations and counts the missing outcomes. The
//! formulas are in `measures`.

use std::collections::{BTreeMap, BTreeSet};

use libero_ctrl::{AxisSet, Condition, Level, Suite, TaskRef};

use crate::bootstrap::Bootstrap;
use crate::bounds::Bounds;
use crate::count::Count;
use crate::design::{PairedDesign, minimum_detectable_effect, task_correlation};
use crate::findings::findings;
use crate::gate::{Gate, SuiteGate};
use crate::inference::Inference;
use crate::inference::components::Components;
use crate::measures::{Configuration, Measures};
use crate::outcomes::{DuplicateRecord, Matched, Outcome, Record, Records};
use crate::replication::Replication;
use crate::report::{Cell, Completeness, Gap, Nominal, NominalSource, Options, Report, SingleAxis};

/// Reports on one policy's records. `records` should hold every planned rollout, including
/// those without a result, because the expected conditions are derived from them.
///
/// # Errors
/// If a rollout is recorded twice in the same replicate.
pub fn report(records: &[Record], options: &Options) -> Result<Report, DuplicateRecord> {
    Ok(report_of(&Records::new(records)?, options))
}

/// Reports on matched records.
pub fn report_of(records: &Records, options: &Options) -> Report {
    let replicates: BTreeSet<u32> = records.outcomes.keys().map(|key| key.0).collect();
    let mut nominal: Vec<Nominal> =
        replicates.iter().filter_map(|&replicate| nominal(records, replicate)).collect();
    if let (true, Some(count)) = (nominal.is_empty(), options.reported_nominal) {
        nominal.push(Nominal {
            replicate: 0,
            source: NominalSource::Reported,
            count,
            gap: Gap::default(),
        });
    }
    let first_nominal = nominal.iter().find(|nominal| nominal.replicate == 0);
    let first_nominal = first_nominal.map_or(Count::default(), |nominal| nominal.count);
    let cells = records.configurations();
    let cells = cells.chunk_by(|a, b| (a.replicate, a.level) == (b.replicate, b.level));
    let placebos = cells.clone().filter(|matched| matched[0].level == Level::L0);
    let placebos: BTreeMap<u32, &[Matched]> =
        placebos.map(|matched| (matched[0].replicate, matched)).collect();
    let cells = cells.map(|matched| {
        let replicate = matched[0].replicate;
        let of_replicate = nominal.iter().find(|nominal| nominal.replicate == replicate);
        let nominal_rate = of_replicate.and_then(|nominal| nominal.count.rate());
        let placebo = placebos.get(&replicate).copied();
        let inference = Inference::of(matched, placebo, options.directions);
        Cell { inference, ..cell(records, matched, nominal_rate, &options.bootstrap) }
    });
    let cells = cells.collect();
    let later = replicates.iter().filter(|&&replicate| replicate > 0);
    let later = later.map(|&replicate| Replication::of(records, replicate, &options.bootstrap));
    let mut report = Report {
        findings: Vec::new(),
        components: Components::of_each(records.configurations()),
        notes: options.notes.clone(),
        overstated: options.overstated.clone(),
        directions: options.directions,
        axes: records.axes().collect(),
        gate: options
            .published_nominal
            .map(|rate| Gate::new(rate, first_nominal).with_tasks(&nominal_by_task(records, None))),
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
        replication: later.collect(),
        quarantined: quarantined(records),
        bootstrap: options.bootstrap,
    };
    report.findings = findings(&report);
    report
}

fn nominal(records: &Records, replicate: u32) -> Option<Nominal> {
    let (mut count, mut gap) = (Count::default(), Gap::default());
    let mut has_nominal = false;
    for (&(number, id), &outcome) in &records.outcomes {
        if number == replicate && id.condition() == Condition::Clean {
            has_nominal = true;
            count.add(outcome);
            gap.add(outcome);
        }
    }
    has_nominal.then_some(Nominal { replicate, source: NominalSource::Records, count, gap })
}

/// Counts the nominal rollouts of one suite in replicate 0.
fn nominal_of_suite(records: &Records, suite: Suite) -> Count {
    let tasks = nominal_by_task(records, Some(suite));
    tasks.iter().fold(Count::default(), |sum, task| Count {
        successes: sum.successes + task.successes,
        n: sum.n + task.n,
    })
}

/// Counts the nominal rollouts of each task in replicate 0, for one suite or for all suites.
fn nominal_by_task(records: &Records, suite: Option<Suite>) -> Vec<Count> {
    let mut tasks: BTreeMap<TaskRef, Count> = BTreeMap::new();
    for (&(replicate, id), &outcome) in &records.outcomes {
        let is_nominal = replicate == 0 && id.condition() == Condition::Clean;
        if is_nominal && suite.is_none_or(|suite| id.task().suite() == suite) {
            tasks.entry(id.task()).or_default().add(outcome);
        }
    }
    tasks.into_values().collect()
}

/// Computes the cell of all configurations of one level and replicate.
fn cell(
    records: &Records,
    matched: &[Matched],
    nominal_rate: Option<f64>,
    bootstrap: &Bootstrap,
) -> Cell {
    let mut conditions: Vec<Condition> = records.axes().map(Condition::Single).collect();
    let has_latency = matched.iter().any(|matched| matched.latency.is_some());
    conditions.extend(has_latency.then_some(Condition::Latency));
    if records.has_simultaneous {
        conditions.push(Condition::Combination);
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
    let complete: Vec<Configuration> = matched.iter().filter_map(Matched::configuration).collect();
    let solvable = matched.iter().filter(|m| m.nominal == Outcome::Success);
    let solvable: Vec<Configuration> = solvable.filter_map(Matched::configuration).collect();
    let alone = records.axes().map(|axis| {
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
        replicate: matched[0].replicate,
        level: matched[0].level,
        alone: alone.collect(),
        latency: has_latency.then(|| SingleAxis::new(counts[&Condition::Latency], nominal_rate)),
        subsets: subsets(matched),
        simultaneous: counts.get(&Condition::Combination).copied(),
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
        Self { count, clean_relative_loss: count.rate().and_then(loss) }
    }
}
