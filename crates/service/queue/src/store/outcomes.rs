//! A job with its outcome: the type of row that several queries return.

use libero_ctrl::UnknownName;
use paired::{Outcome, Record};

#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct OutcomeRow {
    pub rollout_id: String,
    /// Number of the replicate of the rollout.
    pub replicate: u32,
    /// Initial state of the rollout.
    pub init_id: u16,
    pub is_quarantined: bool,
    /// Outcome, true if the goal was reached; `None` until the job is committed.
    pub success: Option<bool>,
}

impl OutcomeRow {
    /// Returns the outcome for statistics.
    pub fn outcome(&self) -> Outcome {
        match (self.success, self.is_quarantined) {
            (Some(success), _) => Outcome::from(success),
            (None, true) => Outcome::Quarantined,
            (None, false) => Outcome::Missing,
        }
    }

    /// Returns the record for statistics.
    pub fn record(&self) -> Result<Record, UnknownName> {
        Ok(Record {
            id: self.rollout_id.parse()?,
            init_id: self.init_id,
            replicate: self.replicate,
            outcome: self.outcome(),
        })
    }
}
