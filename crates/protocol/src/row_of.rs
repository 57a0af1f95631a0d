//! From a rollout's id to its manifest row.

use crate::condition::{Axis, Condition};
use crate::design::{Design, Nominal};
use crate::rollout_id::RolloutId;
use crate::row::ManifestRow;

/// An id that names no rollout of the protocol.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("make the manifest row of {id}: {problem}")]
pub struct NoSuchRow {
    /// The id.
    pub id: RolloutId,
    /// Why not.
    pub problem: String,
}

/// The row of an id in LIBERO-CTRL v0.1, or beyond it in the design of seed 0.
/// A combination combines all six axes, or at a radius of its own, for which
/// there are no paraphrases, the five metric ones.
///
/// # Errors
/// If there is no such configuration.
pub fn row_of(id: RolloutId) -> Result<ManifestRow, NoSuchRow> {
    let problem = |problem: String| NoSuchRow { id, problem };
    let mut design = Design {
        tasks: vec![id.task()],
        ..Design::v0_1()
    };
    if let Some(config) = id.config() {
        design.axes = match id.condition() {
            Condition::Single(axis) => vec![axis],
            _ if id.level().is_named() => Axis::ALL.to_vec(),
            _ => Axis::METRIC.to_vec(),
        };
        design.levels = vec![id.level()];
        design.configs = vec![config];
        design.nominal = Nominal::None;
    }
    let rows = design
        .expand()
        .map_err(|error| problem(error.to_string()))?;
    let row = rows.into_iter().find(|row| row.id == id);
    row.ok_or_else(|| problem("the protocol has no such configuration".to_owned()))
}
