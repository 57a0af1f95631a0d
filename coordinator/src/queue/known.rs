//! What the writer has read and need not read again.
//!
//! For one transaction: the campaigns with waiting jobs, a campaign with its
//! policy's health; forgotten whenever an operation does more than lease or
//! commit. Beyond it: results and origins, which never change once they are
//! stored, and which nobody else stores. Whoever undoes a transaction or
//! deletes a campaign forgets everything.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use sqlx::SqliteConnection;

use crate::ids::{CampaignId, PolicyId};
use crate::outage::PolicyHealth;
use crate::store::campaigns::CampaignRow;
use crate::store::claims::WaitingCampaign;
use crate::store::results::{InitialState, Provenance, ProvenanceId, Sibling};
use crate::store::workers::Pin;
use crate::store::{StoreError, campaigns, claims, results};

/// Initial states whose siblings outlive a transaction: several for each scene that a
/// few thousand slots hold. Of a whole LIBERO-CTRL campaign, about 10 MB.
const MAX_INITIAL_STATES: usize = 512;
/// Origins that outlive a transaction: one for each kind of worker and policy.
const MAX_ORIGINS: usize = 4_096;

/// A campaign, its policy, and that policy's health.
#[derive(Debug)]
pub(super) struct Owner {
    pub(super) campaign: CampaignRow,
    pub(super) policy: PolicyId,
    pub(super) health: PolicyHealth,
}

/// What was read.
#[derive(Debug, Default)]
pub(super) struct Known {
    owners: BTreeMap<CampaignId, Arc<Owner>>,
    waiting: HashMap<Pin, Arc<Vec<WaitingCampaign>>>,
    siblings: BTreeMap<InitialState, Vec<Sibling>>,
    origins: HashMap<Provenance, ProvenanceId>,
}

impl Known {
    /// A transaction begins. Only here may siblings go: those that it has added
    /// may not be stored yet when it looks at them again.
    pub(super) fn begin(&mut self) {
        self.forget_owners();
        if self.siblings.len() > MAX_INITIAL_STATES {
            self.siblings.clear();
        }
        if self.origins.len() > MAX_ORIGINS {
            self.origins.clear();
        }
    }

    /// The campaigns with waiting jobs for a worker that runs on `pin`. One
    /// whose last job was leased since may be among them.
    pub(super) async fn waiting(
        &mut self,
        tx: &mut SqliteConnection,
        pin: &Pin,
    ) -> Result<Arc<Vec<WaitingCampaign>>, StoreError> {
        if let Some(waiting) = self.waiting.get(pin) {
            return Ok(waiting.clone());
        }
        let waiting = Arc::new(claims::waiting_campaigns(tx, pin).await?);
        self.waiting.insert(pin.clone(), waiting.clone());
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
        let (row, policy, health) = campaigns::with_health(tx, campaign).await?;
        let owner = Arc::new(Owner {
            campaign: row,
            policy,
            health,
        });
        self.owners.insert(campaign, owner.clone());
        Ok(owner)
    }

    /// The committed rollouts of an initial state.
    pub(super) async fn siblings(
        &mut self,
        tx: &mut SqliteConnection,
        of: &InitialState,
    ) -> Result<&[Sibling], StoreError> {
        if !self.siblings.contains_key(of) {
            let stored = results::siblings(tx, of).await?;
            self.siblings.insert(of.clone(), stored);
        }
        Ok(&self.siblings[of])
    }

    /// One more committed rollout of an initial state.
    pub(super) fn add_sibling(&mut self, of: &InitialState, sibling: Sibling) {
        if let Some(siblings) = self.siblings.get_mut(of)
            && !siblings.iter().any(|other| other.speaks_for(&sibling))
        {
            siblings.push(sibling);
        }
    }

    /// The number of an origin, which is stored if it is new.
    pub(super) async fn origin(
        &mut self,
        tx: &mut SqliteConnection,
        provenance: &Provenance,
    ) -> Result<ProvenanceId, StoreError> {
        if let Some(id) = self.origins.get(provenance) {
            return Ok(*id);
        }
        let id = results::provenance_id(tx, provenance).await?;
        self.origins.insert(provenance.clone(), id);
        Ok(id)
    }

    /// Campaigns, policies or what waits may have changed.
    pub(super) fn forget_owners(&mut self) {
        self.owners.clear();
        self.waiting.clear();
    }

    /// A transaction was undone, or a campaign deleted.
    pub(super) fn forget(&mut self) {
        *self = Known::default();
    }
}
