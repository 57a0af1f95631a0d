//! Rollouts of the source campaign on which searches rest, and the random order in which
//! configurations are searched.

use crate::Record;
use benchmark::RolloutId;
use benchmark::seeds::rollout_seed;
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Returns the records that decide outcomes: all but those of the placebo level, whose
/// perturbations are too small to matter, and only replicate 0 unless `has_repeats`.
pub(crate) fn decisive(records: &[Record], has_repeats: bool) -> Vec<Record> {
    let is_decisive =
        |record: &&Record| !record.id.is_placebo() && (has_repeats || record.replicate == 0);
    records.iter().filter(is_decisive).copied().collect()
}

/// Returns a pseudorandom sort key of a configuration, which is named by its simultaneous rollout.
/// Configurations are searched in ascending order of their keys. A key depends on the seed and on
/// the configuration alone.
pub(crate) fn rank(configuration: &RolloutId, seed: u64) -> u64 {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    rng.set_stream(u64::from(rollout_seed(configuration)));
    rng.next_u64()
}
