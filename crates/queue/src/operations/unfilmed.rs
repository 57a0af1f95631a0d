//! Rollouts to be filmed and rollouts being filmed, kept in memory only. After a restart the
//! rollouts to be filmed are computed again; one that is still being filmed may be filmed twice,
//! with identical frames.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::clock::UnixMillis;
use crate::ids::{CampaignId, JobId};
use crate::store::films::FilmedCampaign;

/// Time after which a rollout being filmed is assigned again: rendering the longest rollout in
/// software takes a few minutes.
const FILMING_TIMEOUT: Duration = Duration::from_secs(15 * 60);
/// A scan that took less than this duration is repeated after every outcome.
const CHEAP_SCAN: Duration = Duration::from_millis(50);
/// A slower scan is repeated only after this multiple of its duration, so that scans of a large
/// campaign use at most a twentieth of a core while rollouts are committed.
const AGE_PER_COST: u32 = 20;

/// Rollouts to be filmed, by campaign.
#[derive(Debug, Default)]
pub(crate) struct UnfilmedRollouts {
    /// Held while a campaign is scanned, so that concurrent callers share the result.
    pub(super) scanning: tokio::sync::Mutex<()>,
    state: Mutex<FilmState>,
}

#[derive(Debug, Default)]
struct FilmState {
    unfilmed: BTreeMap<CampaignId, Unfilmed>,
    /// Jobs filmed since the last scan began; that scan may have missed their videos.
    filmed: BTreeSet<JobId>,
    /// Jobs being filmed, with the instant from which each may be assigned again.
    in_flight: BTreeMap<JobId, UnixMillis>,
}

/// Rollouts of a campaign that are still to be filmed.
#[derive(Debug)]
struct Unfilmed {
    campaign: FilmedCampaign,
    jobs: Vec<JobId>,
    /// Start of the scan that found the jobs.
    scanned_at: Instant,
    /// Duration of that scan.
    cost: Duration,
}

impl UnfilmedRollouts {
    /// Drops cached campaigns that are not in `campaigns`. Returns those that must be scanned.
    pub(super) fn outdated(
        &self,
        campaigns: &[FilmedCampaign],
        now: Instant,
    ) -> Vec<FilmedCampaign> {
        let mut state = self.lock();
        let is_listed = |id: &CampaignId| campaigns.iter().any(|campaign| campaign.campaign == *id);
        state.unfilmed.retain(|id, _| is_listed(id));
        let is_outdated = |campaign: &&FilmedCampaign| match state.unfilmed.get(&campaign.campaign)
        {
            Some(cached) => {
                let age = now.saturating_duration_since(cached.scanned_at);
                let is_due = cached.cost < CHEAP_SCAN || age >= cached.cost * AGE_PER_COST;
                cached.campaign != **campaign && is_due
            }
            None => true,
        };
        campaigns.iter().filter(is_outdated).cloned().collect()
    }

    /// Records that a scan starts, which sees every video stored so far.
    pub(super) fn scan_begins(&self) {
        self.lock().filmed.clear();
    }

    pub(super) fn scanned(
        &self,
        campaign: FilmedCampaign,
        mut jobs: Vec<JobId>,
        at: Instant,
        cost: Duration,
    ) {
        let mut state = self.lock();
        jobs.retain(|job| !state.filmed.contains(job));
        let id = campaign.campaign;
        let unfilmed = Unfilmed { campaign, jobs, scanned_at: at, cost };
        state.unfilmed.insert(id, unfilmed);
    }

    pub(super) fn filmed(&self, campaign: CampaignId, job: JobId) {
        let mut state = self.lock();
        state.filmed.insert(job);
        state.in_flight.remove(&job);
        if let Some(unfilmed) = state.unfilmed.get_mut(&campaign) {
            unfilmed.jobs.retain(|unfilmed_job| *unfilmed_job != job);
        }
    }

    /// Returns the first rollout of these campaigns that is to be filmed and not yet being filmed,
    /// and the number of rollouts to be filmed, including those being filmed.
    pub(super) fn assign(
        &self,
        campaigns: &[FilmedCampaign],
        now: UnixMillis,
    ) -> Option<(JobId, u64)> {
        let state = &mut *self.lock();
        state.in_flight.retain(|_, until| *until > now);
        let unfilmed = |campaign: &FilmedCampaign| state.unfilmed.get(&campaign.campaign);
        let jobs = || campaigns.iter().filter_map(unfilmed).flat_map(|rollouts| &rollouts.jobs);
        let count = jobs().count() as u64;
        let job = *jobs().find(|job| !state.in_flight.contains_key(job))?;
        state.in_flight.insert(job, now.plus(FILMING_TIMEOUT));
        Some((job, count))
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, FilmState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::CampaignName;

    fn campaign(revision: i64) -> FilmedCampaign {
        let name = CampaignName::parse("one").expect("a name");
        let (source, source_revision) = (None, None);
        FilmedCampaign { campaign: CampaignId(1), name, revision, source, source_revision }
    }

    #[test]
    fn a_campaign_is_scanned_after_new_outcomes_and_rarely_if_scans_are_slow() {
        let films = UnfilmedRollouts::default();
        let now = UnixMillis(0);
        let (began, second) = (Instant::now(), Duration::from_secs(1));
        let outdated = |revision, after: u32| {
            let at = began + second * after;
            !films.outdated(&[campaign(revision)], at).is_empty()
        };
        assert!(outdated(1, 0));
        films.scanned(campaign(1), vec![JobId(1), JobId(2)], began, Duration::ZERO);
        assert!(!outdated(1, 0));
        assert!(outdated(2, 0), "a scan that took no time is repeated at once");

        films.scan_begins();
        films.filmed(CampaignId(1), JobId(1));
        let jobs = vec![JobId(1), JobId(2), JobId(3)];
        films.scanned(campaign(2), jobs, began, second);
        let assigned = films.assign(&[campaign(2)], now);
        assert_eq!(assigned, Some((JobId(2), 2)), "the first was filmed during the scan");
        assert!(!outdated(3, 19), "a scan of a second is repeated after 20 s");
        assert!(outdated(3, 20));
        assert_eq!(films.assign(&[campaign(2)], now), Some((JobId(3), 2)));
        assert_eq!(films.assign(&[campaign(2)], now), None);
        assert!(films.outdated(&[], began).is_empty());
        assert!(outdated(2, 0), "the cached scan is dropped with its campaign");
    }
}
