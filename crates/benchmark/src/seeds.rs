//! Seeds derived from a rollout's id, as in section 5 of the protocol. The matched
//! realisation does not use [`reference_seed`], see `streams`.

use crate::axis::Axis;
use crate::condition::Condition;
use crate::rollout_id::RolloutId;

/// Returns the seed of a rollout: the CRC-32 (zlib) of its published id.
pub fn rollout_seed(id: &RolloutId) -> u32 {
    crc32fast::hash(id.published().as_bytes())
}

/// Returns the seed passed to the policy at Reset: for replicate 0 the rollout's seed, for
/// replicate k ≥ 1 the CRC-32 of `{id}#r{k}`. Replicates differ in this seed only. A variant of
/// LIBERO's family, or a rollout of a suite file, has the seed of its task's nominal rollout, so
/// that a policy that samples draws the same random numbers in both rollouts.
pub fn policy_seed(id: &RolloutId, replicate: u32) -> u64 {
    let id = match id.variant() {
        Some(_) => RolloutId::nominal(id.task(), id.number()),
        None => *id,
    };
    let id = &id;
    u64::from(match replicate {
        0 => rollout_seed(id),
        k => crc32fast::hash(format!("{}#r{k}", id.published()).as_bytes()),
    })
}

/// Returns the seed of an axis in the `reference` realisation: `default_rng(seed)` draws
/// the elements that are fixed for the rollout, `default_rng(seed + 1)` the noise of each
/// step. In a condition of several axes, the axis at index k of [`Axis::METRIC`] adds 1000·k.
pub fn reference_seed(id: &RolloutId, axis: Axis) -> u64 {
    let index = match id.condition() {
        Condition::Subset(_) | Condition::Simultaneous => {
            Axis::METRIC.iter().position(|&metric| metric == axis)
        }
        _ => None,
    };
    u64::from(rollout_seed(id)) + 1000 * index.unwrap_or(0) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(text: &str) -> RolloutId {
        text.parse().expect("an id")
    }

    /// Values of Python's `zlib.crc32`.
    #[test]
    fn seeds_are_the_crc_32_of_the_id() {
        assert_eq!(rollout_seed(&id("spatial/t0/camera/L2/c00")), 2_926_471_293);
        assert_eq!(policy_seed(&id("long/t5/simultaneous/L3/c08"), 0), 2_736_294_675);
        assert_eq!(policy_seed(&id("goal/t9/nominal/i00"), 1), 250_929_353);
    }

    #[test]
    fn axes_of_simultaneous_have_seeds_a_thousand_apart() {
        let simultaneous = id("long/t5/simultaneous/L3/c08");
        let seed = u64::from(rollout_seed(&simultaneous));
        assert_eq!(reference_seed(&simultaneous, Axis::Camera), seed);
        assert_eq!(reference_seed(&simultaneous, Axis::Actuation), seed + 4000);
        let alone = id("long/t5/actuation/L3/c08");
        let seed = u64::from(rollout_seed(&alone));
        assert_eq!(reference_seed(&alone, Axis::Actuation), seed);
    }
}
