//! Status of campaigns.

use std::time::Duration;

use benchmark::attempt::{Fingerprints, Pin};
use serde::{Deserialize, Serialize, Serializer};
use sqlx::SqliteConnection;

use super::View;
use crate::clock::{UnixMillis, rfc3339};
use crate::ids::{CampaignId, CampaignName};
use crate::operations::claim::missing_means;
use crate::operations::error::{QueueError, unknown_campaign};
use crate::rules::campaign::CampaignState;
use crate::rules::outage::PolicyState;
use crate::store::campaigns::{self, Campaign};
use crate::store::stops::{self, EarlyStop};
use crate::store::workers::Live;
use crate::store::{Doing, StoreError, claims, workers};

/// Window over which a campaign's rate is measured; shorter if the earliest of the rollouts
/// committed in it began, or the campaign was resumed, within the window.
pub const RATE_WINDOW: Duration = Duration::from_secs(300);

/// Counts of a campaign's jobs, by state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub struct Counts {
    pub queued: u64,
    pub leased: u64,
    pub committed: u64,
    pub quarantined: u64,
    /// Committed jobs that reached their goal.
    pub succeeded: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    #[default]
    Running,
    /// Running, with every rollout committed or in quarantine.
    Finished,
    Paused,
    Cancelled,
    Stopped,
}

/// Status of a campaign, as operators get it; docs/JSON.md describes the keys.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct CampaignStatus {
    pub name: String,
    /// Name of the policy at its endpoint.
    pub policy: String,
    pub endpoint: String,
    pub priority: i32,
    pub state: Stage,
    /// True if the campaign is cancelled or stopped early, or if every rollout is committed or in
    /// quarantine.
    pub is_finished: bool,
    pub rollouts: Counts,
    /// Committed rollouts per second over [`RATE_WINDOW`]; `None` if there were none, or the
    /// campaign is not running.
    pub rate_per_sec: Option<f64>,
    /// Seconds that the remaining rollouts take at that rate; `None` while none can be leased.
    pub remaining_secs: Option<f64>,
    /// Live workers that meet the campaign's requirements and its pin.
    pub live_workers: u32,
    /// Reason why the campaign's policy is paused, also while a probe tries the policy; `None` if
    /// the policy is available.
    pub policy_outage: Option<String>,
    /// Reason why no job is leased although jobs wait; `None` if there is no such reason.
    pub waiting_reason: Option<String>,
    /// Mix of fingerprints among the campaign's results; `None` unless there are several.
    pub mixed_fingerprints: Option<String>,
    /// Early-stopping rule, with the point at which the campaign stopped; `None` without a rule.
    pub early_stop: Option<EarlyStop>,
    /// Source of a derived campaign; `None` in other campaigns.
    pub follows_from: Option<String>,
    #[serde(with = "rfc3339")]
    pub created_at: UnixMillis,
    /// Seconds until a probe tries the paused policy again; `None` if it is not paused or a probe is
    /// running. Not printed as JSON.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy_retry_secs: Option<f64>,
}

impl Stage {
    /// Returns true if nothing will be leased again.
    pub fn is_over(self) -> bool {
        matches!(self, Stage::Cancelled | Stage::Stopped)
    }
}

impl Serialize for Counts {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map([
            ("total", self.total()),
            ("queued", self.queued),
            ("leased", self.leased),
            ("committed", self.committed),
            ("succeeded", self.succeeded),
            ("failed", self.committed.saturating_sub(self.succeeded)),
            ("quarantined", self.quarantined),
        ])
    }
}

impl Counts {
    pub fn total(&self) -> u64 {
        self.queued + self.leased + self.committed + self.quarantined
    }

    /// Reads the counts of a campaign from its tally: one row, however large the campaign is.
    pub(crate) async fn read(
        tx: &mut SqliteConnection,
        campaign: CampaignId,
    ) -> Result<Counts, StoreError> {
        let counts: (i64, i64, i64, i64, i64) = sqlx::query_as(
            "SELECT queued, leased, committed, quarantined, succeeded FROM tally
             WHERE campaign_id = ?",
        )
        .bind(campaign)
        .fetch_one(tx)
        .await
        .doing("count a campaign's jobs")?;
        Ok(Counts {
            queued: counts.0.unsigned_abs(),
            leased: counts.1.unsigned_abs(),
            committed: counts.2.unsigned_abs(),
            quarantined: counts.3.unsigned_abs(),
            succeeded: counts.4.unsigned_abs(),
        })
    }
}

impl View {
    pub async fn campaign(&mut self, name: &CampaignName) -> Result<Campaign, QueueError> {
        match campaigns::by_name(self.tx(), name).await? {
            Some(campaign) => Ok(campaign),
            None => Err(unknown_campaign(self.tx(), name).await?),
        }
    }

    /// Returns a campaign's specification, JSON, as it was created.
    pub async fn spec(&mut self, campaign: &Campaign) -> Result<String, StoreError> {
        campaigns::spec(self.tx(), campaign.id).await
    }

    /// Returns a campaign's specification with the rows that were added since its creation; without
    /// those of a campaign with a purpose, which follow from outcomes.
    pub async fn current_spec(&mut self, campaign: &Campaign) -> Result<String, StoreError> {
        campaigns::current_spec(self.tx(), campaign.id).await
    }

    /// Returns a campaign's stop rule, and the point at which the campaign stopped; `None` without
    /// a rule.
    pub async fn early_stop(
        &mut self,
        campaign: &Campaign,
    ) -> Result<Option<EarlyStop>, StoreError> {
        stops::early_stop(self.tx(), campaign.id).await
    }

    /// Returns the status of all campaigns, oldest first.
    pub async fn statuses(&mut self) -> Result<Vec<CampaignStatus>, StoreError> {
        let live = self.able_workers().await?;
        let mut list = Vec::new();
        for campaign in campaigns::all(self.tx()).await? {
            list.push(self.status_among(campaign, &live).await?);
        }
        Ok(list)
    }

    pub async fn status(&mut self, campaign: Campaign) -> Result<CampaignStatus, StoreError> {
        let live = self.able_workers().await?;
        self.status_among(campaign, &live).await
    }

    /// Returns the workers that are alive and may lease.
    async fn able_workers(&mut self) -> Result<Vec<Live>, StoreError> {
        let since = self.now.minus(self.timing.worker_alive);
        workers::live(self.tx(), since).await
    }

    /// Returns the reason why none of these workers can run a campaign's waiting jobs, although
    /// they meet its requirements: they lack files or a simulator. `None` if there is no such reason.
    async fn means_reason(
        &mut self,
        campaign: CampaignId,
        able: &[&Live],
    ) -> Result<Option<String>, StoreError> {
        let tasks = claims::queued_tasks(self.tx(), campaign).await?;
        let is_able =
            |task: &String| able.iter().any(|worker| self.means.suffice_for(&worker.id, task));
        let Some(first) = tasks.first().filter(|_| !tasks.iter().any(is_able)) else {
            return Ok(None);
        };
        let missing = missing_means(first, tasks.len(), "every live worker");
        Ok(Some(format!("no worker suits: the campaign needs {missing}")))
    }

    async fn status_among(
        &mut self,
        campaign: Campaign,
        live: &[Live],
    ) -> Result<CampaignStatus, StoreError> {
        let now = self.now;
        let counts = Counts::read(self.tx(), campaign.id).await?;
        let rate_per_sec = match campaign.state {
            CampaignState::Running { since: resumed } => {
                rate(self.tx(), campaign.id, resumed, now).await?
            }
            CampaignState::Paused { .. }
            | CampaignState::Cancelled { .. }
            | CampaignState::Stopped { .. } => None,
        };
        let remaining = (counts.queued + counts.leased) as f64;
        let (policy_outage, policy_retry) = match &campaign.health.state {
            PolicyState::Available => (None, None),
            PolicyState::Paused { resume, reason } => {
                (Some(reason.clone()), Some(resume.since(now).as_secs_f64()))
            }
            PolicyState::Probing { reason, .. } => (Some(reason.clone()), None),
        };
        let able = live.iter().filter(|live| campaign.accepts(&live.pin));
        let able: Vec<&Live> = able.collect();
        let source = self.source(campaign.id).await?;
        let is_waiting = counts.queued > 0 && counts.leased == 0 && campaign.state.may_lease();
        let waiting_reason = match (is_waiting, &self.held, &policy_outage) {
            (false, ..) => None,
            (true, Some(reason), _) => Some(reason.clone()),
            (true, None, Some(reason)) => {
                Some(format!("policy `{}` is paused: {reason}", campaign.policy))
            }
            (true, None, None) if able.is_empty() => {
                Some(no_worker_reason(&campaign.demand(), live.first().map(|live| &live.pin)))
            }
            (true, None, None) => self.means_reason(campaign.id, &able).await?,
        };
        let is_settled = remaining == 0.0;
        let state = match campaign.state {
            CampaignState::Running { .. } if is_settled => Stage::Finished,
            CampaignState::Running { .. } => Stage::Running,
            CampaignState::Paused { .. } => Stage::Paused,
            CampaignState::Cancelled { .. } => Stage::Cancelled,
            CampaignState::Stopped { .. } => Stage::Stopped,
        };
        let fingerprints = self.fingerprints(campaign.id).await?;
        Ok(CampaignStatus {
            name: campaign.name.to_string(),
            policy: campaign.policy,
            endpoint: campaign.endpoint,
            priority: campaign.priority,
            state,
            is_finished: is_settled || state.is_over(),
            rollouts: counts,
            rate_per_sec,
            remaining_secs: rate_per_sec
                .filter(|_| waiting_reason.is_none())
                .map(|rate| remaining / rate),
            live_workers: u32::try_from(able.len()).unwrap_or(u32::MAX),
            policy_outage,
            waiting_reason,
            mixed_fingerprints: fingerprints.as_ref().map(Fingerprints::to_string),
            early_stop: stops::early_stop(self.tx(), campaign.id).await?,
            follows_from: source.map(|source| source.name.to_string()),
            created_at: campaign.created_ms,
            policy_retry_secs: policy_retry,
        })
    }
}

/// Returns committed rollouts per second over [`RATE_WINDOW`]; `None` if there were none. Rollouts
/// that began before the campaign was last resumed are excluded, since their duration includes the
/// pause.
async fn rate(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    resumed: UnixMillis,
    now: UnixMillis,
) -> Result<Option<f64>, StoreError> {
    let window = resumed.max(now.minus(RATE_WINDOW));
    let (committed, first_began): (i64, Option<i64>) = sqlx::query_as(
        "SELECT count(*), min(committed_ms - CAST(wall_secs * 1000 AS INTEGER)) FROM result
         WHERE campaign_id = ?1 AND committed_ms >= ?2
             AND committed_ms - CAST(wall_secs * 1000 AS INTEGER) >= ?3",
    )
    .bind(campaign)
    .bind(window)
    .bind(resumed)
    .fetch_one(tx)
    .await
    .doing("count recent results")?;
    let Some(first_began) = first_began else {
        return Ok(None);
    };
    let span = now.since(window.max(UnixMillis(first_began))).as_secs_f64();
    Ok((span > 0.0).then(|| committed as f64 / span))
}

fn no_worker_reason(demand: &str, live: Option<&Pin>) -> String {
    match (demand, live) {
        ("", _) => "no worker is connected; start one with `worker --connect`".to_owned(),
        (_, None) => format!("no worker is connected, and the campaign {demand}"),
        (_, Some(pin)) => {
            format!("no worker suits: the campaign {demand}; a connected worker runs on {pin}")
        }
    }
}
