//! A row per policy, replicate, level, task and configuration, with all its outcomes.
//!
//! An outcome is true, false or empty. For each empty outcome of a perturbed condition that the
//! campaign runs, the column `unresolved` says whether the rollout is missing or quarantined. For
//! nominal, single-axis and simultaneous rollouts, `…_goal` is the largest share of the goal's
//! predicates that held together, and `…_steps` the number of control steps.

use libero_ctrl::{Axis, Condition};
use paired::{Matched, Outcome, Progress};

use super::form::{self, Column, Kind, Table, Value, text};
use crate::analysis::Analysis;
use crate::document::Document;

pub(super) type Row<'a> = (&'a Analysis, &'a Matched);

pub(super) fn table(document: &Document) -> Table<'_, Row<'_>> {
    let rows = document.analyses.iter().flat_map(|analysis| {
        let configurations = analysis.records.configurations().iter();
        configurations.map(move |matched| (analysis, matched))
    });
    Table { name: "configurations", columns: columns(), rows: rows.collect() }
}

fn columns<'a>() -> Vec<Column<'a, Row<'a>>> {
    use Kind::{Bool, Integer, Number, Real, Text};
    let first: Vec<Column<'a, Row<'a>>> = form::columns([
        ("policy", Text, |(a, _)| text(&a.label)),
        ("origin", Text, |(a, _)| text(a.subject.origin_name())),
        ("replicate", Number, |(_, m)| Value::Number(m.replicate.into())),
        ("level", Text, |(_, m)| text(&m.level.to_string())),
        ("suite", Text, |(_, m)| text(m.task.suite().name())),
        ("task", Number, |(_, m)| Value::Number(m.task.index().into())),
        ("config", Number, |(_, m)| Value::Number(m.config.into())),
        ("init_id", Number, |(_, m)| Value::Number(m.init_id.into())),
        ("nominal", Bool, |(_, m)| Value::Bool(m.nominal.success())),
    ]);
    let alone = Axis::every().map(|axis| -> Column<'a, Row<'a>> {
        (axis.name().to_owned(), Bool, Box::new(move |(_, m)| alone(m, axis)))
    });
    let joint: Vec<Column<'a, Row<'a>>> = form::columns([
        ("conjunction", Bool, |(_, m)| Value::Bool(m.configuration().map(|c| c.conjunction()))),
        ("combination", Bool, |(_, m)| Value::Bool(m.simultaneous.success())),
        ("transition", Text, |(_, m)| {
            Value::Text(m.transition().map(|transition| transition.name().to_owned()))
        }),
        ("unresolved", Text, unresolved),
    ]);
    let singles = Axis::ALL.into_iter().map(|axis| (axis.name(), Condition::Single(axis)));
    let conditions = [("nominal", Condition::Clean)].into_iter().chain(singles);
    let conditions = conditions.chain([("combination", Condition::Combination)]);
    let progress = conditions.flat_map(|(name, condition)| -> [Column<'a, Row<'a>>; 2] {
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

fn goal((analysis, matched): &Row<'_>, condition: Condition) -> Value {
    let progress = analysis.progress(matched, condition);
    Value::Real(progress.and_then(Progress::goal_share))
}

fn steps((analysis, matched): &Row<'_>, condition: Condition) -> Value {
    let progress = analysis.progress(matched, condition);
    Value::Integer(progress.and_then(|progress| progress.steps).map(i64::from))
}

/// Lists the campaign's perturbed conditions under which the configuration has no outcome.
fn unresolved((analysis, matched): &Row<'_>) -> Value {
    let alone = matched.alone.keys().copied().map(Condition::Single);
    let simultaneous = analysis.records.has_simultaneous();
    let simultaneous = simultaneous.then_some(Condition::Combination);
    let conditions = alone.chain(simultaneous);
    let unresolved = conditions.filter_map(|condition| match matched.outcome(condition) {
        Outcome::Missing => Some(format!("{condition} missing")),
        Outcome::Quarantined => Some(format!("{condition} quarantined")),
        Outcome::Success | Outcome::Failure => None,
    });
    let unresolved: Vec<String> = unresolved.collect();
    Value::Text((!unresolved.is_empty()).then(|| unresolved.join(", ")))
}
