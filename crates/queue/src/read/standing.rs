//! State of workers and policies, and the quarantine.

use serde::{Deserialize, Serialize};

use super::View;
use crate::clock::{UnixMillis, rfc3339};
use crate::ids::{CampaignId, CampaignName, PolicyId, WorkerId};
use crate::rules::outage::PolicyHealth;
use crate::store::policies::health;
use crate::store::{Doing, StoreError};

/// Most workers that one query returns: those that called most recently.
pub const MAX_WORKERS_LISTED: u32 = 1_000;

/// A worker, as operators get it; docs/JSON.md describes the keys.
#[derive(Clone, Debug, Serialize, Deserialize, sqlx_macros::FromRow)]
pub struct WorkerLine {
    pub worker_id: WorkerId,
    pub host: String,
    /// Rollouts that the worker runs concurrently.
    pub slots: u32,
    pub leases: u32,
    pub asset_pack: String,
    pub mujoco_version: String,
    pub renderer: String,
    pub look: String,
    pub program_version: String,
    /// True if the worker called recently and has not signed off.
    pub is_alive: bool,
    /// True if the worker signed off after a clean shutdown.
    pub has_signed_off: bool,
    /// Charged failures of the worker's machine since its last committed result.
    pub failures_in_a_row: u32,
    /// Reason why the worker must stop leasing; `None` if it may lease.
    pub stopped_reason: Option<String>,
    /// Instant of the worker's last registration.
    #[serde(with = "rfc3339")]
    pub registered_at: UnixMillis,
    #[serde(with = "rfc3339")]
    pub last_call_at: UnixMillis,
    /// Videos of finished rollouts that the worker renders or uploads; `None` without any, or unless
    /// the worker is alive. Not printed as JSON.
    #[sqlx(skip)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filming: Option<u32>,
}

#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct PolicyLine {
    id: PolicyId,
    pub endpoint: String,
    /// Name of the policy at its endpoint.
    pub name: String,
    #[sqlx(json)]
    pub health: PolicyHealth,
    /// Campaigns that measure the policy, oldest first.
    #[sqlx(skip)]
    pub campaigns: Vec<CampaignName>,
}

#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct QuarantinedLine {
    pub campaign: CampaignName,
    pub rollout_id: String,
    pub replicate: u32,
    pub charged_attempts: u32,
    pub last_error: String,
}

impl View {
    /// Returns up to [`MAX_WORKERS_LISTED`] workers, those that called most recently first.
    pub async fn workers(&mut self) -> Result<Vec<WorkerLine>, StoreError> {
        let alive_since = self.now.minus(self.timing.worker_alive);
        let mut workers: Vec<WorkerLine> = sqlx::query_as(
            "SELECT w.id AS worker_id, w.host, w.slots, coalesce(h.leases, 0) AS leases,
                 w.asset_pack, w.mujoco_version, w.renderer, w.look, w.program_version,
                 w.last_seen_ms >= ? AND w.signed_off_ms IS NULL AS is_alive,
                 w.signed_off_ms IS NOT NULL AS has_signed_off,
                 w.charged_in_a_row AS failures_in_a_row, w.stopped_reason,
                 w.registered_ms AS registered_at, w.last_seen_ms AS last_call_at
             FROM worker w LEFT JOIN
                 (SELECT lease_owner, count(*) AS leases FROM job WHERE state = 'leased'
                  GROUP BY lease_owner) h ON h.lease_owner = w.id
             ORDER BY w.last_seen_ms DESC, w.id LIMIT ?",
        )
        .bind(alive_since)
        .bind(MAX_WORKERS_LISTED)
        .fetch_all(self.tx())
        .await
        .doing("list workers")?;
        for worker in workers.iter_mut().filter(|worker| worker.is_alive) {
            worker.filming = self.filming.get(&worker.worker_id).copied();
        }
        Ok(workers)
    }

    pub async fn policies(&mut self) -> Result<Vec<PolicyLine>, StoreError> {
        let mut policies: Vec<PolicyLine> = sqlx::query_as(concat!(
            "SELECT p.id, p.endpoint, p.name, ",
            health!(),
            " FROM policy p ORDER BY p.name, p.endpoint"
        ))
        .fetch_all(self.tx())
        .await
        .doing("list policies")?;
        let users: Vec<(PolicyId, CampaignName)> = sqlx::query_as(
            "SELECT policy_id, name FROM campaign
                 WHERE id NOT IN (SELECT campaign_id FROM passage) ORDER BY id",
        )
        .fetch_all(self.tx())
        .await
        .doing("list the campaigns of each policy")?;
        for policy in &mut policies {
            let users = users.iter().filter(|(id, _)| *id == policy.id);
            policy.campaigns = users.map(|(_, campaign)| campaign.clone()).collect();
        }
        Ok(policies)
    }

    /// Returns up to `limit` quarantined rollouts, of one campaign or of all campaigns.
    pub async fn quarantine(
        &mut self,
        campaign: Option<CampaignId>,
        limit: u32,
    ) -> Result<Vec<QuarantinedLine>, StoreError> {
        sqlx::query_as(
            "SELECT c.name AS campaign, j.rollout_id, j.replicate, j.charged_attempts, j.last_error
             FROM job j JOIN campaign c ON c.id = j.campaign_id
             WHERE j.state = 'quarantined' AND (?1 IS NULL OR j.campaign_id = ?1)
                 AND c.id NOT IN (SELECT campaign_id FROM passage)
             ORDER BY j.campaign_id, j.rollout_id, j.replicate LIMIT ?2",
        )
        .bind(campaign)
        .bind(limit)
        .fetch_all(self.tx())
        .await
        .doing("read the quarantine")
    }

    /// Returns the number of attempts that ended without a result, by failure reason.
    pub async fn endings(&mut self) -> Result<Vec<(String, i64)>, StoreError> {
        sqlx::query_as("SELECT reason, attempts FROM ending_tally WHERE attempts > 0")
            .fetch_all(self.tx())
            .await
            .doing("count attempts by failure reason")
    }
}
