//! A report in a few lines: success by condition, and what a reader takes away from it.
//! All measures, their intervals and their symbols are in [`table`](crate::table).

use protocol::{Axis, Condition};

use crate::count::Count;
use crate::report::{Cell, Report};
use crate::table::gate_lines;
use crate::text::{NOTHING, percent, push_columns, push_wrapped, separate};

/// The report for readers who do not know the protocol's symbols: notes, success by
/// condition in percent, and at most four sentences. Of replicate 0.
pub fn brief(report: &Report) -> String {
    let mut text = String::new();
    for note in &report.notes {
        push_wrapped(&mut text, "! ", note);
    }
    push_success(&mut text, report);
    separate(&mut text);
    text.push_str(&gate_lines(report));
    for sentence in sentences(report) {
        push_wrapped(&mut text, "", &sentence);
    }
    text
}

fn cells(report: &Report) -> impl Iterator<Item = &Cell> {
    report.cells.iter().filter(|cell| cell.replicate == 0)
}

fn nominal(report: &Report) -> Option<Count> {
    let mut nominal = report.nominal.iter();
    nominal.find(|it| it.replicate == 0).map(|it| it.count)
}

/// A row per level, a column per condition.
fn push_success(text: &mut String, report: &Report) {
    if report.axes.is_empty() {
        return;
    }
    let has_simultaneous = cells(report).any(|cell| cell.simultaneous.is_some());
    let singles = report.axes.iter().copied().map(Condition::Single);
    let columns: Vec<Condition> = [Condition::Clean]
        .into_iter()
        .chain(singles)
        .chain(has_simultaneous.then_some(Condition::Combination))
        .collect();
    let head = columns.iter().map(|it| it.label().to_owned()).collect();
    let mut rows = vec![(String::new(), head)];
    for cell in cells(report) {
        let success = |condition: &Condition| {
            let count = match condition {
                Condition::Clean => nominal(report),
                Condition::Single(axis) => cell.alone.get(axis).map(|alone| alone.count),
                _ => cell.simultaneous,
            };
            match count.and_then(|count| count.rate()) {
                None => NOTHING.to_owned(),
                rate => percent(rate),
            }
        };
        rows.push((
            cell.level.to_string(),
            columns.iter().map(success).collect(),
        ));
    }
    separate(text);
    text.push_str("success, %\n");
    push_columns(text, &rows);
}

fn sentences(report: &Report) -> Vec<String> {
    let last = cells(report).last();
    let sentences = [
        overall(report),
        last.and_then(|cell| costliest(cell, nominal(report)?.rate()?)),
        last.and_then(changed),
        unfinished(report),
    ];
    sentences.into_iter().flatten().collect()
}

/// Nominal and simultaneous success.
fn overall(report: &Report) -> Option<String> {
    let nominal = nominal(report)?;
    let mut sentence = match nominal.n {
        0 => "No nominal rollout has an outcome yet".to_owned(),
        n => format!(
            "Nominally, {} % of {n} rollouts succeed",
            percent(nominal.rate())
        ),
    };
    let at_levels: Vec<String> = cells(report)
        .filter_map(|cell| {
            let rate = cell.simultaneous?.rate()?;
            Some(format!("{} % at {}", percent(Some(rate)), cell.level))
        })
        .collect();
    if !at_levels.is_empty() {
        let at_levels = listed(&at_levels);
        sentence.push_str(&format!("; under simultaneous perturbation, {at_levels}"));
    }
    Some(sentence + ".")
}

/// The single axes under which the fewest rollouts succeed.
fn costliest(cell: &Cell, nominal: f64) -> Option<String> {
    let rates = cell.alone.iter();
    let rates: Vec<(Axis, f64)> = rates
        .filter_map(|(axis, alone)| Some((*axis, alone.count.rate()?)))
        .collect();
    let lowest = rates.iter().map(|(_, rate)| *rate).reduce(f64::min)?;
    let level = cell.level;
    if lowest >= nominal {
        return Some(format!(
            "No single axis costs success at {level}: none is below the nominal rate."
        ));
    }
    let names: Vec<String> = rates
        .iter()
        .filter(|(_, rate)| *rate <= lowest)
        .map(|(axis, _)| axis.name().to_owned())
        .collect();
    let verb = match names.len() {
        1 => "costs",
        _ => "cost",
    };
    Some(format!(
        "Of the single axes, {} {verb} the most: {} % succeed at {level}, {} points below nominal.",
        listed(&names),
        percent(Some(lowest)),
        percent(Some(nominal - lowest)),
    ))
}

/// The outcomes that simultaneous perturbation changes.
fn changed(cell: &Cell) -> Option<String> {
    let measures = cell.paired.as_ref()?;
    Some(format!(
        "Of {} at {} with all their outcomes, {} under every axis alone and {} simultaneously \
         (emergent); {} under some axis alone and {} simultaneously (compensated).",
        configurations(measures.n),
        cell.level,
        verb(measures.b, "succeeds", "succeed"),
        if measures.b == 1 { "fails" } else { "fail" },
        verb(measures.c, "fails", "fail"),
        if measures.c == 1 {
            "succeeds"
        } else {
            "succeed"
        },
    ))
}

fn unfinished(report: &Report) -> Option<String> {
    let mut gaps: Vec<_> = report
        .nominal
        .iter()
        .filter(|it| it.replicate == 0)
        .map(|it| it.gap)
        .collect();
    gaps.extend(cells(report).flat_map(|cell| cell.completeness.gaps.values().copied()));
    let missing: u64 = gaps.iter().map(|gap| gap.missing).sum();
    let quarantined: u64 = gaps.iter().map(|gap| gap.quarantined).sum();
    let missing = (missing > 0).then(|| format!("{missing} have no outcome yet"));
    let quarantined = (quarantined > 0).then(|| format!("{quarantined} are in quarantine"));
    let parts: Vec<String> = missing.into_iter().chain(quarantined).collect();
    (!parts.is_empty()).then(|| format!("Of the rollouts, {}.", listed(&parts)))
}

fn configurations(n: u64) -> String {
    match n {
        1 => "1 configuration".to_owned(),
        n => format!("{n} configurations"),
    }
}

fn verb(count: u64, one: &str, several: &str) -> String {
    match count {
        1 => format!("1 {one}"),
        count => format!("{count} {several}"),
    }
}

/// `a`, `a and b`, `a, b and c`.
fn listed(parts: &[String]) -> String {
    match parts {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}
