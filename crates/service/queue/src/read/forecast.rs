//! Inputs of forecasts: live workers and recent durations of rollouts.

use std::time::Duration;

use super::View;
use super::estimate::{Forecast, Live, Measured, Planned, forecast};
use crate::ids::CampaignId;
use crate::store::campaigns::Campaign;
use crate::store::workers::pin;
use crate::store::{Doing, StoreError};

/// Largest age of the results that a forecast uses.
const RECENT: Duration = Duration::from_secs(7 * 24 * 3_600);
/// Most results of one campaign that a forecast uses.
const RECENT_RESULTS: u32 = 200;

impl View {
    /// Forecasts the duration of rollouts on the live workers, assuming that the workers run no
    /// other rollouts.
    pub async fn forecast(&mut self, planned: &Planned<'_>) -> Result<Forecast, StoreError> {
        let workers = self.live().await?;
        let measured = self.measured(None).await?;
        Ok(forecast(&workers, &measured, planned))
    }

    /// Forecasts the duration of a campaign's waiting rollouts from its own results.
    pub async fn forecast_waiting(&mut self, campaign: &Campaign) -> Result<Forecast, StoreError> {
        let queued: Vec<(String, i64)> = sqlx::query_as(
            "SELECT task, count(*) FROM job WHERE campaign_id = ? AND state = 'queued'
             GROUP BY task",
        )
        .bind(campaign.id)
        .fetch_all(self.tx())
        .await
        .doing("count the waiting rollouts of a campaign")?;
        let mut planned = Planned { policy: &campaign.policy, ..Planned::default() };
        for (task, count) in queued {
            let suite = task.split('/').next().unwrap_or_default();
            *planned.rollouts.entry(suite.to_owned()).or_default() += count.unsigned_abs();
        }
        let mut workers = self.live().await?;
        workers.retain(|worker| campaign.accepts(&worker.pin));
        let measured = self.measured(Some(campaign.id)).await?;
        Ok(forecast(&workers, &measured, &planned))
    }

    async fn live(&mut self) -> Result<Vec<Live>, StoreError> {
        let alive_since = self.now.minus(self.timing.worker_alive);
        let workers = sqlx::query_as(concat!(
            "SELECT ",
            pin!("worker"),
            " AS pin, slots, cores FROM worker WHERE last_seen_ms >= ?
                 AND stopped_reason IS NULL AND signed_off_ms IS NULL"
        ));
        let workers = workers.bind(alive_since).fetch_all(self.tx()).await;
        workers.doing("read the slots of live workers")
    }

    /// Returns recent durations of rollouts, of one campaign or of all campaigns.
    async fn measured(
        &mut self,
        campaign: Option<CampaignId>,
    ) -> Result<Vec<Measured>, StoreError> {
        let recent = self.now.minus(RECENT);
        sqlx::query_as(
            "SELECT p.name AS policy, v.renderer,
                 substr(j.task, 1, instr(j.task, '/') - 1) AS suite,
                 coalesce(w.slots <= w.cores, 0) AS is_roomy,
                 count(*) AS results, avg(r.wall_secs) AS secs,
                 avg(r.outcome ->> '$.parts.physics_secs') AS physics_secs,
                 avg(r.outcome ->> '$.parts.drawing_secs') AS drawing_secs,
                 avg(r.outcome ->> '$.parts.policy_secs') AS policy_secs,
                 avg(max(0.0, r.wall_secs - (r.outcome ->> '$.parts.physics_secs')
                     - (r.outcome ->> '$.parts.drawing_secs')
                     - (r.outcome ->> '$.parts.policy_secs'))) AS waiting_secs,
                 avg(r.outcome ->> '$.policy_queries') AS queries
             FROM campaign c JOIN policy p ON p.id = c.policy_id
             JOIN result r ON r.job_id IN
                 (SELECT job_id FROM result WHERE campaign_id = c.id AND committed_ms >= ?1
                  ORDER BY committed_ms DESC LIMIT ?2)
             JOIN job j ON j.id = r.job_id JOIN provenance v ON v.id = r.provenance_id
             JOIN worker w ON w.id = r.worker_id
             WHERE ?3 IS NULL OR c.id = ?3
             GROUP BY p.name, v.renderer, suite, is_roomy",
        )
        .bind(recent)
        .bind(RECENT_RESULTS)
        .bind(campaign)
        .fetch_all(self.tx())
        .await
        .doing("read the recent durations of rollouts")
    }
}
