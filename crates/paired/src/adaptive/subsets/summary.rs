//! Explanations as plain data for figures: the lattice of one configuration, and the
//! frequency of each minimal subset over all configurations.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use crate::{Interval, Transition};
use benchmark::{AxisSet, RolloutId};
use serde::{Deserialize, Serialize};

use super::evidence::{Evidence, Verdict};
use super::explanation::{Explanation, Unexplained, explain};
use super::lattice::Lattice;
use super::proportion::clopper_pearson;
use crate::adaptive::outcomes::Tally;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Explained {
    /// The configuration, named by its simultaneous rollout.
    pub configuration: RolloutId,
    pub full: AxisSet,
    /// Rule that determined the verdicts.
    pub evidence: Evidence,
    /// The transition and its minimal subsets.
    pub explanation: Explanation,
    /// Every subset with a requested rollout, in order from the nominal rollout to the
    /// simultaneous one.
    pub outcomes: Vec<SubsetOutcome>,
    /// Rollouts under the subsets that an ordinary campaign does not run: those of two or
    /// more axes, but not all.
    pub rollouts: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SubsetOutcome {
    pub set: AxisSet,
    /// Verdict of the rollouts that are evidence.
    pub verdict: Verdict,
    /// Counts of the rollouts under the subset that are evidence.
    pub tally: Tally,
    /// With repeats, counts of the outcomes of the explained campaign, which are not evidence.
    pub selecting: Option<Tally>,
    /// With repeats, the Clopper–Pearson interval of the success probability at the level of one
    /// test; while no rollout is pending, it excludes ½ if and only if the verdict is success or
    /// failure. Absent for a deterministic policy, and without a result.
    pub interval: Option<Interval>,
}

impl Explained {
    /// Explains a configuration, identified by its simultaneous rollout.
    pub fn of(configuration: RolloutId, lattice: &Lattice) -> Result<Self, Unexplained> {
        let explanation = explain(lattice)?;
        Ok(Self {
            configuration,
            full: lattice.full(),
            evidence: lattice.evidence(),
            explanation,
            outcomes: outcomes(lattice),
            rollouts: lattice.further_rollouts(),
        })
    }
}

/// Returns the outcomes under every subset with a requested rollout, in order.
pub fn outcomes(lattice: &Lattice) -> Vec<SubsetOutcome> {
    let outcome = |set: AxisSet| {
        let (tally, looks) = (lattice.tally(set), lattice.looks(set));
        SubsetOutcome {
            set,
            verdict: lattice.verdict(set),
            tally,
            selecting: looks.map(|_| lattice.selecting(set)),
            interval: looks.and_then(|looks| clopper_pearson(tally.count(), 1.0 - looks.level)),
        }
    };
    lattice.sets().map(outcome).collect()
}

/// Frequency of a minimal subset: a bar of an UpSet plot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Occurrence {
    pub transition: Transition,
    /// The set from which the search started: empty, or the axis that fails alone.
    pub start: AxisSet,
    pub set: AxisSet,
    /// Configurations in which `set` is minimal according to the outcomes so far.
    pub configurations: u64,
    /// Configurations counted above in which minimality is established.
    pub established: u64,
}

/// Counts the occurrences of each minimal subset. Emergent failures come first; within a
/// transition, subsets are in descending order of frequency, then ordered by size and axes.
pub fn occurrences(explained: &[Explained]) -> Vec<Occurrence> {
    let mut counts: BTreeMap<(Transition, AxisSet, AxisSet), (u64, u64)> = BTreeMap::new();
    for Explained { explanation, .. } in explained {
        for answer in &explanation.answers {
            for minimal in &answer.minimal {
                let key = (explanation.transition, answer.start, minimal.set);
                let (configurations, established) = counts.entry(key).or_default();
                *configurations += 1;
                *established += u64::from(minimal.is_established());
            }
        }
    }
    let counts = counts.into_iter();
    let mut occurrences: Vec<Occurrence> = counts
        .map(|((transition, start, set), (configurations, established))| Occurrence {
            transition,
            start,
            set,
            configurations,
            established,
        })
        .collect();
    occurrences.sort_by_key(|o| (o.transition, Reverse(o.configurations), o.set, o.start));
    occurrences
}
