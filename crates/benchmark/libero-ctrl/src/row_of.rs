//! Derives a manifest row from a rollout id.

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::condition::Condition;
use crate::design::{Design, Nominal};
use crate::expansion::clean_row;
use crate::rollout_id::RolloutId;
use crate::row::ManifestRow;
use crate::suite::{INIT_STATES_PER_TASK, Suite};

/// Error: no rollout of the protocol has this id.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("make the manifest row of {id}: {problem}")]
pub struct NoSuchRow {
    pub id: RolloutId,
    /// Reason why there is no such row.
    pub problem: String,
}

/// Returns the row of an id in LIBERO-CTRL v0.1; configurations that v0.1 does not have are drawn
/// with design seed 0. A combination perturbs all six axes or, at unnamed radii, which have
/// no paraphrases, the five metric axes.
pub fn row_of(id: RolloutId) -> Result<ManifestRow, NoSuchRow> {
    let problem = |problem: String| NoSuchRow { id, problem };
    if id.variant().is_some() {
        let remedy = match id.task().suite() {
            Suite::Own => {
                "it is a rollout of a suite file; give the file to `worker rollout` with --suite-file"
            }
            _ => "it is a rollout of LIBERO's family, which `worker rollout` and campaigns run",
        };
        return Err(problem(remedy.to_owned()));
    }
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
        latency: id.condition() == Condition::Latency,
        levels: vec![id.level()],
        configs: vec![config],
        nominal: Nominal::None,
        ..Design::v0_1()
    };
    design.check().map_err(|error| problem(error.to_string()))?;
    if !design.runs_condition(id.condition(), id.level()) {
        return Err(problem("the latency axis has no placebo level".to_owned()));
    }
    Ok(design.perturbed_row(id.task(), id.condition(), id.level(), config))
}
