//! Statements on `policy`: the health of each policy at each endpoint.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::clock::UnixMillis;
use crate::ids::{Attempt, JobId, PolicyId};
use crate::outage::{PolicyHealth, PolicyState};

/// A policy's health as it is stored.
#[derive(sqlx::FromRow)]
pub(crate) struct HealthRow {
    state: String,
    #[sqlx(flatten)]
    columns: HealthColumns,
}

/// What a policy's state carries.
#[derive(sqlx::FromRow)]
pub(crate) struct HealthColumns {
    outages: u32,
    available_ms: UnixMillis,
    resume_ms: Option<UnixMillis>,
    pause_reason: Option<String>,
    probe_job_id: Option<JobId>,
    probe_attempt: Option<Attempt>,
}

/// Finds or stores a policy.
pub(crate) async fn find_or_insert(
    tx: &mut SqliteConnection,
    endpoint: &str,
    name: &str,
    now: UnixMillis,
) -> Result<PolicyId, StoreError> {
    sqlx::query("INSERT OR IGNORE INTO policy (endpoint, name, available_ms) VALUES (?, ?, ?)")
        .bind(endpoint)
        .bind(name)
        .bind(now)
        .execute(&mut *tx)
        .await
        .doing("store a policy")?;
    sqlx::query_scalar("SELECT id FROM policy WHERE endpoint = ? AND name = ?")
        .bind(endpoint)
        .bind(name)
        .fetch_one(tx)
        .await
        .doing("look up a policy")
}

/// A policy's health.
pub(crate) async fn health(
    tx: &mut SqliteConnection,
    id: PolicyId,
) -> Result<PolicyHealth, StoreError> {
    let row: HealthRow = sqlx::query_as(
        "SELECT state, outages, available_ms, resume_ms, pause_reason, probe_job_id, probe_attempt
         FROM policy WHERE id = ?",
    )
    .bind(id)
    .fetch_one(tx)
    .await
    .doing("read a policy's health")?;
    row.into_health()
}

/// The policy of a job's campaign.
pub(crate) async fn of_job(tx: &mut SqliteConnection, job: JobId) -> Result<PolicyId, StoreError> {
    sqlx::query_scalar(
        "SELECT c.policy_id FROM job j JOIN campaign c ON c.id = j.campaign_id WHERE j.id = ?",
    )
    .bind(job)
    .fetch_one(tx)
    .await
    .doing("look up a job's policy")
}

/// A job that is out to try its policy.
#[derive(Clone, Copy, Debug, sqlx::FromRow)]
pub(crate) struct Probe {
    pub(crate) policy: PolicyId,
    pub(crate) job: JobId,
    pub(crate) attempt: Attempt,
    /// Control steps before the policy is first asked.
    pub(crate) settle_steps: u32,
}

/// The probes that are out.
pub(crate) async fn probes(tx: &mut SqliteConnection) -> Result<Vec<Probe>, StoreError> {
    sqlx::query_as(
        "SELECT p.id AS policy, j.id AS job, p.probe_attempt AS attempt,
             coalesce(json_extract(j.manifest_row, '$.num_steps_wait'), 0) AS settle_steps
         FROM policy p JOIN job j ON j.id = p.probe_job_id WHERE p.state = 'probing'",
    )
    .fetch_all(tx)
    .await
    .doing("look for probes")
}

/// Stores a policy's health.
pub(crate) async fn set_health(
    tx: &mut SqliteConnection,
    id: PolicyId,
    health: &PolicyHealth,
) -> Result<(), StoreError> {
    let (state, resume, reason, probe) = match &health.state {
        PolicyState::Available => ("available", None, None, None),
        PolicyState::Paused { resume, reason } => ("paused", Some(*resume), Some(reason), None),
        PolicyState::Probing {
            job,
            attempt,
            reason,
        } => ("probing", None, Some(reason), Some((*job, *attempt))),
    };
    sqlx::query(
        "UPDATE policy SET state = ?, outages = ?, available_ms = ?, resume_ms = ?,
             pause_reason = ?, probe_job_id = ?, probe_attempt = ? WHERE id = ?",
    )
    .bind(state)
    .bind(health.outages)
    .bind(health.available_since)
    .bind(resume)
    .bind(reason)
    .bind(probe.map(|(job, _)| job))
    .bind(probe.map(|(_, attempt)| attempt))
    .bind(id)
    .execute(tx)
    .await
    .doing("store a policy's health")?;
    Ok(())
}

impl HealthRow {
    /// Reads the row; the CHECK constraints promise that this works.
    pub(crate) fn into_health(self) -> Result<PolicyHealth, StoreError> {
        self.columns.into_health(&self.state)
    }
}

impl HealthColumns {
    /// Reads the columns of a state; the CHECK constraints promise that this
    /// works.
    pub(crate) fn into_health(self, state: &str) -> Result<PolicyHealth, StoreError> {
        let reason = self.pause_reason.unwrap_or_default();
        let state = match (state, self.resume_ms, self.probe_job_id, self.probe_attempt) {
            ("available", None, None, None) => PolicyState::Available,
            ("paused", Some(resume), None, None) => PolicyState::Paused { resume, reason },
            ("probing", None, Some(job), Some(attempt)) => PolicyState::Probing {
                job,
                attempt,
                reason,
            },
            _ => {
                let what = format!("policy state `{state}` with foreign columns");
                return Err(sqlx::Error::Decode(what.into())).doing("read a policy's health");
            }
        };
        Ok(PolicyHealth {
            outages: self.outages,
            available_since: self.available_ms,
            state,
        })
    }
}
