//! Jobs, with their attempts.

use benchmark::attempt::{Capsule, GoalProgress, Measurement, Motion};
use benchmark::{Condition, Level, Look, ManifestRow};
use serde::ser::Error;
use serde::{Deserialize, Serialize, Serializer};
use sqlx::types::Json;

use super::View;
use super::configurations::ResultLine;
use crate::clock::{UnixMillis, rfc3339};
use crate::ids::{AttemptNumber, JobId, JobName, WorkerId};
use crate::operations::error::QueueError;
use crate::store::campaigns::Campaign;
use crate::store::{Doing, StoreError, json};

pub const MAX_JOBS_LISTED: u32 = 1_000;
const MAX_FAILURES_SHOWN: u32 = 100;

/// Conditions on the jobs to list; `None` is no condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobFilter<'a> {
    /// State: "queued", "leased", "committed" or "quarantined".
    pub state: Option<&'a str>,
    /// Outcome, which only committed jobs have: true if the goal was reached.
    pub success: Option<bool>,
    /// Key of a task, or name of a suite.
    pub task: Option<&'a str>,
    pub condition: Option<Condition>,
    pub level: Option<Level>,
    /// Last job of the preceding page: only jobs after it are listed. 0 for the first page.
    pub after: JobId,
    /// Most jobs to return, capped at [`MAX_JOBS_LISTED`].
    pub limit: u32,
}

/// A job, as operators get it; docs/JSON.md describes the keys.
#[derive(Clone, Debug, Serialize, Deserialize, sqlx_macros::FromRow)]
pub struct JobLine {
    pub rollout_id: String,
    pub replicate: u32,
    pub job_id: JobId,
    /// "queued", "leased", "committed" or "quarantined".
    pub state: String,
    /// "success" or "failure"; `None` until the job is committed.
    pub outcome: Option<String>,
    /// The policy's control steps; `None` until the job is committed.
    pub steps: Option<u32>,
    /// Leases granted so far.
    pub attempts: u32,
    pub charged_attempts: u32,
    /// The attempt that holds the job's lease; `None` unless the job is leased, as are the worker,
    /// its control steps and the lease's length.
    pub attempt_id: Option<String>,
    pub worker_id: Option<WorkerId>,
    /// The policy's control steps that the worker last reported; 0 while the scene settles.
    pub control_steps: Option<u32>,
    /// Seconds until the lease expires without a further heartbeat.
    pub lease_left_secs: Option<f64>,
    /// Seconds until the job may be leased; `None` unless it is queued.
    pub backoff_left_secs: Option<f64>,
    pub last_error: Option<String>,
}

/// An attempt that ended without a result.
#[derive(Clone, Debug, Serialize, Deserialize, sqlx_macros::FromRow)]
pub struct FailureLine {
    #[serde(skip)]
    pub job_id: JobId,
    /// Number of the attempt within its job.
    pub attempt: AttemptNumber,
    /// Worker that ran the attempt.
    pub worker_id: WorkerId,
    /// Kind of the failure, as `FailureReason` names it.
    pub reason: String,
    pub is_charged: bool,
    pub error: String,
    /// Instant at which the attempt ended.
    #[serde(with = "rfc3339")]
    pub failed_at: UnixMillis,
}

/// Origin of a committed job's result.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ResultOrigin {
    pub goal: GoalProgress,
    pub prompt: Option<String>,
    pub attempt: AttemptNumber,
    pub worker_id: WorkerId,
    pub host: String,
    pub renderer: String,
    pub look: Look,
    pub wall_secs: f64,
    pub divergences: u32,
    pub video: Option<String>,
    #[serde(with = "rfc3339")]
    pub committed_at: UnixMillis,
}

/// A job with its manifest row, failed attempts and result.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct JobDetails {
    pub job: JobLine,
    #[serde(serialize_with = "sort_keys")]
    pub manifest_row: ManifestRow,
    /// Reports that were refused because their attempt no longer held the lease.
    pub late_reports: u32,
    pub result: Option<ResultOrigin>,
    /// Attempts that ended without a result, newest first.
    pub failures: Vec<FailureLine>,
    /// The finished rollout, to be repeated elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capsule: Option<Capsule>,
}

fn sort_keys<S: Serializer>(row: &ManifestRow, serializer: S) -> Result<S::Ok, S::Error> {
    serde_json::to_value(row).map_err(S::Error::custom)?.serialize(serializer)
}

impl From<ResultLine> for ResultOrigin {
    fn from(line: ResultLine) -> ResultOrigin {
        let outcome = line.outcome.0;
        ResultOrigin {
            goal: outcome.goal,
            prompt: outcome.prompt,
            attempt: line.number,
            worker_id: line.worker_id,
            host: line.provenance.host,
            renderer: line.provenance.pin.renderer,
            look: line.provenance.pin.look,
            wall_secs: outcome.wall_secs,
            divergences: line.divergences,
            video: line.video,
            committed_at: line.committed_ms,
        }
    }
}

/// Query for the [`JobLine`]s of a campaign, `?1`, at the instant `?2`; further conditions can be
/// appended.
macro_rules! job_lines {
    () => {
        concat!(
            "SELECT j.rollout_id, j.replicate, j.id AS job_id, j.state,
                 iif(r.success IS NULL, NULL, iif(r.success, 'success', 'failure')) AS outcome,
                 r.steps, j.attempt AS attempts, j.charged_attempts, j.attempt_id,
                 j.lease_owner AS worker_id, ",
            policy_steps!(),
            ", max(0, j.lease_expires_ms - ?2) / 1000.0 AS lease_left_secs,
                 max(0, j.not_before_ms - ?2) / 1000.0 AS backoff_left_secs, j.last_error
         FROM job j LEFT JOIN result r ON r.job_id = j.id
         WHERE j.campaign_id = ?1"
        )
    };
}

impl View {
    pub async fn jobs(
        &mut self,
        campaign: &Campaign,
        filter: JobFilter<'_>,
    ) -> Result<Vec<JobLine>, StoreError> {
        sqlx::query_as(concat!(
            job_lines!(),
            " AND j.id > ?3 AND (?4 IS NULL OR j.state = ?4)
             AND (?6 IS NULL OR r.success = ?6)
             AND (?7 IS NULL OR j.task = ?7
                 OR substr(j.task, 1, length(?7) + 1) IN (?7 || '/', ?7 || '+'))
             AND (?8 IS NULL OR instr(j.rollout_id, '/' || ?8 || '/') > 0
                 OR ?8 = 'variant' AND instr(j.rollout_id, ':') > 0)
             AND (?9 IS NULL OR instr(j.rollout_id, '/' || ?9 || '/') > 0
                 OR ?9 = 'L0' AND (instr(j.rollout_id, '/nominal/') > 0
                     OR instr(j.rollout_id, ':') > 0))
             ORDER BY j.id LIMIT ?5"
        ))
        .bind(campaign.id)
        .bind(self.now)
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
            sqlx::query_as(concat!(job_lines!(), " AND j.rollout_id = ?3 AND j.replicate = ?4"))
                .bind(campaign.id)
                .bind(self.now)
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

    pub async fn job_details(
        &mut self,
        campaign: &Campaign,
        job: &JobName,
    ) -> Result<JobDetails, QueueError> {
        let job = self.job(campaign, job).await?;
        let (Json(manifest_row), late_reports) =
            sqlx::query_as("SELECT manifest_row, stale_reports FROM job WHERE id = ?")
                .bind(job.job_id)
                .fetch_one(self.tx())
                .await
                .doing("read a job")?;
        let ids = [job.job_id];
        let result = self.results(&ids).await?.into_iter().next();
        let capsule = match &result {
            None => None,
            Some(result) => {
                let motion = self.motion(job.job_id).await?;
                Some(Capsule {
                    campaign: campaign.name.to_string(),
                    replicate: job.replicate,
                    manifest_row: ManifestRow::clone(&manifest_row),
                    measurement: Measurement {
                        result: result.outcome.0.clone(),
                        provenance: result.provenance.clone(),
                    },
                    path: motion.path(),
                    actions: motion.actions(),
                    minimal_axes: Vec::new(),
                    saved_until: None,
                })
            }
        };
        Ok(JobDetails {
            failures: self.failures(&ids).await?,
            job,
            manifest_row,
            late_reports,
            result: result.map(ResultOrigin::from),
            capsule,
        })
    }

    async fn motion(&mut self, job: JobId) -> Result<Motion, StoreError> {
        let motion: (Vec<u8>, Vec<u8>) =
            sqlx::query_as("SELECT path, actions FROM motion WHERE job_id = ?")
                .bind(job)
                .fetch_one(self.tx())
                .await
                .doing("read a robot's motion")?;
        Ok(Motion { path: motion.0, actions: motion.1 })
    }

    /// Returns the attempts of `jobs` that ended without a result, in descending order of their
    /// numbers within their jobs; at most `MAX_FAILURES_SHOWN` in all.
    pub async fn failures(&mut self, jobs: &[JobId]) -> Result<Vec<FailureLine>, StoreError> {
        sqlx::query_as(
            "SELECT job_id, attempt, worker_id, reason, charged AS is_charged, error,
                 failed_ms AS failed_at
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
