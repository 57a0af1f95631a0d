//! A short report: the main findings and success by condition. The full report with all
//! measures, intervals and symbols is in [`table`](crate::table()).

use libero_ctrl::Condition;

use crate::by_task::SuiteRow;
use crate::finding::{Finding, FindingKind};
use crate::report::Report;
use crate::table::gate_lines;
use crate::text::{ABSENT, listed, percent, push_columns, push_wrapped, separate};

/// Writes the report for readers who do not know the protocol's symbols: notes, up to three
/// findings, success by condition in percent, the gates, and sentences about directions and
/// rollouts without an outcome. Of the findings about a level, and of
/// simultaneous success by suite, the text has only those at the last level.
pub fn brief(report: &Report) -> String {
    let mut text = String::new();
    for note in &report.notes {
        push_wrapped(&mut text, "! ", note);
    }
    separate(&mut text);
    let last = report.cells.last().map(|cell| cell.level);
    let findings = report.findings.iter();
    let findings = findings.filter(|finding| finding.level.is_none() || finding.level == last);
    let (directions, main): (Vec<&Finding>, Vec<&Finding>) =
        findings.partition(|finding| finding.kind == FindingKind::Directions);
    for finding in main {
        push_wrapped(&mut text, "", &finding.sentence);
    }
    push_success(&mut text, report);
    push_suites(&mut text, report, |row| match row.condition {
        Condition::Clean => true,
        condition => condition == Condition::Combination && Some(row.level) == last,
    });
    separate(&mut text);
    text.push_str(&gate_lines(report));
    for finding in directions {
        push_wrapped(&mut text, "", &finding.sentence);
    }
    if let Some(sentence) = incomplete(report) {
        push_wrapped(&mut text, "", &sentence);
    }
    text
}

/// Appends the success table: a row per level, a column per condition.
fn push_success(text: &mut String, report: &Report) {
    let has_latency = report.cells.iter().any(|cell| cell.latency.is_some());
    if report.axes.is_empty() && !has_latency {
        return;
    }
    let has_simultaneous = report.cells.iter().any(|cell| cell.simultaneous.is_some());
    let singles = report.axes.iter().copied().map(Condition::Single);
    let columns: Vec<Condition> = [Condition::Clean]
        .into_iter()
        .chain(singles)
        .chain(has_latency.then_some(Condition::Latency))
        .chain(has_simultaneous.then_some(Condition::Combination))
        .collect();
    let head = columns.iter().map(|column| column.label().to_owned()).collect();
    let mut rows = vec![(String::new(), head)];
    for cell in &report.cells {
        let success = |condition: &Condition| {
            let count = match condition {
                Condition::Clean => report.nominal.as_ref().map(|nominal| nominal.count),
                Condition::Single(axis) => cell.alone.get(axis).map(|alone| alone.count),
                Condition::Latency => cell.latency.as_ref().map(|latency| latency.count),
                _ => cell.simultaneous,
            };
            match count.and_then(|count| count.rate()) {
                None => ABSENT.to_owned(),
                rate => percent(rate),
            }
        };
        rows.push((cell.level.to_string(), columns.iter().map(success).collect()));
    }
    separate(text);
    text.push_str("success, %\n");
    push_columns(text, &rows);
}

/// Appends success by suite, the rows that `is_shown`; nothing for a single suite.
pub(crate) fn push_suites(
    text: &mut String,
    report: &Report,
    is_shown: impl Fn(&SuiteRow) -> bool,
) {
    let suites = report.suites();
    if suites.len() < 2 {
        return;
    }
    let heads = suites.iter().map(|suite| suite.short_name().to_owned());
    let heads = heads.chain(["mean".to_owned()]).collect();
    let mut rows = vec![(String::new(), heads)];
    for row in report.suite_rows().into_iter().filter(is_shown) {
        let rates = row.suites.into_iter().chain([row.mean]);
        let rates = rates.map(|rate| rate.map_or_else(|| ABSENT.to_owned(), |_| percent(rate)));
        rows.push((row.name, rates.collect()));
    }
    separate(text);
    text.push_str("success by suite, and the mean of the suites, %\n");
    push_columns(text, &rows);
}

/// Returns the sentence about rollouts without an outcome; `None` if there are none.
fn incomplete(report: &Report) -> Option<String> {
    let mut gaps: Vec<_> = report.nominal.iter().map(|nominal| nominal.gap).collect();
    gaps.extend(report.cells.iter().flat_map(|cell| cell.completeness.gaps.values().copied()));
    let missing: u64 = gaps.iter().map(|gap| gap.missing).sum();
    let quarantined: u64 = gaps.iter().map(|gap| gap.quarantined).sum();
    let parts = [
        (missing, ["has", "have"], "no outcome yet"),
        (quarantined, ["is", "are"], "in quarantine"),
    ];
    let parts = parts.into_iter().filter(|(count, ..)| *count > 0);
    let parts = parts.map(|(count, [singular, plural], state)| {
        let verb = if count == 1 { singular } else { plural };
        format!("{count} {verb} {state}")
    });
    let parts: Vec<String> = parts.collect();
    (!parts.is_empty()).then(|| format!("Of the rollouts, {}.", listed(&parts)))
}
