//! Statements on `artifact`: files that belong to attempts with a committed outcome.

use std::collections::BTreeSet;

use benchmark::attempt::AttemptId;
use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::{CampaignId, JobId};

/// The rollout that an artifact belongs to.
#[derive(Clone, Debug, PartialEq, Eq, sqlx_macros::FromRow)]
pub(crate) struct ArtifactOwner {
    pub(crate) campaign: CampaignId,
    pub(crate) job: JobId,
    /// Folder of the campaign's files.
    pub(crate) folder: String,
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
}

/// Returns the rollout whose outcome was committed by this attempt; `None` if there is none, or its
/// campaign is in `passage`, that is, being inserted or deleted in batches.
pub(crate) async fn owner(
    tx: &mut SqliteConnection,
    attempt: AttemptId,
) -> Result<Option<ArtifactOwner>, StoreError> {
    sqlx::query_as(
        "SELECT c.id AS campaign, j.id AS job, coalesce(c.folder, c.name) AS folder,
             j.rollout_id, j.replicate
         FROM result r JOIN job j ON j.id = r.job_id JOIN campaign c ON c.id = j.campaign_id
         WHERE r.attempt_id = ? AND c.id NOT IN (SELECT campaign_id FROM passage)",
    )
    .bind(attempt.to_string())
    .fetch_optional(tx)
    .await
    .doing("find the rollout of a video")
}

/// Returns those of the paths that are recorded as artifacts.
pub(crate) async fn recorded(
    tx: &mut SqliteConnection,
    paths: &[&str],
) -> Result<BTreeSet<String>, StoreError> {
    let found: Vec<String> = sqlx::query_scalar(
        "SELECT path FROM artifact WHERE path IN (SELECT value FROM json_each(?))",
    )
    .bind(json(paths))
    .fetch_all(tx)
    .await
    .doing("check which files are recorded")?;
    Ok(found.into_iter().collect())
}

/// Records a stored video, replacing an earlier upload.
pub(crate) async fn record(
    tx: &mut SqliteConnection,
    attempt: AttemptId,
    path: &str,
    size_bytes: u64,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT OR REPLACE INTO artifact (attempt_id, kind, path, size_bytes, stored_ms)
         VALUES (?, 'video', ?, ?, ?)",
    )
    .bind(attempt.to_string())
    .bind(path)
    .bind(i64::try_from(size_bytes).unwrap_or(i64::MAX))
    .bind(now)
    .execute(tx)
    .await
    .doing("record a stored file")
    .map(drop)
}
