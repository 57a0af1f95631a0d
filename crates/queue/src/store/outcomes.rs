//! A job with its outcome: the type of row that several queries return.

use benchmark::UnknownName;
use paired::{Outcome, Record};
use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::ids::CampaignId;

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
    pub fn outcome(&self) -> Outcome {
        match (self.success, self.is_quarantined) {
            (Some(success), _) => Outcome::from(success),
            (None, true) => Outcome::Quarantined,
            (None, false) => Outcome::Missing,
        }
    }

    pub fn record(&self) -> Result<Record, UnknownName> {
        Ok(Record {
            id: self.rollout_id.parse()?,
            init_id: self.init_id,
            replicate: self.replicate,
            outcome: self.outcome(),
        })
    }
}

/// Returns all jobs of a campaign with their outcomes so far, by rollout id, then replicate.
pub(crate) async fn of_campaign(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<OutcomeRow>, StoreError> {
    sqlx::query_as(
        "SELECT j.rollout_id, j.replicate, j.init_id, j.state = 'quarantined' AS is_quarantined,
             r.success
         FROM job j LEFT JOIN result r ON r.job_id = j.id
         WHERE j.campaign_id = ? ORDER BY j.rollout_id, j.replicate",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read a campaign's outcomes")
}
