//! Release of jobs from quarantine.

use super::campaigns::check_not_ended;
use super::context::Context;
use super::error::QueueError;
use crate::ids::{CampaignName, JobId, JobName};
use crate::queue::Queue;
use crate::store::campaigns::Campaign;
use crate::store::failpoint::Step;
use crate::store::jobs;

/// Most jobs that one request may name; all jobs of a campaign can be retried without naming them.
pub const MAX_JOBS_RETRIED: usize = 1_000;

/// Jobs to take out of quarantine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Retry {
    /// All quarantined jobs of the campaign.
    All,
    /// These jobs, each of which must be in quarantine.
    Named(Vec<JobName>),
}

impl Queue {
    /// Takes the chosen jobs out of quarantine: all of them, or none if one cannot be. Returns
    /// their number.
    pub async fn retry_jobs(&self, name: &CampaignName, retry: &Retry) -> Result<u64, QueueError> {
        let mut context = Context::begin(&self.shared, vec![Step::Quarantine]).await?;
        let campaign = context.campaign_named(name).await?;
        check_not_ended(&campaign)?;
        let chosen = match retry {
            Retry::All => jobs::quarantined(&mut context.tx, campaign.id).await?,
            Retry::Named(names) => {
                let mut chosen = Vec::with_capacity(names.len());
                for job in names {
                    match context.job_named(&campaign, job).await? {
                        (id, state) if state == "quarantined" => chosen.push(id),
                        (_, state) => {
                            return Err(QueueError::NotQuarantined { job: job.clone(), state });
                        }
                    }
                }
                // A job may be named twice.
                chosen.sort_unstable();
                chosen.dedup();
                chosen
            }
        };
        for job in &chosen {
            jobs::retry(&mut context.tx, *job, context.now).await?;
        }
        context.commit().await?;
        tracing::info!(campaign = %name, jobs = chosen.len(), "taken out of quarantine");
        self.shared.work.notify_waiters();
        Ok(chosen.len() as u64)
    }
}

impl Context<'_> {
    /// Returns the id and the state of a job.
    pub(super) async fn job_named(
        &mut self,
        campaign: &Campaign,
        job: &JobName,
    ) -> Result<(JobId, String), QueueError> {
        let JobName { rollout_id, replicate } = job;
        let found = jobs::by_rollout(&mut self.tx, campaign.id, rollout_id, *replicate).await?;
        found.ok_or_else(|| QueueError::UnknownRollout {
            campaign: campaign.name.clone(),
            job: job.clone(),
        })
    }
}
