//! Early stop of a campaign: the stop rule, and the random order of configurations.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::axis::Axis;
use crate::condition::Condition;
use crate::level::Level;
use crate::rollout_id::RolloutId;
use crate::row::ManifestRow;
use crate::stop_rule::StopRule;
use crate::suite::TaskRef;

/// Early stop of a campaign. The configurations run in an order that is drawn before any
/// outcome is known, and the campaign ends as soon as the rule holds at every level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stop {
    pub rule: StopRule,
    #[serde(default)]
    pub seed: u64,
    #[serde(default)]
    pub strata: Strata,
}

/// Strata of the random order: each round of the order has one configuration of each stratum that
/// has any left.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Strata {
    /// A stratum per suite: narrower intervals than with [`Self::Tasks`], unless tasks of a suite
    /// differ very much.
    #[default]
    Suites,
    /// A stratum per task.
    Tasks,
}

impl Strata {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Suites => "suites",
            Self::Tasks => "tasks",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StopError {
    #[error(
        "`stop` needs simultaneous rollouts, and those of each axis alone: name two axes or more, \
         or remove `stop`"
    )]
    NotSimultaneous,
    #[error(
        "`stop` with {given} `replicates`: its intervals assume one replicate; write 1, \
         or remove `stop`"
    )]
    Replicates { given: u32 },
    #[error(
        "`stop` needs every configuration under the same conditions at every level: {rollout} is \
         not among the rows; add it, or remove `stop`"
    )]
    Missing { rollout: RolloutId },
}

/// Checks that every configuration has the simultaneous rollout and one rollout per single axis at
/// every level. The stop rule would never count an incomplete configuration, nor any configuration
/// drawn after that configuration.
pub(crate) fn check_rows(rows: &[ManifestRow]) -> Result<(), StopError> {
    let mut axes: BTreeSet<Axis> = BTreeSet::new();
    let mut levels: BTreeSet<Level> = BTreeSet::new();
    let mut units: BTreeMap<(TaskRef, u16), BTreeSet<(Level, Condition)>> = BTreeMap::new();
    for id in rows.iter().map(|row| row.id) {
        let Some(config) = id.config() else { continue };
        if let Condition::Single(axis) = id.condition()
            && axis.def().is_combined
        {
            axes.insert(axis);
        }
        // Placebo rollouts may cover only some configurations and do not affect the rule.
        if id.is_placebo() {
            continue;
        }
        levels.insert(id.level());
        let unit = units.entry((id.task(), config)).or_default();
        unit.insert((id.level(), id.condition()));
    }
    if axes.len() < 2 {
        return Err(StopError::NotSimultaneous);
    }
    let conditions = axes.into_iter().map(Condition::Single);
    let conditions: Vec<Condition> = conditions.chain([Condition::Simultaneous]).collect();
    for (&(task, config), rollouts) in &units {
        for &level in &levels {
            let missing =
                conditions.iter().find(|&&condition| !rollouts.contains(&(level, condition)));
            if let Some(&condition) = missing
                && let Ok(rollout) = RolloutId::perturbed(task, condition, level, config)
            {
                return Err(StopError::Missing { rollout });
            }
        }
    }
    Ok(())
}
