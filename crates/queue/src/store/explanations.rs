//! Statements on `explanation`: campaigns that explain others, and what their next
//! jobs follow from.

use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::expand::NewJob;
use crate::ids::{CampaignId, CampaignName};
use crate::store::campaigns;

/// A campaign that explains another.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct Explaining {
    pub(crate) campaign: CampaignId,
    pub(crate) explained: CampaignId,
    /// Its specification, JSON.
    pub(crate) spec: String,
    /// Its jobs so far.
    pub(crate) jobs: i64,
    /// Jobs without an outcome of the campaign that it explains.
    pub(crate) unsettled: i64,
}

/// A job of either campaign.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct OutcomeRow {
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
    pub(crate) init_id: u16,
    pub(crate) is_quarantined: bool,
    pub(crate) success: Option<bool>,
}

/// Notes that a campaign explains another.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    explained: CampaignId,
) -> Result<(), StoreError> {
    sqlx::query("INSERT INTO explanation (campaign_id, explained_id) VALUES (?, ?)")
        .bind(campaign)
        .bind(explained)
        .execute(tx)
        .await
        .doing("store which campaign is explained")
        .map(drop)
}

/// The campaigns that explain others and are not cancelled.
pub(crate) async fn explaining(tx: &mut SqliteConnection) -> Result<Vec<Explaining>, StoreError> {
    sqlx::query_as(
        "SELECT e.campaign_id AS campaign, e.explained_id AS explained, c.spec, c.jobs,
             (SELECT count(*) FROM job j WHERE j.campaign_id = e.explained_id
              AND j.state IN ('queued', 'leased')) AS unsettled
         FROM explanation e JOIN campaign c ON c.id = e.campaign_id
         WHERE c.state <> 'cancelled' ORDER BY e.campaign_id",
    )
    .fetch_all(tx)
    .await
    .doing("list campaigns that explain others")
}

/// The campaign that one explains, if it explains one.
pub(crate) async fn explained(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Option<CampaignId>, StoreError> {
    sqlx::query_scalar("SELECT explained_id FROM explanation WHERE campaign_id = ?")
        .bind(campaign)
        .fetch_optional(tx)
        .await
        .doing("look which campaign one explains")
}

/// The names of the campaigns that explain one.
pub(crate) async fn of(
    tx: &mut SqliteConnection,
    explained: CampaignId,
) -> Result<Vec<CampaignName>, StoreError> {
    sqlx::query_scalar(
        "SELECT c.name FROM explanation e JOIN campaign c ON c.id = e.campaign_id
         WHERE e.explained_id = ? ORDER BY c.id",
    )
    .bind(explained)
    .fetch_all(tx)
    .await
    .doing("list the campaigns that explain one")
}

/// What is known of a campaign's jobs.
pub(crate) async fn outcomes(
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
    .doing("read the outcomes that an explanation follows from")
}

/// The manifest rows of a campaign's rollouts, JSON.
pub(crate) async fn rows(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    rollouts: &[String],
) -> Result<Vec<String>, StoreError> {
    sqlx::query_scalar(
        "SELECT manifest_row FROM job WHERE campaign_id = ? AND replicate = 0
             AND rollout_id IN (SELECT value FROM json_each(?)) ORDER BY rollout_id",
    )
    .bind(campaign)
    .bind(json(rollouts))
    .fetch_all(tx)
    .await
    .doing("read the rollouts to explain")
}

/// Adds jobs to a campaign, behind those that it has.
pub(crate) async fn append(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    jobs: &[NewJob],
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT OR IGNORE INTO campaign_task (campaign_id, task)
         SELECT DISTINCT ?, value FROM json_each(?)",
    )
    .bind(campaign)
    .bind(json(jobs.iter().map(|job| &job.task).collect::<Vec<_>>()))
    .execute(&mut *tx)
    .await
    .doing("store a campaign's tasks")?;
    campaigns::insert_jobs(&mut *tx, campaign, jobs).await?;
    sqlx::query("UPDATE campaign SET jobs = jobs + ? WHERE id = ?")
        .bind(jobs.len() as i64)
        .bind(campaign)
        .execute(tx)
        .await
        .doing("count a campaign's jobs")
        .map(drop)
}
