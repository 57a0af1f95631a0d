//! Statements on `artifact`: which files are kept beside which rollout.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::clock::UnixMillis;
use crate::ids::{CampaignName, LeaseRef};

/// The rollout that an artifact belongs to.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct ArtifactOwner {
    pub(crate) campaign: CampaignName,
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
}

/// The rollout that `lease` may store files for: it holds the job, or its
/// result is the committed one.
pub(crate) async fn owner(
    tx: &mut SqliteConnection,
    lease: &LeaseRef,
) -> Result<Option<ArtifactOwner>, StoreError> {
    sqlx::query_as(
        "SELECT c.name AS campaign, j.rollout_id, j.replicate
         FROM job j JOIN campaign c ON c.id = j.campaign_id
         LEFT JOIN result r ON r.job_id = j.id
         WHERE j.id = ?1 AND j.attempt = ?2
             AND ((j.state = 'leased' AND j.lease_owner = ?3)
                 OR (r.attempt = ?2 AND r.worker_id = ?3))",
    )
    .bind(lease.job)
    .bind(lease.attempt)
    .bind(&lease.worker)
    .fetch_optional(tx)
    .await
    .doing("look up whose file this is")
}

/// Records a stored file; a later attempt's replaces an earlier one's.
pub(crate) async fn record(
    tx: &mut SqliteConnection,
    lease: &LeaseRef,
    kind: &str,
    path: &str,
    size_bytes: u64,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT OR REPLACE INTO artifact (job_id, kind, attempt, path, size_bytes, stored_ms)
         VALUES (?, ?, ?, ?, ?, ?)",
    )
    .bind(lease.job)
    .bind(kind)
    .bind(lease.attempt)
    .bind(path)
    .bind(i64::try_from(size_bytes).unwrap_or(i64::MAX))
    .bind(now)
    .execute(tx)
    .await
    .doing("record a stored file")?;
    Ok(())
}
