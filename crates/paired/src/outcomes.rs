//! What is known of a rollout.

use protocol::RolloutId;

/// How a rollout ended, if it did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// The goal held within the step budget.
    Success,
    /// It did not.
    Failure,
    /// Expanded, and without a result yet.
    Missing,
    /// Set aside after too many failed attempts: in no rate, and named.
    Quarantined,
}

impl Outcome {
    /// Whether the task succeeded, where that is known.
    pub const fn success(self) -> Option<bool> {
        match self {
            Self::Success => Some(true),
            Self::Failure => Some(false),
            Self::Missing | Self::Quarantined => None,
        }
    }
}

/// One row of a campaign × one replicate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// Which rollout.
    pub id: RolloutId,
    /// The initial state that it started from; pairs a configuration with its
    /// nominal rollout.
    pub init_id: u16,
    /// Which replicate.
    pub replicate: u32,
    /// How it ended.
    pub outcome: Outcome,
}
