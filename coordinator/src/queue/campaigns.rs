//! Campaigns as operators see them: creating and following them.

use std::time::Duration;

use report::Fingerprints;
use sqlx::SqliteConnection;

use super::claim::describe;
use super::{Queue, QueueError};
use crate::artifacts;
use crate::campaign::CampaignState;
use crate::clock::UnixMillis;
use crate::expand::{NewCampaign, differing_fields};
use crate::ids::CampaignName;
use crate::outage::PolicyState;
use crate::store::campaigns::{CampaignRow, Counts};
use crate::store::failpoint::Step;
use crate::store::workers::Pin;
use crate::store::{StoreError, campaigns, removals, results, workers};

/// A campaign's rate is taken over so long, or since its first lease or since it
/// was resumed if that is less.
pub const RATE_WINDOW: Duration = Duration::from_secs(300);

/// What creating a campaign did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Created {
    /// Jobs added: all of them, or none if the campaign was there.
    pub jobs_added: u64,
    /// Jobs that it has.
    pub jobs_total: u64,
}

/// How a campaign stands.
#[derive(Clone, Debug)]
pub struct CampaignStatus {
    /// Its name.
    pub name: CampaignName,
    /// Its specification, JSON.
    pub spec: String,
    /// Its policy's name.
    pub policy: String,
    /// Its policy's endpoint.
    pub policy_endpoint: String,
    /// Where it stands with its operator.
    pub state: CampaignState,
    /// Its jobs by state.
    pub counts: Counts,
    /// Why its policy's jobs wait, if they do.
    pub policy_pause_reason: Option<String>,
    /// Committed rollouts per second over [`RATE_WINDOW`].
    pub rate_per_sec: Option<f64>,
    /// Seconds that the rest takes at that rate.
    pub eta_secs: Option<f64>,
    /// Workers alive that suit its assets, simulator and renderer.
    pub live_workers: u32,
    /// Why nothing is running although jobs wait; empty otherwise.
    pub waiting_reason: String,
    /// How its results mix fingerprints, if they have more than one.
    pub fingerprints: Option<Fingerprints>,
}

impl Queue {
    /// Stores a campaign and its jobs. The same specification twice adds
    /// nothing.
    ///
    /// # Errors
    /// When another specification has the name, or the database fails.
    pub async fn create_campaign(&self, campaign: &NewCampaign) -> Result<Created, QueueError> {
        let _alone = self.campaigns.lock().await;
        let mut tx = self.store.write(Step::CreateCampaign).await?;
        if let Some(existing) = campaigns::by_name(&mut tx, &campaign.name).await? {
            if existing.spec_digest != campaign.spec_digest {
                return Err(QueueError::CampaignDiffers {
                    campaign: campaign.name.clone(),
                    differs: differing_fields(&existing.spec, &campaign.spec),
                });
            }
            let counts = campaigns::counts(&mut tx, existing.id).await?;
            return Ok(Created {
                jobs_added: 0,
                jobs_total: counts.total(),
            });
        }
        campaigns::insert(&mut tx, campaign, self.now()).await?;
        // Files that could not be removed with a deleted campaign of this name
        // stay now, rather than to take the new one's with them.
        removals::done(&mut tx, &artifacts::campaign_folder(&campaign.name)).await?;
        tx.commit().await?;
        tracing::info!(campaign = %campaign.name, jobs = campaign.jobs.len(), "campaign created");
        self.work.notify_waiters();
        let jobs = campaign.jobs.len() as u64;
        Ok(Created {
            jobs_added: jobs,
            jobs_total: jobs,
        })
    }

    /// How all campaigns stand, oldest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn list_campaigns(&self) -> Result<Vec<CampaignStatus>, QueueError> {
        let mut tx = self.store.read().await?;
        let mut list = Vec::new();
        for row in campaigns::all(&mut tx).await? {
            list.push(self.status_of(&mut tx, row).await?);
        }
        Ok(list)
    }

    /// How one campaign stands.
    ///
    /// # Errors
    /// When there is no such campaign or the database fails.
    pub async fn campaign_status(&self, name: &CampaignName) -> Result<CampaignStatus, QueueError> {
        let mut tx = self.store.read().await?;
        let row = self.campaign(&mut tx, name).await?;
        Ok(self.status_of(&mut tx, row).await?)
    }

    async fn status_of(
        &self,
        tx: &mut SqliteConnection,
        row: CampaignRow,
    ) -> Result<CampaignStatus, StoreError> {
        let now = self.now();
        let counts = campaigns::counts(tx, row.id).await?;
        let health = campaigns::policy_health(tx, row.id).await?;
        let live = workers::live_pins(tx, now.minus(self.timing().worker_alive)).await?;
        let state = row.state()?;
        let rate_per_sec = match (row.pinned_ms, state) {
            (Some(started), CampaignState::Running { since: resumed }) => {
                let since = started.max(resumed).max(now.minus(RATE_WINDOW));
                rate(
                    campaigns::committed_since(tx, row.id, since).await?,
                    since,
                    now,
                )
            }
            _ => None,
        };
        let left = counts.queued + counts.leased;
        let policy_pause_reason = match health.state {
            PolicyState::Available => None,
            PolicyState::Paused { reason, .. } | PolicyState::Probing { reason, .. } => {
                Some(reason)
            }
        };
        let pin = row.pin();
        let able = live
            .iter()
            .filter(|live| pin.as_ref().is_none_or(|pin| pin.takes(live)));
        let live_workers = u32::try_from(able.count()).unwrap_or(u32::MAX);
        let waiting_reason = if counts.queued == 0 || counts.leased > 0 || !state.may_lease() {
            String::new()
        } else if let Some(reason) = self.held() {
            reason
        } else if let Some(reason) = &policy_pause_reason {
            format!("policy `{}` is down: {reason}", row.policy)
        } else {
            no_worker_reason(pin.as_ref(), &live, live_workers)
        };
        let fingerprints = results::fingerprints(tx, row.id).await?;
        Ok(CampaignStatus {
            name: row.name,
            spec: row.spec,
            policy: row.policy,
            policy_endpoint: row.endpoint,
            state,
            counts,
            policy_pause_reason,
            rate_per_sec,
            eta_secs: rate_per_sec
                .filter(|rate| *rate > 0.0)
                .map(|rate| left as f64 / rate),
            live_workers,
            waiting_reason,
            fingerprints,
        })
    }
}

/// Rollouts per second; none before the first was committed.
fn rate(committed: u64, since: UnixMillis, now: UnixMillis) -> Option<f64> {
    let span = now.since(since).as_secs_f64();
    (committed > 0 && span > 0.0).then(|| committed as f64 / span)
}

fn no_worker_reason(pin: Option<&Pin>, live: &[Pin], able: u32) -> String {
    match (pin, live.first()) {
        _ if able > 0 => String::new(),
        (Some(pin), Some(other)) => format!(
            "no worker runs on {}, to which the campaign is pinned; one that is here runs on {}",
            describe(pin),
            describe(other)
        ),
        (Some(pin), None) => format!("no worker is here; start one on {}", describe(pin)),
        (None, _) => "no worker is here; start one with `worker --connect`".to_owned(),
    }
}
