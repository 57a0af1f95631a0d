//! Explanations as plain data, to be drawn: the lattice of one configuration,
//! and how often each minimal subset occurs over all.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use libero_ctrl::{AxisSet, RolloutId};
use paired::{Interval, Transition};
use serde::{Deserialize, Serialize};

use crate::evidence::{Evidence, Tally, Verdict};
use crate::explain::{Explanation, Unexplained, explain};
use crate::known::Known;
use crate::proportion::clopper_pearson;

/// One configuration's lattice and its explanation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Explained {
    /// The configuration, named by its simultaneous rollout.
    pub configuration: RolloutId,
    /// All axes of the campaign.
    pub full: AxisSet,
    /// Rule by which verdicts were reached.
    pub evidence: Evidence,
    /// The transition and its minimal subsets.
    pub explanation: Explanation,
    /// Every subset of which a rollout was asked for, in order, from the nominal
    /// rollout to the simultaneous one.
    pub outcomes: Vec<SubsetOutcome>,
    /// Rollouts under the subsets that no campaign runs by itself: all but none,
    /// one and all of the axes.
    pub rollouts: u32,
}

/// Verdict and rollouts under one subset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SubsetOutcome {
    /// The axes that are perturbed.
    pub set: AxisSet,
    /// Verdict, as far as it is decided.
    pub verdict: Verdict,
    /// Its rollouts.
    pub tally: Tally,
    /// With replicates, the Clopper–Pearson interval of its success probability
    /// at the level of one test: it excludes ½ exactly where the verdict is
    /// success or failure. Absent for a deterministic policy, and without a result.
    pub interval: Option<Interval>,
}

impl Explained {
    /// Explains a configuration, named by its simultaneous rollout.
    ///
    /// # Errors
    /// If it has no transition to be explained.
    pub fn of(configuration: RolloutId, known: &Known) -> Result<Self, Unexplained> {
        let explanation = explain(known)?;
        Ok(Self {
            configuration,
            full: known.full(),
            evidence: known.evidence(),
            explanation,
            outcomes: outcomes(known),
            rollouts: known.further_rollouts(),
        })
    }
}

/// Returns the outcomes under every subset of which a rollout was asked for, in
/// order.
pub fn outcomes(known: &Known) -> Vec<SubsetOutcome> {
    let evidence = known.evidence();
    let outcome = |(set, tally): (AxisSet, Tally)| SubsetOutcome {
        set,
        verdict: evidence.verdict(&tally),
        tally,
        interval: match evidence {
            Evidence::Once => None,
            Evidence::Repeated(repeats) => {
                clopper_pearson(tally.count(), 1.0 - repeats.error_per_test())
            }
        },
    };
    known.tallies().map(outcome).collect()
}

/// Frequency of a minimal subset: a bar of an UpSet plot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Occurrence {
    /// Emergent or compensated.
    pub transition: Transition,
    /// The set from which the search started: empty, or the axis that fails alone.
    pub start: AxisSet,
    /// The minimal subset.
    pub set: AxisSet,
    /// Configurations in which it is minimal, as far as was run.
    pub configurations: u64,
    /// Configurations among them in which that is established.
    pub established: u64,
}

/// Counts the occurrences of each minimal subset. Emergent failures come first, and
/// of each transition the most frequent subsets; equally frequent ones are ordered
/// by size, then by their axes.
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
        .map(
            |((transition, start, set), (configurations, established))| Occurrence {
                transition,
                start,
                set,
                configurations,
                established,
            },
        )
        .collect();
    occurrences.sort_by_key(|o| (o.transition, Reverse(o.configurations), o.set, o.start));
    occurrences
}
