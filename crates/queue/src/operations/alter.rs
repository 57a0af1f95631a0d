//! Alteration of an existing campaign: its priority, policy or name. A request is applied in full
//! or not at all.

use benchmark::CampaignSpec;

use super::campaigns::check_not_ended;
use super::context::Context;
use super::error::QueueError;
use crate::expand::altered;
use crate::ids::CampaignName;
use crate::queue::Queue;
use crate::read::Counts;
use crate::store::campaigns::Campaign;
use crate::store::failpoint::Step;
use crate::store::{campaigns, policies};

/// A change of a campaign; fields that are `None` stay as they are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Alteration {
    /// One of [`PRIORITIES`](crate::rules::campaign::PRIORITIES).
    pub priority: Option<i32>,
    /// New URL of the policy. A change of URL or policy revokes leases without a charge.
    pub endpoint: Option<String>,
    /// New name of the policy at its endpoint; allowed only while the campaign has no results.
    pub policy: Option<String>,
    pub name: Option<CampaignName>,
}

impl Queue {
    /// Alters a campaign. Returns the number of revoked leases; each worker learns of the
    /// revocation from the response to its next heartbeat.
    ///
    /// A renamed campaign is found under its new name only; its files stay in their folder. Name,
    /// policy and endpoint also change in the stored specification, so that creating a campaign
    /// with the altered specification finds this one. Creation with the original specification is
    /// refused after a change of policy or endpoint; after a change of name, it creates another
    /// campaign under the old name.
    pub async fn alter_campaign(
        &self,
        name: &CampaignName,
        alteration: &Alteration,
    ) -> Result<u64, QueueError> {
        let _guard = self.campaigns.lock().await;
        let shared = &*self.shared;
        let mut context = Context::begin(shared, vec![Step::ChangeCampaign]).await?;
        let campaign = context.campaign_named(name).await?;
        let mut revoked = 0;
        if let Some(priority) = alteration.priority {
            campaigns::set_priority(&mut context.tx, campaign.id, priority).await?;
        }
        let endpoint = alteration.endpoint.as_ref().unwrap_or(&campaign.endpoint);
        let policy = alteration.policy.as_ref().unwrap_or(&campaign.policy);
        if (endpoint, policy) != (&campaign.endpoint, &campaign.policy) {
            revoked = context.change_policy(&campaign, endpoint, policy).await?;
        }
        if let Some(new_name) = alteration.name.as_ref().filter(|new| *new != name) {
            context.rename(&campaign, new_name).await?;
        }
        context.cache.clear_campaigns();
        context.commit().await?;
        tracing::info!(campaign = %name, "altered: {alteration:?}");
        shared.work.notify_waiters();
        Ok(revoked)
    }
}

impl Context<'_> {
    async fn change_policy(
        &mut self,
        campaign: &Campaign,
        endpoint: &str,
        policy: &str,
    ) -> Result<u64, QueueError> {
        check_not_ended(campaign)?;
        let results = Counts::read(&mut self.tx, campaign.id).await?.committed;
        if policy != campaign.policy && results > 0 {
            return Err(QueueError::PolicyMeasured {
                campaign: campaign.name.clone(),
                policy: campaign.policy.clone(),
                results,
            });
        }
        // The leases are revoked before the policy changes: the end of their attempts, one of which
        // may be the probe of the paused policy, counts as evidence about the old policy only.
        let explanation = "the campaign's policy or endpoint was changed";
        let revoked = self.revoke_leases(campaign.id, explanation).await?;
        let (spec, digest) = self
            .altered_spec(campaign, |spec| {
                endpoint.clone_into(&mut spec.policy.endpoint);
                policy.clone_into(&mut spec.policy.name);
            })
            .await?;
        let new_policy = policies::find_or_insert(&mut self.tx, endpoint, policy, self.now).await?;
        campaigns::set_policy(&mut self.tx, campaign.id, new_policy).await?;
        campaigns::set_spec(&mut self.tx, campaign.id, &spec, &digest).await?;
        policies::remove_unused(&mut self.tx, campaign.policy_id).await?;
        Ok(revoked)
    }

    async fn rename(&mut self, campaign: &Campaign, name: &CampaignName) -> Result<(), QueueError> {
        if campaigns::by_name(&mut self.tx, name).await?.is_some() {
            return Err(QueueError::NameTaken {
                campaign: campaign.name.clone(),
                taken: name.clone(),
            });
        }
        let (spec, digest) = self
            .altered_spec(campaign, |spec| {
                name.as_str().clone_into(&mut spec.name);
            })
            .await?;
        campaigns::set_spec(&mut self.tx, campaign.id, &spec, &digest).await?;
        let derived_campaigns = campaigns::derived_from(&mut self.tx, campaign.id).await?;
        campaigns::rename(&mut self.tx, campaign, name).await?;
        for derived in derived_campaigns {
            let (spec, digest) = self
                .altered_spec(&derived, |spec| {
                    if let Some(purpose) = &mut spec.purpose {
                        purpose.set_source(name.as_str());
                    }
                })
                .await?;
            campaigns::set_spec(&mut self.tx, derived.id, &spec, &digest).await?;
        }
        Ok(())
    }

    async fn altered_spec(
        &mut self,
        campaign: &Campaign,
        change: impl FnOnce(&mut CampaignSpec),
    ) -> Result<(String, String), QueueError> {
        let spec = campaigns::spec(&mut self.tx, campaign.id).await?;
        altered(&spec, change).map_err(|error| QueueError::Unspecified {
            campaign: campaign.name.clone(),
            problem: error.to_string(),
        })
    }
}
