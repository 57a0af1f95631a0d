//! Tables of the page. A table wider than the page scrolls in its own box.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;

use libero_ctrl::{Axis, Condition, Measure};
use maud::{Markup, Render, html};
use paired::{
    Bounds, Cell, Count, Gap, GateVerdict, Interval, Measures, NoInterval, Nominal, NominalSource,
    SuiteRow, TaskSuccess,
};

use crate::analysis::Analysis;
use crate::document::Document;
use crate::words::{self, percent, points, points_interval, rate_interval};

/// A row of a table: a policy and one of its cells.
#[derive(Clone, Copy)]
struct Row<'a> {
    policy: &'a str,
    cell: &'a Cell,
    overstated: &'a BTreeSet<Measure>,
}

fn rows(document: &Document) -> impl Iterator<Item = Row<'_>> {
    document.analyses.iter().flat_map(|analysis| {
        let policy = analysis.label.as_str();
        let overstated = &analysis.report.overstated;
        let row = move |cell| Row { policy, cell, overstated };
        analysis.report.cells.iter().map(row)
    })
}

/// Renders a table in a scrolling box that the keyboard reaches; empty without rows. A
/// column whose head ends with a full stop is aligned as text, every other column as numbers.
pub(super) fn table(name: &str, heads: &[&str], rows: Vec<Vec<Markup>>) -> Markup {
    let class = |column: usize| heads[column].ends_with('.').then_some("words");
    html! {
        @if !rows.is_empty() {
            div.scroll tabindex="0" role="region" aria-label=(name) {
                table {
                    thead {
                        tr {
                            @for (column, head) in heads.iter().enumerate() {
                                th scope="col" class=[class(column)] {
                                    (head.trim_end_matches('.'))
                                }
                            }
                        }
                    }
                    tbody {
                        @for row in &rows {
                            tr {
                                th scope="row" { (row[0]) }
                                @for (column, value) in row.iter().enumerate().skip(1) {
                                    td class=[class(column)] { (value) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

pub(super) fn plain(value: impl Display) -> Markup {
    html! { (value.to_string()) }
}

/// Renders a value, or a dash for `None`.
pub(super) fn or_dash(value: Option<impl Render>) -> Markup {
    html! { @if let Some(value) = value { (value) } @else { span.muted { "–" } } }
}

/// Renders a value with a line of smaller type below it.
pub(super) fn with_note(value: impl Display, below: &str) -> Markup {
    html! { (value.to_string()) @if !below.is_empty() { small { (below.trim_start()) } } }
}

fn rate(rate: f64, interval: Option<Interval>, reason: Option<NoInterval>) -> Markup {
    with_note(percent(rate), &rate_interval(interval, reason))
}

pub(super) fn difference(
    difference: f64,
    interval: Option<Interval>,
    reason: Option<NoInterval>,
) -> Markup {
    with_note(points(difference), &points_interval(interval, reason))
}

type Column = (&'static str, fn(&Measures) -> Markup);

const PAIRED: [Column; 12] = [
    ("S_indep %", |m| plain(percent(m.s_indep))),
    ("S_conj %", |m| plain(percent(m.s_conj))),
    ("S_sim %", |m| plain(percent(m.s_sim))),
    ("D points", |m| difference(m.d, m.d_ci95, m.no_interval)),
    ("I points", |m| difference(m.i, m.i_ci95, m.no_interval)),
    ("b", |m| plain(m.b)),
    ("c", |m| plain(m.c)),
    ("R_e %", |m| rate(m.r_e, m.r_e_ci95, m.no_interval)),
    ("R_c %", |m| rate(m.r_c, m.r_c_ci95, m.no_interval)),
    ("R_d %", |m| rate(m.r_d, m.r_d_ci95, m.no_interval)),
    ("emergent share %", |m| or_dash(m.emergent_share.map(percent))),
    ("McNemar p", |m| plain(words::p_value(m.mcnemar_p))),
];

/// Meaning of the star beside a measure.
const OVERSTATED: &str = "this measure is overstated, because the campaign ended when it was \
    large; the measure's confidence sequence bounds the overstatement";

/// Renders the table of paired measures by policy and level.
pub(super) fn paired(document: &Document) -> Markup {
    let mut heads = vec!["policy", "level", "n"];
    heads.extend(PAIRED.map(|(head, _)| head));
    heads.push("detectable |I|");
    let values = |row: Row| {
        let Row { policy, cell, overstated } = row;
        let completeness = &cell.completeness;
        let expected = match completeness.complete < completeness.expected {
            true => format!("of {}", completeness.expected),
            false => String::new(),
        };
        let mut values =
            vec![plain(policy), plain(cell.level), with_note(completeness.complete, &expected)];
        let measures = cell.paired.as_ref();
        values.extend(PAIRED.map(|(head, value)| {
            let is_overstated =
                overstated.iter().any(|measure| head.split(' ').next() == Some(measure.name()));
            html! {
                @if is_overstated { abbr title=(OVERSTATED) { "*" } }
                (or_dash(measures.map(value)))
            }
        }));
        values.push(or_dash(cell.minimum_detectable_i.map(percent)));
        values
    };
    html! {
        (table("Paired outcomes", &heads, rows(document).map(values).collect()))
        p.muted {
            "n: configurations of which all outcomes are known. b: every axis alone succeeds, the \
            simultaneous rollout fails (emergent). c: some axis alone fails, the simultaneous \
            rollout succeeds (compensated). R_e = b/n, R_c = c/n, R_d = R_e + R_c, I = R_c − R_e. \
            Emergent share: share of b in all simultaneous failures. In brackets, 95 % intervals; \
            where an interval would mislead, the reason (see Methods). Detectable |I|, in points: \
            the smallest net effect that this number of configurations, with this rate of changes, \
            shows in four of five repetitions."
            @if rows(document).any(|row| !row.overstated.is_empty()) { " *: " (OVERSTATED) "." }
        }
    }
}

/// Renders the table of nominal success with the verdict of the reproduction gate.
pub(super) fn nominal(document: &Document) -> Markup {
    let values = |analysis: &Analysis| {
        let nominal = analysis.report.nominal.as_ref()?;
        let gate = analysis.report.gate.as_ref();
        Some(vec![
            plain(&analysis.label),
            with_seeds(nominal.count.rate().map(percent), &nominal.by_replicate),
            nominal_counts(nominal),
            or_dash(gate.map(|gate| percent(gate.published))),
            plain(match gate.map(|gate| gate.verdict) {
                Some(GateVerdict::Passed) => "passed",
                Some(GateVerdict::Failed) => "failed: robustness is not to be interpreted",
                Some(GateVerdict::Undecided) => {
                    "undecided: not all 2,000 nominal rollouts have a result"
                }
                None => "no published figure",
            }),
        ])
    };
    let rows = document.analyses.iter().filter_map(values);
    let heads = ["policy", "nominal %", "counts", "published %", "gate."];
    table("Nominal success", &heads, rows.collect())
}

fn nominal_counts(nominal: &Nominal) -> Markup {
    let Count { successes, n } = nominal.count;
    let below = match nominal.source {
        NominalSource::Reported => Some("as reported".to_owned()),
        NominalSource::Records => gap_words(&nominal.gap),
    };
    with_note(format!("{successes}/{n}"), &below.unwrap_or_default())
}

fn gap_words(gap: &Gap) -> Option<String> {
    match (gap.missing, gap.quarantined) {
        (0, 0) => None,
        (missing, 0) => Some(format!("{missing} missing")),
        (0, quarantined) => Some(format!("{quarantined} quarantined")),
        (missing, quarantined) => Some(format!("{missing} missing, {quarantined} quarantined")),
    }
}

/// Renders the table of success under each single axis, with counts, losses and gaps.
pub(super) fn single_axes(document: &Document) -> Markup {
    let is_run = |axis: &Axis| rows(document).any(|row| row.cell.alone.contains_key(axis));
    let axes: Vec<Axis> = Axis::ALL.into_iter().filter(is_run).collect();
    let names: Vec<String> = axes.iter().map(|axis| format!("{axis} %")).collect();
    let mut heads = vec!["policy", "level"];
    heads.extend(names.iter().map(String::as_str));
    let has_latency = rows(document).any(|row| row.cell.latency.is_some());
    heads.extend(has_latency.then_some("latency %"));
    heads.push("simultaneous %");
    let values = |Row { policy, cell, .. }: Row| {
        let alone = |axis: &Axis| {
            let alone = cell.alone.get(axis);
            let loss = alone.and_then(|alone| alone.clean_relative_loss);
            let count = alone.map(|alone| alone.count);
            success(cell, Condition::Single(*axis), count, loss)
        };
        let mut values = vec![plain(policy), plain(cell.level)];
        values.extend(axes.iter().map(alone));
        values.extend(has_latency.then(|| {
            let latency = cell.latency.as_ref();
            let loss = latency.and_then(|latency| latency.clean_relative_loss);
            let count = latency.map(|latency| latency.count);
            success(cell, Condition::Latency, count, loss)
        }));
        let simultaneous = success(cell, Condition::Combination, cell.simultaneous, None);
        values.push(with_seeds(Some(simultaneous), &cell.by_replicate));
        values
    };
    html! {
        (table("Single axes", &heads, rows(document).map(values).collect()))
        p.muted {
            "Success over all rollouts that have a result, also of incomplete configurations. \
            Loss: 1 − success / nominal success, in percent."
        }
    }
}

/// Renders a rate with those of the single seeds below it.
fn with_seeds(value: Option<impl Render>, by_replicate: &BTreeMap<u32, Count>) -> Markup {
    let rates = by_replicate.values().map(|count| count.rate().map_or("–".to_owned(), percent));
    let rates: Vec<String> = rates.collect();
    html! {
        (or_dash(value))
        @if !rates.is_empty() { small { (rates.len()) " seeds: " (rates.join(", ")) } }
    }
}

/// Renders success by suite, and by task in a folded table.
pub(super) fn suites(analysis: &Analysis) -> Markup {
    let (report, suites) = (&analysis.report, analysis.report.suites());
    let mut heads = vec!["condition"];
    heads.extend(suites.iter().map(|suite| suite.name()));
    heads.push("mean of suites");
    let row = |row: SuiteRow| {
        let rates = row.suites.into_iter().chain([row.mean]);
        let rates = rates.map(|rate| or_dash(rate.map(percent)));
        [plain(row.name)].into_iter().chain(rates).collect()
    };
    let by_task: Vec<Vec<Markup>> = report
        .by_task
        .iter()
        .map(|row| {
            let TaskSuccess { level, condition, task, count } = row;
            let rate = or_dash(count.rate().map(percent));
            let counts = format!("{}/{}", count.successes, count.n);
            vec![plain(task), plain(level), plain(condition.label()), rate, plain(counts)]
        })
        .collect();
    html! {
        @if suites.len() > 1 {
            (table(&format!("{}: success by suite, %", analysis.label), &heads,
                report.suite_rows().into_iter().map(row).collect()))
        }
        @if !by_task.is_empty() {
            details {
                summary { (analysis.label) ": success by task" }
                (table("Success by task", &["task", "level.", "condition.", "success %", "counts"],
                    by_task))
            }
        }
    }
}

/// Renders the table of success under proper subsets of the axes, for campaigns that run
/// such subsets.
pub(super) fn subsets(document: &Document) -> Markup {
    let subset_rows = |Row { policy, cell, .. }: Row| {
        let subsets = cell.subsets.iter();
        let subsets = subsets.map(|(axes, count)| {
            vec![
                plain(policy),
                plain(cell.level),
                plain(axes),
                or_dash(count.rate().map(percent)),
                plain(format!("{}/{}", count.successes, count.n)),
            ]
        });
        subsets.collect::<Vec<_>>()
    };
    let heads = ["policy", "level", "axes.", "success %", "counts"];
    let rows: Vec<Vec<Markup>> = rows(document).flat_map(subset_rows).collect();
    html! {
        @if !rows.is_empty() {
            details {
                summary { "Success under several axes but not all: " (rows.len()) " rows" }
                (table("Several axes", &heads, rows))
            }
        }
    }
}

fn success(cell: &Cell, condition: Condition, count: Option<Count>, loss: Option<f64>) -> Markup {
    let Gap { missing, quarantined } =
        cell.completeness.gaps.get(&condition).copied().unwrap_or_default();
    html! {
        (or_dash(count.and_then(|count| count.rate()).map(percent)))
        @if let Some(Count { successes, n }) = count { small { (successes) "/" (n) } }
        @if let Some(loss) = loss { small { "loss " (percent(loss)) } }
        @if missing > 0 { small { (missing) " missing" } }
        @if quarantined > 0 { small { (quarantined) " quarantined" } }
    }
}

/// Renders the table of measures over solvable configurations only.
pub(super) fn solvable(document: &Document) -> Markup {
    let values = |Row { policy, cell, .. }: Row| {
        let m = cell.solvable.as_ref()?;
        Some(vec![
            plain(policy),
            plain(cell.level),
            plain(m.n),
            plain(m.b),
            plain(m.c),
            difference(m.i, m.i_ci95, m.no_interval),
            rate(m.r_e, m.r_e_ci95, m.no_interval),
            rate(m.r_c, m.r_c_ci95, m.no_interval),
            plain(words::p_value(m.mcnemar_p)),
        ])
    };
    let rows: Vec<Vec<Markup>> = rows(document).filter_map(values).collect();
    let heads = ["policy", "level", "n", "b", "c", "I points", "R_e %", "R_c %", "McNemar p"];
    html! {
        @if !rows.is_empty() {
            section {
                h2 { "Solvable configurations only" }
                p { "The same measures over configurations whose nominal rollout succeeds." }
                (table("Solvable configurations", &heads, rows))
            }
        }
    }
}

/// Renders the ranges of I, R_e, R_c, S_conj and S_sim over all possible outcomes of quarantined
/// rollouts.
pub(super) fn bounds(document: &Document) -> Markup {
    let range = |[low, high]: [f64; 2]| plain(format!("{} to {}", percent(low), percent(high)));
    let bounds_row = |policy: &str, cell: &Cell, bounds: &Bounds| {
        let [low, high] = bounds.i.map(points);
        vec![
            plain(policy),
            plain(cell.level),
            plain(bounds.n),
            plain(bounds.affected),
            plain(format!("{low} to {high}")),
            range(bounds.r_e),
            range(bounds.r_c),
            range(bounds.s_conj),
            range(bounds.s_sim),
        ]
    };
    let values = |row: Row| Some(bounds_row(row.policy, row.cell, row.cell.bounds.as_ref()?));
    let rows: Vec<Vec<Markup>> = rows(document).filter_map(values).collect();
    let heads =
        ["policy", "level", "n", "affected", "I points", "R_e %", "R_c %", "S_conj %", "S_sim %"];
    html! {
        @if !rows.is_empty() {
            section {
                h2 { "Worst and best case of quarantined rollouts" }
                p {
                    "Quarantined rollouts are excluded from every rate. Whatever their outcomes \
                    had been, the measures would lie within these bounds."
                }
                (table("Worst and best case", &heads, rows))
            }
        }
    }
}

/// Renders the table of quarantined rollouts with their last errors.
pub(super) fn quarantine(document: &Document) -> Markup {
    let quarantine_rows = |analysis: &Analysis| -> Vec<Vec<Markup>> {
        let errors = analysis.subject.errors.iter();
        let row = errors.map(|quarantined| {
            let rollout = html! { code { (quarantined.rollout) } };
            vec![rollout, plain(&analysis.label), plain(&quarantined.last_error)]
        });
        row.collect()
    };
    let rows: Vec<Vec<Markup>> = document.analyses.iter().flat_map(quarantine_rows).collect();
    html! {
        @if !rows.is_empty() {
            section {
                h2 { "Quarantine" }
                (table("Quarantine", &["rollout", "policy.", "last error."], rows))
            }
        }
    }
}
