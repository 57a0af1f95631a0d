//! Statements that grant leases: where jobs wait for a worker, and taking them.

use std::collections::{BTreeMap, VecDeque};

use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::{Attempt, CampaignId, CampaignName, JobId, PolicyId, WorkerId};
use crate::lease::MAX_CHARGED_ATTEMPTS;
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
    /// Which rollouts are filmed: "none", "failures", "transitions" or "all".
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

/// A job that waits.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct Candidate {
    /// The job.
    pub(crate) id: JobId,
    /// Its task, "libero_goal/3".
    pub(crate) task: String,
    /// How often it failed.
    pub(crate) charged_attempts: u32,
}

/// Campaigns with waiting jobs that this worker's assets, simulator and renderer
/// suit, oldest first.
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
        "SELECT c.id, c.policy_id, c.renderer IS NOT NULL AS is_pinned, c.name,
             p.name AS policy_name, p.endpoint, c.realisation, c.record, p.state, p.outages, p.available_ms, p.resume_ms,
             p.pause_reason, p.probe_job_id, p.probe_attempt
         FROM campaign c JOIN policy p ON p.id = c.policy_id
         WHERE c.state = 'running'
             AND (c.pinned_ms IS NULL OR (c.asset_pack_digest = ?1 AND c.mujoco_version = ?2
                 AND coalesce(c.renderer, ?3) = ?3))
             AND EXISTS (SELECT 1 FROM job j WHERE j.campaign_id = c.id AND j.state = 'queued')
         ORDER BY c.id",
    )
    .bind(&pin.asset_pack_digest)
    .bind(&pin.mujoco_version)
    .bind(&pin.renderer)
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

/// By task, jobs whose back-off is over, in paired-unit order: at least as many
/// of each task as are demanded of it, if there are.
pub(crate) async fn candidates(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    demand: &BTreeMap<&str, usize>,
    now: UnixMillis,
) -> Result<BTreeMap<String, VecDeque<Candidate>>, StoreError> {
    // A limit cannot name a column: it is the largest of all tasks'.
    let limit = demand.values().max().copied().unwrap_or(0);
    let waiting: Vec<Candidate> = sqlx::query_as(
        "SELECT j.id, j.task, j.charged_attempts
         FROM json_each(?3) AS demand JOIN job j ON j.id IN
             (SELECT q.id FROM job q
              WHERE q.campaign_id = ?1 AND q.task = demand.value AND q.state = 'queued'
                  AND q.not_before_ms <= ?2
              ORDER BY q.unit_order LIMIT ?4)
         ORDER BY j.unit_order",
    )
    .bind(campaign)
    .bind(now)
    .bind(json(demand.keys().collect::<Vec<_>>()))
    .bind(i64::try_from(limit).unwrap_or(i64::MAX))
    .fetch_all(tx)
    .await
    .doing("look for waiting jobs")?;
    let mut candidates: BTreeMap<String, VecDeque<Candidate>> = BTreeMap::new();
    for job in waiting {
        candidates
            .entry(job.task.clone())
            .or_default()
            .push_back(job);
    }
    Ok(candidates)
}

/// Leases waiting jobs, each to its worker: one statement raises the attempts
/// and grants the leases.
pub(crate) async fn grant(
    tx: &mut SqliteConnection,
    grants: &[(JobId, &WorkerId)],
    now: UnixMillis,
    expires: UnixMillis,
) -> Result<BTreeMap<JobId, LeasedJob>, StoreError> {
    let grants = grants.iter().map(|(job, worker)| (job.0, &worker.0));
    let jobs: Vec<LeasedJob> = sqlx::query_as(
        "UPDATE job SET state = 'leased', attempt = attempt + 1, not_before_ms = NULL,
             lease_owner = granted.value ->> 1, leased_ms = ?1, lease_expires_ms = ?2,
             control_steps = 0
         FROM json_each(?3) AS granted
         WHERE job.id = granted.value ->> 0 AND state = 'queued'
         RETURNING id, attempt, campaign_id, replicate, manifest_row, policy_seed, unit_order",
    )
    .bind(now)
    .bind(expires)
    .bind(json(grants.collect::<Vec<_>>()))
    .fetch_all(tx)
    .await
    .doing("lease jobs")?;
    Ok(jobs.into_iter().map(|job| (job.id, job)).collect())
}
