//! Rollouts of the source campaign on which searches rest, and the random order in which
//! configurations are searched.

use libero_ctrl::RolloutId;
use libero_ctrl::seeds::rollout_seed;
use paired::Record;
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Returns the records without those of the placebo level, whose perturbations are too small
/// to matter, and without replicates other than 0 unless `has_repeats`.
pub(crate) fn decisive(records: &[Record], has_repeats: bool) -> Vec<Record> {
    let is_decisive =
        |record: &&Record| !record.id.is_placebo() && (has_repeats || record.replicate == 0);
    records.iter().filter(is_decisive).copied().collect()
}

/// Returns the place of a configuration, named by its simultaneous rollout, in the random
/// order of a seed. It does not depend on the other configurations.
pub(crate) fn rank(configuration: &RolloutId, seed: u64) -> u64 {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    rng.set_stream(u64::from(rollout_seed(configuration)));
    rng.next_u64()
}
