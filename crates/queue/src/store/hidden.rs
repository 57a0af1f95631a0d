//! Statements on `passage`: campaigns that are inserted or deleted in batches, so that workers are
//! served in between. Meanwhile the campaign is hidden: its name is not a valid campaign name, its
//! jobs are not leased, and lists of campaigns exclude it.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::clock::UnixMillis;
use crate::ids::{CampaignId, CampaignName, PolicyId};

/// Statements that hide a campaign, each with the campaign's row number as `?1`.
const HIDE: [&str; 2] = [
    "INSERT INTO passage (campaign_id) VALUES (?1)",
    "UPDATE campaign SET name = '~' || id, folder = NULL WHERE id = ?1",
];

/// Statements that remove the remaining visible traces of a campaign that is being deleted.
const REMOVE_TRACES: [&str; 3] = [
    "UPDATE campaign SET state = 'cancelled' WHERE id = ?1",
    "DELETE FROM stop WHERE campaign_id = ?1",
    "DELETE FROM former_name WHERE campaign_id = ?1",
];

async fn run(
    tx: &mut SqliteConnection,
    statements: &[&'static str],
    id: CampaignId,
) -> Result<(), StoreError> {
    for statement in statements {
        sqlx::query(*statement)
            .bind(id)
            .execute(&mut *tx)
            .await
            .doing("hide, publish or remove a campaign")?;
    }
    Ok(())
}

/// Hides a campaign that has just been stored without its jobs. It is paused until it is published.
pub(crate) async fn hide_new(tx: &mut SqliteConnection, id: CampaignId) -> Result<(), StoreError> {
    run(tx, &HIDE, id).await?;
    run(tx, &["UPDATE campaign SET state = 'paused' WHERE id = ?1 AND state = 'running'"], id).await
}

pub(crate) async fn hide_deleted(
    tx: &mut SqliteConnection,
    id: CampaignId,
) -> Result<(), StoreError> {
    run(tx, &HIDE, id).await?;
    run(tx, &REMOVE_TRACES, id).await
}

/// Makes a campaign visible under its name once all its jobs are stored.
pub(crate) async fn publish(
    tx: &mut SqliteConnection,
    id: CampaignId,
    (name, folder): (&CampaignName, &str),
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE campaign SET name = ?2, folder = nullif(?3, ?2),
             state = iif(state = 'paused', 'running', state), state_since_ms = ?4,
             created_ms = ?4 WHERE id = ?1",
    )
    .bind(id)
    .bind(name)
    .bind(folder)
    .bind(now)
    .execute(&mut *tx)
    .await
    .doing("make a complete campaign visible")?;
    run(tx, &["DELETE FROM passage WHERE campaign_id = ?1"], id).await
}

pub(crate) async fn all(
    tx: &mut SqliteConnection,
) -> Result<Vec<(CampaignId, PolicyId)>, StoreError> {
    sqlx::query_as(
        "SELECT c.id, c.policy_id FROM passage h JOIN campaign c ON c.id = h.campaign_id
         ORDER BY c.id",
    )
    .fetch_all(tx)
    .await
    .doing("list incomplete campaigns")
}

/// Deletes up to `limit` jobs of a campaign with all dependent rows. Returns their number.
pub(crate) async fn delete_jobs(
    tx: &mut SqliteConnection,
    id: CampaignId,
    limit: usize,
) -> Result<u64, StoreError> {
    let deleted = sqlx::query(
        "DELETE FROM job WHERE id IN (SELECT id FROM job WHERE campaign_id = ? LIMIT ?)",
    )
    .bind(id)
    .bind(i64::try_from(limit).unwrap_or(i64::MAX))
    .execute(tx)
    .await
    .doing("delete a campaign's jobs")?;
    Ok(deleted.rows_affected())
}
