//! Statements that find waiting jobs and grant leases.

use sqlx::types::Text;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

use benchmark::attempt::AttemptId;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, CampaignId, JobId, WorkerId};
use crate::rules::choice::WaitingTask;
use crate::rules::lease::LOSSES_UNTIL_ALONE;

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

/// A task, and the machine that its rollouts must not have failed on too often; `None` for any
/// rollouts.
pub(crate) type Asked = (String, Option<String>);

/// A waiting job, as the answer to an [`Asked`].
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct Candidate {
    pub(crate) id: JobId,
    task: String,
    machine: Option<String>,
    /// Place in the campaign's order of jobs.
    pub(crate) unit_order: i64,
}

/// SQL condition that job `j` may run on the machine of an [`Asked`], in the columns of the JSON
/// array `asked`: the machine is NULL, or the job has fewer than `MAX_CHARGED_ATTEMPTS` charged
/// failures, 3, or none of them was on this machine.
macro_rules! suits_machine {
    () => {
        "(j.charged_attempts < 3 OR NOT EXISTS
             (SELECT 1 FROM failure f LEFT JOIN worker w ON w.id = f.worker_id
              WHERE f.job_id = j.id AND f.charged = 1 AND f.attempt > j.forgiven_attempt
                  AND coalesce(w.machine, f.worker_id) = asked.value ->> 1))"
    };
}

/// A job that runs alone, that is, only as its policy's single lease.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct LoneJob {
    pub(crate) id: JobId,
    /// Index of the claim that gets the job.
    pub(crate) place: u32,
    pub(crate) rollout_id: String,
    /// Number of attempts that ended because the policy became unreachable.
    pub(crate) losses: u32,
}

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

/// Returns the machines on which waiting jobs have failed that reached `MAX_CHARGED_ATTEMPTS`, by
/// task. Reads only these jobs.
pub(crate) async fn failing(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<(String, String)>, StoreError> {
    // The 3 is `MAX_CHARGED_ATTEMPTS` and must match the index.
    sqlx::query_as(
        "SELECT DISTINCT j.task, coalesce(w.machine, f.worker_id)
         FROM job j INDEXED BY job_failing
         JOIN failure f ON f.job_id = j.id AND f.charged = 1 AND f.attempt > j.forgiven_attempt
         LEFT JOIN worker w ON w.id = f.worker_id
         WHERE j.campaign_id = ? AND j.state = 'queued' AND j.charged_attempts >= 3",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("find jobs that have failed too often on a machine")
}

/// Returns for each `asked` up to `limit` waiting jobs whose back-off is over, without jobs that run
/// alone, in the campaign's order of jobs.
pub(crate) async fn candidates(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    asked: &BTreeSet<Asked>,
    limit: usize,
    now: UnixMillis,
) -> Result<BTreeMap<Asked, VecDeque<Candidate>>, StoreError> {
    let waiting: Vec<Candidate> = sqlx::query_as(concat!(
        "SELECT q.id, q.unit_order, asked.value ->> 0 AS task, asked.value ->> 1 AS machine
         FROM json_each(?3) AS asked JOIN job q ON q.id IN
             (SELECT j.id FROM job j
              WHERE j.campaign_id = ?1 AND j.task = asked.value ->> 0 AND j.state = 'queued'
                  AND j.not_before_ms <= ?2 AND j.losses < ?5 AND ",
        suits_machine!(),
        " ORDER BY j.unit_order LIMIT ?4)
         ORDER BY q.unit_order",
    ))
    .bind(campaign)
    .bind(now)
    .bind(json(asked))
    .bind(i64::try_from(limit).unwrap_or(i64::MAX))
    .bind(LOSSES_UNTIL_ALONE)
    .fetch_all(tx)
    .await
    .doing("find waiting jobs")?;
    let mut candidates: BTreeMap<Asked, VecDeque<Candidate>> = BTreeMap::new();
    for job in waiting {
        let asked = (job.task.clone(), job.machine.clone());
        candidates.entry(asked).or_default().push_back(job);
    }
    Ok(candidates)
}

/// Returns the campaigns and tasks with waiting jobs that run alone. Reads only these jobs.
pub(crate) async fn lone_tasks(
    tx: &mut SqliteConnection,
) -> Result<BTreeSet<(CampaignId, String)>, StoreError> {
    // The 4 is `LOSSES_UNTIL_ALONE` and must match the index `job_alone`.
    let tasks: Vec<(CampaignId, String)> = sqlx::query_as(
        "SELECT DISTINCT campaign_id, task FROM job INDEXED BY job_alone
         WHERE state = 'queued' AND losses >= 4",
    )
    .fetch_all(tx)
    .await
    .doing("find tasks with jobs that run alone")?;
    Ok(tasks.into_iter().collect())
}

/// Returns the first waiting job of a campaign that runs alone, whose back-off is over, and that
/// suits one of the claims, each of which is asked for with its index; the first such claim gets
/// the job.
pub(crate) async fn lone(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    asked: &[(&str, Option<&str>, usize)],
    now: UnixMillis,
) -> Result<Option<LoneJob>, StoreError> {
    // The 4 is `LOSSES_UNTIL_ALONE` and must match the index `job_alone`.
    sqlx::query_as(concat!(
        "SELECT j.id, j.rollout_id, j.losses, asked.value ->> 2 AS place
         FROM json_each(?3) AS asked CROSS JOIN job j INDEXED BY job_alone
         WHERE j.campaign_id = ?1 AND j.task = asked.value ->> 0 AND j.state = 'queued'
             AND j.losses >= 4 AND j.not_before_ms <= ?2 AND ",
        suits_machine!(),
        " ORDER BY place, j.unit_order LIMIT 1"
    ))
    .bind(campaign)
    .bind(now)
    .bind(json(asked))
    .fetch_optional(tx)
    .await
    .doing("find a job that runs alone")
}

/// Returns the tasks of a campaign that have waiting jobs, also those that run alone or back off.
pub(crate) async fn queued_tasks(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<String>, StoreError> {
    sqlx::query_scalar(
        "SELECT t.task FROM campaign_task t WHERE t.campaign_id = ? AND EXISTS
             (SELECT 1 FROM job j
              WHERE j.campaign_id = t.campaign_id AND j.task = t.task AND j.state = 'queued')",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("find the tasks of waiting jobs")
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
