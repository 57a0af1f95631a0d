//! Statements on `policy`: the health of each policy at each endpoint.

use attempt::AttemptId;
use sqlx::SqliteConnection;

use super::{Doing, StoreError, undecodable};
use crate::clock::UnixMillis;
use crate::ids::{CampaignId, PolicyId};
use crate::rules::outage::{PolicyHealth, PolicyState};

/// The columns of [`HealthRow`], of table `p`.
macro_rules! health_columns {
    () => {
        "p.state AS policy_state, p.outages, p.available_ms, p.resume_ms, p.pause_reason,
         p.probe_attempt_id"
    };
}
pub(crate) use health_columns;

/// A policy's health as it is stored.
#[derive(sqlx::FromRow)]
pub(crate) struct HealthRow {
    policy_state: String,
    outages: u32,
    available_ms: UnixMillis,
    resume_ms: Option<UnixMillis>,
    pause_reason: Option<String>,
    probe_attempt_id: Option<String>,
}

impl TryFrom<HealthRow> for PolicyHealth {
    type Error = sqlx::Error;

    /// Reads the row; the CHECK constraints promise that this works.
    fn try_from(row: HealthRow) -> Result<PolicyHealth, sqlx::Error> {
        let reason = row.pause_reason.unwrap_or_default();
        let state = (
            row.policy_state.as_str(),
            row.resume_ms,
            row.probe_attempt_id,
        );
        let state = match state {
            ("available", None, None) => PolicyState::Available,
            ("paused", Some(resume), None) => PolicyState::Paused { resume, reason },
            ("probing", None, Some(attempt)) => PolicyState::Probing {
                attempt: attempt.parse().map_err(undecodable)?,
                reason,
            },
            (state, ..) => {
                let what = format!("policy state `{state}` with columns of another");
                return Err(undecodable(what));
            }
        };
        Ok(PolicyHealth {
            outages: row.outages,
            available_since: row.available_ms,
            state,
        })
    }
}

/// Finds or stores a policy.
pub(crate) async fn find_or_insert(
    tx: &mut SqliteConnection,
    endpoint: &str,
    name: &str,
    now: UnixMillis,
) -> Result<PolicyId, StoreError> {
    sqlx::query_scalar(
        "INSERT INTO policy (endpoint, name, available_ms) VALUES (?, ?, ?)
         ON CONFLICT DO UPDATE SET name = excluded.name RETURNING id",
    )
    .bind(endpoint)
    .bind(name)
    .bind(now)
    .fetch_one(tx)
    .await
    .doing("store a policy")
}

/// An attempt that is out to try its policy.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct Probe {
    pub(crate) campaign: CampaignId,
    #[sqlx(try_from = "String")]
    pub(crate) attempt: AttemptId,
    /// Control steps before the policy is first asked.
    pub(crate) settle_steps: u32,
}

/// The probes that are out.
pub(crate) async fn probes(tx: &mut SqliteConnection) -> Result<Vec<Probe>, StoreError> {
    sqlx::query_as(
        "SELECT j.campaign_id AS campaign, j.attempt_id AS attempt,
             coalesce(json_extract(j.manifest_row, '$.num_steps_wait'), 0) AS settle_steps
         FROM policy p JOIN job j ON j.attempt_id = p.probe_attempt_id AND j.state = 'leased'
         WHERE p.state = 'probing'",
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
        PolicyState::Probing { attempt, reason } => {
            ("probing", None, Some(reason), Some(attempt.to_string()))
        }
    };
    sqlx::query(
        "UPDATE policy SET state = ?, outages = ?, available_ms = ?, resume_ms = ?,
             pause_reason = ?, probe_attempt_id = ? WHERE id = ?",
    )
    .bind(state)
    .bind(health.outages)
    .bind(health.available_since)
    .bind(resume)
    .bind(reason)
    .bind(probe)
    .bind(id)
    .execute(tx)
    .await
    .doing("store a policy's health")
    .map(drop)
}
