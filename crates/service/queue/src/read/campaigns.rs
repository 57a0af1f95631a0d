//! Status of campaigns.

use std::time::Duration;

use rollout_types::{Fingerprints, Pin};
use sqlx::SqliteConnection;

use super::View;
use crate::clock::UnixMillis;
use crate::ids::{CampaignId, CampaignName};
use crate::operations::claim::missing_files;
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub queued: u64,
    pub leased: u64,
    pub committed: u64,
    pub quarantined: u64,
    /// Committed jobs that reached their goal.
    pub succeeded: u64,
}

#[derive(Clone, Debug)]
pub struct CampaignStatus {
    pub campaign: Campaign,
    /// Numbers of the campaign's jobs, by state.
    pub counts: Counts,
    /// Reason why the campaign's policy is paused, also while a probe tries the policy; `None` if
    /// the policy is available.
    pub policy_pause_reason: Option<String>,
    /// Time until a probe tries the paused policy again; `None` if it is not paused or a probe is
    /// running.
    pub policy_retry: Option<Duration>,
    /// Committed rollouts per second over [`RATE_WINDOW`]; `None` if there were none, or the
    /// campaign is not running.
    pub rate_per_sec: Option<f64>,
    /// Seconds that the remaining rollouts take at that rate; `None` while none can be leased.
    pub eta_secs: Option<f64>,
    /// Live workers that meet the campaign's requirements and its pin.
    pub live_workers: u32,
    /// Reason why no job is leased although jobs wait; empty if there is no such reason.
    pub waiting_reason: String,
    /// Mix of fingerprints among the campaign's results; `None` unless there are several.
    pub fingerprints: Option<Fingerprints>,
    /// Early-stopping rule, with the point at which the campaign stopped; `None` without a rule.
    pub stop: Option<EarlyStop>,
    /// Source of a derived campaign; `None` in other campaigns.
    pub source: Option<CampaignName>,
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
    /// they meet its requirements: they lack files. Empty if there is no such reason.
    async fn files_reason(
        &mut self,
        campaign: CampaignId,
        able: &[&Live],
    ) -> Result<String, StoreError> {
        let tasks = claims::queued_tasks(self.tx(), campaign).await?;
        let has_files =
            |task: &String| able.iter().any(|worker| self.lacking.has_files(&worker.id, task));
        let Some(first) = tasks.first().filter(|_| !tasks.iter().any(has_files)) else {
            return Ok(String::new());
        };
        let files = missing_files(first, tasks.len(), "every live worker");
        Ok(format!("no worker suits: the campaign needs {files}"))
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
        let policy_pause_reason = match &campaign.health.state {
            PolicyState::Available => None,
            PolicyState::Paused { reason, .. } | PolicyState::Probing { reason, .. } => {
                Some(reason.clone())
            }
        };
        let policy_retry = match &campaign.health.state {
            PolicyState::Paused { resume, .. } => Some(resume.since(now)),
            PolicyState::Available | PolicyState::Probing { .. } => None,
        };
        let able = live.iter().filter(|live| campaign.accepts(&live.pin));
        let able: Vec<&Live> = able.collect();
        let source = self.source(campaign.id).await?.map(|source| source.name);
        let is_waiting = counts.queued > 0 && counts.leased == 0 && campaign.state.may_lease();
        let waiting_reason = match (is_waiting, &self.held, &policy_pause_reason) {
            (false, ..) => String::new(),
            (true, Some(reason), _) => reason.clone(),
            (true, None, Some(reason)) => {
                format!("policy `{}` is paused: {reason}", campaign.policy)
            }
            (true, None, None) if able.is_empty() => {
                no_worker_reason(&campaign.demand(), live.first().map(|live| &live.pin))
            }
            (true, None, None) => self.files_reason(campaign.id, &able).await?,
        };
        let is_stuck = is_waiting && !waiting_reason.is_empty();
        let fingerprints = self.fingerprints(campaign.id).await?;
        let stop = stops::early_stop(self.tx(), campaign.id).await?;
        Ok(CampaignStatus {
            campaign,
            counts,
            policy_pause_reason,
            policy_retry,
            rate_per_sec,
            eta_secs: rate_per_sec.filter(|_| !is_stuck).map(|rate| remaining / rate),
            live_workers: u32::try_from(able.len()).unwrap_or(u32::MAX),
            waiting_reason,
            fingerprints,
            stop,
            source,
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
