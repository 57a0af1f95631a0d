//! What a transaction has read and its next operations would read again: the
//! campaigns with waiting jobs, a campaign with its policy's health, the number
//! of an origin. It lives as long as its transaction, and forgets whenever an
//! operation does more than lease or commit.

use std::collections::BTreeMap;
use std::sync::Arc;

use sqlx::SqliteConnection;

use crate::ids::{CampaignId, PolicyId};
use crate::outage::PolicyHealth;
use crate::store::campaigns::CampaignRow;
use crate::store::claims::WaitingCampaign;
use crate::store::results::{Provenance, ProvenanceId};
use crate::store::workers::Pin;
use crate::store::{StoreError, campaigns, claims, results};

/// A campaign, its policy, and that policy's health.
pub(super) type Owner = (CampaignRow, PolicyId, PolicyHealth);

/// What was read in one transaction.
#[derive(Debug, Default)]
pub(super) struct Memo {
    owners: BTreeMap<CampaignId, Arc<Owner>>,
    waiting: Option<(Pin, Arc<Vec<WaitingCampaign>>)>,
    origin: Option<(Provenance, ProvenanceId)>,
}

impl Memo {
    /// The campaigns with waiting jobs for a worker that runs on `pin`. One
    /// whose last job was leased since may be among them.
    pub(super) async fn waiting(
        &mut self,
        tx: &mut SqliteConnection,
        pin: &Pin,
    ) -> Result<Arc<Vec<WaitingCampaign>>, StoreError> {
        if let Some((of, waiting)) = &self.waiting
            && of == pin
        {
            return Ok(waiting.clone());
        }
        let waiting = Arc::new(claims::waiting_campaigns(tx, pin).await?);
        self.waiting = Some((pin.clone(), waiting.clone()));
        Ok(waiting)
    }

    /// A campaign with its policy's health.
    pub(super) async fn owner(
        &mut self,
        tx: &mut SqliteConnection,
        campaign: CampaignId,
    ) -> Result<Arc<Owner>, StoreError> {
        if let Some(owner) = self.owners.get(&campaign) {
            return Ok(owner.clone());
        }
        let owner = Arc::new(campaigns::with_health(tx, campaign).await?);
        self.owners.insert(campaign, owner.clone());
        Ok(owner)
    }

    /// The number of an origin, which is stored if it is new.
    pub(super) async fn origin(
        &mut self,
        tx: &mut SqliteConnection,
        provenance: &Provenance,
    ) -> Result<ProvenanceId, StoreError> {
        if let Some((of, id)) = &self.origin
            && of == provenance
        {
            return Ok(*id);
        }
        let id = results::provenance_id(tx, provenance).await?;
        self.origin = Some((provenance.clone(), id));
        Ok(id)
    }

    /// Campaigns, policies or what waits may have changed.
    pub(super) fn forget(&mut self) {
        self.owners.clear();
        self.waiting = None;
    }
}
