//! Choice of a campaign's jobs for waiting claims.

use std::collections::BTreeSet;

use super::context::Context;
use crate::ids::{JobId, WorkerId};
use crate::rules::choice::{WaitingTask, choose_task, first_tasks};
use crate::rules::lease::MIN_MACHINES_TO_QUARANTINE;
use crate::store::StoreError;
use crate::store::campaigns::Campaign;
use crate::store::claims::{self, Grant};

/// Candidate jobs read beyond the number requested, because some waiting jobs avoid the machine
/// whose worker claims a job.
const SPARE_CANDIDATES: usize = 8;

/// A worker's request for one job.
#[derive(Clone, Debug)]
pub struct ClaimRequest {
    pub worker: WorkerId,
    /// Idempotency key chosen by the worker: a repeated claim gets the same lease.
    pub claim: String,
    /// Task whose compiled scene the slot holds.
    pub warm_task: Option<String>,
    /// Keys of tasks whose files the worker lacks.
    pub lacking_tasks: BTreeSet<String>,
}

impl ClaimRequest {
    pub(super) fn has_files_of(&self, task: &str) -> bool {
        !self.lacking_tasks.contains(task)
    }
}

/// A pending claim, to which no job is assigned yet.
pub(super) struct PendingClaim<'a> {
    /// Index of the claim among the claims of the transaction.
    pub(super) place: usize,
    pub(super) request: &'a ClaimRequest,
    /// Machine of the claiming worker.
    pub(super) machine: &'a str,
    /// Tasks of the current campaign that have no job for this claim.
    pub(super) exhausted: BTreeSet<String>,
}

impl Context<'_> {
    /// Assigns up to `room` jobs of a campaign to claims: each claim gets a job of its warm task
    /// or, if that task has no job left, of the task with the fewest leases. Removes served claims
    /// from `pending`. Returns the grants with the indices of their claims.
    pub(super) async fn choose(
        &mut self,
        campaign: &Campaign,
        pending: &mut Vec<PendingClaim<'_>>,
        room: usize,
    ) -> Result<Vec<(usize, Grant)>, StoreError> {
        // With enough machines, a job that failed too often avoids the machines of its failures.
        let avoids_failed_machine =
            self.able_machines(campaign).await?.len() >= MIN_MACHINES_TO_QUARANTINE;
        let mut grants: Vec<(usize, Grant)> = Vec::new();
        let mut taken: BTreeSet<JobId> = BTreeSet::new();
        let mut tasks: Option<Vec<WaitingTask>> = None;
        for claim in pending.iter_mut() {
            claim.exhausted.clone_from(&claim.request.lacking_tasks);
        }
        while grants.len() < room && !pending.is_empty() {
            let is_warm = |claim: &PendingClaim<'_>| claim.warm().is_some();
            if tasks.is_none() && !pending.iter().all(is_warm) {
                tasks = Some(claims::waiting_tasks(&mut self.tx, campaign.id, self.now).await?);
            }
            let mut chosen: Vec<Option<String>> = Vec::with_capacity(pending.len());
            let mut open = room - grants.len();
            for claim in pending.iter() {
                let tasks = tasks.as_deref_mut().unwrap_or_default();
                let task = (open > 0).then(|| claim.choose(tasks)).flatten();
                open -= usize::from(task.is_some());
                chosen.push(task);
            }
            let demand: BTreeSet<&str> = chosen.iter().flatten().map(String::as_str).collect();
            if demand.is_empty() {
                break;
            }
            let limit = chosen.len() + taken.len() + SPARE_CANDIDATES;
            let demand = demand.into_iter();
            let mut candidates =
                claims::candidates(&mut self.tx, campaign.id, demand, limit, self.now).await?;
            let mut unserved = Vec::new();
            for (place, mut claim) in pending.drain(..).enumerate() {
                let Some(Some(task)) = chosen.get(place) else {
                    unserved.push(claim);
                    continue;
                };
                let suits = |job: &claims::Candidate| {
                    !(taken.contains(&job.id)
                        || avoids_failed_machine && job.has_failed_on(claim.machine))
                };
                let waiting = candidates.get_mut(task);
                let job = waiting.and_then(|jobs| {
                    let at = jobs.iter().position(suits)?;
                    jobs.remove(at)
                });
                let Some(job) = job else {
                    claim.exhausted.insert(task.clone());
                    unserved.push(claim);
                    continue;
                };
                taken.insert(job.id);
                grants.push((claim.place, self.grant(job.id, claim.request)));
            }
            *pending = unserved;
        }
        Ok(grants)
    }

    /// Assigns up to `room` jobs of a campaign that may stop early, in its random order, regardless
    /// of the scenes that the slots hold. The stop rule uses only the outcomes before the first gap
    /// in that order, so the result of a job after a gap may be wasted.
    pub(super) async fn choose_in_order(
        &mut self,
        campaign: &Campaign,
        pending: &mut Vec<PendingClaim<'_>>,
        room: usize,
    ) -> Result<Vec<(usize, Grant)>, StoreError> {
        // With enough machines, a job that failed too often avoids the machines of its failures.
        let avoids_failed_machine =
            self.able_machines(campaign).await?.len() >= MIN_MACHINES_TO_QUARANTINE;
        let limit = room.min(pending.len()) + SPARE_CANDIDATES;
        let mut tasks = claims::waiting_tasks(&mut self.tx, campaign.id, self.now).await?;
        let is_runnable = |task: &str| pending.iter().any(|claim| claim.request.has_files_of(task));
        tasks.retain(|waiting| is_runnable(&waiting.task));
        let tasks = first_tasks(tasks, limit);
        let tasks = tasks.iter().map(String::as_str);
        let candidates =
            claims::candidates(&mut self.tx, campaign.id, tasks, limit, self.now).await?;
        let candidates = candidates.into_iter();
        let mut candidates: Vec<_> = candidates
            .flat_map(|(task, jobs)| jobs.into_iter().map(move |job| (task.clone(), job)))
            .collect();
        candidates.sort_by_key(|(_, job)| job.unit_order);
        let mut grants: Vec<(usize, Grant)> = Vec::new();
        let mut unserved = Vec::new();
        for claim in pending.drain(..) {
            let request = claim.request;
            let suits = |(task, job): &(String, claims::Candidate)| {
                request.has_files_of(task)
                    && !(avoids_failed_machine && job.has_failed_on(claim.machine))
            };
            let found = match grants.len() < room {
                true => candidates.iter().position(suits),
                false => None,
            };
            let Some(found) = found else {
                unserved.push(claim);
                continue;
            };
            let (_, job) = candidates.remove(found);
            grants.push((claim.place, self.grant(job.id, request)));
        }
        *pending = unserved;
        Ok(grants)
    }

    /// Assigns a job that must run alone to one of the claims. Returns the index of the claim, the
    /// grant, and the reason why the job runs alone; `None` if no such job suits any of the claims.
    pub(super) async fn choose_lone(
        &mut self,
        campaign: &Campaign,
        pending: &mut Vec<PendingClaim<'_>>,
    ) -> Result<Option<(usize, Grant, String)>, StoreError> {
        // With enough machines, a job that failed too often avoids the machines of its failures.
        let avoids_failed_machine =
            self.able_machines(campaign).await?.len() >= MIN_MACHINES_TO_QUARANTINE;
        let waiting = claims::lone(&mut self.tx, campaign.id, SPARE_CANDIDATES, self.now).await?;
        for (at, claim) in pending.iter().enumerate() {
            let suits = |lone: &&claims::LoneJob| {
                claim.request.has_files_of(&lone.task)
                    && !(avoids_failed_machine && lone.job.has_failed_on(claim.machine))
            };
            let Some(chosen) = waiting.iter().find(suits) else {
                continue;
            };
            let reason = format!(
                "rollout `{}` runs alone, because {} of its attempts lost the policy",
                chosen.rollout_id, chosen.losses
            );
            let granted = (claim.place, self.grant(chosen.job.id, claim.request), reason);
            pending.remove(at);
            return Ok(Some(granted));
        }
        Ok(None)
    }

    fn grant(&self, job: JobId, to: &ClaimRequest) -> Grant {
        Grant {
            job: job.0,
            worker: to.worker.0.clone(),
            attempt: self.shared.new_attempt(),
            claim: to.claim.clone(),
        }
    }
}

impl PendingClaim<'_> {
    /// Returns the task whose scene the slot holds, unless that task is exhausted.
    fn warm(&self) -> Option<&str> {
        let warm = self.request.warm_task.as_deref();
        warm.filter(|task| !self.exhausted.contains(*task))
    }

    /// Returns the task to serve this claim from: its warm task, or else the task that
    /// [`choose_task`] chooses, whose number of leases is then incremented.
    fn choose(&self, tasks: &mut [WaitingTask]) -> Option<String> {
        if let Some(warm) = self.warm() {
            return Some(warm.to_owned());
        }
        let is_open = |task: &&WaitingTask| !self.exhausted.contains(&task.task);
        let open: Vec<WaitingTask> = tasks.iter().filter(is_open).cloned().collect();
        let chosen = choose_task(&open)?.task.clone();
        let counted = tasks.iter_mut().find(|task| task.task == chosen);
        counted.into_iter().for_each(|task| task.leased += 1);
        Some(chosen)
    }
}
