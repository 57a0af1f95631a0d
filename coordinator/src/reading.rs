//! Errors from reading a campaign's stored results.

use libero_ctrl::{JsonError, SpecError, UnknownName};
use queue::ids::CampaignName;
use queue::{QueueError, StoreError};

/// Error from reading a campaign's stored results.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The campaign does not exist, or the database failed.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// The stored specification cannot be parsed.
    #[error("read the stored specification of campaign `{campaign}`")]
    Spec {
        /// The campaign.
        campaign: CampaignName,
        /// Error of the specification.
        source: SpecError,
    },
    /// A stored rollout id or realisation cannot be parsed.
    #[error("read a stored name of a result")]
    Name(#[from] UnknownName),
    /// A stored manifest row cannot be parsed.
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
