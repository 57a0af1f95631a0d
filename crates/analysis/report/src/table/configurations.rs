//! A row per policy, replicate, level, task and configuration, with all its outcomes.
//!
//! An outcome is true, false or empty; for an empty one, the column `unresolved` says
//! whether it is missing or quarantined.

use libero_ctrl::{Axis, Condition};
use paired::{Matched, Outcome};

use super::form::{Column, Kind, Table, Value, text};
use crate::analysis::Analysis;
use crate::document::Document;

pub(super) type Row<'a> = (&'a Analysis, &'a Matched);

pub(super) fn table(document: &Document) -> Table<Row<'_>> {
    let rows = document.analyses.iter().flat_map(|analysis| {
        let configurations = analysis.records.configurations().iter();
        configurations.map(move |matched| (analysis, matched))
    });
    Table {
        of: "configurations",
        columns: columns().into(),
        rows: rows.collect(),
    }
}

fn columns<'a>() -> [Column<Row<'a>>; 20] {
    use Kind::{Bool, Number, Text};
    [
        ("policy", Text, |(a, _)| text(&a.label)),
        ("origin", Text, |(a, _)| text(a.subject.origin_name())),
        ("replicate", Number, |(_, m)| {
            Value::Number(m.replicate.into())
        }),
        ("level", Text, |(_, m)| text(&m.level.to_string())),
        ("suite", Text, |(_, m)| text(m.task.suite().name())),
        ("task", Number, |(_, m)| {
            Value::Number(m.task.index().into())
        }),
        ("config", Number, |(_, m)| Value::Number(m.config.into())),
        ("init_id", Number, |(_, m)| Value::Number(m.init_id.into())),
        ("nominal", Bool, |(_, m)| Value::Bool(m.nominal.success())),
        ("camera", Bool, |(_, m)| alone(m, Axis::Camera)),
        ("lighting", Bool, |(_, m)| alone(m, Axis::Lighting)),
        ("robot", Bool, |(_, m)| alone(m, Axis::Robot)),
        ("sensor", Bool, |(_, m)| alone(m, Axis::Sensor)),
        ("actuation", Bool, |(_, m)| alone(m, Axis::Actuation)),
        ("language", Bool, |(_, m)| alone(m, Axis::Language)),
        ("latency", Bool, |(_, m)| {
            Value::Bool(m.latency.and_then(Outcome::success))
        }),
        ("conjunction", Bool, |(_, m)| {
            Value::Bool(m.configuration().map(|c| c.conjunction()))
        }),
        ("combination", Bool, |(_, m)| {
            Value::Bool(m.simultaneous.success())
        }),
        ("transition", Text, |(_, m)| {
            Value::Text(
                m.transition()
                    .map(|transition| transition.name().to_owned()),
            )
        }),
        ("unresolved", Text, |(_, m)| unresolved(m)),
    ]
}

fn alone(matched: &Matched, axis: Axis) -> Value {
    Value::Bool(matched.outcome(Condition::Single(axis)).success())
}

/// Lists the campaign's conditions without an outcome.
fn unresolved(matched: &Matched) -> Value {
    let alone = matched.alone.keys().copied().map(Condition::Single);
    let named = alone
        .chain(matched.latency.map(|_| Condition::Latency))
        .chain([Condition::Combination])
        .filter_map(|condition| match matched.outcome(condition) {
            Outcome::Missing => Some(format!("{condition} missing")),
            Outcome::Quarantined => Some(format!("{condition} quarantined")),
            Outcome::Success | Outcome::Failure => None,
        });
    let named: Vec<String> = named.collect();
    Value::Text((!named.is_empty()).then(|| named.join(", ")))
}
