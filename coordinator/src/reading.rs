//! Errors from reading a campaign's stored results.

use benchmark::{JsonError, SpecError, UnknownName};
use queue::ids::CampaignName;
use queue::{QueueError, StoreError};

/// Error from reading a campaign's stored results.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The campaign does not exist, or the database failed.
    #[error(transparent)]
    Queue(#[from] QueueError),
    #[error("read the stored specification of campaign `{campaign}`")]
    Spec { campaign: CampaignName, source: SpecError },
    #[error("read a name in a stored result")]
    Name(#[from] UnknownName),
    #[error("read the stored manifest row of `{rollout_id}`")]
    Row { rollout_id: String, source: JsonError },
}

impl From<StoreError> for ReadError {
    fn from(error: StoreError) -> ReadError {
        ReadError::Queue(error.into())
    }
}
