//! Step budgets of rollouts, in which a campaign must agree with its source.

use std::collections::BTreeSet;

use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::ids::CampaignId;

/// A task, by its key, with its numbers of policy steps and settling steps.
pub(crate) type Budget = (String, i64, i64);

pub(crate) async fn of_campaign(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<BTreeSet<Budget>, StoreError> {
    let budgets: Vec<Budget> = sqlx::query_as(
        "SELECT DISTINCT task, manifest_row ->> 'max_steps', manifest_row ->> 'num_steps_wait'
         FROM job WHERE campaign_id = ?",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read the step budgets of a campaign")?;
    Ok(budgets.into_iter().collect())
}
