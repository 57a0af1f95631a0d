//! Statements on `policy`: the health of each policy at each endpoint.

use benchmark::attempt::AttemptId;
use sqlx::SqliteConnection;
use sqlx::types::Text;

use super::{Doing, StoreError};
use crate::clock::UnixMillis;
use crate::ids::{CampaignId, PolicyId};
use crate::rules::lease::LOSSES_UNTIL_ALONE;
use crate::rules::outage::{PolicyHealth, PolicyState};

/// SQL for the [`PolicyHealth`] of a row of table `p`, as JSON; the CHECK constraints guarantee
/// that it can be parsed.
macro_rules! health {
    () => {
        "json_object('outages', p.outages, 'misbehaved', p.misbehaved,
             'available_since', p.available_ms, 'state', json_object('is', p.state,
                 'resume', p.resume_ms, 'reason', p.pause_reason, 'attempt', p.probe_attempt_id)) AS health"
    };
}
pub(crate) use health;

pub(crate) async fn find_or_insert(
    tx: &mut SqliteConnection,
    endpoint: &str,
    name: &str,
    now: UnixMillis,
) -> Result<PolicyId, StoreError> {
    // The update changes nothing; without one, RETURNING gives no row for an existing policy.
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

/// Removes a policy unless a campaign still measures it.
pub(crate) async fn remove_unused(
    tx: &mut SqliteConnection,
    id: PolicyId,
) -> Result<(), StoreError> {
    sqlx::query(
        "DELETE FROM policy WHERE id = ?1
         AND NOT EXISTS (SELECT 1 FROM campaign WHERE policy_id = ?1)",
    )
    .bind(id)
    .execute(tx)
    .await
    .doing("remove a policy")
    .map(drop)
}

#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct Probe {
    pub(crate) campaign: CampaignId,
    pub(crate) attempt: Text<AttemptId>,
    /// Control steps before the first query of the policy.
    pub(crate) settle_steps: u32,
}

/// Returns the leased probes, except probes of jobs that run alone: since these jobs lose the
/// policy after it has answered, a first answer does not show that the policy stays available.
pub(crate) async fn probes(tx: &mut SqliteConnection) -> Result<Vec<Probe>, StoreError> {
    sqlx::query_as(
        "SELECT j.campaign_id AS campaign, j.attempt_id AS attempt,
             coalesce(json_extract(j.manifest_row, '$.num_steps_wait'), 0) AS settle_steps
         FROM policy p JOIN job j ON j.attempt_id = p.probe_attempt_id AND j.state = 'leased'
         WHERE p.state = 'probing' AND j.losses < ?",
    )
    .bind(LOSSES_UNTIL_ALONE)
    .fetch_all(tx)
    .await
    .doing("find the probes of policies")
}

/// Returns true if no job of the policy is leased.
pub(crate) async fn is_idle(tx: &mut SqliteConnection, id: PolicyId) -> Result<bool, StoreError> {
    sqlx::query_scalar(
        "SELECT NOT EXISTS (SELECT 1 FROM campaign c JOIN job j ON j.campaign_id = c.id
         WHERE c.policy_id = ? AND j.state = 'leased')",
    )
    .bind(id)
    .fetch_one(tx)
    .await
    .doing("check whether a policy's jobs are leased")
}

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
        "UPDATE policy SET state = ?, outages = ?, misbehaved = ?, available_ms = ?, resume_ms = ?,
             pause_reason = ?, probe_attempt_id = ? WHERE id = ?",
    )
    .bind(state)
    .bind(health.outages)
    .bind(health.misbehaved)
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
