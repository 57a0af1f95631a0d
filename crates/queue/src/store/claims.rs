//! Statements that grant leases: where jobs wait, and taking them.

use std::collections::{BTreeMap, VecDeque};

use attempt::AttemptId;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, CampaignId, JobId, WorkerId};
use crate::rules::choice::WaitingTask;
use crate::rules::lease::MAX_CHARGED_ATTEMPTS;

/// A job as it is handed to a worker.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct LeasedJob {
    pub(crate) id: JobId,
    #[sqlx(try_from = "String")]
    pub(crate) attempt_id: AttemptId,
    pub(crate) attempt: AttemptNumber,
    pub(crate) claim_id: String,
    pub(crate) lease_owner: WorkerId,
    pub(crate) campaign_id: CampaignId,
    pub(crate) replicate: u32,
    /// One manifest row, JSON.
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

/// A job that waits.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct Candidate {
    pub(crate) id: JobId,
    /// "libero_goal/3".
    task: String,
    /// Place in paired-unit order.
    pub(crate) unit_order: i64,
    /// The workers on which it failed, JSON, once it has failed so often that it
    /// matters which.
    failed_on: Option<String>,
}

/// A lease on its way into the database.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Grant {
    pub(crate) job: i64,
    pub(crate) worker: String,
    pub(crate) attempt: AttemptId,
    pub(crate) claim: String,
}

/// How long leases last.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Term {
    pub(crate) granted: UnixMillis,
    pub(crate) expires: UnixMillis,
    /// Milliseconds for each control step of the budget, settling included.
    pub(crate) ceiling_per_step_ms: i64,
}

impl Candidate {
    /// Whether it has failed too often, and on this very worker.
    pub(crate) fn has_failed_on(&self, worker: &WorkerId) -> bool {
        let failed_on = self.failed_on.as_deref().unwrap_or("[]");
        let failed_on: Vec<&str> = serde_json::from_str(failed_on).unwrap_or_default();
        failed_on.contains(&worker.0.as_str())
    }
}

/// The leases that these claims got before.
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
    .doing("look for claims that are repeated")
}

/// The leases that campaigns hold; one that holds none is left out. Walks the
/// leased jobs only.
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

/// The tasks of a campaign of which jobs wait. One index seek per task, whatever
/// the number of jobs.
pub(crate) async fn waiting_tasks(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    now: UnixMillis,
) -> Result<Vec<WaitingTask>, StoreError> {
    let rows: Vec<(String, Option<i64>, u32)> = sqlx::query_as(
        "SELECT t.task,
             (SELECT j.unit_order FROM job j
              WHERE j.campaign_id = t.campaign_id AND j.task = t.task AND j.state = 'queued'
                  AND j.not_before_ms <= ?2
              ORDER BY j.unit_order LIMIT 1),
             (SELECT count(*) FROM job h
              WHERE h.campaign_id = t.campaign_id AND h.task = t.task AND h.state = 'leased')
         FROM campaign_task t WHERE t.campaign_id = ?1",
    )
    .bind(campaign)
    .bind(now)
    .fetch_all(tx)
    .await
    .doing("look for waiting tasks")?;
    let waiting = |(task, first_unit, leased): (String, Option<i64>, u32)| {
        Some(WaitingTask {
            task,
            first_unit: first_unit?,
            leased,
        })
    };
    Ok(rows.into_iter().filter_map(waiting).collect())
}

/// By task, up to `limit` jobs of each whose back-off is over, in paired-unit
/// order.
pub(crate) async fn candidates(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    tasks: impl Iterator<Item = &str>,
    limit: usize,
    now: UnixMillis,
) -> Result<BTreeMap<String, VecDeque<Candidate>>, StoreError> {
    let waiting: Vec<Candidate> = sqlx::query_as(
        "SELECT j.id, j.task, j.unit_order, CASE WHEN j.charged_attempts >= ?5 THEN
                 (SELECT json_group_array(f.worker_id) FROM failure f
                  WHERE f.job_id = j.id AND f.charged = 1 AND f.attempt > j.forgiven_attempt)
             END AS failed_on
         FROM json_each(?3) AS asked JOIN job j ON j.id IN
             (SELECT q.id FROM job q
              WHERE q.campaign_id = ?1 AND q.task = asked.value AND q.state = 'queued'
                  AND q.not_before_ms <= ?2
              ORDER BY q.unit_order LIMIT ?4)
         ORDER BY j.unit_order",
    )
    .bind(campaign)
    .bind(now)
    .bind(json(tasks.collect::<Vec<_>>()))
    .bind(i64::try_from(limit).unwrap_or(i64::MAX))
    .bind(MAX_CHARGED_ATTEMPTS)
    .fetch_all(tx)
    .await
    .doing("look for waiting jobs")?;
    let mut candidates: BTreeMap<String, VecDeque<Candidate>> = BTreeMap::new();
    for job in waiting {
        let of_task = candidates.entry(job.task.clone()).or_default();
        of_task.push_back(job);
    }
    Ok(candidates)
}

/// Leases waiting jobs, each to its worker: one statement raises the attempts
/// and grants the leases.
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
