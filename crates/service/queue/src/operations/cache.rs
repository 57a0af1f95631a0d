//! Cache of rows that need not be read again.
//!
//! For one transaction: the campaigns with waiting jobs, a campaign with its
//! policy, and what live workers run on; forgotten whenever an operation changes
//! any of them. Beyond it: results and origins, which never change once they are
//! stored, and which only this process stores; and whose turn it was, which only
//! orders equals. A transaction that was undone, or that deleted a campaign,
//! forgets everything.

use std::collections::HashMap;
use std::collections::btree_map::{BTreeMap, Entry};
use std::sync::Arc;

use libero_ctrl::Suite;
use rollout_types::Provenance;
use sqlx::SqliteConnection;

use crate::clock::UnixMillis;
use crate::ids::CampaignId;
use crate::rules::pairing::Sibling;
use crate::store::campaigns::{self, Campaign};
use crate::store::jobs::InitialState;
use crate::store::provenance::{self, ProvenanceId};
use crate::store::workers::{self, Live};
use crate::store::{StoreError, results};

/// Initial states whose siblings outlive a transaction: several for each scene that a
/// few thousand slots hold. Of a whole LIBERO-CTRL campaign, about 20 MB.
const MAX_INITIAL_STATES: usize = 512;
/// Origins that outlive a transaction: one for each kind of worker and policy.
const MAX_ORIGINS: usize = 4_096;

/// Rows that have been read.
#[derive(Debug, Default)]
pub(super) struct Cache {
    /// A transaction is under way, or was undone.
    is_open: bool,
    campaigns: BTreeMap<CampaignId, Arc<Campaign>>,
    waiting: Option<Arc<Vec<Campaign>>>,
    live: Option<Arc<Vec<Live>>>,
    siblings: BTreeMap<InitialState, Vec<Sibling>>,
    origins: HashMap<Arc<Provenance>, ProvenanceId>,
    /// Origin of the results of a campaign in a suite, by which their policy is known.
    measured: BTreeMap<(CampaignId, Suite), Option<Arc<Provenance>>>,
    /// How often campaigns were leased from, and at which of these each last was.
    turns: u64,
    last_turns: BTreeMap<CampaignId, u64>,
}

impl Cache {
    /// A transaction begins. Only here may siblings go: those that it has added
    /// may not be stored yet when it looks at them again.
    pub(super) fn begin(&mut self) {
        if self.is_open {
            *self = Cache::default();
        }
        self.is_open = true;
        self.forget_campaigns();
        self.live = None;
        if self.siblings.len() > MAX_INITIAL_STATES {
            self.siblings.clear();
        }
        if self.origins.len() > MAX_ORIGINS {
            self.origins.clear();
        }
    }

    /// The transaction is on the disk.
    pub(super) fn committed(&mut self) {
        self.is_open = false;
    }

    /// The campaigns with waiting jobs. One whose last job was leased since may
    /// be among them.
    pub(super) async fn waiting(
        &mut self,
        tx: &mut SqliteConnection,
    ) -> Result<Arc<Vec<Campaign>>, StoreError> {
        if self.waiting.is_none() {
            self.waiting = Some(Arc::new(campaigns::waiting(tx).await?));
        }
        Ok(self.waiting.clone().unwrap_or_default())
    }

    /// Workers that have called since `since` and may lease.
    pub(super) async fn live(
        &mut self,
        tx: &mut SqliteConnection,
        since: UnixMillis,
    ) -> Result<Arc<Vec<Live>>, StoreError> {
        if self.live.is_none() {
            self.live = Some(Arc::new(workers::live(tx, since).await?));
        }
        Ok(self.live.clone().unwrap_or_default())
    }

    /// A campaign with its policy.
    pub(super) async fn campaign(
        &mut self,
        tx: &mut SqliteConnection,
        id: CampaignId,
    ) -> Result<Arc<Campaign>, StoreError> {
        if let Some(campaign) = self.campaigns.get(&id) {
            return Ok(campaign.clone());
        }
        let campaign = Arc::new(campaigns::by_id(tx, id).await?);
        self.campaigns.insert(id, campaign.clone());
        Ok(campaign)
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
            && !siblings.iter().any(|other| other.stands_for(&sibling))
        {
            siblings.push(sibling);
        }
    }

    /// An origin, and its number; it is stored if it is new.
    pub(super) async fn origin(
        &mut self,
        tx: &mut SqliteConnection,
        of: &Provenance,
    ) -> Result<(ProvenanceId, Arc<Provenance>), StoreError> {
        if let Some((origin, id)) = self.origins.get_key_value(of) {
            return Ok((*id, origin.clone()));
        }
        let id = provenance::find_or_insert(tx, of).await?;
        let origin = Arc::new(of.clone());
        self.origins.insert(origin.clone(), id);
        Ok((id, origin))
    }

    /// An origin of the campaign's results of a suite that says which policy was
    /// measured; none before the first.
    pub(super) async fn measured(
        &mut self,
        tx: &mut SqliteConnection,
        campaign: CampaignId,
        suite: Suite,
    ) -> Result<Option<Arc<Provenance>>, StoreError> {
        Ok(match self.measured.entry((campaign, suite)) {
            Entry::Occupied(known) => known.get().clone(),
            Entry::Vacant(unknown) => {
                let stored = provenance::of_suite(tx, campaign, suite).await?;
                unknown.insert(stored.map(Arc::new)).clone()
            }
        })
    }

    /// The campaign has a result of a suite, and this is its origin.
    pub(super) fn add_measured(
        &mut self,
        campaign: CampaignId,
        suite: Suite,
        origin: &Arc<Provenance>,
    ) {
        let known = self.measured.entry((campaign, suite)).or_default();
        if known.is_none() && !origin.policy_settings.is_empty() {
            *known = Some(origin.clone());
        }
    }

    /// A campaign was leased from.
    pub(super) fn had_turn(&mut self, campaign: CampaignId) {
        self.turns += 1;
        self.last_turns.insert(campaign, self.turns);
    }

    /// When a campaign was last leased from, by a number that only rises; 0 if
    /// that is not known.
    pub(super) fn last_turn(&self, campaign: CampaignId) -> u64 {
        self.last_turns.get(&campaign).copied().unwrap_or(0)
    }

    /// Campaigns, policies or what waits may have changed.
    pub(super) fn forget_campaigns(&mut self) {
        self.campaigns.clear();
        self.waiting = None;
    }

    /// A campaign was deleted, and what was read of it is gone.
    pub(super) fn forget(&mut self) {
        *self = Cache {
            is_open: self.is_open,
            ..Cache::default()
        };
    }
}
