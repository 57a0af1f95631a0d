//! A row per explained configuration and minimal subset.

use adaptive::subsets::{Answer, Explained, MinimalSubset};

use super::form::{self, Column, Kind, Table, Value, text};
use crate::document::Document;
use crate::explanation::Findings;

pub(super) struct Row<'a> {
    findings: &'a Findings,
    explained: &'a Explained,
    answer: &'a Answer,
    minimal: &'a MinimalSubset,
}

pub(super) fn table(document: &Document) -> Table<'_, Row<'_>> {
    let campaigns = document.analyses.iter();
    let campaigns = campaigns.filter_map(|analysis| analysis.findings.as_ref());
    let rows = campaigns.flat_map(|findings| {
        findings.configurations.iter().flat_map(move |explained| {
            let answers = explained.explanation.answers.iter();
            answers.flat_map(move |answer| {
                answer.minimal.iter().map(move |minimal| Row {
                    findings,
                    explained,
                    answer,
                    minimal,
                })
            })
        })
    });
    Table { name: "explanations", columns: columns(), rows: rows.collect() }
}

fn columns<'a>() -> Vec<Column<'a, Row<'a>>> {
    use Kind::{Bool, Number, Text};
    form::columns([
        ("policy", Text, |row| text(&row.findings.policy)),
        ("campaign", Text, |row| text(&row.findings.campaign)),
        ("explained_by", Text, |row| text(&row.findings.explained_by)),
        ("level", Text, |row| text(&row.explained.configuration.level().to_string())),
        ("suite", Text, |row| text(row.explained.configuration.task().suite().name())),
        ("task", Number, |row| Value::Number(row.explained.configuration.task().index().into())),
        ("config", Number, |row| Value::Number(row.explained.configuration.number().into())),
        ("transition", Text, |row| text(row.explained.explanation.transition.name())),
        ("start", Text, |row| text(row.answer.start.name())),
        ("subset", Text, |row| text(row.minimal.set.name())),
        ("axes", Number, |row| Value::Number(row.minimal.set.len() as i64)),
        ("established", Bool, |row| Value::Bool(Some(row.minimal.is_established()))),
        ("open", Number, |row| Value::Number(row.minimal.open.len() as i64)),
        ("undone_by", Text, |row| undone_by(row)),
        ("rollouts", Number, |row| Value::Number(row.explained.rollouts.into())),
    ])
}

/// Returns the smallest supersets that do not flip the outcome; absent if there are none.
fn undone_by(row: &Row) -> Value {
    let pairs = row.answer.non_monotone.iter();
    let pairs = pairs.filter(|pair| pair.minimal == row.minimal.set);
    let names: Vec<&str> = pairs.map(|pair| pair.superset.name()).collect();
    Value::Text((!names.is_empty()).then(|| names.join(", ")))
}
