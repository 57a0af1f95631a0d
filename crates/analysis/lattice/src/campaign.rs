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

/// The configurations of a campaign and what is known of each, by the
/// simultaneous rollout: `explained` are that campaign's records, `own` those of
/// the campaign that explains it. Of a rollout that is recorded twice, nothing is
/// known.
///
/// One rollout decides, and is that of replicate 0, unless the policy samples:
/// then all replicates count.
///
/// # Errors
/// If the campaign perturbs one axis only.
pub fn configurations(
    explained: &[Record],
    own: &[Record],
    explanation: &Explanation,
) -> Result<BTreeMap<RolloutId, Known>, KnownError> {
    let evidence = match explanation.repeats {
        None => Evidence::Once,
        Some(most) => Evidence::Repeated(Repeats::up_to(most)),
    };
    // Nothing explains a change at the placebo level: nothing to speak of is perturbed.
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

/// The configurations of a campaign that runs subsets of the axes itself, and what is
/// known of each in replicate 0.
///
/// # Errors
/// If the campaign perturbs one axis only.
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
    /// Sample of a campaign that explains another one, whose records are `explained`.
    pub fn of(explanation: &Explanation, explained: &[Record]) -> Self {
        let replicates = explained.iter().map(|record| record.replicate + 1).max();
        Self {
            budget: explanation.budget.unwrap_or(u32::MAX),
            seed: explanation.seed,
            strategy: match explanation.exhaustive {
                true => Strategy::Exhaustive,
                false => Strategy::Adaptive,
            },
            replicates: match explanation.repeats {
                None => 1,
                Some(_) => replicates.unwrap_or(1),
            },
        }
    }
}
