//! Statements on `job` and `failure`: renewing and ending an attempt, and what is
//! known of a job. Granting leases is the business of `claims`.
//!
//! Every statement that moves a leased job is conditional on its owner and
//! attempt, and answers whether it moved anything.

use std::collections::{BTreeMap, BTreeSet};

use protocol::ManifestRow;
use sqlx::SqliteConnection;

use super::results::InitialState;
use super::{Doing, StoreError, json, undecodable};
use crate::clock::UnixMillis;
use crate::ids::{Attempt, CampaignId, JobId, LeaseRef, WorkerId};
use crate::lease::{AfterFailure, FailureReason, Job, JobState, OutcomeKey};

/// A job as a report of its outcome finds it.
#[derive(Clone, Debug)]
pub(crate) struct ReportedJob {
    /// The job.
    pub(crate) job: Job,
    /// What its siblings share with it.
    pub(crate) of: InitialState,
    /// The rollout that it is to run.
    pub(crate) row: ManifestRow,
    /// Its committed outcome, if it has one.
    pub(crate) stored: Option<OutcomeKey>,
}

/// A leased job whose time is over.
#[derive(Clone, Debug)]
pub(crate) struct ExpiredRow {
    /// The job.
    pub(crate) job: Job,
    /// Its holder.
    pub(crate) owner: WorkerId,
    /// Its campaign.
    pub(crate) campaign: CampaignId,
    /// Progress last reported.
    pub(crate) control_steps: u32,
    /// Failures in a row that its holder has.
    pub(crate) owner_failures_in_a_row: u32,
}

#[derive(sqlx::FromRow)]
struct JobRow {
    id: JobId,
    campaign_id: CampaignId,
    attempt: Attempt,
    charged_attempts: u32,
    state: String,
    not_before_ms: Option<UnixMillis>,
    lease_owner: Option<WorkerId>,
    leased_ms: Option<UnixMillis>,
    lease_expires_ms: Option<UnixMillis>,
}

/// One job and its campaign.
pub(crate) async fn load(
    tx: &mut SqliteConnection,
    id: JobId,
) -> Result<Option<(Job, CampaignId)>, StoreError> {
    let row: Option<JobRow> = sqlx::query_as(
        "SELECT id, campaign_id, attempt, charged_attempts, state, not_before_ms, lease_owner,
             leased_ms, lease_expires_ms FROM job WHERE id = ?",
    )
    .bind(id)
    .fetch_optional(tx)
    .await
    .doing("read a job")?;
    row.map(|row| {
        let campaign = row.campaign_id;
        Ok((row.into_job()?, campaign))
    })
    .transpose()
}

/// Jobs as reports of their outcomes find them; those that there are.
pub(crate) async fn reported(
    tx: &mut SqliteConnection,
    ids: &[JobId],
) -> Result<BTreeMap<JobId, ReportedJob>, StoreError> {
    #[derive(sqlx::FromRow)]
    struct Row {
        #[sqlx(flatten)]
        job: JobRow,
        task: String,
        init_id: i64,
        manifest_row: String,
        success: Option<bool>,
        steps: Option<u32>,
    }
    let rows: Vec<Row> = sqlx::query_as(
        "SELECT j.id, j.campaign_id, j.attempt, j.charged_attempts, j.state, j.not_before_ms,
             j.lease_owner, j.leased_ms, j.lease_expires_ms, j.task, j.init_id, j.manifest_row,
             r.success, r.steps
         FROM job j LEFT JOIN result r ON r.job_id = j.id
         WHERE j.id IN (SELECT value FROM json_each(?))",
    )
    .bind(json(ids.iter().map(|id| id.0).collect::<Vec<_>>()))
    .fetch_all(tx)
    .await
    .doing("read jobs")?;
    let read = |row: Row| {
        let manifest_row = serde_json::from_str(&row.manifest_row).map_err(undecodable);
        let reported = ReportedJob {
            of: InitialState {
                campaign: row.job.campaign_id,
                task: row.task,
                init_id: row.init_id,
            },
            job: row.job.into_job()?,
            row: manifest_row.doing("read a job's manifest row")?,
            stored: match (row.success, row.steps) {
                (Some(success), Some(steps)) => Some(OutcomeKey { success, steps }),
                _ => None,
            },
        };
        Ok((reported.job.id, reported))
    };
    rows.into_iter().map(read).collect()
}

/// Renews leases and stores their progress. Answers which of them are still
/// held.
pub(crate) async fn renew(
    tx: &mut SqliteConnection,
    progress: &[(LeaseRef, u32)],
    expires: UnixMillis,
) -> Result<BTreeSet<JobId>, StoreError> {
    let renewed = progress
        .iter()
        .map(|(lease, control_steps)| (named(lease), *control_steps));
    let held: Vec<JobId> = sqlx::query_scalar(
        "UPDATE job
         SET lease_expires_ms = ?1, control_steps = max(control_steps, renewed.value ->> 1)
         FROM json_each(?2) AS renewed
         WHERE job.id = renewed.value ->> '$[0][0]' AND attempt = renewed.value ->> '$[0][1]'
             AND lease_owner = renewed.value ->> '$[0][2]' AND state = 'leased'
         RETURNING id",
    )
    .bind(expires)
    .bind(json(renewed.collect::<Vec<_>>()))
    .fetch_all(tx)
    .await
    .doing("renew leases")?;
    Ok(held.into_iter().collect())
}

/// Gives every lease at least until `until`.
pub(crate) async fn extend_leases(
    tx: &mut SqliteConnection,
    until: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE job SET lease_expires_ms = max(lease_expires_ms, ?) WHERE state = 'leased'",
    )
    .bind(until)
    .execute(tx)
    .await
    .doing("extend leases")?;
    Ok(())
}

/// Ends a held attempt without a result and records how. Answers whether it
/// was held.
pub(crate) async fn fail(
    tx: &mut SqliteConnection,
    lease: &LeaseRef,
    reason: FailureReason,
    error: &str,
    then: AfterFailure,
    now: UnixMillis,
) -> Result<bool, StoreError> {
    let (state, not_before) = match then {
        AfterFailure::Requeue { not_before } => ("queued", Some(not_before)),
        AfterFailure::Quarantine => ("quarantined", None),
    };
    let done = sqlx::query(
        "UPDATE job SET state = ?4, not_before_ms = ?5, lease_owner = NULL, leased_ms = NULL,
             lease_expires_ms = NULL, control_steps = NULL,
             charged_attempts = charged_attempts + ?6,
             last_error = CASE WHEN ?6 THEN ?7 ELSE last_error END
         WHERE id = ?1 AND attempt = ?2 AND lease_owner = ?3 AND state = 'leased'",
    )
    .bind(lease.job)
    .bind(lease.attempt)
    .bind(&lease.worker)
    .bind(state)
    .bind(not_before)
    .bind(reason.is_charged())
    .bind(error)
    .execute(&mut *tx)
    .await
    .doing("end an attempt")?;
    if done.rows_affected() == 0 {
        return Ok(false);
    }
    sqlx::query(
        "INSERT INTO failure (job_id, attempt, worker_id, failed_ms, reason, charged, error)
         VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(lease.job)
    .bind(lease.attempt)
    .bind(&lease.worker)
    .bind(now)
    .bind(reason.as_str())
    .bind(reason.is_charged())
    .bind(error)
    .execute(tx)
    .await
    .doing("record how an attempt ended")?;
    Ok(true)
}

/// Marks held jobs as committed; their results were stored just before.
pub(crate) async fn mark_committed(
    tx: &mut SqliteConnection,
    leases: &[&LeaseRef],
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE job SET state = 'committed', lease_owner = NULL, leased_ms = NULL,
             lease_expires_ms = NULL, control_steps = NULL
         FROM json_each(?) AS ended
         WHERE job.id = ended.value ->> 0 AND attempt = ended.value ->> 1
             AND lease_owner = ended.value ->> 2 AND state = 'leased'",
    )
    .bind(json(
        leases.iter().map(|lease| named(lease)).collect::<Vec<_>>(),
    ))
    .execute(tx)
    .await
    .doing("mark jobs as committed")?;
    Ok(())
}

/// A lease as statements read it from JSON.
fn named(lease: &LeaseRef) -> (i64, u32, &str) {
    (lease.job.0, lease.attempt.0, &lease.worker.0)
}

/// Counts a report that was refused because its lease was gone.
pub(crate) async fn count_stale_report(
    tx: &mut SqliteConnection,
    job: JobId,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE job SET stale_reports = stale_reports + 1 WHERE id = ?")
        .bind(job)
        .execute(tx)
        .await
        .doing("count a late report")?;
    Ok(())
}

/// The leases of a campaign.
pub(crate) async fn leased(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<LeaseRef>, StoreError> {
    let rows: Vec<(WorkerId, JobId, Attempt)> = sqlx::query_as(
        "SELECT lease_owner, id, attempt FROM job WHERE campaign_id = ? AND state = 'leased'
         ORDER BY id",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("look for a campaign's leases")?;
    let lease = |(worker, job, attempt)| LeaseRef {
        worker,
        job,
        attempt,
    };
    Ok(rows.into_iter().map(lease).collect())
}

/// The jobs of a campaign that are set aside.
pub(crate) async fn quarantined(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<JobId>, StoreError> {
    sqlx::query_scalar("SELECT id FROM job WHERE campaign_id = ? AND state = 'quarantined'")
        .bind(campaign)
        .fetch_all(tx)
        .await
        .doing("look for jobs that are set aside")
}

/// Takes a job out of quarantine: it may be leased at once, and its failures so
/// far are forgiven.
pub(crate) async fn retry(
    tx: &mut SqliteConnection,
    job: JobId,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE job SET state = 'queued', not_before_ms = ?, charged_attempts = 0,
             forgiven_attempt = attempt
         WHERE id = ? AND state = 'quarantined'",
    )
    .bind(now)
    .bind(job)
    .execute(tx)
    .await
    .doing("take a job out of quarantine")?;
    Ok(())
}

/// Whether this worker ever held this attempt.
pub(crate) async fn was_granted(
    tx: &mut SqliteConnection,
    lease: &LeaseRef,
) -> Result<bool, StoreError> {
    sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM job WHERE id = ?1 AND attempt = ?2 AND lease_owner = ?3)
             OR EXISTS (SELECT 1 FROM result WHERE job_id = ?1 AND attempt = ?2 AND worker_id = ?3)
             OR EXISTS (SELECT 1 FROM failure WHERE job_id = ?1 AND attempt = ?2 AND worker_id = ?3)",
    )
    .bind(lease.job)
    .bind(lease.attempt)
    .bind(&lease.worker)
    .fetch_one(tx)
    .await
    .doing("look up who held an attempt")
}

/// Distinct workers on which a job's attempts were charged, counting `worker`
/// as one of them.
pub(crate) async fn failed_on_workers(
    tx: &mut SqliteConnection,
    job: JobId,
    worker: &WorkerId,
) -> Result<u32, StoreError> {
    sqlx::query_scalar(
        "SELECT 1 + count(DISTINCT f.worker_id) FROM failure f JOIN job j ON j.id = f.job_id
         WHERE f.job_id = ? AND f.charged = 1 AND f.attempt > j.forgiven_attempt
             AND f.worker_id <> ?",
    )
    .bind(job)
    .bind(worker)
    .fetch_one(tx)
    .await
    .doing("count the workers that a job failed on")
}

/// Up to `limit` leases whose time was over at `now`, longest first.
pub(crate) async fn expired(
    tx: &mut SqliteConnection,
    now: UnixMillis,
    limit: u32,
) -> Result<Vec<ExpiredRow>, StoreError> {
    #[derive(sqlx::FromRow)]
    struct Row {
        #[sqlx(flatten)]
        job: JobRow,
        control_steps: u32,
        charged_in_a_row: u32,
    }
    let rows: Vec<Row> = sqlx::query_as(
        "SELECT j.id, j.campaign_id, j.attempt, j.charged_attempts, j.state, j.not_before_ms,
             j.lease_owner, j.leased_ms, j.lease_expires_ms, j.control_steps, w.charged_in_a_row
         FROM job j JOIN worker w ON w.id = j.lease_owner
         WHERE j.state = 'leased' AND j.lease_expires_ms <= ?
         ORDER BY j.lease_expires_ms LIMIT ?",
    )
    .bind(now)
    .bind(limit)
    .fetch_all(tx)
    .await
    .doing("look for expired leases")?;
    rows.into_iter()
        .map(|row| {
            let owner = row
                .job
                .lease_owner
                .clone()
                .ok_or_else(|| foreign_columns("leased"))?;
            Ok(ExpiredRow {
                campaign: row.job.campaign_id,
                job: row.job.into_job()?,
                owner,
                control_steps: row.control_steps,
                owner_failures_in_a_row: row.charged_in_a_row,
            })
        })
        .collect()
}

/// Whether a back-off or a policy's pause ended in `(after, until]`: waiting
/// claims are woken then.
pub(crate) async fn fell_due(
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
    .doing("look for jobs that fell due")
}

impl JobRow {
    /// Reads the row; the CHECK constraints promise that this works.
    fn into_job(self) -> Result<Job, StoreError> {
        let lease = (self.lease_owner, self.leased_ms, self.lease_expires_ms);
        let state = match (self.state.as_str(), self.not_before_ms, lease) {
            ("queued", Some(not_before), (None, None, None)) => JobState::Queued { not_before },
            ("leased", None, (Some(owner), Some(granted), Some(expires))) => JobState::Leased {
                owner,
                granted,
                expires,
            },
            ("committed", None, (None, None, None)) => JobState::Committed,
            ("quarantined", None, (None, None, None)) => JobState::Quarantined,
            _ => return Err(foreign_columns(&self.state)),
        };
        Ok(Job {
            id: self.id,
            attempt: self.attempt,
            charged_attempts: self.charged_attempts,
            state,
        })
    }
}

fn foreign_columns(state: &str) -> StoreError {
    StoreError {
        doing: "read a job",
        source: sqlx::Error::Decode(format!("job state `{state}` with foreign columns").into()),
    }
}
