//! Statements on `job` and `failure`: claiming, renewing, ending an attempt.
//!
//! Every statement that moves a leased job is conditional on its owner and
//! attempt, and answers whether it moved anything.

use protocol::ManifestRow;
use sqlx::SqliteConnection;

use super::{Doing, StoreError, undecodable};
use crate::clock::UnixMillis;
use crate::ids::{Attempt, CampaignId, CampaignName, JobId, LeaseRef, PolicyId, WorkerId};
use crate::lease::{AfterFailure, FailureReason, Job, JobState, MAX_CHARGED_ATTEMPTS, OutcomeKey};
use crate::outage::PolicyHealth;
use crate::plan::WaitingTask;
use crate::store::policies::HealthRow;
use crate::store::workers::Pin;

/// The condition under which job `j` may be leased: its back-off (until ?2) is
/// over, and it has not failed too often (?3) on this very worker (?5) while
/// another (?4 in all) could try it.
macro_rules! is_waiting {
    () => {
        "j.state = 'queued' AND j.not_before_ms <= ?2
         AND NOT (j.charged_attempts >= ?3 AND ?4 >= 2 AND EXISTS
             (SELECT 1 FROM failure f
              WHERE f.job_id = j.id AND f.charged = 1 AND f.worker_id = ?5
                  AND f.attempt > j.forgiven_attempt))"
    };
}

/// Who claims, and when.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Claimant<'a> {
    /// The worker.
    pub(crate) worker: &'a WorkerId,
    /// What it runs on.
    pub(crate) pin: &'a Pin,
    /// Workers alive that run on the same, this one included: where there are
    /// two, a job that failed too often is kept from those that it failed on.
    pub(crate) able_workers: u32,
    /// The present instant.
    pub(crate) now: UnixMillis,
}

/// A campaign with waiting jobs that a worker could run.
#[derive(Clone, Debug)]
pub(crate) struct WaitingCampaign {
    /// The campaign.
    pub(crate) id: CampaignId,
    /// Its policy.
    pub(crate) policy: PolicyId,
    /// That policy's health.
    pub(crate) health: PolicyHealth,
    /// Whether a lease has pinned it yet.
    pub(crate) is_pinned: bool,
    /// Its name.
    pub(crate) name: CampaignName,
    /// Its policy's name at its endpoint.
    pub(crate) policy_name: String,
    /// Its policy's endpoint.
    pub(crate) policy_endpoint: String,
    /// "matched" or "reference".
    pub(crate) realisation: String,
    /// Which rollouts are filmed: "none", "failures" or "all".
    pub(crate) record: String,
}

/// A job as it is handed to a worker.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub struct LeasedJob {
    /// The job.
    pub id: JobId,
    /// The attempt that was granted.
    pub attempt: Attempt,
    /// Its campaign.
    pub campaign_id: CampaignId,
    /// Which replicate.
    pub replicate: u32,
    /// One manifest row, JSON.
    pub manifest_row: String,
    /// Seed for the policy.
    pub policy_seed: i64,
    /// Place in paired-unit order.
    pub unit_order: i64,
}

/// A job as a report of its outcome finds it.
#[derive(Clone, Debug)]
pub(crate) struct ReportedJob {
    /// The job.
    pub(crate) job: Job,
    /// Its campaign.
    pub(crate) campaign: CampaignId,
    /// Its committed outcome, if it has one.
    pub(crate) stored: Option<OutcomeKey>,
    manifest_row: String,
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

/// Campaigns with waiting jobs that this worker's assets and simulator suit,
/// oldest first.
pub(crate) async fn waiting_campaigns(
    tx: &mut SqliteConnection,
    pin: &Pin,
) -> Result<Vec<WaitingCampaign>, StoreError> {
    #[derive(sqlx::FromRow)]
    struct Row {
        id: CampaignId,
        policy_id: PolicyId,
        is_pinned: bool,
        name: CampaignName,
        policy_name: String,
        endpoint: String,
        realisation: String,
        record: String,
        #[sqlx(flatten)]
        health: HealthRow,
    }
    let rows: Vec<Row> = sqlx::query_as(
        "SELECT c.id, c.policy_id, c.pinned_ms IS NOT NULL AS is_pinned, c.name,
             p.name AS policy_name, p.endpoint, c.realisation, c.record, p.state, p.outages, p.available_ms, p.resume_ms,
             p.pause_reason, p.probe_job_id, p.probe_attempt
         FROM campaign c JOIN policy p ON p.id = c.policy_id
         WHERE c.state = 'running'
             AND (c.pinned_ms IS NULL OR (c.asset_pack_digest = ? AND c.mujoco_version = ?))
             AND EXISTS (SELECT 1 FROM job j WHERE j.campaign_id = c.id AND j.state = 'queued')
         ORDER BY c.id",
    )
    .bind(&pin.asset_pack_digest)
    .bind(&pin.mujoco_version)
    .fetch_all(tx)
    .await
    .doing("look for campaigns with waiting jobs")?;
    rows.into_iter()
        .map(|row| {
            Ok(WaitingCampaign {
                id: row.id,
                policy: row.policy_id,
                health: row.health.into_health()?,
                is_pinned: row.is_pinned,
                name: row.name,
                policy_name: row.policy_name,
                policy_endpoint: row.endpoint,
                realisation: row.realisation,
                record: row.record,
            })
        })
        .collect()
}

/// The tasks of a campaign of which jobs wait for this worker. One index seek
/// per task, whatever the number of jobs.
pub(crate) async fn waiting_tasks(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    claimant: Claimant<'_>,
) -> Result<Vec<WaitingTask>, StoreError> {
    let rows: Vec<(String, Option<i64>, u32)> = sqlx::query_as(concat!(
        "SELECT t.task,
             (SELECT j.unit_order FROM job j
              WHERE j.campaign_id = t.campaign_id AND j.task = t.task AND ",
        is_waiting!(),
        "
              ORDER BY j.unit_order LIMIT 1),
             (SELECT count(*) FROM job h
              WHERE h.campaign_id = t.campaign_id AND h.task = t.task AND h.state = 'leased'
                  AND h.lease_owner <> ?5)
         FROM campaign_task t WHERE t.campaign_id = ?1",
    ))
    .bind(campaign)
    .bind(claimant.now)
    .bind(MAX_CHARGED_ATTEMPTS)
    .bind(claimant.able_workers)
    .bind(claimant.worker)
    .fetch_all(tx)
    .await
    .doing("look for waiting tasks")?;
    Ok(rows
        .into_iter()
        .filter_map(|(task, first_unit, held_by_others)| {
            Some(WaitingTask {
                task,
                first_unit: first_unit?,
                held_by_others,
            })
        })
        .collect())
}

/// Leases up to `limit` jobs of one task, in paired-unit order: one statement
/// raises the attempt and grants the lease.
pub(crate) async fn claim(
    tx: &mut SqliteConnection,
    (campaign, task): (CampaignId, &str),
    claimant: Claimant<'_>,
    expires: UnixMillis,
    limit: u32,
) -> Result<Vec<LeasedJob>, StoreError> {
    let mut jobs: Vec<LeasedJob> = sqlx::query_as(concat!(
        "UPDATE job SET state = 'leased', attempt = attempt + 1, not_before_ms = NULL,
             lease_owner = ?5, leased_ms = ?2, lease_expires_ms = ?6, control_steps = 0
         WHERE id IN
             (SELECT j.id FROM job j
              WHERE j.campaign_id = ?1 AND j.task = ?7 AND ",
        is_waiting!(),
        "
              ORDER BY j.unit_order LIMIT ?8)
         RETURNING id, attempt, campaign_id, replicate, manifest_row, policy_seed, unit_order",
    ))
    .bind(campaign)
    .bind(claimant.now)
    .bind(MAX_CHARGED_ATTEMPTS)
    .bind(claimant.able_workers)
    .bind(claimant.worker)
    .bind(expires)
    .bind(task)
    .bind(limit)
    .fetch_all(tx)
    .await
    .doing("lease jobs")?;
    jobs.sort_by_key(|job| job.unit_order);
    Ok(jobs)
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

/// One job as a report of its outcome finds it.
pub(crate) async fn reported(
    tx: &mut SqliteConnection,
    id: JobId,
) -> Result<Option<ReportedJob>, StoreError> {
    #[derive(sqlx::FromRow)]
    struct Row {
        #[sqlx(flatten)]
        job: JobRow,
        manifest_row: String,
        success: Option<bool>,
        steps: Option<u32>,
    }
    let row: Option<Row> = sqlx::query_as(
        "SELECT j.id, j.campaign_id, j.attempt, j.charged_attempts, j.state, j.not_before_ms,
             j.lease_owner, j.leased_ms, j.lease_expires_ms, j.manifest_row, r.success, r.steps
         FROM job j LEFT JOIN result r ON r.job_id = j.id WHERE j.id = ?",
    )
    .bind(id)
    .fetch_optional(tx)
    .await
    .doing("read a job")?;
    row.map(|row| {
        Ok(ReportedJob {
            campaign: row.job.campaign_id,
            job: row.job.into_job()?,
            manifest_row: row.manifest_row,
            stored: match (row.success, row.steps) {
                (Some(success), Some(steps)) => Some(OutcomeKey { success, steps }),
                _ => None,
            },
        })
    })
    .transpose()
}

impl ReportedJob {
    /// The rollout that the job is to run.
    pub(crate) fn manifest_row(&self) -> Result<ManifestRow, StoreError> {
        let row = serde_json::from_str(&self.manifest_row).map_err(undecodable);
        row.doing("read a job's manifest row")
    }
}

/// Renews a lease and stores its progress. Answers whether it is still held.
pub(crate) async fn renew(
    tx: &mut SqliteConnection,
    lease: &LeaseRef,
    control_steps: u32,
    expires: UnixMillis,
) -> Result<bool, StoreError> {
    let done = sqlx::query(
        "UPDATE job SET lease_expires_ms = ?, control_steps = max(control_steps, ?)
         WHERE id = ? AND attempt = ? AND lease_owner = ? AND state = 'leased'",
    )
    .bind(expires)
    .bind(control_steps)
    .bind(lease.job)
    .bind(lease.attempt)
    .bind(&lease.worker)
    .execute(tx)
    .await
    .doing("renew a lease")?;
    Ok(done.rows_affected() == 1)
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

/// Marks a held job as committed; its result was stored just before. Answers
/// whether it was held.
pub(crate) async fn mark_committed(
    tx: &mut SqliteConnection,
    lease: &LeaseRef,
) -> Result<bool, StoreError> {
    let done = sqlx::query(
        "UPDATE job SET state = 'committed', lease_owner = NULL, leased_ms = NULL,
             lease_expires_ms = NULL, control_steps = NULL
         WHERE id = ? AND attempt = ? AND lease_owner = ? AND state = 'leased'",
    )
    .bind(lease.job)
    .bind(lease.attempt)
    .bind(&lease.worker)
    .execute(tx)
    .await
    .doing("mark a job as committed")?;
    Ok(done.rows_affected() == 1)
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
