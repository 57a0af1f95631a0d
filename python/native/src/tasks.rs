//! Tasks and configurations of the protocol.

use libero_ctrl::{ManifestRow, RolloutId, TaskRef, row_of};
use pyo3::prelude::*;

use crate::error::value;

/// Describes a task such as `libero_goal/3`: name of the suite, index, stem of the files,
/// instruction, and step budget of the policy.
#[pyfunction]
pub(crate) fn task(name: &str) -> PyResult<(&'static str, u8, &'static str, String, u32)> {
    let task: TaskRef = name.parse().map_err(value)?;
    let suite = task.suite();
    Ok((suite.name(), task.index(), task.name(), task.instruction(), suite.max_steps()))
}

/// Returns the manifest row, JSON, of a rollout id such as `spatial/t0/combination/L2/c03`.
#[pyfunction]
pub(crate) fn configuration_row(id: &str) -> PyResult<String> {
    let id: RolloutId = id.parse().map_err(value)?;
    row_of(id).map_err(value).map(|row| json(&row))
}

/// Returns the manifest row, JSON, of a task's nominal rollout from an initial state.
#[pyfunction]
pub(crate) fn nominal_row(task: &str, initial_state: u16) -> PyResult<String> {
    let task: TaskRef = task.parse().map_err(value)?;
    let id = RolloutId::clean(task, initial_state);
    let row = ManifestRow::new(id, initial_state, initial_state, Default::default());
    Ok(json(&row))
}

fn json(row: &ManifestRow) -> String {
    serde_json::to_string(row).expect("a row is JSON")
}
