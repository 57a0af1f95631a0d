//! Skipping of rollouts: at an operator's request they are quarantined, and the campaign continues
//! without them.

use std::collections::BTreeSet;

use super::campaigns::check_not_ended;
use super::context::Context;
use super::error::QueueError;
use crate::ids::{CampaignName, JobName};
use crate::queue::Queue;
use crate::rules::lease::{FailureReason, JobState};
use crate::store::failpoint::Step;
use crate::store::jobs;

/// Error text stored with a skipped rollout.
const SKIPPED: &str = "an operator skipped this rollout";

impl Queue {
    /// Quarantines all of the named rollouts, or none. They must be waiting or leased. No failure
    /// is charged, and `retry_jobs` releases them again. Returns their number.
    pub async fn skip_jobs(
        &self,
        name: &CampaignName,
        names: &[JobName],
    ) -> Result<u64, QueueError> {
        let mut context = Context::begin(&self.shared, vec![Step::Quarantine]).await?;
        let campaign = context.campaign_named(name).await?;
        check_not_ended(&campaign)?;
        let mut skipped = BTreeSet::new();
        for job in names {
            let (id, state) = context.job_named(&campaign, job).await?;
            // A job may be named twice.
            if !skipped.insert(id) {
                continue;
            }
            match jobs::lease(&mut context.tx, id).await? {
                Some(row) => {
                    if let JobState::Leased(lease) = &row.job.state {
                        let ending = (FailureReason::Skipped, SKIPPED);
                        let ended = context.end_attempt((&row.job, lease), campaign.id, ending);
                        ended.await?;
                    }
                }
                None if state == "queued" => {
                    let attempt = self.shared.new_attempt();
                    jobs::skip(&mut context.tx, id, attempt, SKIPPED, context.now).await?;
                }
                None => {
                    return Err(QueueError::NotSkippable { job: job.clone(), state });
                }
            }
        }
        context.settles = true;
        context.commit().await?;
        tracing::info!(campaign = %name, jobs = skipped.len(), "skipped by an operator");
        self.shared.work.notify_waiters();
        Ok(skipped.len() as u64)
    }
}
