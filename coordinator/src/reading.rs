//! Errors of reading a campaign's results.

use libero_ctrl::{JsonError, SpecError, UnknownName};
use queue::ids::CampaignName;
use queue::{QueueError, StoreError};

/// Results that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The campaign or the database.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// The stored specification does not read back.
    #[error("read the stored specification of campaign `{campaign}`")]
    Spec {
        /// The campaign.
        campaign: CampaignName,
        /// Error of the specification.
        source: SpecError,
    },
    /// A stored rollout id or realisation does not read back.
    #[error("read a stored name of a result")]
    Name(#[from] UnknownName),
    /// A stored manifest row does not read back.
    #[error("read the stored manifest row of `{rollout_id}`")]
    Row {
        /// Id of the rollout.
        rollout_id: String,
        /// Error of the row.
        source: JsonError,
    },
}

impl From<StoreError> for ReadError {
    fn from(error: StoreError) -> ReadError {
        ReadError::Queue(error.into())
    }
}
