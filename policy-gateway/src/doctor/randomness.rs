//! Randomness of a server's answers: their dependence on the seed, and the difference between
//! answers to a repeated query.

use crate::doctor::answers::Answers;
use crate::doctor::probe::ExaminationError;
use crate::doctor::server_pair::{SEED, ServerPair, Side};
use crate::doctor::verdict::BATCH_TOLERANCE;

/// Largest difference of answers that count as equal: batches and kernels change low-order bits.
pub(crate) const REPEATABLE: f64 = BATCH_TOLERANCE as f64;
/// Number of answers per situation that are averaged, if equal seeds do not give equal noise.
pub(crate) const SEEDS_PER_MEAN: usize = 8;
/// Number of situations that are queried again.
const SITUATIONS: usize = 3;

/// Largest variation of a server's answers to the same observation, over [`SITUATIONS`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Randomness {
    /// Largest difference between answers to a repeated query.
    pub repeat_difference: f64,
    /// Largest difference between answers with two seeds.
    pub seed_difference: f64,
}

impl Randomness {
    /// Repeats a server's queries with the same seed and with another seed; `answers` are the
    /// answers to the first queries, with [`SEED`].
    pub(crate) async fn measure(
        servers: &ServerPair,
        side: Side,
        answers: &Answers,
    ) -> Result<Self, ExaminationError> {
        let same_seed = servers.query(side, &[], SITUATIONS, |_| vec![SEED]).await?;
        let other_seed = servers.query(side, &[], SITUATIONS, |_| vec![SEED + 1]).await?;
        Ok(Self {
            repeat_difference: same_seed.largest_difference(answers).0,
            seed_difference: other_seed.largest_difference(answers).0,
        })
    }

    pub(crate) fn is_repeatable(&self) -> bool {
        self.repeat_difference <= REPEATABLE
    }

    /// Returns true if answers depend on the seed, and are equal for equal seeds.
    pub(crate) fn follows_seed(&self) -> bool {
        self.is_repeatable() && self.seed_difference > REPEATABLE
    }
}
