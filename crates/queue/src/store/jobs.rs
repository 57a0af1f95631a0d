//! Statements on `job` and `failure`: renewing and ending attempts, and reading jobs. `claims`
//! grants leases.
//!
//! Every statement that changes the state of a leased job is conditional on its attempt.

use sqlx::types::Text;
use std::collections::{BTreeMap, BTreeSet};

use benchmark::ManifestRow;
use benchmark::attempt::AttemptId;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::{Doing, StoreError, json, undecodable};
use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, CampaignId, JobId, PolicyId, WorkerId};
use crate::rules::lease::{AfterFailure, CutOff, FailureReason, Job, Lease, OutcomeKey};

/// Key of matched rollouts: campaign, task and initial state.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, sqlx_macros::FromRow)]
pub(crate) struct InitialState {
    #[sqlx(rename = "campaign_id")]
    pub(crate) campaign: CampaignId,
    pub(crate) task: String,
    pub(crate) init_id: i64,
}

#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct NamedAttempt {
    #[sqlx(rename = "named")]
    pub(crate) id: Text<AttemptId>,
    /// The worker that holds or held the attempt's lease.
    pub(crate) worker: WorkerId,
    pub(crate) number: AttemptNumber,
    #[sqlx(json)]
    pub(crate) job: Job,
    /// Initial state that the job shares with its siblings.
    #[sqlx(flatten)]
    pub(crate) initial_state: InitialState,
    #[sqlx(json, rename = "manifest_row")]
    pub(crate) row: ManifestRow,
    /// The job's committed outcome, if it has one.
    #[sqlx(json(nullable))]
    pub(crate) stored: Option<OutcomeKey>,
    /// The attempt's lease, if the attempt was cut off with its worker.
    #[sqlx(json(nullable))]
    pub(crate) cut_off: Option<CutOff>,
}

#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct LeasedRow {
    #[sqlx(json)]
    pub(crate) job: Job,
    pub(crate) campaign_id: CampaignId,
    /// Control steps that the worker last reported.
    pub(crate) control_steps: u32,
}

#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct ExpiredRow {
    #[sqlx(flatten)]
    pub(crate) leased: LeasedRow,
    /// Instant of the last heartbeat of the lease's worker.
    pub(crate) heartbeat_ms: Option<UnixMillis>,
}

/// Machines of a job's failed attempts, one entry for each attempt.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct History {
    pub(crate) task: String,
    /// Machines of charged failures.
    #[sqlx(json)]
    pub(crate) failed_on: Vec<String>,
    /// Machines of attempts that were cut off with their worker.
    #[sqlx(json)]
    pub(crate) silent_on: Vec<String>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct Progress<'a> {
    pub(crate) worker: &'a str,
    pub(crate) attempt: AttemptId,
    pub(crate) control_steps: u32,
}

/// SQL for the [`Job`] of a row of table `j`, as JSON; the CHECK constraints guarantee that it can
/// be parsed.
macro_rules! job {
    () => {
        "json_object('id', j.id, 'attempt', j.attempt, 'charged_attempts', j.charged_attempts,
             'losses', j.losses, 'state', json_object('is', j.state, 'not_before', j.not_before_ms,
                 'attempt', j.attempt_id, 'owner', j.lease_owner, 'granted', j.leased_ms,
                 'expires', j.lease_expires_ms, 'ceiling', j.ceiling_ms,
                 'is_acknowledged', json(iif(j.acknowledged, 'true', 'false')))) AS job"
    };
}

/// Returns the attempts with these ids that exist, whether or not they still hold their leases.
pub(crate) async fn attempts_by_id(
    tx: &mut SqliteConnection,
    attempts: &[AttemptId],
) -> Result<BTreeMap<AttemptId, NamedAttempt>, StoreError> {
    let found: Vec<NamedAttempt> = sqlx::query_as(concat!(
        "SELECT n.named, n.worker, n.number, ",
        job!(),
        ", j.campaign_id, j.task, j.init_id, j.manifest_row,
             iif(r.job_id IS NULL, NULL, json_object('steps', r.steps,
                 'success', json(iif(r.success, 'true', 'false')))) AS stored, n.cut_off
         FROM (SELECT a.value AS named, h.id AS job_id, h.lease_owner AS worker,
                   h.attempt AS number, NULL AS cut_off
                   FROM json_each(?1) a
                   JOIN job h ON h.attempt_id = a.value AND h.state = 'leased'
               UNION ALL SELECT a.value, h.job_id, h.worker_id, h.attempt, NULL
                   FROM json_each(?1) a JOIN result h ON h.attempt_id = a.value
               UNION ALL SELECT a.value, h.job_id, h.worker_id, h.attempt,
                   iif(h.ceiling_ms IS NULL, NULL, json_object('number', h.attempt, 'lease',
                       json_object('attempt', h.attempt_id, 'owner', h.worker_id,
                           'granted', h.leased_ms, 'expires', h.failed_ms,
                           'ceiling', h.ceiling_ms, 'is_acknowledged', json('true'))))
                   FROM json_each(?1) a JOIN failure h ON h.attempt_id = a.value) n
         JOIN job j ON j.id = n.job_id LEFT JOIN result r ON r.job_id = j.id"
    ))
    .bind(json(attempts))
    .fetch_all(tx)
    .await
    .doing("find attempts")?;
    let by_id = |attempt: NamedAttempt| (attempt.id.0, attempt);
    Ok(found.into_iter().map(by_id).collect())
}

/// Renews leases up to their ceilings, acknowledges them, and stores their progress. Returns the
/// attempts whose leases are still held.
pub(crate) async fn renew(
    tx: &mut SqliteConnection,
    progress: &[Progress<'_>],
    expires: UnixMillis,
) -> Result<BTreeSet<AttemptId>, StoreError> {
    let held: Vec<String> = sqlx::query_scalar(
        "UPDATE job
         SET lease_expires_ms = min(?1, ceiling_ms), acknowledged = 1,
             control_steps = max(control_steps, renewed.value ->> 'control_steps')
         FROM json_each(?2) AS renewed
         WHERE job.attempt_id = renewed.value ->> 'attempt' AND state = 'leased'
             AND lease_owner = renewed.value ->> 'worker'
         RETURNING attempt_id",
    )
    .bind(expires)
    .bind(json(progress))
    .fetch_all(tx)
    .await
    .doing("renew leases")?;
    let read = held.into_iter().map(|id| id.parse().map_err(undecodable));
    read.collect::<Result<_, _>>().doing("renew leases")
}

/// Restarts every lease with exactly its full duration, even past its ceiling, so that workers can
/// report what they could not report in the meantime.
pub(crate) async fn restart_leases(
    tx: &mut SqliteConnection,
    expires: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE job SET lease_expires_ms = ?1, ceiling_ms = max(ceiling_ms, ?1)
         WHERE state = 'leased'",
    )
    .bind(expires)
    .execute(tx)
    .await
    .doing("restart leases")
    .map(drop)
}

/// Restores a lease that was cut off with its worker, which has reconnected. The job waits and was
/// not leased in the meantime.
pub(crate) async fn resume(
    tx: &mut SqliteConnection,
    job: JobId,
    lease: &Lease,
    expires: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM failure WHERE attempt_id = ?")
        .bind(lease.attempt.to_string())
        .execute(&mut *tx)
        .await
        .doing("resume an attempt")?;
    // The claim's idempotency key is replaced, since the worker already has this lease.
    sqlx::query(
        "UPDATE job SET state = 'leased', not_before_ms = NULL, attempt_id = ?2, claim_id = ?2,
             acknowledged = 1, lease_owner = ?3, leased_ms = ?4, lease_expires_ms = min(?5, ?6),
             ceiling_ms = ?6, control_steps = 0
         WHERE id = ?1 AND state = 'queued'",
    )
    .bind(job)
    .bind(lease.attempt.to_string())
    .bind(&lease.owner)
    .bind(lease.granted)
    .bind(expires)
    .bind(lease.ceiling)
    .execute(tx)
    .await
    .doing("resume an attempt")
    .map(drop)
}

/// Discards the attempts of a campaign that were cut off with their worker, so that their results
/// are refused.
pub(crate) async fn forget_cut_off(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE failure SET leased_ms = NULL, ceiling_ms = NULL
         WHERE ceiling_ms IS NOT NULL
             AND (SELECT campaign_id FROM job WHERE id = job_id) = ?",
    )
    .bind(campaign)
    .execute(tx)
    .await
    .doing("discard attempts that were cut off")
    .map(drop)
}

/// Quarantines a waiting job that an operator skips. The reason is recorded as an attempt that
/// nobody ran.
pub(crate) async fn skip(
    tx: &mut SqliteConnection,
    job: JobId,
    attempt: AttemptId,
    explanation: &str,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE job SET state = 'quarantined', attempt = attempt + 1, not_before_ms = NULL,
             last_error = ?
         WHERE id = ? AND state = 'queued'",
    )
    .bind(explanation)
    .bind(job)
    .execute(&mut *tx)
    .await
    .doing("skip a job")?;
    sqlx::query(
        "INSERT INTO failure (attempt_id, job_id, attempt, worker_id, failed_ms, reason, charged,
             error)
         SELECT ?, id, attempt, 'operator', ?, ?, 0, ? FROM job WHERE id = ?",
    )
    .bind(attempt.to_string())
    .bind(now)
    .bind(FailureReason::Skipped.as_str())
    .bind(explanation)
    .bind(job)
    .execute(tx)
    .await
    .doing("skip a job")
    .map(drop)
}

/// Ends a lease without a result and records the failure.
pub(crate) async fn fail(
    tx: &mut SqliteConnection,
    job: &Job,
    lease: &Lease,
    reason: FailureReason,
    error: &str,
    next_step: AfterFailure,
    now: UnixMillis,
) -> Result<(), StoreError> {
    let (state, not_before) = match next_step {
        AfterFailure::Requeue { not_before } => ("queued", Some(not_before)),
        AfterFailure::Quarantine => ("quarantined", None),
    };
    sqlx::query(
        "UPDATE job SET state = ?2, not_before_ms = ?3, attempt_id = NULL, claim_id = NULL,
             acknowledged = NULL, ceiling_ms = NULL, lease_owner = NULL, leased_ms = NULL,
             lease_expires_ms = NULL, control_steps = NULL,
             charged_attempts = charged_attempts + ?4, losses = losses + ?6,
             last_error = CASE WHEN ?4 OR ?7 THEN ?5 ELSE last_error END
         WHERE attempt_id = ?1 AND state = 'leased'",
    )
    .bind(lease.attempt.to_string())
    .bind(state)
    .bind(not_before)
    .bind(reason.is_charged())
    .bind(error)
    .bind(reason.is_loss())
    .bind(reason.is_loss() || next_step == AfterFailure::Quarantine)
    .execute(&mut *tx)
    .await
    .doing("end an attempt")?;
    let may_be_resumed = reason.may_be_resumed().then_some(lease);
    sqlx::query(
        "INSERT INTO failure (attempt_id, job_id, attempt, worker_id, failed_ms, reason, charged,
             error, leased_ms, ceiling_ms)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(lease.attempt.to_string())
    .bind(job.id)
    .bind(job.attempt)
    .bind(&lease.owner)
    .bind(now)
    .bind(reason.as_str())
    .bind(reason.is_charged())
    .bind(error)
    .bind(may_be_resumed.map(|lease| lease.granted))
    .bind(may_be_resumed.map(|lease| lease.ceiling))
    .execute(tx)
    .await
    .doing("record the failure of an attempt")
    .map(drop)
}

/// Marks the jobs of attempts that hold their leases as committed, after their results were stored.
pub(crate) async fn mark_committed(
    tx: &mut SqliteConnection,
    attempts: &[AttemptId],
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE job SET state = 'committed', attempt_id = NULL, claim_id = NULL,
             acknowledged = NULL, ceiling_ms = NULL, lease_owner = NULL, leased_ms = NULL,
             lease_expires_ms = NULL, control_steps = NULL
         FROM json_each(?) AS ended
         WHERE job.attempt_id = ended.value AND state = 'leased'",
    )
    .bind(json(attempts))
    .execute(tx)
    .await
    .doing("mark jobs as committed")
    .map(drop)
}

/// Counts a report that was refused because its attempt no longer held the lease.
pub(crate) async fn count_stale_report(
    tx: &mut SqliteConnection,
    job: JobId,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE job SET stale_reports = stale_reports + 1 WHERE id = ?")
        .bind(job)
        .execute(tx)
        .await
        .doing("count a stale report")
        .map(drop)
}

pub(crate) async fn leased(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<LeasedRow>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT ",
        job!(),
        ", j.campaign_id, j.control_steps FROM job j
         WHERE j.campaign_id = ? AND j.state = 'leased' ORDER BY j.id"
    ))
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("find a campaign's leases")
}

/// Returns up to `limit` leases that have expired at `now`, the longest expired first.
pub(crate) async fn expired(
    tx: &mut SqliteConnection,
    now: UnixMillis,
    limit: u32,
) -> Result<Vec<ExpiredRow>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT ",
        job!(),
        ", j.campaign_id, j.control_steps, w.heartbeat_ms
         FROM job j JOIN worker w ON w.id = j.lease_owner
         WHERE j.state = 'leased' AND j.lease_expires_ms <= ?
         ORDER BY j.lease_expires_ms LIMIT ?"
    ))
    .bind(now)
    .bind(limit)
    .fetch_all(tx)
    .await
    .doing("find expired leases")
}

/// Returns a job with its lease; `None` if the job is not leased.
pub(crate) async fn lease(
    tx: &mut SqliteConnection,
    job: JobId,
) -> Result<Option<LeasedRow>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT ",
        job!(),
        ", j.campaign_id, j.control_steps FROM job j WHERE j.id = ? AND j.state = 'leased'"
    ))
    .bind(job)
    .fetch_optional(tx)
    .await
    .doing("find a lease")
}

pub(crate) async fn quarantined(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<JobId>, StoreError> {
    sqlx::query_scalar("SELECT id FROM job WHERE campaign_id = ? AND state = 'quarantined'")
        .bind(campaign)
        .fetch_all(tx)
        .await
        .doing("find quarantined jobs")
}

pub(crate) async fn by_rollout(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    rollout_id: &str,
    replicate: u32,
) -> Result<Option<(JobId, String)>, StoreError> {
    sqlx::query_as(
        "SELECT id, state FROM job WHERE campaign_id = ? AND rollout_id = ? AND replicate = ?",
    )
    .bind(campaign)
    .bind(rollout_id)
    .bind(replicate)
    .fetch_optional(tx)
    .await
    .doing("find a job")
}

/// Takes a job out of quarantine: it may be leased at once, and its past failures no longer count.
pub(crate) async fn retry(
    tx: &mut SqliteConnection,
    job: JobId,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE job SET state = 'queued', not_before_ms = ?, charged_attempts = 0, losses = 0,
             forgiven_attempt = attempt
         WHERE id = ? AND state = 'quarantined'",
    )
    .bind(now)
    .bind(job)
    .execute(tx)
    .await
    .doing("take a job out of quarantine")
    .map(drop)
}

/// Returns the machines of a job's failed attempts since an operator last retried the job. A worker
/// that does not name its machine counts as a machine of its own.
pub(crate) async fn history(tx: &mut SqliteConnection, job: JobId) -> Result<History, StoreError> {
    sqlx::query_as(
        "SELECT j.task,
             json_group_array(coalesce(w.machine, f.worker_id)) FILTER (WHERE f.charged)
                 AS failed_on,
             json_group_array(coalesce(w.machine, f.worker_id))
                 FILTER (WHERE f.reason = 'worker_silent') AS silent_on
         FROM job j LEFT JOIN failure f ON f.job_id = j.id AND f.attempt > j.forgiven_attempt
         LEFT JOIN worker w ON w.id = f.worker_id WHERE j.id = ?",
    )
    .bind(job)
    .fetch_one(tx)
    .await
    .doing("find a job's failed attempts")
}

/// Returns the instant of the last attempt at a job that ended because the policy was unreachable.
pub(crate) async fn last_without_policy(
    tx: &mut SqliteConnection,
    job: JobId,
) -> Result<Option<UnixMillis>, StoreError> {
    sqlx::query_scalar(
        "SELECT max(failed_ms) FROM failure
         WHERE job_id = ? AND reason IN ('policy_unavailable', 'policy_lost')",
    )
    .bind(job)
    .fetch_one(tx)
    .await
    .doing("find a job's last failure to reach its policy")
}

/// Returns true if another job of the policy waits in a running campaign and has lost the policy
/// fewer than `losses` times.
pub(crate) async fn has_other_waiting(
    tx: &mut SqliteConnection,
    policy: PolicyId,
    job: JobId,
    losses: u32,
) -> Result<bool, StoreError> {
    sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM campaign c JOIN job j ON j.campaign_id = c.id
         WHERE c.policy_id = ? AND c.state = 'running' AND j.state = 'queued'
             AND j.losses < ? AND j.id <> ? AND NOT EXISTS
                 (SELECT 1 FROM stop s WHERE s.campaign_id = c.id AND s.stopped_ms IS NOT NULL))",
    )
    .bind(policy)
    .bind(losses)
    .bind(job)
    .fetch_one(tx)
    .await
    .doing("check whether other jobs of a policy wait")
}

/// Returns true if a back-off or a policy's pause ended in `(after, until]`, so that waiting claims
/// must be woken.
pub(crate) async fn has_ended_wait(
    tx: &mut SqliteConnection,
    after: UnixMillis,
    until: UnixMillis,
) -> Result<bool, StoreError> {
    sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM job WHERE state = 'queued' AND not_before_ms > 0
                 AND not_before_ms > ?1 AND not_before_ms <= ?2)
             OR EXISTS (SELECT 1 FROM policy WHERE resume_ms > ?1 AND resume_ms <= ?2)",
    )
    .bind(after)
    .bind(until)
    .fetch_one(tx)
    .await
    .doing("check whether a back-off has ended")
}
