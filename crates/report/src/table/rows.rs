//! Rows of the tables and their columns.

use std::io::Write;

use benchmark::{Axis, Condition, Execution, JsonError};
use paired::adaptive::subsets::{Answer, Explained, MinimalSubset};
use paired::{Matched, Outcome, Progress};
use serde::Deserialize;

use super::Kind::{Bool, Integer, Number, Real, Text};
use super::{Column, Table, TableError, Value, columns, number, text};
use crate::analysis::Analysis;
use crate::document::Document;
use crate::explanation::Findings;
use crate::threshold_report::{Measured, ThresholdReport};

type OfConfiguration<'a> = (&'a Analysis, &'a Matched);

/// A row per policy, replicate, level, task and configuration, with all its outcomes.
///
/// An outcome is true, false or empty. For each empty outcome of a perturbed condition that the
/// campaign runs, the column `unresolved` says whether the rollout is missing or quarantined. For
/// nominal, single-axis and simultaneous rollouts, `…_goal` is the largest share of the goal's
/// predicates that held together, and `…_steps` the number of control steps.
pub(super) fn configurations(document: &Document) -> Table<'_, OfConfiguration<'_>> {
    let rows = document.analyses.iter().flat_map(|analysis| {
        let configurations = analysis.records.configurations().iter();
        configurations.map(move |matched| (analysis, matched))
    });
    Table { name: "configurations", columns: configuration_columns(), rows: rows.collect() }
}

fn configuration_columns<'a>() -> Vec<Column<'a, OfConfiguration<'a>>> {
    let first: Vec<Column<'a, OfConfiguration<'a>>> = columns([
        ("policy", Text, |(a, _)| text(&a.label)),
        ("origin", Text, |(a, _)| text(a.subject.origin_name())),
        ("replicate", Number, |(_, m)| number(m.replicate)),
        ("level", Text, |(_, m)| text(m.level)),
        ("suite", Text, |(_, m)| text(m.task.suite().name())),
        ("task", Number, |(_, m)| number(m.task.index())),
        ("config", Number, |(_, m)| number(m.config)),
        ("init_id", Number, |(_, m)| number(m.init_id)),
        ("nominal", Bool, |(_, m)| Value::Bool(m.nominal.success())),
    ]);
    let alone = Axis::every().map(|axis| -> Column<'a, OfConfiguration<'a>> {
        (axis.name().to_owned(), Bool, Box::new(move |(_, m)| alone(m, axis)))
    });
    let joint: Vec<Column<'a, OfConfiguration<'a>>> = columns([
        ("conjunction", Bool, |(_, m)| Value::Bool(m.configuration().map(|c| c.conjunction()))),
        ("simultaneous", Bool, |(_, m)| Value::Bool(m.simultaneous.success())),
        ("transition", Text, |(_, m)| {
            Value::Text(m.transition().map(|transition| transition.name().to_owned()))
        }),
        ("unresolved", Text, unresolved),
    ]);
    let singles = Axis::ALL.into_iter().map(|axis| (axis.name(), Condition::Single(axis)));
    let conditions = [("nominal", Condition::Nominal)].into_iter().chain(singles);
    let conditions = conditions.chain([("simultaneous", Condition::Simultaneous)]);
    let progress =
        conditions.flat_map(|(name, condition)| -> [Column<'a, OfConfiguration<'a>>; 2] {
            [
                (format!("{name}_goal"), Real, Box::new(move |row| goal(row, condition))),
                (format!("{name}_steps"), Integer, Box::new(move |row| steps(row, condition))),
            ]
        });
    first.into_iter().chain(alone).chain(joint).chain(progress).collect()
}

fn alone(matched: &Matched, axis: Axis) -> Value {
    Value::Bool(matched.outcome(Condition::Single(axis)).success())
}

fn goal((analysis, matched): &OfConfiguration<'_>, condition: Condition) -> Value {
    let progress = analysis.progress(matched, condition);
    Value::Real(progress.and_then(Progress::goal_share))
}

fn steps((analysis, matched): &OfConfiguration<'_>, condition: Condition) -> Value {
    let progress = analysis.progress(matched, condition);
    Value::Number(progress.and_then(|progress| progress.steps).map(i64::from))
}

/// Lists the campaign's perturbed conditions under which the configuration has no outcome.
fn unresolved((analysis, matched): &OfConfiguration<'_>) -> Value {
    let alone = matched.alone.keys().copied().map(Condition::Single);
    let simultaneous = analysis.records.has_simultaneous();
    let simultaneous = simultaneous.then_some(Condition::Simultaneous);
    let unresolved =
        alone.chain(simultaneous).filter_map(|condition| match matched.outcome(condition) {
            Outcome::Missing => Some(format!("{condition} missing")),
            Outcome::Quarantined => Some(format!("{condition} quarantined")),
            Outcome::Success | Outcome::Failure => None,
        });
    let unresolved: Vec<String> = unresolved.collect();
    Value::Text((!unresolved.is_empty()).then(|| unresolved.join(", ")))
}

pub(super) struct OfSubset<'a> {
    findings: &'a Findings,
    explained: &'a Explained,
    answer: &'a Answer,
    minimal: &'a MinimalSubset,
}

/// A row per explained configuration and minimal subset.
pub(super) fn explanations(document: &Document) -> Table<'_, OfSubset<'_>> {
    let campaigns = document.analyses.iter();
    let campaigns = campaigns.filter_map(|analysis| analysis.findings.as_ref());
    let rows = campaigns.flat_map(|findings| {
        findings.configurations.iter().flat_map(move |explained| {
            let answers = explained.explanation.answers.iter();
            answers.flat_map(move |answer| {
                answer.minimal.iter().map(move |minimal| OfSubset {
                    findings,
                    explained,
                    answer,
                    minimal,
                })
            })
        })
    });
    Table {
        name: "explanations",
        columns: columns([
            ("policy", Text, |row| text(&row.findings.policy)),
            ("campaign", Text, |row| text(&row.findings.campaign)),
            ("explained_by", Text, |row| text(&row.findings.explained_by)),
            ("level", Text, |row| text(row.explained.configuration.level())),
            ("suite", Text, |row| text(row.explained.configuration.task().suite().name())),
            ("task", Number, |row| number(row.explained.configuration.task().index())),
            ("config", Number, |row| number(row.explained.configuration.number())),
            ("transition", Text, |row| text(row.explained.explanation.transition.name())),
            ("start", Text, |row| text(row.answer.start.name())),
            ("subset", Text, |row| text(row.minimal.set.name())),
            ("axes", Number, |row| number(row.minimal.set.len() as i64)),
            ("established", Bool, |row| Value::Bool(Some(row.minimal.is_established()))),
            ("open", Number, |row| number(row.minimal.open.len() as i64)),
            ("undone_by", Text, |row| undone_by(row)),
            ("rollouts", Number, |row| number(row.explained.rollouts)),
        ]),
        rows: rows.collect(),
    }
}

/// Returns the smallest supersets that do not flip the outcome; absent if there are none.
fn undone_by(row: &OfSubset<'_>) -> Value {
    let pairs = row.answer.non_monotone.iter();
    let pairs = pairs.filter(|pair| pair.minimal == row.minimal.set);
    let names: Vec<&str> = pairs.map(|pair| pair.superset.name()).collect();
    Value::Text((!names.is_empty()).then(|| names.join(", ")))
}

type OfThreshold<'a> = (&'a ThresholdReport, &'a Measured);

/// A row per threshold searched for: the radius at which success turns to failure.
pub(super) fn thresholds(document: &Document) -> Table<'_, OfThreshold<'_>> {
    let reports = document.analyses.iter();
    let reports = reports.filter_map(|analysis| analysis.thresholds.as_ref());
    let rows =
        reports.flat_map(|report| report.thresholds.iter().map(move |measured| (report, measured)));
    Table {
        name: "thresholds",
        columns: columns([
            ("policy", Text, |(report, _)| text(&report.policy)),
            ("campaign", Text, |(report, _)| text(&report.campaign)),
            ("measured_by", Text, |(report, _)| text(&report.measured_by)),
            ("condition", Text, |(_, measured)| text(measured.condition)),
            ("suite", Text, |(_, measured)| text(measured.task.suite().name())),
            ("task", Number, |(_, measured)| number(measured.task.index())),
            ("config", Number, |(_, measured)| number(measured.config)),
            ("threshold", Text, |(_, measured)| text(measured.threshold.name())),
            ("succeeds_at", Real, |(_, measured)| Value::Real(measured.succeeds_at)),
            ("fails_at", Real, |(_, measured)| Value::Real(measured.fails_at)),
            ("recovers", Bool, |(_, measured)| Value::Bool(Some(!measured.recovers_at.is_empty()))),
            ("found", Bool, |(_, measured)| Value::Bool(Some(measured.is_found))),
        ]),
        rows: rows.collect(),
    }
}

#[derive(Debug, Deserialize)]
pub struct ResultRow {
    rollout_id: String,
    #[serde(default)]
    replicate: u32,
    success: bool,
    steps: u32,
    axis: String,
    level: String,
    suite: String,
    task_id: u8,
    init_id: u16,
    config: Option<u16>,
    policy: String,
    wall_s: f64,
    ik_res_mm: Option<f64>,
    placebo_radius: Option<f64>,
    #[serde(default)]
    execution: Execution,
    goal_predicates: Option<u32>,
    goal_at_end: Option<u32>,
    goal_at_most: Option<u32>,
    protocol: Option<String>,
    prompt: Option<String>,
}

impl ResultRow {
    /// Parses a line of an export.
    pub fn from_json(line: &str) -> Result<Self, JsonError> {
        Ok(serde_json::from_str(line)?)
    }
}

/// Writes result rows as Parquet, as [`write_parquet`](super::write_parquet) does.
pub fn write_results_parquet(
    rows: Vec<ResultRow>,
    out: impl Write + Send,
) -> Result<(), TableError> {
    let columns = columns::<ResultRow, _>([
        ("rollout_id", Text, |row| text(&row.rollout_id)),
        ("replicate", Number, |row| number(row.replicate)),
        ("success", Bool, |row| Value::Bool(Some(row.success))),
        ("steps", Number, |row| number(row.steps)),
        ("axis", Text, |row| text(&row.axis)),
        ("level", Text, |row| text(&row.level)),
        ("suite", Text, |row| text(&row.suite)),
        ("task_id", Number, |row| number(row.task_id)),
        ("init_id", Number, |row| number(row.init_id)),
        ("config", Integer, |row| Value::Number(row.config.map(i64::from))),
        ("policy", Text, |row| text(&row.policy)),
        ("wall_s", Real, |row| Value::Real(Some(row.wall_s))),
        ("ik_res_mm", Real, |row| Value::Real(row.ik_res_mm)),
        ("placebo_radius", Real, |row| Value::Real(row.placebo_radius)),
        ("execution", Text, |row| text(&row.execution)),
        ("goal_predicates", Integer, |row| Value::Number(row.goal_predicates.map(i64::from))),
        ("goal_at_end", Integer, |row| Value::Number(row.goal_at_end.map(i64::from))),
        ("goal_at_most", Integer, |row| Value::Number(row.goal_at_most.map(i64::from))),
        ("protocol", Text, |row| Value::Text(row.protocol.clone())),
        ("prompt", Text, |row| Value::Text(row.prompt.clone())),
    ]);
    Table { name: "results", columns, rows }.parquet(out)
}
