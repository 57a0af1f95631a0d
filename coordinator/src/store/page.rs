//! Statements for the live page and the metrics: they read only, and nothing
//! that workers wait for uses them.

use sqlx::pool::PoolConnection;
use sqlx::{Sqlite, SqliteConnection};

use super::listing::FailureLine;
use super::policies::HealthColumns;
use super::results::Provenance;
use super::{DATABASE_FILE, Doing, Store, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::{Attempt, CampaignId, CampaignName, JobId, PolicyId, WorkerId};
use crate::outage::PolicyHealth;

/// Tells when something was committed, from a connection of its own.
#[derive(Debug)]
pub(crate) struct Changes(PoolConnection<Sqlite>);

/// Sizes of the database's files, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Sizes {
    /// The database itself.
    pub(crate) database: u64,
    /// Its write-ahead log.
    pub(crate) log: u64,
}

/// What a report of a campaign depends on: while it is the same, so is the
/// report.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct Edition {
    id: CampaignId,
    // Row numbers may be given again after a deletion.
    created_ms: UnixMillis,
    committed: i64,
    quarantined: i64,
    divergent: i64,
}

/// One rollout of a configuration, as far as its job goes.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct RolloutLine {
    pub(crate) id: JobId,
    pub(crate) rollout_id: String,
    pub(crate) state: String,
    pub(crate) attempt: Attempt,
    pub(crate) charged_attempts: u32,
    pub(crate) manifest_row: String,
    pub(crate) policy_seed: i64,
    pub(crate) lease_owner: Option<WorkerId>,
    pub(crate) control_steps: Option<u32>,
    pub(crate) stale_reports: u32,
    pub(crate) video_bytes: Option<i64>,
}

/// What a rollout came to, and how.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct OutcomeLine {
    pub(crate) job_id: JobId,
    pub(crate) attempt: Attempt,
    pub(crate) worker_id: WorkerId,
    pub(crate) committed_ms: UnixMillis,
    pub(crate) success: bool,
    pub(crate) steps: u32,
    pub(crate) wall_secs: f64,
    pub(crate) ik_residual_mm: Option<f64>,
    pub(crate) clipped_actions: u32,
    pub(crate) policy_queries: u32,
    pub(crate) divergences: u32,
    pub(crate) scene_digest: String,
    pub(crate) init_state_digest: String,
    pub(crate) perturbation_digests: String,
    pub(crate) first_frame_digest: String,
    #[sqlx(flatten)]
    pub(crate) provenance: Provenance,
}

/// An attempt of one of several jobs that brought no result.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct JobFailure {
    pub(crate) job_id: JobId,
    #[sqlx(flatten)]
    pub(crate) line: FailureLine,
}

/// A policy at one endpoint.
#[derive(Clone, Debug)]
pub(crate) struct PolicyLine {
    pub(crate) endpoint: String,
    pub(crate) name: String,
    pub(crate) health: PolicyHealth,
    /// The campaigns that measure it, oldest first.
    pub(crate) campaigns: Vec<CampaignName>,
}

/// A rollout that was set aside.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct AsideLine {
    pub(crate) campaign: CampaignName,
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
    pub(crate) charged_attempts: u32,
    pub(crate) last_error: String,
}

/// A file kept beside a rollout, below the data folder.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct KeptFile {
    pub(crate) path: String,
    pub(crate) attempt: Attempt,
}

impl Edition {
    /// Whether the other is an earlier or a later one of the same campaign.
    pub(crate) fn is_of_same_campaign(&self, other: &Edition) -> bool {
        (self.id, self.created_ms) == (other.id, other.created_ms)
    }
}

impl Store {
    /// A connection that sees what others commit.
    pub(crate) async fn changes(&self) -> Result<Changes, StoreError> {
        let connection = self.readers.acquire().await;
        connection.map(Changes).doing("watch for changes")
    }

    /// Sizes of the database's files; what is not there has none.
    pub(crate) fn sizes(&self) -> Sizes {
        let size = |name: &str| std::fs::metadata(self.folder.join(name)).map_or(0, |m| m.len());
        Sizes {
            database: size(DATABASE_FILE),
            log: size(&format!("{DATABASE_FILE}-wal")),
        }
    }
}

impl Changes {
    /// A number that another connection's commit changes.
    pub(crate) async fn version(&mut self) -> Result<i64, StoreError> {
        sqlx::query_scalar("PRAGMA data_version")
            .fetch_one(&mut *self.0)
            .await
            .doing("watch for changes")
    }
}

/// What a campaign's report depends on. Each count walks one partial index.
pub(crate) async fn edition(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Edition, StoreError> {
    sqlx::query_as(
        "SELECT id, created_ms,
             (SELECT count(*) FROM job WHERE campaign_id = ?1 AND state = 'committed')
                 AS committed,
             (SELECT count(*) FROM job WHERE campaign_id = ?1 AND state = 'quarantined')
                 AS quarantined,
             (SELECT count(DISTINCT d.job_id) FROM divergence d JOIN job j ON j.id = d.job_id
              WHERE j.campaign_id = ?1) AS divergent
         FROM campaign WHERE id = ?1",
    )
    .bind(campaign)
    .fetch_one(tx)
    .await
    .doing("look whether a campaign's results changed")
}

/// Those of the named rollouts that the campaign has, in one replicate.
pub(crate) async fn rollouts(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    ids: &[String],
    replicate: u32,
) -> Result<Vec<RolloutLine>, StoreError> {
    sqlx::query_as(
        "SELECT j.id, j.rollout_id, j.state, j.attempt, j.charged_attempts, j.manifest_row,
             j.policy_seed, j.lease_owner, j.control_steps, j.stale_reports,
             (SELECT a.size_bytes FROM artifact a WHERE a.job_id = j.id AND a.kind = 'video')
                 AS video_bytes
         FROM job j WHERE j.campaign_id = ? AND j.replicate = ?
             AND j.rollout_id IN (SELECT value FROM json_each(?))",
    )
    .bind(campaign)
    .bind(replicate)
    .bind(json(ids))
    .fetch_all(tx)
    .await
    .doing("read a configuration's rollouts")
}

/// The replicates in which a campaign has a rollout.
pub(crate) async fn replicates(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    rollout_id: &str,
) -> Result<Vec<u32>, StoreError> {
    sqlx::query_scalar(
        "SELECT replicate FROM job WHERE campaign_id = ? AND rollout_id = ? ORDER BY replicate",
    )
    .bind(campaign)
    .bind(rollout_id)
    .fetch_all(tx)
    .await
    .doing("read a rollout's replicates")
}

/// A campaign's rollout ids that begin like this and go on with something, in
/// replicate 0.
pub(crate) async fn beginning(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    prefix: &str,
) -> Result<Vec<String>, StoreError> {
    sqlx::query_scalar(
        "SELECT rollout_id FROM job
         WHERE campaign_id = ?1 AND rollout_id > ?2 AND rollout_id < ?2 || '~' AND replicate = 0",
    )
    .bind(campaign)
    .bind(prefix)
    .fetch_all(tx)
    .await
    .doing("read a configuration's neighbours")
}

/// The committed outcomes of some jobs.
pub(crate) async fn outcomes(
    tx: &mut SqliteConnection,
    jobs: &[JobId],
) -> Result<Vec<OutcomeLine>, StoreError> {
    sqlx::query_as(
        "SELECT r.job_id, r.attempt, r.worker_id, r.committed_ms, r.success, r.steps,
             r.wall_secs, r.ik_residual_mm, r.clipped_actions, r.policy_queries,
             (SELECT count(*) FROM divergence d WHERE d.job_id = r.job_id) AS divergences,
             r.scene_digest, r.init_state_digest, r.perturbation_digests, r.first_frame_digest,
             p.*
         FROM result r JOIN provenance p ON p.id = r.provenance_id
         WHERE r.job_id IN (SELECT value FROM json_each(?))",
    )
    .bind(numbers(jobs))
    .fetch_all(tx)
    .await
    .doing("read a configuration's outcomes")
}

/// How the robots of some committed jobs moved, as `motions` keeps it.
pub(crate) async fn paths(
    tx: &mut SqliteConnection,
    jobs: &[JobId],
) -> Result<Vec<(JobId, Vec<u8>)>, StoreError> {
    sqlx::query_as(
        "SELECT job_id, path FROM motion WHERE job_id IN (SELECT value FROM json_each(?))",
    )
    .bind(numbers(jobs))
    .fetch_all(tx)
    .await
    .doing("read how a configuration's robots moved")
}

/// The attempts of some jobs that brought no result, newest first, at most so
/// many.
pub(crate) async fn failures(
    tx: &mut SqliteConnection,
    jobs: &[JobId],
    limit: u32,
) -> Result<Vec<JobFailure>, StoreError> {
    sqlx::query_as(
        "SELECT job_id, attempt, worker_id, failed_ms, reason, charged, error
         FROM failure WHERE job_id IN (SELECT value FROM json_each(?))
         ORDER BY attempt DESC LIMIT ?",
    )
    .bind(numbers(jobs))
    .bind(limit)
    .fetch_all(tx)
    .await
    .doing("read a configuration's failures")
}

/// Jobs for one statement.
fn numbers(jobs: &[JobId]) -> String {
    json(jobs.iter().map(|job| job.0).collect::<Vec<_>>())
}

/// All policies with their health, by name.
pub(crate) async fn policies(tx: &mut SqliteConnection) -> Result<Vec<PolicyLine>, StoreError> {
    #[derive(sqlx::FromRow)]
    struct Row {
        id: PolicyId,
        endpoint: String,
        name: String,
        state: String,
        #[sqlx(flatten)]
        health: HealthColumns,
    }
    let rows: Vec<Row> = sqlx::query_as(
        "SELECT id, endpoint, name, state, outages, available_ms, resume_ms, pause_reason,
             probe_job_id, probe_attempt
         FROM policy ORDER BY name, endpoint",
    )
    .fetch_all(&mut *tx)
    .await
    .doing("list policies")?;
    let users: Vec<(PolicyId, CampaignName)> =
        sqlx::query_as("SELECT policy_id, name FROM campaign ORDER BY id")
            .fetch_all(tx)
            .await
            .doing("list the campaigns of policies")?;
    let line = |row: Row| {
        let users = users.iter().filter(|(policy, _)| *policy == row.id);
        Ok(PolicyLine {
            endpoint: row.endpoint,
            name: row.name,
            health: row.health.into_health(&row.state)?,
            campaigns: users.map(|(_, campaign)| campaign.clone()).collect(),
        })
    };
    rows.into_iter().map(line).collect()
}

/// Up to `limit` rollouts that were set aside, of one campaign or of all.
pub(crate) async fn set_aside(
    tx: &mut SqliteConnection,
    campaign: Option<CampaignId>,
    limit: u32,
) -> Result<Vec<AsideLine>, StoreError> {
    sqlx::query_as(
        "SELECT c.name AS campaign, j.rollout_id, j.replicate, j.charged_attempts, j.last_error
         FROM job j JOIN campaign c ON c.id = j.campaign_id
         WHERE j.state = 'quarantined' AND (?1 IS NULL OR j.campaign_id = ?1)
         ORDER BY j.campaign_id, j.rollout_id, j.replicate LIMIT ?2",
    )
    .bind(campaign)
    .bind(limit)
    .fetch_all(tx)
    .await
    .doing("read the quarantine")
}

/// The video of a rollout.
pub(crate) async fn video(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    rollout_id: &str,
    replicate: u32,
) -> Result<Option<KeptFile>, StoreError> {
    sqlx::query_as(
        "SELECT a.path, a.attempt FROM job j JOIN artifact a ON a.job_id = j.id
         WHERE j.campaign_id = ? AND j.rollout_id = ? AND j.replicate = ? AND a.kind = 'video'",
    )
    .bind(campaign)
    .bind(rollout_id)
    .bind(replicate)
    .fetch_optional(tx)
    .await
    .doing("look up a video")
}

/// How many attempts ended without a result, by how they ended.
pub(crate) async fn endings(tx: &mut SqliteConnection) -> Result<Vec<(String, i64)>, StoreError> {
    sqlx::query_as("SELECT reason, count(*) FROM failure GROUP BY reason ORDER BY reason")
        .fetch_all(tx)
        .await
        .doing("count how attempts ended")
}
