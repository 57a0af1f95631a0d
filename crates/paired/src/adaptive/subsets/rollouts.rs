//! Next rollouts of a campaign that explains another, and those that are worth filming.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use crate::Record;
use benchmark::{AxisSet, Condition, Explanation, RolloutId};

use super::{Sample, configurations, explain, plan};

/// Rollouts of one subset of axes that are to be added.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Addition {
    /// The simultaneous rollout of the configuration in the explained campaign.
    pub simultaneous: RolloutId,
    pub axes: AxisSet,
    /// Replicates to run, which neither campaign has yet.
    pub replicates: Range<u32>,
}

/// Returns the rollouts to add, given the records of the explained and of the explaining
/// campaign; empty if everything is explained or already requested.
pub fn additions(
    explained: &[Record],
    explaining: &[Record],
    explanation: &Explanation,
) -> Vec<Addition> {
    // A campaign that perturbs a single axis has nothing to explain.
    let Ok(lattices) = configurations(explained, explaining, explanation.repeats) else {
        return Vec::new();
    };
    let mut all = Vec::new();
    for (&simultaneous, requests) in plan(&lattices, &Sample::of(explanation)) {
        for request in requests {
            let lattice = &lattices[&simultaneous];
            let requested = lattice.outcomes().both(request.set).requested();
            all.push(Addition {
                simultaneous,
                axes: request.set,
                replicates: requested..requested + request.rollouts,
            });
        }
    }
    all
}

/// Returns the rollouts of the explaining campaign that illustrate an explanation and are worth
/// filming: those under the minimal subsets of axes, and those under the largest subsets of each
/// minimal subset that do not flip the outcome. For each of these subsets, returns the first
/// replicate with the majority's outcome.
pub fn illustrative(
    explained: &[Record],
    explaining: &[Record],
    explanation: &Explanation,
) -> BTreeSet<(RolloutId, u32)> {
    let Ok(lattices) = configurations(explained, explaining, explanation.repeats) else {
        return BTreeSet::new();
    };
    let mut verdicts = BTreeMap::new();
    for (simultaneous, lattice) in &lattices {
        let answers = explain(lattice).map_or_else(|_| Vec::new(), |result| result.answers);
        let minimal = answers.iter().flat_map(|answer| &answer.minimal);
        let sets = minimal.flat_map(|minimum| minimum.below.iter().copied().chain([minimum.set]));
        for set in sets {
            let (task, level) = (simultaneous.task(), simultaneous.level());
            let condition = match set == lattice.full() {
                true => Condition::Simultaneous,
                false => Condition::of(set),
            };
            let id = RolloutId::perturbed(task, condition, level, simultaneous.number());
            if let (Ok(id), Some(success)) = (id, lattice.verdict(set).success()) {
                verdicts.insert(id, success);
            }
        }
    }
    let mut illustrative = BTreeMap::new();
    for &Record { id, replicate, outcome, .. } in explaining {
        if outcome.success().is_some() && outcome.success() == verdicts.get(&id).copied() {
            let least = illustrative.entry(id).or_insert(replicate);
            *least = replicate.min(*least);
        }
    }
    illustrative.into_iter().collect()
}
