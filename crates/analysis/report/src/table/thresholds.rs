//! A row per threshold searched for: the radius at which success turns to failure.

use super::form::{self, Column, Kind, Table, Value, text};
use crate::document::Document;
use crate::threshold_report::{Measured, ThresholdReport};

pub(super) type Row<'a> = (&'a ThresholdReport, &'a Measured);

pub(super) fn table(document: &Document) -> Table<'_, Row<'_>> {
    let reports = document.analyses.iter();
    let reports = reports.filter_map(|analysis| analysis.thresholds.as_ref());
    let rows =
        reports.flat_map(|report| report.thresholds.iter().map(move |measured| (report, measured)));
    Table { name: "thresholds", columns: columns(), rows: rows.collect() }
}

fn columns<'a>() -> Vec<Column<'a, Row<'a>>> {
    use Kind::{Bool, Number, Real, Text};
    form::columns([
        ("policy", Text, |(report, _)| text(&report.policy)),
        ("campaign", Text, |(report, _)| text(&report.campaign)),
        ("measured_by", Text, |(report, _)| text(&report.measured_by)),
        ("condition", Text, |(_, measured)| text(&measured.condition.to_string())),
        ("suite", Text, |(_, measured)| text(measured.task.suite().name())),
        ("task", Number, |(_, measured)| Value::Number(measured.task.index().into())),
        ("config", Number, |(_, measured)| Value::Number(measured.config.into())),
        ("threshold", Text, |(_, measured)| text(measured.threshold.name())),
        ("succeeds_at", Real, |(_, measured)| Value::Real(measured.succeeds_at)),
        ("fails_at", Real, |(_, measured)| Value::Real(measured.fails_at)),
        ("recovers", Bool, |(_, measured)| Value::Bool(Some(!measured.recovers_at.is_empty()))),
        ("found", Bool, |(_, measured)| Value::Bool(Some(measured.is_found))),
    ])
}
