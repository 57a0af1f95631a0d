//! Creating, pausing, resuming, cancelling and deleting campaigns.

use benchmark::Realisation;
use serde::{Deserialize, Serialize};

use super::batches::{self, JOBS_PER_BATCH, remove as remove_hidden};
use super::context::Context;
use super::error::{QueueError, unknown_campaign};
use super::shared::Shared;
use super::{artifacts, removals};
use crate::expand::{NewCampaign, differing_fields};
use crate::ids::{CampaignId, CampaignName};
use crate::queue::Queue;
use crate::read::Counts;
use crate::rules::campaign::{CampaignState, Change, EndedIsFinal};
use crate::rules::lease::{FailureReason, JobState};
use crate::store::campaigns::Campaign;
use crate::store::failpoint::Step;
use crate::store::removals as removal_marks;
use crate::store::{StoreError, campaigns, hidden, jobs, policies, stops};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Created {
    /// Jobs added: all of them, or 0 if the campaign already existed.
    pub jobs_added: u64,
    pub jobs_total: u64,
    /// Priority of the campaign; a campaign that already existed keeps its own.
    pub priority: i32,
}

impl Queue {
    /// Stores a campaign and its jobs. Creating the same specification again adds nothing.
    ///
    /// # Errors
    /// If a campaign of this name has another specification; if the source campaign does not exist
    /// or its results could not be compared; or if the database fails.
    pub async fn create_campaign(&self, new: &NewCampaign) -> Result<Created, QueueError> {
        let _guard = self.campaigns.lock().await;
        let shared = &*self.shared;
        let mut context = Context::begin(shared, vec![Step::CreateCampaign]).await?;
        let jobs = new.jobs.len() as u64;
        if let Some(existing) = campaigns::by_name(&mut context.tx, &new.name).await? {
            if existing.spec_digest != new.spec_digest {
                let spec = campaigns::spec(&mut context.tx, existing.id).await?;
                return Err(QueueError::CampaignDiffers {
                    campaign: new.name.clone(),
                    differs: differing_fields(&spec, &new.spec),
                });
            }
            return Ok(Created { jobs_added: 0, jobs_total: jobs, priority: existing.priority });
        }
        if new.record == "transitions" && new.source.is_none() && !new.has_simultaneous() {
            return Err(QueueError::Unspecified {
                campaign: new.name.clone(),
                problem: "`record` is transitions, the rollouts of configurations whose outcome \
                          changes under simultaneous perturbation, and it has no simultaneous \
                          rollout; record failures or all"
                    .to_owned(),
            });
        }
        let folder = campaigns::free_folder(&mut context.tx, &new.name).await?;
        if new.jobs.len() > JOBS_PER_BATCH {
            // The campaign has no source: one that has is created without jobs.
            drop(context);
            batches::insert(shared, new, &folder).await?;
            return Ok(report_created(shared, new));
        }
        context.check_source(new).await?;
        let id = campaigns::insert(&mut context.tx, new, &folder, context.now).await?;
        if let Some(configurations) = new.stoppable_configurations {
            stops::insert(&mut context.tx, id, configurations).await?;
        }
        context.commit().await?;
        Ok(report_created(shared, new))
    }

    /// Pauses, resumes or cancels a campaign. Resuming also ends the back-off of its policy, which
    /// may be probed at once. Cancelling revokes the campaign's leases without a charge; each
    /// worker learns of the revocation from the response to its next heartbeat.
    ///
    /// # Errors
    /// If there is no such campaign, the campaign is cancelled or stopped (but a cancelled campaign
    /// may be cancelled again), or the database fails.
    pub async fn change_campaign(
        &self,
        name: &CampaignName,
        change: Change,
    ) -> Result<CampaignState, QueueError> {
        let shared = &*self.shared;
        let mut context = Context::begin(shared, vec![Step::ChangeCampaign]).await?;
        let campaign = context.campaign_named(name).await?;
        let after = campaign.state.after(change, context.now);
        let after = after.map_err(|EndedIsFinal| ended_error(&campaign))?;
        let health = match change {
            Change::Resume => campaign.health.due_at_once(context.now),
            Change::Pause | Change::Cancel => campaign.health.clone(),
        };
        if after == campaign.state && health == campaign.health {
            return Ok(after);
        }
        policies::set_health(&mut context.tx, campaign.policy_id, &health).await?;
        campaigns::set_state(&mut context.tx, campaign.id, after).await?;
        if let CampaignState::Cancelled { .. } = after {
            let explanation = "the campaign was cancelled";
            context.revoke_leases(campaign.id, explanation).await?;
        }
        context.commit().await?;
        tracing::info!(campaign = %name, "the campaign is {}", after.name());
        shared.work.notify_waiters();
        Ok(after)
    }

    /// Deletes a campaign with its jobs, results and files. Returns the numbers of deleted jobs by
    /// state.
    ///
    /// # Errors
    /// If there is no such campaign, some of its rollouts are leased, another campaign derives from
    /// it, or the database fails. Local files that cannot be removed now are removed at the next
    /// start; remote ones by [`finish_removals`](Self::finish_removals).
    pub async fn delete_campaign(&self, name: &CampaignName) -> Result<Counts, QueueError> {
        let _guard = self.campaigns.lock().await;
        let shared = &*self.shared;
        let mut context = Context::begin(shared, vec![Step::DeleteCampaign]).await?;
        let campaign = context.campaign_named(name).await?;
        let counts = Counts::read(&mut context.tx, campaign.id).await?;
        if counts.leased > 0 {
            return Err(QueueError::CampaignInUse {
                campaign: name.clone(),
                leased: counts.leased,
            });
        }
        let derived = campaigns::derived_from(&mut context.tx, campaign.id).await?;
        if let Some(Campaign { name: derived, .. }) = derived.into_iter().next() {
            return Err(QueueError::HasDerived { campaign: name.clone(), derived });
        }
        let folder = artifacts::campaign_folder(&campaign.folder);
        let is_large = counts.total() > JOBS_PER_BATCH as u64;
        if is_large {
            hidden::hide_deleted(&mut context.tx, campaign.id).await?;
        } else {
            campaigns::delete(&mut context.tx, campaign.id).await?;
            policies::remove_unused(&mut context.tx, campaign.policy_id).await?;
        }
        context.cache.clear();
        removal_marks::add(&mut context.tx, &folder).await?;
        context.commit().await?;
        if is_large {
            remove_hidden(shared, campaign.id, campaign.policy_id).await?;
        }
        tracing::warn!(campaign = %name, jobs = counts.total(), results = counts.committed,
        "the campaign was deleted");
        removals::remove_locally(shared, &folder).await?;
        Ok(counts)
    }
}

/// Logs a campaign that was added with its jobs, wakes waiting claims, and returns the reply.
fn report_created(shared: &Shared, new: &NewCampaign) -> Created {
    let jobs = new.jobs.len() as u64;
    tracing::info!(campaign = %new.name, jobs, "campaign created");
    shared.work.notify_waiters();
    Created { jobs_added: jobs, jobs_total: jobs, priority: new.priority }
}

fn ended_error(campaign: &Campaign) -> QueueError {
    let name = campaign.name.clone();
    match campaign.state {
        CampaignState::Stopped { .. } => QueueError::Stopped { campaign: name },
        _ => QueueError::Cancelled { campaign: name },
    }
}

pub(super) fn check_not_ended(campaign: &Campaign) -> Result<(), QueueError> {
    if campaign.state.is_over() { Err(ended_error(campaign)) } else { Ok(()) }
}

impl Context<'_> {
    /// Refuses a campaign that has a source with whose results its own could not be compared.
    async fn check_source(&mut self, new: &NewCampaign) -> Result<(), QueueError> {
        let Some(name) = &new.source else {
            return Ok(());
        };
        let source = self.campaign_named(name).await?;
        let Campaign { policy, endpoint, execution, .. } = &source;
        let problem = if source.mode()? != Realisation::Matched {
            "has the realisation reference, in which each condition perturbs an axis differently; \
             name a campaign whose realisation is matched"
                .to_owned()
        } else if (policy, endpoint) != (&new.policy, &new.policy_endpoint) {
            format!("measures policy `{policy}` at {endpoint}; name the same policy")
        } else if *execution != new.execution {
            format!(
                "ran under {execution}, but `execution` is {}; write {execution}",
                new.execution
            )
        } else {
            return Ok(());
        };
        let problem = format!("its source campaign `{name}` {problem}");
        Err(QueueError::Unspecified { campaign: new.name.clone(), problem })
    }

    pub(super) async fn campaign_named(
        &mut self,
        name: &CampaignName,
    ) -> Result<Campaign, QueueError> {
        match campaigns::by_name(&mut self.tx, name).await? {
            Some(campaign) => Ok(campaign),
            None => Err(unknown_campaign(&mut self.tx, name).await?),
        }
    }

    /// Revokes a campaign's leases without a charge, including those of workers that were cut off
    /// and may reconnect. Each worker learns of the revocation from the response to its next
    /// heartbeat. Returns the number of leases.
    pub(super) async fn revoke_leases(
        &mut self,
        campaign: CampaignId,
        explanation: &str,
    ) -> Result<u64, StoreError> {
        let leased = jobs::leased(&mut self.tx, campaign).await?;
        for row in &leased {
            if let JobState::Leased(lease) = &row.job.state {
                let failure = (FailureReason::Cancelled, explanation);
                self.end_attempt((&row.job, lease), campaign, failure).await?;
            }
        }
        jobs::forget_cut_off(&mut self.tx, campaign).await?;
        Ok(leased.len() as u64)
    }
}
