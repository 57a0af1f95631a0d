//! Derives the manifest row of a rollout's id.

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::design::{Design, Nominal};
use crate::expansion::clean_row;
use crate::rollout_id::RolloutId;
use crate::row::ManifestRow;
use crate::suite::INIT_STATES_PER_TASK;

/// An id that names no rollout of the protocol.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("make the manifest row of {id}: {problem}")]
pub struct NoSuchRow {
    /// The id.
    pub id: RolloutId,
    /// Reason of the failure.
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
    let Some(config) = id.config() else {
        return match id.number() {
            state if state < INIT_STATES_PER_TASK => Ok(clean_row(id.task(), state)),
            _ => Err(problem("the task has no such initial state".to_owned())),
        };
    };
    let combined = match id.level().is_named() || id.is_placebo() {
        true => AxisSet::ALL,
        false => AxisSet::from_iter(Axis::METRIC),
    };
    let design = Design {
        tasks: vec![id.task()],
        axes: id.condition().axes(combined).axes().collect(),
        levels: vec![id.level()],
        configs: vec![config],
        nominal: Nominal::None,
        ..Design::v0_1()
    };
    design.check().map_err(|error| problem(error.to_string()))?;
    Ok(design.perturbed_row(id.task(), id.condition(), id.level(), config))
}
