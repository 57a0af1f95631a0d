//! Granting leases, at once or after a wait.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use sqlx::SqliteConnection;
use tokio::time::Instant;

use super::known::Known;
use super::writer::{Operation, Presence};
use super::{Queue, QueueError};
use crate::clock::UnixMillis;
use crate::ids::{Attempt, CampaignId, CampaignName, JobId, PolicyId, WorkerId};
use crate::lease::{MAX_CHARGED_ATTEMPTS, MIN_WORKERS_TO_QUARANTINE};
use crate::outage::{Allowance, PolicyState};
use crate::plan::choose_task;
use crate::store::claims::{Candidate, Claimant, LeasedJob, WaitingCampaign};
use crate::store::workers::{Pin, Standing};
use crate::store::{StoreError, campaigns, claims, policies, workers};

/// Most jobs that one claim leases.
pub const MAX_CLAIM_JOBS: u32 = 64;
/// Longest wait of a claim.
pub const MAX_CLAIM_WAIT: Duration = Duration::from_secs(30);

/// What a worker asks for.
#[derive(Clone, Debug)]
pub struct ClaimRequest {
    /// Who.
    pub worker: WorkerId,
    /// At most so many jobs; bounded by [`MAX_CLAIM_JOBS`].
    pub max_jobs: u32,
    /// The task whose scene the slot holds compiled.
    pub warm_task: Option<String>,
}

/// What a worker gets.
#[derive(Clone, Debug, Default)]
pub struct Claimed {
    /// The leases.
    pub jobs: Vec<ClaimedJob>,
    /// Without leases: why, where jobs wait that this worker cannot have.
    pub idle_reason: String,
}

/// One lease.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClaimedJob {
    /// The job.
    pub job: JobId,
    /// The attempt granted.
    pub attempt: Attempt,
    /// Its campaign.
    pub campaign: CampaignName,
    /// Which replicate.
    pub replicate: u32,
    /// One manifest row, JSON.
    pub manifest_row: String,
    /// Seed for the policy.
    pub policy_seed: u64,
    /// The policy's name at its endpoint.
    pub policy: String,
    /// The policy's endpoint.
    pub policy_endpoint: String,
    /// "matched" or "reference".
    pub realisation: String,
    /// Which rollouts are filmed: "none", "failures", "transitions" or "all".
    pub record: String,
}

/// A worker that asks for more of the scene that it holds.
struct Wanted<'a> {
    /// Which of those that ask.
    place: usize,
    worker: &'a WorkerId,
    task: &'a str,
    jobs: usize,
    /// Campaigns that it suits; the jobs are the first one's.
    waiting: Arc<Vec<WaitingCampaign>>,
}

impl Queue {
    /// Leases jobs; waits up to `wait` for the first.
    ///
    /// # Errors
    /// When the worker is unknown or must stop, while shutting down, or when
    /// the database fails.
    pub async fn claim(
        &self,
        request: &ClaimRequest,
        wait: Duration,
    ) -> Result<Claimed, QueueError> {
        let deadline = Instant::now() + wait.min(MAX_CLAIM_WAIT);
        let mut draining = self.draining.subscribe();
        let mut presence = Presence::Noted;
        loop {
            if *draining.borrow_and_update() {
                return Err(QueueError::ShuttingDown);
            }
            // Listening begins before looking: what is queued in between rings.
            let mut work = std::pin::pin!(self.work.notified());
            work.as_mut().enable();
            let request = request.clone();
            let claimed = self
                .ask(|pending| Operation::Claim(request, presence, pending))
                .await?;
            presence = Presence::Unknown;
            if !claimed.jobs.is_empty() {
                return Ok(claimed);
            }
            tokio::select! {
                () = &mut work => {}
                _ = draining.changed() => {}
                () = tokio::time::sleep_until(deadline) => return Ok(claimed),
            }
        }
    }

    /// What workers that ask at the same time can have now.
    pub(super) async fn claim_in(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        requests: &[(&ClaimRequest, Presence)],
    ) -> Result<Vec<Result<Claimed, QueueError>>, StoreError> {
        if requests.is_empty() {
            return Ok(Vec::new());
        }
        let now = self.now();
        let standings = self.standings(tx, requests, now).await?;
        let mut plain = self
            .claim_plain(tx, known, requests, &standings, now)
            .await?;
        let mut answers = Vec::with_capacity(requests.len());
        for (place, (request, _)) in requests.iter().enumerate() {
            answers.push(match may_claim(&standings, &request.worker) {
                Err(refusal) => Err(refusal),
                Ok(standing) => Ok(match plain.remove(&place) {
                    Some(claimed) => claimed,
                    None => self.claim_alone(tx, known, request, standing, now).await?,
                }),
            });
        }
        Ok(answers)
    }

    /// Who asks, and notes that they are there.
    async fn standings(
        &self,
        tx: &mut SqliteConnection,
        requests: &[(&ClaimRequest, Presence)],
        now: UnixMillis,
    ) -> Result<BTreeMap<WorkerId, Standing>, StoreError> {
        let asking: Vec<_> = requests
            .iter()
            .map(|(request, _)| &request.worker)
            .collect();
        let standings = workers::standings(tx, &asking).await?;
        let mut heard_of = Vec::new();
        for (request, presence) in requests {
            let standing = standings.get(&request.worker);
            let is_news = standing.is_some_and(|standing| standing.last_seen < now);
            if *presence == Presence::Noted && is_news {
                heard_of.push(&request.worker);
            }
        }
        if !heard_of.is_empty() {
            workers::seen(tx, &heard_of, now).await?;
        }
        Ok(standings)
    }

    /// Leases to those who ask for more of the scene that they hold, as far as
    /// the first campaign that they suit has it and nothing speaks against it,
    /// all by the same two statements. Answers by places in `requests`; whoever
    /// is missing is looked at alone.
    async fn claim_plain(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        requests: &[(&ClaimRequest, Presence)],
        standings: &BTreeMap<WorkerId, Standing>,
        now: UnixMillis,
    ) -> Result<BTreeMap<usize, Claimed>, StoreError> {
        let mut wanted: BTreeMap<CampaignId, Vec<Wanted<'_>>> = BTreeMap::new();
        for (place, (request, _)) in requests.iter().enumerate() {
            let (Ok(standing), Some(task), None) = (
                may_claim(standings, &request.worker),
                &request.warm_task,
                self.held(),
            ) else {
                continue;
            };
            let waiting = known.waiting(tx, &standing.pin).await?;
            let Some(first) = waiting.first() else {
                continue;
            };
            if first.is_pinned && first.health.allowance(now) == Allowance::Unlimited {
                wanted.entry(first.id).or_default().push(Wanted {
                    place,
                    worker: &request.worker,
                    task,
                    jobs: jobs_wanted(request) as usize,
                    waiting: waiting.clone(),
                });
            }
        }
        let mut claimed = BTreeMap::new();
        let expires = now.plus(self.timing.lease);
        for (campaign, wanted) in wanted {
            let candidates = claims::candidates(tx, campaign, &demand(&wanted), now).await?;
            let shares = share_out(wanted, candidates);
            let mut grants = Vec::new();
            for (wanted, jobs) in &shares {
                grants.extend(jobs.iter().map(|job| (*job, wanted.worker)));
            }
            let mut leased = claims::grant(tx, &grants, now, expires).await?;
            for (wanted, jobs) in shares {
                let leased = jobs.iter().filter_map(|job| leased.remove(job)).collect();
                claimed.insert(
                    wanted.place,
                    Claimed {
                        jobs: hand_out(&wanted.waiting[0], leased),
                        idle_reason: String::new(),
                    },
                );
            }
        }
        Ok(claimed)
    }

    /// What one worker can have now, whatever it asks for.
    async fn claim_alone(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        request: &ClaimRequest,
        standing: &Standing,
        now: UnixMillis,
    ) -> Result<Claimed, StoreError> {
        if let Some(idle_reason) = self.held() {
            return Ok(Claimed {
                jobs: Vec::new(),
                idle_reason,
            });
        }
        let claimant = Claimant {
            worker: &request.worker,
            pin: &standing.pin,
            able_workers: self.able_workers(tx, Some(&standing.pin), now).await?,
            now,
        };
        self.lease_from_campaigns(tx, known, request, claimant)
            .await
    }

    async fn lease_from_campaigns(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        request: &ClaimRequest,
        claimant: Claimant<'_>,
    ) -> Result<Claimed, StoreError> {
        let mut room = jobs_wanted(request);
        let mut claimed = Claimed::default();
        let mut probed: Vec<PolicyId> = Vec::new();
        for campaign in known.waiting(tx, claimant.pin).await?.iter() {
            let allowed = match campaign.health.allowance(claimant.now) {
                _ if probed.contains(&campaign.policy) => 0,
                Allowance::Unlimited => room,
                Allowance::Probe => room.min(1),
                Allowance::Nothing => 0,
            };
            let leased = self
                .lease_from(tx, campaign.id, request, claimant, allowed)
                .await?;
            let Some(first) = leased.first() else {
                continue;
            };
            if campaign.health.state != PolicyState::Available {
                let health = campaign.health.with_probe(first.id, first.attempt);
                policies::set_health(tx, campaign.policy, &health).await?;
                probed.push(campaign.policy);
                known.forget_owners();
            }
            if !campaign.is_pinned {
                campaigns::pin(tx, campaign.id, claimant.pin, claimant.now).await?;
                known.forget_owners();
            }
            room -= u32::try_from(leased.len()).unwrap_or(room).min(room);
            claimed.jobs.extend(hand_out(campaign, leased));
            if room == 0 {
                break;
            }
        }
        if claimed.jobs.is_empty() {
            claimed.idle_reason = idle_reason(tx, claimant.pin, claimant.now).await?;
        }
        Ok(claimed)
    }

    async fn lease_from(
        &self,
        tx: &mut SqliteConnection,
        campaign: CampaignId,
        request: &ClaimRequest,
        claimant: Claimant<'_>,
        limit: u32,
    ) -> Result<Vec<LeasedJob>, StoreError> {
        let expires = claimant.now.plus(self.timing.lease);
        let mut leased = Vec::new();
        while let room @ 1.. = limit.saturating_sub(u32::try_from(leased.len()).unwrap_or(limit)) {
            let tasks = claims::waiting_tasks(tx, campaign, claimant).await?;
            let Some(task) = choose_task(&tasks, request.warm_task.as_deref()) else {
                break;
            };
            leased
                .extend(claims::claim(tx, (campaign, &task.task), claimant, expires, room).await?);
        }
        Ok(leased)
    }

    /// Workers alive that run on `pin`, or on anything if there is none yet; as
    /// many as make a difference.
    pub(super) async fn able_workers(
        &self,
        tx: &mut SqliteConnection,
        pin: Option<&Pin>,
        now: UnixMillis,
    ) -> Result<u32, StoreError> {
        let since = now.minus(self.timing.worker_alive);
        workers::able(tx, pin, since, MIN_WORKERS_TO_QUARANTINE).await
    }
}

/// The standing of a worker that may lease.
fn may_claim<'a>(
    standings: &'a BTreeMap<WorkerId, Standing>,
    worker: &WorkerId,
) -> Result<&'a Standing, QueueError> {
    let standing = standings
        .get(worker)
        .ok_or_else(|| QueueError::UnknownWorker {
            worker: worker.clone(),
        })?;
    match &standing.stopped_reason {
        Some(reason) => Err(QueueError::WorkerStopped {
            worker: worker.clone(),
            reason: reason.clone(),
        }),
        None => Ok(standing),
    }
}

fn jobs_wanted(request: &ClaimRequest) -> u32 {
    request.max_jobs.clamp(1, MAX_CLAIM_JOBS)
}

/// Jobs wanted of each task.
fn demand<'a>(wanted: &[Wanted<'a>]) -> BTreeMap<&'a str, usize> {
    let mut demand = BTreeMap::new();
    for wanted in wanted {
        *demand.entry(wanted.task).or_default() += wanted.jobs;
    }
    demand
}

/// Gives everybody the next jobs of their task. Whoever would get fewer than
/// they ask for, or a job that failed so often that it matters where, gets none
/// here.
fn share_out<'a>(
    wanted: Vec<Wanted<'a>>,
    mut candidates: BTreeMap<String, VecDeque<Candidate>>,
) -> Vec<(Wanted<'a>, Vec<JobId>)> {
    let mut shares = Vec::new();
    for wanted in wanted {
        let Some(waiting) = candidates.get_mut(wanted.task) else {
            continue;
        };
        let mut next = waiting.iter().take(wanted.jobs);
        if waiting.len() >= wanted.jobs
            && next.all(|job| job.charged_attempts < MAX_CHARGED_ATTEMPTS)
        {
            let jobs = waiting.drain(..wanted.jobs).map(|job| job.id).collect();
            shares.push((wanted, jobs));
        }
    }
    shares
}

/// An asset pack, a simulator and a renderer, in words.
pub(super) fn describe(pin: &Pin) -> String {
    let digest = crate::ids::shortened(&pin.asset_pack_digest, 12);
    let mut text = format!(
        "asset pack `{}` ({digest}) with MuJoCo {}",
        pin.asset_pack, pin.mujoco_version
    );
    if !pin.renderer.is_empty() {
        text.push_str(&format!(" and renderer `{}`", pin.renderer));
    }
    text
}

fn hand_out(campaign: &WaitingCampaign, leased: Vec<LeasedJob>) -> Vec<ClaimedJob> {
    let claimed = |job: LeasedJob| ClaimedJob {
        job: job.id,
        attempt: job.attempt,
        campaign: campaign.name.clone(),
        replicate: job.replicate,
        manifest_row: job.manifest_row,
        policy_seed: job.policy_seed.cast_unsigned(),
        policy: campaign.policy_name.clone(),
        policy_endpoint: campaign.policy_endpoint.clone(),
        realisation: campaign.realisation.clone(),
        record: campaign.record.clone(),
    };
    leased.into_iter().map(claimed).collect()
}

/// Why jobs wait that this worker does not get; empty if none do.
async fn idle_reason(
    tx: &mut SqliteConnection,
    pin: &Pin,
    now: UnixMillis,
) -> Result<String, StoreError> {
    let mut reasons = Vec::new();
    for campaign in campaigns::waiting(tx).await? {
        if let Some(other) = campaign.pin().filter(|other| !other.takes(pin)) {
            reasons.push(format!(
                "campaign `{}` is pinned to {} and this worker runs on {}",
                campaign.name,
                describe(&other),
                describe(pin)
            ));
            continue;
        }
        if !campaign.state()?.may_lease() {
            reasons.push(format!("campaign `{}` is paused", campaign.name));
            continue;
        }
        let health = campaigns::policy_health(tx, campaign.id).await?;
        if let (PolicyState::Paused { reason, .. } | PolicyState::Probing { reason, .. }, true) =
            (&health.state, health.allowance(now) == Allowance::Nothing)
        {
            reasons.push(format!(
                "policy `{}` of campaign `{}` is down: {reason}",
                campaign.policy, campaign.name
            ));
        }
    }
    Ok(reasons.join("; "))
}
