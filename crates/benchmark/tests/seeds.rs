//! Tests of seeds: a replicate changes only the policy's seed, and the matched streams depend on
//! neither replicate nor condition.

use std::collections::BTreeSet;

use benchmark::seeds::{policy_seed, reference_seed, rollout_seed};
use benchmark::streams::Randomness;
use benchmark::{Axis, Condition, Design, ManifestRow, Realisation, RolloutId};

const REPLICATES: u32 = 5;

fn rows() -> Vec<ManifestRow> {
    Design::v0_1().expand().expect("rows")
}

fn sibling(id: RolloutId, condition: Condition) -> RolloutId {
    let config = id.config().expect("a perturbed rollout");
    RolloutId::perturbed(id.task(), condition, id.level(), config).expect("an id")
}

#[test]
fn every_replicate_of_every_rollout_has_its_own_policy_seed() {
    for row in rows() {
        let seeds: BTreeSet<u64> = (0..REPLICATES).map(|k| policy_seed(&row.id, k)).collect();
        assert_eq!(seeds.len(), REPLICATES as usize, "{}", row.id);
    }
}

#[test]
fn the_first_replicate_has_the_references_seed() {
    for row in rows() {
        assert_eq!(policy_seed(&row.id, 0), u64::from(rollout_seed(&row.id)));
    }
}

/// The protocol derives the policy's seed from the rollout's id, so that this seed differs between
/// the conditions of a configuration, whose other random elements are equal.
#[test]
fn conditions_of_a_configuration_have_different_policy_seeds_and_the_same_matched_streams() {
    let rows = rows();
    let perturbed = rows.iter().filter(|row| row.id.config().is_some());
    for id in perturbed.map(|row| row.id) {
        let Condition::Single(axis) = id.condition() else {
            continue;
        };
        let combined = sibling(id, Condition::Simultaneous);
        assert_ne!(policy_seed(&id, 0), policy_seed(&combined, 0), "{id}");
        let matched = |id| Randomness::of(id, axis, Realisation::Matched);
        assert_eq!(matched(&id), matched(&combined), "{id}");
    }
}

/// Defect that the `matched` realisation corrects: the reference draws the
/// bias, the misalignment, the blur's angle and all noise anew in the
/// combination.
#[test]
fn the_references_seeds_of_a_configuration_differ_between_conditions() {
    let rows = rows();
    let perturbed = rows.iter().filter(|row| row.id.config().is_some());
    for id in perturbed.map(|row| row.id) {
        if let Condition::Single(axis @ (Axis::Sensor | Axis::Actuation)) = id.condition() {
            let combined = sibling(id, Condition::Simultaneous);
            assert_ne!(reference_seed(&id, axis), reference_seed(&combined, axis));
        }
    }
}

#[test]
fn no_two_single_axis_rollouts_share_a_matched_stream() {
    let rows = rows();
    let mut streams = Vec::new();
    for row in &rows {
        if let Condition::Single(axis) = row.id.condition() {
            streams.push(Randomness::of(&row.id, axis, Realisation::Matched));
        }
    }
    let distinct: BTreeSet<String> = streams.iter().map(|s| format!("{s:?}")).collect();
    assert_eq!(distinct.len(), 40 * 10 * 3 * 6);
}
