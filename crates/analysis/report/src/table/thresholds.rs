//! A row per threshold searched for: the radius at which success turns to failure.

use super::form::{Column, Kind, Table, Value, text};
use crate::document::Document;
use crate::how_far::{HowFar, Measured};

pub(super) type Row<'a> = (&'a HowFar, &'a Measured);

pub(super) fn table(document: &Document) -> Table<Row<'_>> {
    let found = document.analyses.iter();
    let found = found.filter_map(|analysis| analysis.how_far.as_ref());
    let rows = found.flat_map(|found| found.thresholds.iter().map(move |it| (found, it)));
    Table {
        of: "thresholds",
        columns: columns().into(),
        rows: rows.collect(),
    }
}

fn columns<'a>() -> [Column<Row<'a>>; 12] {
    use Kind::{Bool, Number, Real, Text};
    [
        ("policy", Text, |(found, _)| text(&found.policy)),
        ("campaign", Text, |(found, _)| text(&found.campaign)),
        ("measured_by", Text, |(found, _)| text(&found.measured_by)),
        ("condition", Text, |(_, it)| text(&it.condition.to_string())),
        ("suite", Text, |(_, it)| text(it.task.suite().name())),
        ("task", Number, |(_, it)| {
            Value::Number(it.task.index().into())
        }),
        ("config", Number, |(_, it)| Value::Number(it.config.into())),
        ("threshold", Text, |(_, it)| text(it.threshold.name())),
        ("succeeds_at", Real, |(_, it)| Value::Real(it.succeeds_at)),
        ("fails_at", Real, |(_, it)| Value::Real(it.fails_at)),
        ("recovers", Bool, |(_, it)| {
            Value::Bool(Some(!it.recovers_at.is_empty()))
        }),
        ("found", Bool, |(_, it)| Value::Bool(Some(it.is_found))),
    ]
}
