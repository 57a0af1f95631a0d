//! Joins the records of two campaigns, the explained and the explaining one, into the
//! known outcomes of each configuration.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use libero_ctrl::{Condition, Explanation, RolloutId};
use paired::{Record, Records};

use crate::evidence::{Evidence, Repeats};
use crate::known::{Known, KnownError};
use crate::next::Strategy;
use crate::plan::Sample;

/// Returns the known outcomes of each configuration of a campaign, by its simultaneous
/// rollout. `explained` are the records of that campaign, `own` those of the campaign that
/// explains it. A rollout that is recorded twice counts as unknown.
///
/// Without repeats, the rollout of replicate 0 alone decides. With repeats, for policies that
/// sample, all replicates of the explained campaign select configurations, and only those of
/// the campaign that explains it decide.
///
/// # Errors
/// If the campaign perturbs only one axis.
pub fn configurations(
    explained: &[Record],
    own: &[Record],
    explanation: &Explanation,
) -> Result<BTreeMap<RolloutId, Known>, KnownError> {
    let evidence = match explanation.repeats {
        None => Evidence::Once,
        Some(most) => Evidence::Repeated(Repeats::up_to(most)),
    };
    // Changes at the placebo level have no explanation, because its perturbations are too
    // small to matter.
    let counts = |record: &&Record| {
        !record.id.is_placebo() && (explanation.repeats.is_some() || record.replicate == 0)
    };
    let explained: Vec<Record> = explained.iter().filter(counts).copied().collect();
    let records = Records::new(&explained).unwrap_or_default();
    let mut known = BTreeMap::new();
    for matched in records.configurations() {
        let simultaneous = Condition::Combination;
        let id = RolloutId::perturbed(matched.task, simultaneous, matched.level, matched.config);
        let Ok(id) = id else { continue };
        match known.entry(id) {
            Entry::Vacant(new) => {
                new.insert(Known::of_campaign(matched, evidence)?);
            }
            Entry::Occupied(mut there) => there.get_mut().add_replicate(matched)?,
        }
    }
    for &Record { id, outcome, .. } in own {
        let simultaneous = Condition::Combination;
        let name = RolloutId::perturbed(id.task(), simultaneous, id.level(), id.number());
        if let Some(configuration) = name.ok().and_then(|name| known.get_mut(&name)) {
            let axes = id.condition().axes(configuration.full());
            configuration.record(axes, outcome)?;
        }
    }
    Ok(known)
}

/// Returns the known outcomes in replicate 0 of each configuration of a campaign that runs
/// subsets of the axes itself.
///
/// # Errors
/// If the campaign perturbs only one axis.
pub fn own_configurations(records: &[Record]) -> Result<BTreeMap<RolloutId, Known>, KnownError> {
    let is_subset = |record: &&Record| matches!(record.id.condition(), Condition::Subset(_));
    let first = records.iter().filter(|record| record.replicate == 0);
    let (subsets, others): (Vec<&Record>, Vec<&Record>) = first.partition(is_subset);
    let owned = |records: Vec<&Record>| records.into_iter().copied().collect::<Vec<_>>();
    let once = Explanation {
        campaign: String::new(),
        budget: None,
        seed: 0,
        exhaustive: true,
        repeats: None,
    };
    configurations(&owned(others), &owned(subsets), &once)
}

impl Sample {
    /// Returns the sampling settings of a campaign that explains another one.
    pub fn of(explanation: &Explanation) -> Self {
        Self {
            budget: explanation.budget.unwrap_or(u32::MAX),
            seed: explanation.seed,
            strategy: match explanation.exhaustive {
                true => Strategy::Exhaustive,
                false => Strategy::Adaptive,
            },
        }
    }
}
