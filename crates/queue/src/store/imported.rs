//! Statements that read the rows of an archive before they are trusted.

use std::collections::BTreeSet;

use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::ids::{CampaignId, JobId};

/// The columns of a job that an archive is checked by. Types are SQLite's,
/// since the values are untrusted.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct StoredRow {
    pub(crate) id: JobId,
    pub(crate) rollout_id: String,
    pub(crate) replicate: i64,
    pub(crate) task: String,
    pub(crate) init_id: i64,
    pub(crate) policy_seed: i64,
    /// Manifest row, JSON.
    pub(crate) manifest_row: String,
}

/// Returns the checked columns of some jobs.
pub(crate) async fn rows_of(
    tx: &mut SqliteConnection,
    jobs: &[JobId],
) -> Result<Vec<StoredRow>, StoreError> {
    sqlx::query_as(
        "SELECT j.id, j.rollout_id, j.replicate, j.task, j.init_id, j.policy_seed,
             j.manifest_row
         FROM json_each(?) w CROSS JOIN job j ON j.id = w.value",
    )
    .bind(json(jobs))
    .fetch_all(tx)
    .await
    .doing("read the rows of an archive")
}

/// Key of a task, with its numbers of policy steps and settling steps.
pub(crate) type Budget = (String, i64, i64);

/// Returns the step budgets of a campaign's rollouts.
pub(crate) async fn budgets(
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

/// Returns the ids of all workers with their slots and cores. Types are SQLite's, since the values
/// are untrusted.
pub(crate) async fn worker_sizes(
    tx: &mut SqliteConnection,
) -> Result<Vec<(String, i64, Option<i64>)>, StoreError> {
    sqlx::query_as("SELECT id, slots, cores FROM worker ORDER BY id")
        .fetch_all(tx)
        .await
        .doing("read the workers of an archive")
}
