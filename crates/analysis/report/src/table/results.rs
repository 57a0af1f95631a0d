//! A row per committed rollout, read from the JSON rows of `coordinator export`.

use std::io::Write;

use libero_ctrl::{Execution, JsonError};
use serde::Deserialize;

use super::form::{self, Column, Kind, Table, TableError, Value, text};

/// A result row; optional fields that the JSON lacks are null.
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
    ///
    /// # Errors
    /// If the line is not a valid result row.
    pub fn from_json(line: &str) -> Result<Self, JsonError> {
        Ok(serde_json::from_str(line)?)
    }
}

/// Writes result rows as Parquet, as [`write_parquet`](super::write_parquet) does.
///
/// # Errors
/// If `out` fails.
pub fn write_results_parquet(
    rows: Vec<ResultRow>,
    out: impl Write + Send,
) -> Result<(), TableError> {
    let table = Table { name: "results", columns: columns(), rows };
    table.parquet(out)
}

fn columns() -> Vec<Column<'static, ResultRow>> {
    use Kind::{Bool, Integer, Number, Real, Text};
    form::columns([
        ("rollout_id", Text, |row| text(&row.rollout_id)),
        ("replicate", Number, |row| Value::Number(row.replicate.into())),
        ("success", Bool, |row| Value::Bool(Some(row.success))),
        ("steps", Number, |row| Value::Number(row.steps.into())),
        ("axis", Text, |row| text(&row.axis)),
        ("level", Text, |row| text(&row.level)),
        ("suite", Text, |row| text(&row.suite)),
        ("task_id", Number, |row| Value::Number(row.task_id.into())),
        ("init_id", Number, |row| Value::Number(row.init_id.into())),
        ("config", Integer, |row| Value::Integer(row.config.map(i64::from))),
        ("policy", Text, |row| text(&row.policy)),
        ("wall_s", Real, |row| Value::Real(Some(row.wall_s))),
        ("ik_res_mm", Real, |row| Value::Real(row.ik_res_mm)),
        ("placebo_radius", Real, |row| Value::Real(row.placebo_radius)),
        ("execution", Text, |row| text(&row.execution.to_string())),
        ("goal_predicates", Integer, |row| Value::Integer(row.goal_predicates.map(i64::from))),
        ("goal_at_end", Integer, |row| Value::Integer(row.goal_at_end.map(i64::from))),
        ("goal_at_most", Integer, |row| Value::Integer(row.goal_at_most.map(i64::from))),
        ("protocol", Text, |row| Value::Text(row.protocol.clone())),
        ("prompt", Text, |row| Value::Text(row.prompt.clone())),
    ])
}
