//! Granting of leases. All claims that arrive together are served by the same statements: a
//! repeated claim gets its earlier lease, and a new claim a waiting job.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use benchmark::TaskKey;
use benchmark::attempt::{AttemptId, Pin};

use super::choose::{Avoided, PendingClaim};
use super::context::Context;
use super::error::QueueError;
use crate::ids::{AttemptNumber, CampaignId, CampaignName, JobId, PolicyId, WorkerId};
use crate::rules::choice::{WaitingCampaign, choose_campaign};
use crate::rules::outage::{Allowance, PolicyState};
use crate::store::campaigns::Campaign;
use crate::store::claims::{self, Grant, LeasedJob, Term};
use crate::store::workers::Standing;
use crate::store::{StoreError, policies, workers};

pub use super::choose::{ClaimRequest, Means};

/// Longest time that a claim waits for a job.
pub const MAX_CLAIM_WAIT: Duration = Duration::from_secs(30);

#[derive(Clone, Debug, Default)]
pub struct Claimed {
    /// The leased job; `None` if no lease was granted.
    pub job: Option<Assigned>,
    /// Reasons why waiting jobs cannot go to this worker; empty if a lease was granted or there is
    /// no such reason.
    pub idle_reason: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assigned {
    pub attempt: AttemptId,
    pub job: JobId,
    /// Number of the attempt within the job, from 1.
    pub number: AttemptNumber,
    pub campaign: CampaignName,
    pub replicate: u32,
    /// Manifest row, JSON.
    pub manifest_row: String,
    pub policy_seed: u64,
    /// The policy's name at its endpoint.
    pub policy: String,
    pub policy_endpoint: String,
    pub realisation: String,
    /// Execution model, as text.
    pub execution: String,
    /// Name of the rollouts to be filmed.
    pub record: String,
}

impl Context<'_> {
    /// Answers claims that arrive at the same time. The flag of a request is true for a new claim,
    /// and false for a waiting claim that was woken, which does not show that its worker is alive.
    pub(super) async fn claim(
        &mut self,
        requests: &[(&ClaimRequest, bool)],
    ) -> Result<Vec<Result<Claimed, QueueError>>, StoreError> {
        if requests.is_empty() {
            return Ok(Vec::new());
        }
        let standings = self.standings(requests).await?;
        let repeated = self.repeated(requests).await?;
        let mut answers = Vec::with_capacity(requests.len());
        let mut pending: Vec<(Pin, Vec<PendingClaim<'_>>)> = Vec::new();
        for (place, (request, _)) in requests.iter().enumerate() {
            let standing = match may_claim(&standings, &request.worker) {
                Ok(standing) => standing,
                Err(refusal) => {
                    answers.push(Err(refusal));
                    continue;
                }
            };
            let mut claimed = Claimed::default();
            let earlier = repeated.get(request.claim.as_str());
            if let Some(job) = earlier.filter(|job| job.lease_owner == request.worker) {
                let campaign = self.campaign(job.campaign_id).await?;
                claimed.job = Some(assigned(&campaign, job.clone()));
            } else if let Some(reason) = self.shared.held() {
                claimed.idle_reason = reason;
            } else {
                let claim = PendingClaim {
                    place,
                    request,
                    machine: &standing.machine,
                    exhausted: BTreeSet::new(),
                };
                match pending.iter_mut().find(|(pin, _)| *pin == standing.pin) {
                    Some((_, same_pin)) => same_pin.push(claim),
                    None => pending.push((standing.pin.clone(), vec![claim])),
                }
            }
            answers.push(Ok(claimed));
        }
        for (pin, mut pending) in pending {
            for (place, assigned) in self.lease_to(&pin, &mut pending).await? {
                answers[place] = Ok(Claimed { job: Some(assigned), idle_reason: String::new() });
            }
            if pending.is_empty() {
                continue;
            }
            let idle_reason = self.idle_reason(&pin).await?;
            let unserved = self.unserved(&pin).await?;
            for claim in pending {
                let reasons = unserved.iter().filter_map(|unserved| unserved.reason(&claim));
                let reasons = Some(idle_reason.clone()).into_iter().chain(reasons);
                let reasons: Vec<String> = reasons.filter(|reason| !reason.is_empty()).collect();
                answers[claim.place] = Ok(Claimed { job: None, idle_reason: reasons.join("; ") });
            }
        }
        Ok(answers)
    }

    /// Returns the standings of the claiming workers, and records new claims as signs of life, and
    /// the tasks that the workers can run.
    async fn standings(
        &mut self,
        requests: &[(&ClaimRequest, bool)],
    ) -> Result<BTreeMap<WorkerId, Standing>, StoreError> {
        let claiming: Vec<_> = requests.iter().map(|(request, _)| &request.worker).collect();
        let standings = workers::standings(&mut self.tx, &claiming).await?;
        let new = requests.iter().filter(|(_, is_new)| *is_new).map(|(request, _)| *request);
        let new: Vec<&ClaimRequest> = new.collect();
        if !new.is_empty() {
            let workers: Vec<_> = new.iter().map(|request| &request.worker).collect();
            workers::record_calls(&mut self.tx, &workers, self.now).await?;
        }
        let known = new.into_iter().filter(|request| standings.contains_key(&request.worker));
        let record =
            |request: &ClaimRequest| self.shared.means.record(&request.worker, &request.means);
        if known.map(record).fold(false, |has_changed, record| has_changed | record) {
            // A job that was left to one of these workers may suit others now.
            self.shared.work.notify_waiters();
        }
        Ok(standings)
    }

    async fn repeated(
        &mut self,
        requests: &[(&ClaimRequest, bool)],
    ) -> Result<BTreeMap<String, LeasedJob>, StoreError> {
        let claims = requests.iter().map(|(request, _)| request.claim.as_str());
        let claims: Vec<&str> = claims.collect();
        let leases = claims::repeated(&mut self.tx, &claims).await?;
        let by_claim = leases.into_iter().map(|job| (job.claim_id.clone(), job));
        Ok(by_claim.collect())
    }

    /// Grants leases to workers with the pin `pin`, in the order of `choose_campaign`. Removes
    /// served claims from `pending`.
    async fn lease_to(
        &mut self,
        pin: &Pin,
        pending: &mut Vec<PendingClaim<'_>>,
    ) -> Result<Vec<(usize, Assigned)>, StoreError> {
        let mut assigned = Vec::new();
        // Campaigns with no more jobs for the remaining claims.
        let mut done: BTreeSet<CampaignId> = BTreeSet::new();
        let mut leased: Option<BTreeMap<CampaignId, u32>> = None;
        while !pending.is_empty() {
            // Reads the campaigns again after every grant: the granted lease may be the probe of a
            // paused policy, and the policy's other campaigns wait until the probe ends.
            let waiting = self.cache.waiting(&mut self.tx).await?;
            let now = self.now;
            let suits = |campaign: &&Campaign| {
                campaign.state.may_lease()
                    && campaign.accepts(pin)
                    && !done.contains(&campaign.id)
                    && campaign.health.allowance(now) != Allowance::Nothing
            };
            let suitable: Vec<&Campaign> = waiting.iter().filter(suits).collect();
            if suitable.len() > 1 && leased.is_none() {
                leased = Some(claims::leases(&mut self.tx).await?);
            }
            let to_choice = |campaign: &&Campaign| WaitingCampaign {
                id: campaign.id,
                priority: campaign.priority,
                leased: leased.iter().filter_map(|all| all.get(&campaign.id)).sum(),
                last_turn: self.cache.last_turn(campaign.id),
            };
            let choices: Vec<WaitingCampaign> = suitable.iter().map(to_choice).collect();
            let Some((chosen, share)) = choose_campaign(&choices, pending.len()) else {
                break;
            };
            let Some(campaign) = suitable.into_iter().find(|candidate| candidate.id == chosen)
            else {
                break;
            };
            let room = match campaign.health.allowance(now) {
                Allowance::Unlimited => share,
                Allowance::Probe => 1,
                Allowance::Nothing => 0,
            };
            let granted = self.lease_from(campaign, pending, room).await?;
            if granted.len() < room {
                done.insert(chosen);
            }
            if !granted.is_empty() {
                self.cache.count_turn(chosen);
            }
            if let Some(leased) = &mut leased {
                let more = u32::try_from(granted.len()).unwrap_or(u32::MAX);
                *leased.entry(chosen).or_default() += more;
            }
            assigned.extend(granted);
        }
        assigned.extend(self.lease_alone_to(pin, pending).await?);
        Ok(assigned)
    }

    /// Leases jobs whose policy has repeatedly failed during their attempts, each as the policy's
    /// only lease. Removes served claims from `pending`.
    async fn lease_alone_to(
        &mut self,
        pin: &Pin,
        pending: &mut Vec<PendingClaim<'_>>,
    ) -> Result<Vec<(usize, Assigned)>, StoreError> {
        let mut assigned = Vec::new();
        if pending.is_empty() {
            return Ok(assigned);
        }
        let lone = claims::lone_tasks(&mut self.tx).await?;
        if lone.is_empty() {
            return Ok(assigned);
        }
        let waiting = self.cache.waiting(&mut self.tx).await?;
        let mut tried: BTreeSet<PolicyId> = BTreeSet::new();
        for campaign in waiting.iter() {
            let tasks = lone.iter().filter(|(id, _)| *id == campaign.id);
            let tasks: Vec<&str> = tasks.map(|(_, task)| task.as_str()).collect();
            let may_lease = !(pending.is_empty() || tasks.is_empty())
                && campaign.state.may_lease()
                && campaign.accepts(pin)
                && campaign.health.allowance(self.now) != Allowance::Nothing
                && !tried.contains(&campaign.policy_id);
            if !may_lease || !policies::is_idle(&mut self.tx, campaign.policy_id).await? {
                continue;
            }
            let chosen = self.choose_lone(campaign, &tasks, pending).await?;
            if let Some((place, grant, reason)) = chosen {
                tried.insert(campaign.policy_id);
                tracing::info!("policy `{}`: {reason}", campaign.policy);
                let probing = campaign.health.with_lone_probe(grant.attempt, reason);
                policies::set_health(&mut self.tx, campaign.policy_id, &probing).await?;
                self.cache.clear_campaigns();
                assigned.extend(self.lease_jobs(campaign, vec![(place, grant)]).await?);
            }
        }
        Ok(assigned)
    }

    async fn lease_from(
        &mut self,
        campaign: &Campaign,
        pending: &mut Vec<PendingClaim<'_>>,
        room: usize,
    ) -> Result<Vec<(usize, Assigned)>, StoreError> {
        let grants = match campaign.is_drawn {
            true => self.choose_in_order(campaign, pending, room).await?,
            false => self.choose(campaign, pending, room).await?,
        };
        let Some((_, first)) = grants.first() else {
            return Ok(Vec::new());
        };
        if campaign.health.state != PolicyState::Available {
            let probing = campaign.health.with_probe(first.attempt);
            policies::set_health(&mut self.tx, campaign.policy_id, &probing).await?;
            self.cache.clear_campaigns();
        }
        self.lease_jobs(campaign, grants).await
    }

    async fn lease_jobs(
        &mut self,
        campaign: &Campaign,
        grants: Vec<(usize, Grant)>,
    ) -> Result<Vec<(usize, Assigned)>, StoreError> {
        let timing = self.shared.timing;
        let per_step = timing.ceiling_per_step.as_millis();
        let term = Term {
            granted: self.now,
            expires: self.now.plus(timing.lease),
            ceiling_per_step_ms: i64::try_from(per_step).unwrap_or(i64::MAX),
        };
        let (places, grants): (Vec<usize>, Vec<Grant>) = grants.into_iter().unzip();
        let leased = claims::grant(&mut self.tx, &grants, term).await?;
        let mut leased: BTreeMap<JobId, LeasedJob> =
            leased.into_iter().map(|job| (job.id, job)).collect();
        let assignments = places.into_iter().zip(&grants).filter_map(|(place, grant)| {
            let job = leased.remove(&JobId(grant.job))?;
            Some((place, assigned(campaign, job)))
        });
        Ok(assignments.collect())
    }

    /// Returns the reasons why campaigns with waiting jobs do not lease to a worker with this pin;
    /// empty if there are none.
    pub(super) async fn idle_reason(&mut self, pin: &Pin) -> Result<String, StoreError> {
        let mut reasons = Vec::new();
        for campaign in self.cache.waiting(&mut self.tx).await?.iter() {
            let name = &campaign.name;
            if !campaign.accepts(pin) {
                let demand = campaign.demand();
                reasons.push(format!("campaign `{name}` {demand} and this worker runs on {pin}"));
            } else if !campaign.state.may_lease() {
                reasons.push(format!("campaign `{name}` is paused"));
            } else if let (
                PolicyState::Paused { reason, .. } | PolicyState::Probing { reason, .. },
                true,
            ) =
                (&campaign.health.state, campaign.health.allowance(self.now) == Allowance::Nothing)
            {
                let policy = &campaign.policy;
                reasons.push(format!("policy `{policy}` of campaign `{name}` is paused: {reason}"));
            }
        }
        Ok(reasons.join("; "))
    }

    /// Returns the campaigns that may lease to workers of a pin, with those of their waiting tasks
    /// that claims may not be served from.
    async fn unserved(&mut self, pin: &Pin) -> Result<Vec<Unserved>, StoreError> {
        let mut unserved = Vec::new();
        for campaign in self.cache.waiting(&mut self.tx).await?.iter() {
            let may_lease = campaign.accepts(pin)
                && campaign.state.may_lease()
                && campaign.health.allowance(self.now) != Allowance::Nothing;
            if !may_lease {
                continue;
            }
            let avoided = self.avoided(campaign).await?;
            let tasks = claims::waiting_tasks(&mut self.tx, campaign.id, self.now).await?;
            let tasks = tasks.into_iter().map(|waiting| waiting.task).collect();
            unserved.push(Unserved { campaign: campaign.name.clone(), tasks, avoided });
        }
        Ok(unserved)
    }
}

/// A campaign with waiting tasks that claims may not be served from.
struct Unserved {
    campaign: CampaignName,
    tasks: Vec<String>,
    avoided: Avoided,
}

impl Unserved {
    /// Returns the reason why no task suits a claim; `None` if there is no such reason.
    fn reason(&self, claim: &PendingClaim<'_>) -> Option<String> {
        let Unserved { campaign, tasks, avoided } = self;
        let first = tasks.first()?;
        let can_run = |task: &&String| claim.request.means.suffice_for(task);
        let mut runnable = tasks.iter().filter(can_run).peekable();
        if runnable.peek().is_none() {
            let missing = missing_means(first, tasks.len(), "this worker");
            return Some(format!("campaign `{campaign}` needs {missing}"));
        }
        runnable.all(|task| avoided.contains(task, claim.machine)).then(|| {
            format!(
                "the waiting rollouts of campaign `{campaign}` have failed on this machine and are \
                 left to another one"
            )
        })
    }
}

/// Describes the files or the simulator that workers (`who`) lack for each of a number of tasks, by
/// the example of the first task.
pub(crate) fn missing_means(first: &str, tasks: usize, who: &str) -> String {
    if let Some(name) = TaskKey::simulator_of(first) {
        return format!(
            "simulator `{name}`, which {who} lacks; start a worker with `--simulator \
             {name}=COMMAND`, whose log says whether it can be used"
        );
    }
    let others = match tasks {
        1 => "",
        _ => " and others",
    };
    match TaskKey::files_of(first) {
        Some(benchmark) => format!(
            "task files that {who} lacks; run `{}` on the worker's machine",
            benchmark.fetch_command()
        ),
        None if first.contains('+') => format!(
            "task files that {who} lacks or has in another version, for task {first}{others}; the \
             worker's log names the files"
        ),
        None => format!("assets that {who} lacks, for task {first}{others}"),
    }
}

/// Returns the standing of a worker, or the error if the worker may not lease.
fn may_claim<'a>(
    standings: &'a BTreeMap<WorkerId, Standing>,
    worker: &WorkerId,
) -> Result<&'a Standing, QueueError> {
    let standing = standings
        .get(worker)
        .ok_or_else(|| QueueError::UnknownWorker { worker: worker.clone() })?;
    match &standing.stopped_reason {
        Some(reason) => {
            Err(QueueError::WorkerStopped { worker: worker.clone(), reason: reason.clone() })
        }
        None => Ok(standing),
    }
}

fn assigned(campaign: &Campaign, job: LeasedJob) -> Assigned {
    Assigned {
        attempt: job.attempt_id.0,
        job: job.id,
        number: job.attempt,
        campaign: campaign.name.clone(),
        replicate: job.replicate,
        manifest_row: job.manifest_row,
        policy_seed: job.policy_seed.cast_unsigned(),
        policy: campaign.policy.clone(),
        policy_endpoint: campaign.endpoint.clone(),
        realisation: campaign.realisation.clone(),
        execution: campaign.execution.clone(),
        record: campaign.record.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_files_are_described_by_a_task_and_whether_others_wait() {
        let tasks = ["goal/3", "goal/4"].map(str::to_owned);
        let mut request = ClaimRequest {
            worker: WorkerId("a".to_owned()),
            claim: String::new(),
            warm_task: None,
            means: Means { lacking_tasks: tasks.clone().into(), ..Means::default() },
        };
        let reason = |tasks: &[String], request: &ClaimRequest| {
            let campaign = CampaignName::parse("c").expect("a name");
            let avoided = Avoided::default();
            let unserved = Unserved { campaign, tasks: tasks.to_vec(), avoided };
            let exhausted = BTreeSet::new();
            unserved.reason(&PendingClaim { place: 0, request, machine: "m", exhausted })
        };
        let one = "campaign `c` needs assets that this worker lacks, for task goal/3";
        assert_eq!(reason(&tasks[..1], &request).as_deref(), Some(one));
        let several = format!("{one} and others");
        assert_eq!(reason(&tasks, &request), Some(several));
        request.means.lacking_tasks.remove(&tasks[1]);
        assert_eq!(reason(&tasks, &request), None);
        let simulated = ["simulated/metaworld/reach-v3".to_owned()];
        let missing = reason(&simulated, &request).expect("a reason");
        assert!(missing.contains("`--simulator metaworld=COMMAND`"), "{missing}");
        request.means.simulators.insert("metaworld".to_owned());
        assert_eq!(reason(&simulated, &request), None);
    }
}
