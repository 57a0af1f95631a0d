//! Cache of database rows.
//!
//! Cached for one transaction: the campaigns that have waiting jobs, and single campaigns with
//! their policies, both cleared when an operation changes a campaign; and the live workers, which
//! are read once and kept even if the transaction stops one of them. Cached across transactions:
//! results and origins, which never change and are stored only by this process; and the turns at
//! which campaigns last received leases, which only break ties between campaigns. A transaction
//! that is rolled back, or that deletes a campaign, clears the whole cache.

use std::collections::HashMap;
use std::collections::btree_map::{BTreeMap, Entry};
use std::sync::Arc;

use benchmark::Suite;
use benchmark::attempt::Provenance;
use sqlx::SqliteConnection;

use crate::clock::UnixMillis;
use crate::ids::CampaignId;
use crate::rules::pairing::Sibling;
use crate::store::campaigns::{self, Campaign};
use crate::store::jobs::InitialState;
use crate::store::provenance::{self, ProvenanceId};
use crate::store::workers::{self, Live};
use crate::store::{StoreError, results};

/// Initial states whose siblings are cached across transactions: about a dozen for each of
/// 40 tasks. The siblings of 2,000 initial states take about 20 MB.
const MAX_INITIAL_STATES: usize = 512;
/// Origins that are cached across transactions: one for each kind of worker and policy.
const MAX_ORIGINS: usize = 4_096;

/// Cached rows.
#[derive(Debug, Default)]
pub(super) struct Cache {
    /// True while a transaction is in progress, and after one was rolled back.
    is_open: bool,
    campaigns: BTreeMap<CampaignId, Arc<Campaign>>,
    waiting: Option<Arc<Vec<Campaign>>>,
    live: Option<Arc<Vec<Live>>>,
    siblings: BTreeMap<InitialState, Vec<Sibling>>,
    origins: HashMap<Arc<Provenance>, ProvenanceId>,
    /// Origin of a campaign's results in a suite; identifies the policy that was measured.
    measured: BTreeMap<(CampaignId, Suite), Option<Arc<Provenance>>>,
    /// Number of turns so far. A turn grants leases to one campaign.
    turns: u64,
    last_turns: BTreeMap<CampaignId, u64>,
}

impl Cache {
    /// Prepares the cache for a new transaction. Siblings are evicted only here: a transaction may
    /// need siblings that it has added to the cache and not yet written to the database.
    pub(super) fn begin(&mut self) {
        if self.is_open {
            *self = Cache::default();
        }
        self.is_open = true;
        self.clear_campaigns();
        self.live = None;
        if self.siblings.len() > MAX_INITIAL_STATES {
            self.siblings.clear();
        }
        if self.origins.len() > MAX_ORIGINS {
            self.origins.clear();
        }
    }

    pub(super) fn committed(&mut self) {
        self.is_open = false;
    }

    /// Returns the campaigns with waiting jobs. May include a campaign whose last waiting job was
    /// leased after the list was read.
    pub(super) async fn waiting(
        &mut self,
        tx: &mut SqliteConnection,
    ) -> Result<Arc<Vec<Campaign>>, StoreError> {
        if self.waiting.is_none() {
            self.waiting = Some(Arc::new(campaigns::waiting(tx).await?));
        }
        Ok(self.waiting.clone().unwrap_or_default())
    }

    /// Returns the workers that have contacted the coordinator since `since` and may lease.
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

    /// Returns the rollouts of an initial state that have a result, in the database or from this
    /// transaction.
    pub(super) async fn siblings(
        &mut self,
        tx: &mut SqliteConnection,
        state: &InitialState,
    ) -> Result<&[Sibling], StoreError> {
        if !self.siblings.contains_key(state) {
            let stored = results::siblings(tx, state).await?;
            self.siblings.insert(state.clone(), stored);
        }
        Ok(&self.siblings[state])
    }

    /// Adds a rollout to the siblings of its initial state, if they are cached. This transaction
    /// stores the rollout's result.
    pub(super) fn add_sibling(&mut self, state: &InitialState, sibling: Sibling) {
        if let Some(siblings) = self.siblings.get_mut(state)
            && !siblings.iter().any(|other| other.stands_for(&sibling))
        {
            siblings.push(sibling);
        }
    }

    /// Returns an origin with its row number, storing the origin if it is new.
    pub(super) async fn origin(
        &mut self,
        tx: &mut SqliteConnection,
        reported: &Provenance,
    ) -> Result<(ProvenanceId, Arc<Provenance>), StoreError> {
        if let Some((origin, id)) = self.origins.get_key_value(reported) {
            return Ok((*id, origin.clone()));
        }
        let id = provenance::find_or_insert(tx, reported).await?;
        let origin = Arc::new(reported.clone());
        self.origins.insert(origin.clone(), id);
        Ok((id, origin))
    }

    /// Returns the origin of a result of the campaign, or of its source, in a suite, which
    /// identifies the policy that was measured; `None` without a result.
    pub(super) async fn measured(
        &mut self,
        tx: &mut SqliteConnection,
        campaign: CampaignId,
        suite: Suite,
    ) -> Result<Option<Arc<Provenance>>, StoreError> {
        Ok(match self.measured.entry((campaign, suite)) {
            Entry::Occupied(cached) => cached.get().clone(),
            Entry::Vacant(vacant) => {
                let stored = provenance::of_suite(tx, campaign, suite).await?;
                vacant.insert(stored.map(Arc::new)).clone()
            }
        })
    }

    /// Caches the origin of a campaign's result in a suite, unless one is cached.
    pub(super) fn add_measured(
        &mut self,
        campaign: CampaignId,
        suite: Suite,
        origin: &Arc<Provenance>,
    ) {
        let cached = self.measured.entry((campaign, suite)).or_default();
        cached.get_or_insert_with(|| origin.clone());
    }

    pub(super) fn count_turn(&mut self, campaign: CampaignId) {
        self.turns += 1;
        self.last_turns.insert(campaign, self.turns);
    }

    /// Returns the turn at which a campaign last received leases, from 1; 0 if unknown.
    pub(super) fn last_turn(&self, campaign: CampaignId) -> u64 {
        self.last_turns.get(&campaign).copied().unwrap_or(0)
    }

    /// Clears the campaigns with their policies and the list of those with waiting jobs, which may
    /// have changed.
    pub(super) fn clear_campaigns(&mut self) {
        self.campaigns.clear();
        self.waiting = None;
    }

    pub(super) fn clear(&mut self) {
        *self = Cache { is_open: self.is_open, ..Cache::default() };
    }
}
