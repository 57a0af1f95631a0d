//! Derivations between campaigns, and the known outcomes of a configuration.

use super::View;
use crate::ids::CampaignId;
use crate::store::campaigns::{self, Campaign};
use crate::store::outcomes::OutcomeRow;
use crate::store::{Doing, StoreError, json};

/// One rollout of a configuration, with the fields that an explanation of the configuration needs.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct SubsetRow {
    #[sqlx(flatten)]
    pub job: OutcomeRow,
    /// True if the rollout has a video.
    pub is_filmed: bool,
}

impl View {
    /// Returns the source of a derived campaign; `None` for other campaigns.
    pub async fn source(&mut self, campaign: CampaignId) -> Result<Option<Campaign>, StoreError> {
        campaigns::source(self.tx(), campaign).await
    }

    /// Returns the campaigns that derive from a campaign, oldest first.
    pub async fn derived_campaigns(
        &mut self,
        campaign: CampaignId,
    ) -> Result<Vec<Campaign>, StoreError> {
        campaigns::derived_from(self.tx(), campaign).await
    }

    /// Returns the named rollouts that exist in a campaign, in every replicate, by rollout id, then
    /// replicate.
    pub async fn subsets(
        &mut self,
        campaign: CampaignId,
        ids: &[String],
    ) -> Result<Vec<SubsetRow>, StoreError> {
        sqlx::query_as(
            "SELECT j.rollout_id, j.replicate, j.init_id, j.state = 'quarantined' AS is_quarantined,
                 r.success, EXISTS (SELECT 1 FROM artifact a
                     WHERE a.attempt_id = r.attempt_id AND a.kind = 'video') AS is_filmed
             FROM job j LEFT JOIN result r ON r.job_id = j.id
             WHERE j.campaign_id = ? AND j.rollout_id IN (SELECT value FROM json_each(?))
             ORDER BY j.rollout_id, j.replicate",
        )
        .bind(campaign)
        .bind(json(ids))
        .fetch_all(self.tx())
        .await
        .doing("read the outcomes of a configuration's subsets")
    }
}
