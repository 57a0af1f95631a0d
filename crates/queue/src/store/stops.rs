//! Statements on `stop`: campaigns that may stop early or have stopped early.

use benchmark::Stop;
use serde::{Deserialize, Serialize};
use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::clock::UnixMillis;
use crate::ids::CampaignId;

/// A campaign that may stop early and has not.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct Stoppable {
    pub(crate) campaign: CampaignId,
    #[sqlx(json)]
    pub(crate) stop: Stop,
}

/// The first rollout that is neither committed nor quarantined, in the campaign's order of jobs.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct FirstUnsettled {
    pub(crate) rollout_id: String,
    /// Place of the rollout's job in the campaign's order of jobs.
    pub(crate) unit_order: i64,
}

/// Early stop of a campaign: the rule, and the point at which the campaign stopped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, sqlx_macros::FromRow)]
pub struct EarlyStop {
    /// The stop rule, with the seed of the random order of configurations.
    #[sqlx(json)]
    #[serde(flatten)]
    pub stop: Stop,
    /// Number of all configurations of the campaign.
    pub configurations: u32,
    /// Number of configurations after which the campaign stopped; `None` if it has not stopped.
    pub used: Option<u32>,
    /// Number of rollouts that do not run and stay queued; `None` if it has not stopped.
    pub saved: Option<u32>,
}

pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    configurations: usize,
) -> Result<(), StoreError> {
    sqlx::query("INSERT INTO stop (campaign_id, configurations) VALUES (?, ?)")
        .bind(campaign)
        .bind(i64::try_from(configurations).unwrap_or(i64::MAX))
        .execute(tx)
        .await
        .doing("store the stop rule of a campaign")
        .map(drop)
}

pub(crate) async fn stoppable(tx: &mut SqliteConnection) -> Result<Vec<Stoppable>, StoreError> {
    sqlx::query_as(
        "SELECT s.campaign_id AS campaign, c.spec -> '$.stop' AS stop FROM stop s
         JOIN campaign c ON c.id = s.campaign_id
         WHERE s.stopped_ms IS NULL AND c.state <> 'cancelled' ORDER BY s.campaign_id",
    )
    .fetch_all(tx)
    .await
    .doing("list campaigns that may stop early")
}

/// Returns the first queued or leased rollout, in the campaign's order of jobs; `None` if the
/// campaign is complete. Two index seeks per task.
pub(crate) async fn first_unsettled(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Option<FirstUnsettled>, StoreError> {
    sqlx::query_as(
        "SELECT j.rollout_id, j.unit_order FROM campaign_task t JOIN job j ON j.id IN (
             (SELECT q.id FROM job q WHERE q.campaign_id = t.campaign_id AND q.task = t.task
                  AND q.state = 'queued' ORDER BY q.unit_order LIMIT 1),
             (SELECT l.id FROM job l WHERE l.campaign_id = t.campaign_id AND l.task = t.task
                  AND l.state = 'leased' ORDER BY l.unit_order LIMIT 1))
         WHERE t.campaign_id = ? ORDER BY j.unit_order LIMIT 1",
    )
    .bind(campaign)
    .fetch_optional(tx)
    .await
    .doing("find the first rollout without an outcome")
}

pub(crate) async fn stop(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    used: usize,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE stop SET used = ?, stopped_ms = ? WHERE campaign_id = ?")
        .bind(i64::try_from(used).unwrap_or(i64::MAX))
        .bind(now)
        .bind(campaign)
        .execute(tx)
        .await
        .doing("stop a campaign")
        .map(drop)
}

/// Returns a campaign's stop rule, and the point at which the campaign stopped; `None` without a
/// rule.
pub(crate) async fn early_stop(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Option<EarlyStop>, StoreError> {
    sqlx::query_as(
        "SELECT c.spec -> '$.stop' AS stop, s.configurations, s.used,
             iif(s.used IS NULL, NULL, t.queued) AS saved
         FROM stop s JOIN campaign c ON c.id = s.campaign_id
         JOIN tally t ON t.campaign_id = s.campaign_id WHERE s.campaign_id = ?",
    )
    .bind(campaign)
    .fetch_optional(tx)
    .await
    .doing("read the early stop of a campaign")
}
