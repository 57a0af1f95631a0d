//! Dependence of a server's answers on chance: on the seed, and on nothing at
//! all.

use super::{
    answers::Answers,
    panel::{Panel, SEED, Side},
    server::RefereeError,
};
use crate::conformance::verdict::BATCH_TOLERANCE;

/// Answers to the same question may differ by so much and still be the same: batches
/// and kernels move low-order bits.
pub const REPEATABLE: f64 = BATCH_TOLERANCE as f64;
/// Situations that it is looked for in.
const SITUATIONS: usize = 3;

/// Variation of a server's answers to one observation.
#[derive(Clone, Copy, Debug)]
pub struct Chance {
    /// Largest difference between two answers to the same question.
    pub repeats: f64,
    /// Largest difference between answers with two seeds.
    pub moves: f64,
}

impl Chance {
    /// Asks a server again, and with another seed; `answers` are those of [`SEED`].
    ///
    /// # Errors
    /// If the server does not answer with actions.
    pub async fn of(panel: &Panel, side: Side, answers: &Answers) -> Result<Self, RefereeError> {
        let again = panel.ask(side, &[], SITUATIONS, |_| vec![SEED]).await?;
        let other = panel.ask(side, &[], SITUATIONS, |_| vec![SEED + 1]).await?;
        Ok(Self {
            repeats: again.largest_difference(answers).0,
            moves: other.largest_difference(answers).0,
        })
    }

    /// Returns true if the same question gets the same answer.
    pub fn is_repeatable(&self) -> bool {
        self.repeats <= REPEATABLE
    }

    /// Returns true if the answers vary with the seed and with nothing else.
    pub fn follows_seed(&self) -> bool {
        self.is_repeatable() && self.moves > REPEATABLE
    }
}
