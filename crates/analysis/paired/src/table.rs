//! A report as text for a terminal of 80 columns: notes, success rates with their
//! counts, paired measures, and missing outcomes.

use std::collections::BTreeSet;
use std::fmt::Write;

use libero_ctrl::{AxisSet, Condition, Measure};

use crate::bounds::Bounds;
use crate::brief::push_suites;
use crate::count::Count;
use crate::findings::seeds;
use crate::gate::{
    GATE_ROLLOUTS, GATE_ROLLOUTS_OF_A_SUITE, GATE_TOLERANCE, Gate, GateVerdict, SuiteGate,
};
use crate::inference::components::Components;
use crate::inference_table::push_inference;
use crate::measures::Measures;
use crate::replication::Flips;
use crate::report::{Cell, Gap, Nominal, NominalSource, Report};
use crate::text::{
    ABSENT, p_value, percent, points, points_interval, push_columns, push_row, push_wrapped, rate,
    rate_interval, separate,
};

/// Width of the column of labels in tables with a column per level.
const LABEL_WIDTH: usize = 20;
/// Width of the column of a level.
const COLUMN_WIDTH: usize = 19;
/// Largest number of levels side by side.
const MAX_CELLS: usize = 3;
/// Largest number of quarantined rollouts that are named; further ones are only counted.
const MAX_NAMED: usize = 6;

/// Writes the report as a table. Rates are in percent, differences in percentage points;
/// [`legend`](crate::legend()) explains the symbols.
pub fn table(report: &Report) -> String {
    let mut text = String::new();
    for note in &report.notes {
        push_wrapped(&mut text, "! ", note);
    }
    if !report.quarantined.is_empty() {
        push_wrapped(&mut text, "! ", &quarantined(&report.quarantined));
    }
    if let Some(nominal) = &report.nominal {
        separate(&mut text);
        push_wrapped(&mut text, "", &nominal_line(nominal));
    }
    text.push_str(&gate_lines(report));
    let cells: Vec<&Cell> = report.cells.iter().collect();
    push_rates(&mut text, report, &cells);
    push_suites(&mut text, report, |_| true);
    push_subsets(&mut text, &cells);
    if cells.iter().any(|cell| cell.simultaneous.is_some()) {
        for cells in cells.chunks(MAX_CELLS) {
            push_paired(&mut text, cells, &report.overstated);
        }
        push_inference(&mut text, &cells);
    }
    push_gaps(&mut text, &cells);
    push_replication(&mut text, report);
    text
}

fn quarantined(names: &[String]) -> String {
    let named = names[..names.len().min(MAX_NAMED)].join(", ");
    let more = match names.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    format!("in quarantine and excluded from every rate ({}): {named}{more}", names.len())
}

fn nominal_line(nominal: &Nominal) -> String {
    let seeds = seeds(&nominal.by_replicate);
    let Count { successes, n } = nominal.count;
    let rate = percent(nominal.count.rate());
    let missing = match gap_text(&nominal.gap) {
        Some(gap) => format!("; {gap}"),
        None => String::new(),
    };
    let source = match nominal.source {
        NominalSource::Records => "",
        NominalSource::Reported => ", as reported",
    };
    format!("nominal success: {rate} % ({successes}/{n}{source}){seeds}{missing}")
}

/// Writes the verdicts of the gates over all suites and for single suites.
pub fn gate_lines(report: &Report) -> String {
    let mut text = String::new();
    if let Some(gate) = &report.gate {
        let remedy = "if only one suite was run, give its published figure as \
                      `--published SUITE:POLICY=PERCENT`";
        push_wrapped(&mut text, "", &gate_line("", gate, GATE_ROLLOUTS, remedy));
    }
    for SuiteGate { suite, gate } in &report.suite_gates {
        let suffix = format!(" of {suite}");
        let remedy = "create the campaign with `--nominal all`";
        let line = gate_line(&suffix, gate, GATE_ROLLOUTS_OF_A_SUITE, remedy);
        push_wrapped(&mut text, "", &line);
    }
    text
}

fn gate_line(suffix: &str, gate: &Gate, rollouts: u64, remedy: &str) -> String {
    let verdict = match gate.verdict {
        GateVerdict::Passed => "passed".to_owned(),
        GateVerdict::Failed => "FAILED: robustness is not to be interpreted".to_owned(),
        GateVerdict::Undecided => format!(
            "undecided: {} of {rollouts} nominal rollouts have a result; {remedy}",
            gate.nominal.n
        ),
    };
    let difference = gate.difference.map_or_else(|| ABSENT.to_owned(), points);
    let equivalence = match gate.equivalence_p {
        Some(p) if p < 0.05 => {
            format!("; the rate is significantly within the tolerance (p = {})", p_value(p))
        }
        Some(p) if gate.verdict == GateVerdict::Passed => format!(
            "; the rate is not significantly within the tolerance (p = {}): run more nominal \
             rollouts",
            p_value(p)
        ),
        _ => String::new(),
    };
    format!(
        "reproduction gate{suffix}: {difference} points from the published {} %, tolerance {:.0}: \
         {verdict}{equivalence}",
        percent(Some(gate.published)),
        100.0 * GATE_TOLERANCE
    )
}

fn push_rates(text: &mut String, report: &Report, cells: &[&Cell]) {
    let has_latency = cells.iter().any(|cell| cell.latency.is_some());
    if report.axes.is_empty() && !has_latency {
        return;
    }
    separate(text);
    let has_loss = |cell: &&Cell| {
        let mut axes = cell.alone.values().chain(&cell.latency);
        axes.any(|axis| axis.clean_relative_loss.is_some())
    };
    let has_loss = cells.iter().any(has_loss);
    let title = match has_loss {
        true => "success, its counts, and the loss against nominal, %",
        false => "success, and its counts, %",
    };
    let _ = writeln!(text, "{title}");
    let has_simultaneous = cells.iter().any(|cell| cell.simultaneous.is_some());
    let singles = report.axes.iter().copied().map(Condition::Single);
    let columns: Vec<Condition> = singles
        .chain(has_latency.then_some(Condition::Latency))
        .chain(has_simultaneous.then_some(Condition::Combination))
        .collect();
    let row = |label: &str, value: &dyn Fn(Condition) -> String| -> (String, Vec<String>) {
        (label.to_owned(), columns.iter().copied().map(value).collect())
    };
    let mut rows = vec![row("", &|condition| condition.label().to_owned())];
    for cell in cells {
        let count = |condition| match condition {
            Condition::Single(axis) => cell.alone.get(&axis).map(|alone| alone.count),
            Condition::Latency => cell.latency.as_ref().map(|latency| latency.count),
            _ => cell.simultaneous,
        };
        let loss = |condition| match condition {
            Condition::Single(axis) => percent(cell.alone[&axis].clean_relative_loss),
            Condition::Latency => {
                percent(cell.latency.as_ref().and_then(|latency| latency.clean_relative_loss))
            }
            _ => String::new(),
        };
        let success = |condition| match count(condition).and_then(|count| count.rate()) {
            Some(success) => rate(success),
            None => ABSENT.to_owned(),
        };
        let counts = |condition| match count(condition) {
            Some(Count { successes, n }) => format!("{successes}/{n}"),
            None => ABSENT.to_owned(),
        };
        rows.push(row(&cell.level.to_string(), &success));
        rows.push(row(" counts", &counts));
        if has_loss {
            rows.push(row(" loss", &loss));
        }
    }
    push_columns(text, &rows);
}

/// Appends success under subsets of two or more axes, a line for each subset.
fn push_subsets(text: &mut String, cells: &[&Cell]) {
    let sets: BTreeSet<AxisSet> =
        cells.iter().flat_map(|cell| cell.subsets.keys().copied()).collect();
    if sets.is_empty() {
        return;
    }
    separate(text);
    let _ = writeln!(text, "success under several axes, and its counts, %");
    for cells in cells.chunks(MAX_CELLS) {
        let levels = cells.iter().map(|cell| cell.level.to_string());
        push_row(text, LABEL_WIDTH, COLUMN_WIDTH, "", levels);
        for set in &sets {
            let success = cells.iter().map(|cell| match cell.subsets.get(set) {
                Some(count) => {
                    format!("{} ({}/{})", percent(count.rate()), count.successes, count.n)
                }
                None => ABSENT.to_owned(),
            });
            // A name that is too long for the column gets its own line.
            let name = set.name();
            let label = match name.len() < LABEL_WIDTH {
                true => name,
                false => {
                    let _ = writeln!(text, "{name}");
                    ""
                }
            };
            push_row(text, LABEL_WIDTH, COLUMN_WIDTH, label, success);
        }
    }
}

/// One line of the block of paired measures: its label and the function that formats a value.
type Line = (&'static str, fn(&Measures) -> String);

const PAIRED_LINES: [Line; 17] = [
    ("S_indep", |m| rate(m.s_indep)),
    ("S_conj", |m| rate(m.s_conj)),
    ("S_sim", |m| rate(m.s_sim)),
    ("D = S_conj-S_indep", |m| points(m.d)),
    ("  95 %", |m| points_interval(m.d_ci95, m.no_interval)),
    ("I = S_sim-S_conj", |m| points(m.i)),
    ("  95 %", |m| points_interval(m.i_ci95, m.no_interval)),
    ("b emergent", |m| m.b.to_string()),
    ("c compensated", |m| m.c.to_string()),
    ("R_e = b/n", |m| rate(m.r_e)),
    ("  95 %", |m| rate_interval(m.r_e_ci95, m.no_interval)),
    ("R_c = c/n", |m| rate(m.r_c)),
    ("  95 %", |m| rate_interval(m.r_c_ci95, m.no_interval)),
    ("R_d = R_e+R_c", |m| rate(m.r_d)),
    ("  95 %", |m| rate_interval(m.r_d_ci95, m.no_interval)),
    ("emergent share", |m| percent(m.emergent_share)),
    ("McNemar p", |m| p_value(m.mcnemar_p)),
];

const SOLVABLE_LINES: [Line; 4] = [
    ("solvable: n", |m| m.n.to_string()),
    ("  b, c", |m| format!("{}, {}", m.b, m.c)),
    ("  I", |m| points(m.i)),
    ("    95 %", |m| points_interval(m.i_ci95, m.no_interval)),
];

/// One line of the block of worst and best cases.
type BoundsLine = (&'static str, fn(&Bounds) -> String);

/// Lines of the ranges of measures over all possible outcomes of quarantined rollouts.
const BOUNDS_LINES: [BoundsLine; 4] = [
    ("worst and best: n", |b| b.n.to_string()),
    ("  I", |b| points_interval(Some(b.i), None)),
    ("  R_e", |b| rate_interval(Some(b.r_e), None)),
    ("  R_c", |b| rate_interval(Some(b.r_c), None)),
];

/// Appends a star to the label if the campaign's early end overstates the measure.
fn starred(label: &str, overstated: &BTreeSet<Measure>) -> String {
    let measure = match label {
        "S_sim" => Some(Measure::SSim),
        "I = S_sim-S_conj" => Some(Measure::I),
        "R_e = b/n" => Some(Measure::RE),
        "R_c = c/n" => Some(Measure::RC),
        "R_d = R_e+R_c" => Some(Measure::RD),
        _ => None,
    };
    match measure.is_some_and(|measure| overstated.contains(&measure)) {
        true => format!("{label} *"),
        false => label.to_owned(),
    }
}

fn push_paired(text: &mut String, cells: &[&Cell], overstated: &BTreeSet<Measure>) {
    separate(text);
    let _ = writeln!(text, "paired outcomes of complete configurations, %");
    let levels = cells.iter().map(|cell| cell.level.to_string());
    push_row(text, LABEL_WIDTH, COLUMN_WIDTH, "", levels);
    let complete = cells.iter().map(|cell| {
        let completeness = &cell.completeness;
        format!("{} of {}", completeness.complete, completeness.expected)
    });
    push_row(text, LABEL_WIDTH, COLUMN_WIDTH, "n complete", complete);
    for (label, value) in PAIRED_LINES {
        let values = cells.iter().map(|cell| value_or_dash(cell.paired.as_ref(), value));
        let label = starred(label, overstated);
        push_row(text, LABEL_WIDTH, COLUMN_WIDTH, &label, values);
    }
    let detectable = cells.iter().map(|cell| match cell.minimum_detectable_i {
        Some(i) => format!("{:.2}", 100.0 * i),
        None => ABSENT.to_owned(),
    });
    push_row(text, LABEL_WIDTH, COLUMN_WIDTH, "detectable |I|", detectable);
    if cells.iter().any(|cell| cell.solvable.is_some()) {
        for (label, value) in SOLVABLE_LINES {
            let values = cells.iter().map(|cell| value_or_dash(cell.solvable.as_ref(), value));
            push_row(text, LABEL_WIDTH, COLUMN_WIDTH, label, values);
        }
    }
    if cells.iter().any(|cell| cell.bounds.is_some()) {
        for (label, value) in BOUNDS_LINES {
            let values = cells.iter().map(|cell| match &cell.bounds {
                Some(bounds) => value(bounds),
                None => ABSENT.to_owned(),
            });
            push_row(text, LABEL_WIDTH, COLUMN_WIDTH, label, values);
        }
    }
}

fn push_gaps(text: &mut String, cells: &[&Cell]) {
    let mut is_separated = false;
    for cell in cells {
        let gaps = cell.completeness.gaps.iter();
        let gaps: Vec<String> = gaps
            .filter_map(|(condition, gap)| {
                Some(format!("{} {}", condition.label(), gap_text(gap)?))
            })
            .collect();
        if gaps.is_empty() {
            continue;
        }
        if !is_separated {
            separate(text);
            is_separated = true;
        }
        let prefix = format!("incomplete {}: ", cell.level);
        push_wrapped(text, &prefix, &gaps.join("; "));
    }
}

fn push_replication(text: &mut String, report: &Report) {
    if report.flips.is_empty() {
        return;
    }
    separate(text);
    let flips = report.flips.iter().map(|(condition, flips)| {
        let Flips { compared, flipped } = flips;
        format!("{} {} % ({flipped}/{compared})", condition.label(), percent(flips.rate()))
    });
    let flips: Vec<String> = flips.collect();
    push_wrapped(text, "", &format!("outcomes that another seed changes: {}", flips.join(", ")));
    for cell in report.cells.iter().filter(|cell| !cell.by_replicate.is_empty()) {
        let line = format!("simultaneous at {}{}", cell.level, seeds(&cell.by_replicate));
        push_wrapped(text, "", &line);
    }
    for components in &report.components {
        let Components { level, replicates, tasks, configurations, replicate, .. } = components;
        let total = tasks + configurations + replicate;
        if total <= 0.0 {
            continue;
        }
        let share = |part: &f64| format!("{:.0} %", 100.0 * part / total);
        let effect = components.design_effect;
        let effect =
            effect.map_or_else(String::new, |effect| format!("; design effect {effect:.1}"));
        let line = format!(
            "variance of S_sim at {level}, {replicates} replicates: {} between tasks, {} between \
             configurations, {} chance{effect}; standard error {} points, {} with one more \
             replicate, {} with ten more configurations of every task",
            share(tasks),
            share(configurations),
            share(replicate),
            rate(components.standard_error),
            rate(components.one_more_replicate),
            rate(components.ten_more_configurations),
        );
        push_wrapped(text, "", &line);
    }
}

fn gap_text(gap: &Gap) -> Option<String> {
    match (gap.missing, gap.quarantined) {
        (0, 0) => None,
        (missing, 0) => Some(format!("{missing} missing")),
        (0, quarantined) => Some(format!("{quarantined} quarantined")),
        (missing, quarantined) => Some(format!("{missing} missing, {quarantined} quarantined")),
    }
}

fn value_or_dash(measures: Option<&Measures>, value: fn(&Measures) -> String) -> String {
    measures.map_or_else(|| ABSENT.to_owned(), value)
}
