//! Jobs, with their attempts.

use libero_ctrl::{Condition, Level};

use super::View;
use super::configurations::ResultLine;
use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, JobId, JobName, WorkerId};
use crate::operations::error::QueueError;
use crate::store::campaigns::Campaign;
use crate::store::{Doing, StoreError, json};

/// Most jobs that one query returns.
pub const MAX_JOBS_LISTED: u32 = 1_000;
/// Most failures that one query returns.
const MAX_FAILURES_SHOWN: u32 = 100;

/// Conditions on the jobs to list; `None` is no condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobFilter<'a> {
    /// State: "queued", "leased", "committed" or "quarantined".
    pub state: Option<&'a str>,
    /// Outcome, which only committed jobs have: true if the goal was reached.
    pub success: Option<bool>,
    /// A task such as "libero_object/0", or a suite such as "libero_object".
    pub task: Option<&'a str>,
    pub condition: Option<Condition>,
    pub level: Option<Level>,
    /// Last job of the preceding page: only jobs after it are listed. 0 for the first page.
    pub after: JobId,
    /// Most jobs to return, capped at [`MAX_JOBS_LISTED`].
    pub limit: u32,
}

/// A job as listed to operators.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct JobLine {
    pub id: JobId,
    pub rollout_id: String,
    pub replicate: u32,
    /// "queued", "leased", "committed" or "quarantined".
    pub state: String,
    /// Leases granted so far.
    pub attempt: AttemptNumber,
    pub charged_attempts: u32,
    /// Earliest instant of the next lease; `None` unless the job is queued.
    pub not_before_ms: Option<UnixMillis>,
    /// The attempt that holds the job's lease; `None` unless the job is leased.
    pub attempt_id: Option<String>,
    /// The worker that holds the job's lease; `None` unless the job is leased.
    pub lease_owner: Option<WorkerId>,
    /// Instant at which the lease expires without a further heartbeat.
    pub lease_expires_ms: Option<UnixMillis>,
    /// The policy's control steps that the worker last reported; 0 while the scene settles, `None`
    /// unless the job is leased.
    pub control_steps: Option<u32>,
    pub last_error: Option<String>,
    /// Outcome, true if the goal was reached; `None` until the job is committed.
    pub success: Option<bool>,
    /// The policy's control steps; `None` until the job is committed.
    pub steps: Option<u32>,
}

/// An attempt that ended without a result.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct FailureLine {
    pub job_id: JobId,
    /// Number of the attempt within its job.
    pub attempt: AttemptNumber,
    /// Worker that ran the attempt.
    pub worker_id: WorkerId,
    /// Instant at which the attempt ended.
    pub failed_ms: UnixMillis,
    /// Kind of the failure, as `FailureReason` names it.
    pub reason: String,
    pub charged: bool,
    pub error: String,
}

/// A job with its manifest row, failed attempts and result.
#[derive(Clone, Debug)]
pub struct JobDetails {
    pub line: JobLine,
    /// Manifest row, JSON.
    pub manifest_row: String,
    /// Reports that were refused because their attempt no longer held the lease.
    pub stale_reports: u32,
    /// Attempts that ended without a result, newest first.
    pub failures: Vec<FailureLine>,
    pub result: Option<ResultLine>,
}

/// Query for the [`JobLine`]s of a campaign, `?1`; further conditions can be appended.
macro_rules! job_lines {
    () => {
        concat!(
            "SELECT j.id, j.rollout_id, j.replicate, j.state, j.attempt, j.charged_attempts,
             j.not_before_ms, j.attempt_id, j.lease_owner, j.lease_expires_ms, ",
            policy_steps!(),
            ", j.last_error, r.success, r.steps
         FROM job j LEFT JOIN result r ON r.job_id = j.id
         WHERE j.campaign_id = ?1"
        )
    };
}

impl View {
    /// Returns jobs of a campaign, in its order of jobs.
    pub async fn jobs(
        &mut self,
        campaign: &Campaign,
        filter: JobFilter<'_>,
    ) -> Result<Vec<JobLine>, StoreError> {
        sqlx::query_as(concat!(
            job_lines!(),
            " AND j.id > ?2 AND (?3 IS NULL OR j.state = ?3)
             AND (?5 IS NULL OR r.success = ?5)
             AND (?6 IS NULL OR j.task = ?6
                 OR substr(j.task, 1, length(?6) + 1) IN (?6 || '/', ?6 || '+'))
             AND (?7 IS NULL OR instr(j.rollout_id, '/' || ?7 || '/') > 0
                 OR ?7 = 'variant' AND instr(j.rollout_id, ':') > 0)
             AND (?8 IS NULL OR instr(j.rollout_id, '/' || ?8 || '/') > 0
                 OR ?8 = 'L0' AND (instr(j.rollout_id, '/clean/') > 0
                     OR instr(j.rollout_id, ':') > 0))
             ORDER BY j.id LIMIT ?4"
        ))
        .bind(campaign.id)
        .bind(filter.after)
        .bind(filter.state)
        .bind(filter.limit.clamp(1, MAX_JOBS_LISTED))
        .bind(filter.success)
        .bind(filter.task)
        .bind(filter.condition.map(Condition::name))
        // Nominal rollouts and variants have level L0, but their ids do not contain it.
        .bind(filter.level.as_ref().map(Level::to_string))
        .fetch_all(self.tx())
        .await
        .doing("list jobs")
    }

    pub async fn job(&mut self, campaign: &Campaign, job: &JobName) -> Result<JobLine, QueueError> {
        let line =
            sqlx::query_as(concat!(job_lines!(), " AND j.rollout_id = ?2 AND j.replicate = ?3"))
                .bind(campaign.id)
                .bind(&job.rollout_id)
                .bind(job.replicate)
                .fetch_optional(self.tx())
                .await
                .doing("find a job")?;
        line.ok_or_else(|| QueueError::UnknownRollout {
            campaign: campaign.name.clone(),
            job: job.clone(),
        })
    }

    /// Returns one job of a campaign with its manifest row, failed attempts and result.
    pub async fn job_details(
        &mut self,
        campaign: &Campaign,
        job: &JobName,
    ) -> Result<JobDetails, QueueError> {
        let line = self.job(campaign, job).await?;
        let (manifest_row, stale_reports) =
            sqlx::query_as("SELECT manifest_row, stale_reports FROM job WHERE id = ?")
                .bind(line.id)
                .fetch_one(self.tx())
                .await
                .doing("read a job")?;
        let ids = [line.id];
        Ok(JobDetails {
            manifest_row,
            stale_reports,
            failures: self.failures(&ids).await?,
            result: self.results(&ids).await?.into_iter().next(),
            line,
        })
    }

    /// Returns the attempts of `jobs` that ended without a result, in descending order of their
    /// numbers within their jobs; at most `MAX_FAILURES_SHOWN` in all.
    pub async fn failures(&mut self, jobs: &[JobId]) -> Result<Vec<FailureLine>, StoreError> {
        sqlx::query_as(
            "SELECT job_id, attempt, worker_id, failed_ms, reason, charged, error
             FROM failure WHERE job_id IN (SELECT value FROM json_each(?))
             ORDER BY attempt DESC LIMIT ?",
        )
        .bind(json(jobs))
        .bind(MAX_FAILURES_SHOWN)
        .fetch_all(self.tx())
        .await
        .doing("read the failures of attempts")
    }
}
