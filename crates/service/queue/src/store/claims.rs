//! Statements that find waiting jobs and grant leases.

use sqlx::types::Text;
use std::collections::{BTreeMap, VecDeque};

use rollout_types::AttemptId;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, CampaignId, JobId, WorkerId};
use crate::rules::choice::WaitingTask;
use crate::rules::lease::{LOSSES_UNTIL_ALONE, MAX_CHARGED_ATTEMPTS};

/// A leased job with the fields that a worker needs.
#[derive(Clone, Debug, PartialEq, Eq, sqlx_macros::FromRow)]
pub(crate) struct LeasedJob {
    pub(crate) id: JobId,
    pub(crate) attempt_id: Text<AttemptId>,
    pub(crate) attempt: AttemptNumber,
    pub(crate) claim_id: String,
    pub(crate) lease_owner: WorkerId,
    pub(crate) campaign_id: CampaignId,
    pub(crate) replicate: u32,
    /// Manifest row, JSON.
    pub(crate) manifest_row: String,
    pub(crate) policy_seed: i64,
}

/// The columns of [`LeasedJob`].
macro_rules! leased_columns {
    () => {
        "id, attempt_id, attempt, claim_id, lease_owner, campaign_id, replicate, manifest_row,
         policy_seed"
    };
}

/// A waiting job.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct Candidate {
    pub(crate) id: JobId,
    /// Task, such as "libero_goal/3".
    task: String,
    /// Place in the campaign's order of jobs.
    pub(crate) unit_order: i64,
    /// Machines on which the job failed, JSON; `None` if the job has fewer than
    /// [`MAX_CHARGED_ATTEMPTS`] charged failures.
    failed_on: Option<String>,
}

/// SQL for the `failed_on` of a [`Candidate`], job `j`. `failures` is the SQL parameter of the
/// number of charged failures below which `failed_on` is NULL.
macro_rules! failed_on {
    ($failures:literal) => {
        concat!(
            "CASE WHEN j.charged_attempts >= ",
            $failures,
            " THEN (SELECT json_group_array(coalesce(w.machine, f.worker_id))
                  FROM failure f LEFT JOIN worker w ON w.id = f.worker_id
                  WHERE f.job_id = j.id AND f.charged = 1 AND f.attempt > j.forgiven_attempt)
             END AS failed_on"
        )
    };
}

/// A job that runs alone, that is, only as its policy's single lease.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct LoneJob {
    #[sqlx(flatten)]
    pub(crate) job: Candidate,
    pub(crate) task: String,
    pub(crate) rollout_id: String,
    /// Number of attempts that ended because the policy became unreachable.
    pub(crate) losses: u32,
}

/// A lease to be stored.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Grant {
    pub(crate) job: i64,
    pub(crate) worker: String,
    pub(crate) attempt: AttemptId,
    pub(crate) claim: String,
}

/// Times of leases that are granted together: start, expiry, and ceiling, after which heartbeats do
/// not renew a lease.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Term {
    pub(crate) granted: UnixMillis,
    pub(crate) expires: UnixMillis,
    /// Milliseconds from the grant to the ceiling, for each control step of the budget, settling
    /// included.
    pub(crate) ceiling_per_step_ms: i64,
}

impl Candidate {
    /// Returns true if the job should run on another machine: it has at least
    /// [`MAX_CHARGED_ATTEMPTS`] charged failures, one of them on this machine.
    pub(crate) fn has_failed_on(&self, machine: &str) -> bool {
        let failed_on = self.failed_on.as_deref().unwrap_or("[]");
        let failed_on: Vec<&str> = serde_json::from_str(failed_on).unwrap_or_default();
        failed_on.contains(&machine)
    }
}

/// Returns the current leases that were granted to earlier requests with the same claim ids.
pub(crate) async fn repeated(
    tx: &mut SqliteConnection,
    claims: &[&str],
) -> Result<Vec<LeasedJob>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT ",
        leased_columns!(),
        " FROM job WHERE claim_id IN (SELECT value FROM json_each(?)) AND state = 'leased'"
    ))
    .bind(json(claims))
    .fetch_all(tx)
    .await
    .doing("find the leases of repeated claims")
}

/// Returns the number of leases of each campaign that has leases. Reads leased jobs only.
pub(crate) async fn leases(
    tx: &mut SqliteConnection,
) -> Result<BTreeMap<CampaignId, u32>, StoreError> {
    let rows: Vec<(CampaignId, u32)> = sqlx::query_as(
        "SELECT campaign_id, count(*) FROM job WHERE state = 'leased' GROUP BY campaign_id",
    )
    .fetch_all(tx)
    .await
    .doing("count the leases of campaigns")?;
    Ok(rows.into_iter().collect())
}

/// Returns those tasks of a campaign that have waiting jobs whose back-off is over, not counting
/// jobs that run alone. Each task costs two look-ups in indexes: of its first waiting job, and of
/// its leased jobs.
pub(crate) async fn waiting_tasks(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    now: UnixMillis,
) -> Result<Vec<WaitingTask>, StoreError> {
    let rows: Vec<(String, Option<i64>, u32)> = sqlx::query_as(
        "SELECT t.task,
             (SELECT j.unit_order FROM job j
              WHERE j.campaign_id = t.campaign_id AND j.task = t.task AND j.state = 'queued'
                  AND j.not_before_ms <= ?2 AND j.losses < ?3
              ORDER BY j.unit_order LIMIT 1),
             (SELECT count(*) FROM job h
              WHERE h.campaign_id = t.campaign_id AND h.task = t.task AND h.state = 'leased')
         FROM campaign_task t WHERE t.campaign_id = ?1",
    )
    .bind(campaign)
    .bind(now)
    .bind(LOSSES_UNTIL_ALONE)
    .fetch_all(tx)
    .await
    .doing("find waiting tasks")?;
    let waiting = |(task, first_unit, leased): (String, Option<i64>, u32)| {
        Some(WaitingTask { task, first_unit: first_unit?, leased })
    };
    Ok(rows.into_iter().filter_map(waiting).collect())
}

/// Returns for each task up to `limit` waiting jobs whose back-off is over, without jobs that run
/// alone, in the campaign's order of jobs.
pub(crate) async fn candidates(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    tasks: impl Iterator<Item = &str>,
    limit: usize,
    now: UnixMillis,
) -> Result<BTreeMap<String, VecDeque<Candidate>>, StoreError> {
    let waiting: Vec<Candidate> = sqlx::query_as(concat!(
        "SELECT j.id, j.task, j.unit_order, ",
        failed_on!("?5"),
        " FROM json_each(?3) AS asked JOIN job j ON j.id IN
             (SELECT q.id FROM job q
              WHERE q.campaign_id = ?1 AND q.task = asked.value AND q.state = 'queued'
                  AND q.not_before_ms <= ?2 AND q.losses < ?6
              ORDER BY q.unit_order LIMIT ?4)
         ORDER BY j.unit_order",
    ))
    .bind(campaign)
    .bind(now)
    .bind(json(tasks.collect::<Vec<_>>()))
    .bind(i64::try_from(limit).unwrap_or(i64::MAX))
    .bind(MAX_CHARGED_ATTEMPTS)
    .bind(LOSSES_UNTIL_ALONE)
    .fetch_all(tx)
    .await
    .doing("find waiting jobs")?;
    let mut candidates: BTreeMap<String, VecDeque<Candidate>> = BTreeMap::new();
    for job in waiting {
        let of_task = candidates.entry(job.task.clone()).or_default();
        of_task.push_back(job);
    }
    Ok(candidates)
}

/// Returns the campaigns with waiting jobs that run alone. Reads only these jobs.
pub(crate) async fn with_lone_jobs(
    tx: &mut SqliteConnection,
) -> Result<Vec<CampaignId>, StoreError> {
    // The 4 is `LOSSES_UNTIL_ALONE` and must match the index `job_alone`.
    sqlx::query_scalar(
        "SELECT DISTINCT campaign_id FROM job WHERE state = 'queued' AND losses >= 4",
    )
    .fetch_all(tx)
    .await
    .doing("find campaigns with jobs that run alone")
}

/// Returns up to `limit` waiting jobs of a campaign that run alone and whose back-off is over, in
/// the campaign's order of jobs.
pub(crate) async fn lone(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    limit: usize,
    now: UnixMillis,
) -> Result<Vec<LoneJob>, StoreError> {
    // The 4 is `LOSSES_UNTIL_ALONE` and must match the index `job_alone`.
    sqlx::query_as(concat!(
        "SELECT j.id, j.task, j.unit_order, j.rollout_id, j.losses, ",
        failed_on!("?4"),
        " FROM job j WHERE j.campaign_id = ?1 AND j.state = 'queued' AND j.losses >= 4
             AND j.not_before_ms <= ?2
         ORDER BY j.unit_order LIMIT ?3"
    ))
    .bind(campaign)
    .bind(now)
    .bind(i64::try_from(limit).unwrap_or(i64::MAX))
    .bind(MAX_CHARGED_ATTEMPTS)
    .fetch_all(tx)
    .await
    .doing("find jobs that run alone")
}

/// Leases waiting jobs to their workers: one statement increments the attempts and grants the
/// leases.
pub(crate) async fn grant(
    tx: &mut SqliteConnection,
    grants: &[Grant],
    term: Term,
) -> Result<Vec<LeasedJob>, StoreError> {
    sqlx::query_as(concat!(
        "UPDATE job SET state = 'leased', attempt = attempt + 1, not_before_ms = NULL,
             lease_owner = granted.value ->> 'worker', attempt_id = granted.value ->> 'attempt',
             claim_id = granted.value ->> 'claim', acknowledged = 0, leased_ms = ?1,
             lease_expires_ms = ?2, control_steps = 0,
             ceiling_ms = ?1 + ?3 * (coalesce(manifest_row ->> 'max_steps', 0)
                 + coalesce(manifest_row ->> 'num_steps_wait', 0))
         FROM json_each(?4) AS granted
         WHERE job.id = granted.value ->> 'job' AND state = 'queued'
         RETURNING ",
        leased_columns!(),
    ))
    .bind(term.granted)
    .bind(term.expires)
    .bind(term.ceiling_per_step_ms)
    .bind(json(grants))
    .fetch_all(tx)
    .await
    .doing("lease jobs")
}
