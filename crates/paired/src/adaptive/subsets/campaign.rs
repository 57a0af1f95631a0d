//! Joins the records of two campaigns, the explained and the explaining one, into the
//! lattice of each configuration.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use crate::{Record, Records};
use benchmark::{Condition, Explanation, Level, RolloutId, TaskRef};

use super::evidence::{Evidence, Repeats};
use super::lattice::{Lattice, LatticeError};
use super::next::Strategy;
use super::plan::Sample;
use crate::adaptive::source::decisive;

/// Returns the lattice of each configuration of the explained campaign, by the configuration's
/// simultaneous rollout. `explained` are the records of the explained campaign, `explaining` those
/// of the explaining one.
///
/// Without repeats, the rollout of replicate 0 alone decides. With repeats, for policies that
/// sample, all replicates of the explained campaign select configurations, and only the replicates
/// of the explaining campaign decide.
pub fn configurations(
    explained: &[Record],
    explaining: &[Record],
    repeats: Option<u32>,
) -> Result<BTreeMap<RolloutId, Lattice>, LatticeError> {
    let evidence = match repeats {
        None => Evidence::Once,
        Some(most) => Evidence::Repeated(Repeats::up_to(most)),
    };
    let explained = decisive(explained, repeats.is_some());
    let records = Records::new(&explained).map_err(LatticeError::Duplicate)?;
    let full = records.axes().collect();
    let mut lattices = BTreeMap::new();
    for matched in records.configurations() {
        let id = simultaneous(matched.task, matched.level, matched.config);
        let Some(id) = id else { continue };
        let lattice = match lattices.entry(id) {
            Entry::Vacant(new) => new.insert(Lattice::new(full, evidence)?),
            Entry::Occupied(existing) => existing.into_mut(),
        };
        lattice.add_replicate(matched)?;
    }
    for &Record { id, outcome, .. } in explaining {
        let configuration = simultaneous(id.task(), id.level(), id.number());
        if let Some(lattice) = configuration.and_then(|id| lattices.get_mut(&id)) {
            let axes = id.condition().axes(lattice.full());
            lattice.record(axes, outcome)?;
        }
    }
    Ok(lattices)
}

fn simultaneous(task: TaskRef, level: Level, config: u16) -> Option<RolloutId> {
    RolloutId::perturbed(task, Condition::Simultaneous, level, config).ok()
}

/// Returns the lattice of replicate 0 of each configuration of a campaign that runs subsets of
/// the axes itself.
pub fn own_configurations(
    records: &[Record],
) -> Result<BTreeMap<RolloutId, Lattice>, LatticeError> {
    let is_subset = |record: &Record| matches!(record.id.condition(), Condition::Subset(_));
    let records = decisive(records, false).into_iter();
    let (subsets, others): (Vec<Record>, Vec<Record>) = records.partition(is_subset);
    configurations(&others, &subsets, None)
}

impl Sample {
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

#[cfg(test)]
mod tests {
    use crate::Outcome;

    use super::*;

    #[test]
    fn a_rollout_recorded_twice_is_refused_by_name() {
        let record = |id: &str| Record {
            id: id.parse().expect("an id"),
            init_id: 6,
            replicate: 0,
            outcome: Outcome::from(true),
        };
        let mut records = vec![record("goal/t0/camera/L2/c01"), record("goal/t0/robot/L2/c01")];
        let lattices = configurations(&records, &[], None).expect("two axes");
        assert_eq!(lattices.len(), 1);
        records.push(record("goal/t0/robot/L2/c01"));
        let error = configurations(&records, &[], None).expect_err("twice");
        assert_eq!(
            error.to_string(),
            "explain goal/t0/robot/L2/c01: replicate 0 is recorded twice; keep one record"
        );
    }
}
