//! What people look at: jobs with their attempts, and workers. Statements that
//! read only.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::clock::UnixMillis;
use crate::ids::{Attempt, CampaignId, JobId, WorkerId};

/// Failures of one job that are shown, newest first.
const MAX_FAILURES_SHOWN: u32 = 100;

/// A job as people see it.
#[derive(Clone, Debug, sqlx::FromRow)]
pub struct JobLine {
    /// The job.
    pub id: JobId,
    /// Which rollout.
    pub rollout_id: String,
    /// Which replicate of it.
    pub replicate: u32,
    /// "queued", "leased", "committed" or "quarantined".
    pub state: String,
    /// Leases granted so far.
    pub attempt: Attempt,
    /// Failures that count against it.
    pub charged_attempts: u32,
    /// When it may be leased, while it waits.
    pub not_before_ms: Option<UnixMillis>,
    /// Who has it, while it is leased.
    pub lease_owner: Option<WorkerId>,
    /// When its lease ends without a heartbeat.
    pub lease_expires_ms: Option<UnixMillis>,
    /// Control steps that its worker last reported.
    pub control_steps: Option<u32>,
    /// What it last failed with.
    pub last_error: Option<String>,
    /// Whether it reached its goal, once it is committed.
    pub success: Option<bool>,
    /// The policy's control steps, once it is committed.
    pub steps: Option<u32>,
}

/// An attempt that brought no result.
#[derive(Clone, Debug, sqlx::FromRow)]
pub struct FailureLine {
    /// Which attempt.
    pub attempt: Attempt,
    /// Whose.
    pub worker_id: WorkerId,
    /// When it ended.
    pub failed_ms: UnixMillis,
    /// How, as `FailureReason` names it.
    pub reason: String,
    /// Whether it counts against job and worker.
    pub charged: bool,
    /// In words.
    pub error: String,
}

/// Where a committed outcome came from.
#[derive(Clone, Debug, sqlx::FromRow)]
pub struct ResultLine {
    /// Which attempt.
    pub attempt: Attempt,
    /// Whose.
    pub worker_id: WorkerId,
    /// When it was stored.
    pub committed_ms: UnixMillis,
    /// Duration of the rollout.
    pub wall_secs: f64,
    /// Machine.
    pub host: String,
    /// What rendered the frames.
    pub renderer: String,
    /// Reports of another outcome.
    pub divergences: u32,
    /// Its video below the data folder.
    pub video: Option<String>,
}

/// Everything about one job.
#[derive(Clone, Debug)]
pub struct JobDetails {
    /// The job.
    pub line: JobLine,
    /// One manifest row, JSON.
    pub manifest_row: String,
    /// Reports that were refused because their lease was gone.
    pub stale_reports: u32,
    /// Attempts that brought no result, newest first.
    pub failures: Vec<FailureLine>,
    /// The committed outcome's origin.
    pub result: Option<ResultLine>,
}

/// A worker as people see it.
#[derive(Clone, Debug, sqlx::FromRow)]
pub struct WorkerLine {
    /// Its id.
    pub id: WorkerId,
    /// The machine it runs on.
    pub host: String,
    /// Rollouts that it runs side by side.
    pub slots: u32,
    /// Leases that it holds.
    pub leases: u32,
    /// Name of its asset pack.
    pub asset_pack: String,
    /// Version of its simulator.
    pub mujoco_version: String,
    /// What renders its frames.
    pub renderer: String,
    /// Version of its program.
    pub program_version: String,
    /// When it was last heard of.
    pub last_seen_ms: UnixMillis,
    /// Charged failures in a row.
    pub charged_in_a_row: u32,
    /// Why it may lease no more, if so.
    pub stopped_reason: Option<String>,
}

/// The columns of [`JobLine`] and where they come from.
macro_rules! job_lines {
    () => {
        "SELECT j.id, j.rollout_id, j.replicate, j.state, j.attempt, j.charged_attempts,
             j.not_before_ms, j.lease_owner, j.lease_expires_ms, j.control_steps, j.last_error,
             r.success, r.steps
         FROM job j LEFT JOIN result r ON r.job_id = j.id
         WHERE j.campaign_id = ?1"
    };
}

/// Up to `limit` jobs of a campaign after one, in paired-unit order, of one
/// state or of all.
pub(crate) async fn jobs(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    state: Option<&str>,
    after: JobId,
    limit: u32,
) -> Result<Vec<JobLine>, StoreError> {
    sqlx::query_as(concat!(
        job_lines!(),
        " AND j.id > ?2 AND (?3 IS NULL OR j.state = ?3) ORDER BY j.id LIMIT ?4"
    ))
    .bind(campaign)
    .bind(after)
    .bind(state)
    .bind(limit)
    .fetch_all(tx)
    .await
    .doing("list jobs")
}

/// One job of a campaign by its rollout.
pub(crate) async fn job(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    rollout_id: &str,
    replicate: u32,
) -> Result<Option<JobLine>, StoreError> {
    sqlx::query_as(concat!(
        job_lines!(),
        " AND j.rollout_id = ?2 AND j.replicate = ?3"
    ))
    .bind(campaign)
    .bind(rollout_id)
    .bind(replicate)
    .fetch_optional(tx)
    .await
    .doing("look up a job")
}

/// What else is known of a job.
pub(crate) async fn details(
    tx: &mut SqliteConnection,
    line: JobLine,
) -> Result<JobDetails, StoreError> {
    let (manifest_row, stale_reports) =
        sqlx::query_as("SELECT manifest_row, stale_reports FROM job WHERE id = ?")
            .bind(line.id)
            .fetch_one(&mut *tx)
            .await
            .doing("read a job")?;
    let failures = sqlx::query_as(
        "SELECT attempt, worker_id, failed_ms, reason, charged, error FROM failure
         WHERE job_id = ? ORDER BY attempt DESC LIMIT ?",
    )
    .bind(line.id)
    .bind(MAX_FAILURES_SHOWN)
    .fetch_all(&mut *tx)
    .await
    .doing("read a job's failures")?;
    let result = sqlx::query_as(
        "SELECT r.attempt, r.worker_id, r.committed_ms, r.wall_secs, p.host, p.renderer,
             (SELECT count(*) FROM divergence d WHERE d.job_id = r.job_id) AS divergences,
             (SELECT a.path FROM artifact a WHERE a.job_id = r.job_id) AS video
         FROM result r JOIN provenance p ON p.id = r.provenance_id WHERE r.job_id = ?",
    )
    .bind(line.id)
    .fetch_optional(tx)
    .await
    .doing("read where a result came from")?;
    Ok(JobDetails {
        line,
        manifest_row,
        stale_reports,
        failures,
        result,
    })
}

/// Up to `limit` workers, those heard of last first.
pub(crate) async fn workers(
    tx: &mut SqliteConnection,
    limit: u32,
) -> Result<Vec<WorkerLine>, StoreError> {
    sqlx::query_as(
        "SELECT w.id, w.host, w.slots, coalesce(h.leases, 0) AS leases, w.asset_pack,
             w.mujoco_version, w.renderer, w.program_version, w.last_seen_ms,
             w.charged_in_a_row, w.stopped_reason
         FROM worker w LEFT JOIN
             (SELECT lease_owner, count(*) AS leases FROM job WHERE state = 'leased'
              GROUP BY lease_owner) h ON h.lease_owner = w.id
         ORDER BY w.last_seen_ms DESC, w.id LIMIT ?",
    )
    .bind(limit)
    .fetch_all(tx)
    .await
    .doing("list workers")
}
