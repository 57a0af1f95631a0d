//! Choice of a campaign's jobs for waiting claims.

use std::collections::BTreeSet;

use benchmark::TaskKey;

use super::context::Context;
use crate::ids::{JobId, WorkerId};
use crate::rules::choice::{WaitingTask, choose_task};
use crate::store::StoreError;
use crate::store::campaigns::Campaign;
use crate::store::claims::{self, Asked, Grant};

/// A worker's request for one job.
#[derive(Clone, Debug)]
pub struct ClaimRequest {
    pub worker: WorkerId,
    /// Idempotency key chosen by the worker: a repeated claim gets the same lease.
    pub claim: String,
    /// Task whose compiled scene the slot holds.
    pub warm_task: Option<String>,
    pub means: Means,
}

/// Tasks that a worker can run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Means {
    /// Keys of tasks whose files the worker lacks.
    pub lacking_tasks: BTreeSet<String>,
    /// Simulators that the worker serves beside the one of its slots.
    pub simulators: BTreeSet<String>,
}

impl Means {
    pub(crate) fn suffice_for(&self, task: &str) -> bool {
        let serves = |name| self.simulators.contains(name);
        !self.lacking_tasks.contains(task) && TaskKey::simulator_of(task).is_none_or(serves)
    }
}

/// A pending claim, to which no job is assigned yet.
pub(super) struct PendingClaim<'a> {
    /// Index of the claim among the claims of the transaction.
    pub(super) place: usize,
    pub(super) request: &'a ClaimRequest,
    pub(super) machine: &'a str,
    /// Tasks of the current campaign that have no job for this claim.
    pub(super) exhausted: BTreeSet<String>,
}

/// Tasks and machines such that waiting jobs of the task have failed too often on the machine and
/// are left to the other able machines.
#[derive(Debug, Default)]
pub(super) struct Avoided(BTreeSet<(String, String)>);

impl Avoided {
    pub(super) fn contains(&self, task: &str, machine: &str) -> bool {
        self.0.contains(&(task.to_owned(), machine.to_owned()))
    }

    /// Returns what to ask for to serve a machine from a task.
    fn ask(&self, task: &str, machine: &str) -> Asked {
        let avoids = self.contains(task, machine);
        (task.to_owned(), avoids.then(|| machine.to_owned()))
    }
}

impl Context<'_> {
    /// Returns the tasks and machines for which jobs of the campaign are left to other machines:
    /// another able machine exists, so that failures on this one alone quarantine nothing.
    pub(super) async fn avoided(&mut self, campaign: &Campaign) -> Result<Avoided, StoreError> {
        let mut avoided = BTreeSet::new();
        for (task, machine) in claims::failing(&mut self.tx, campaign.id).await? {
            let able = self.able_machines(campaign, &task).await?;
            if able.iter().any(|able| *able != machine) {
                avoided.insert((task, machine));
            }
        }
        Ok(Avoided(avoided))
    }

    /// Assigns up to `room` jobs of a campaign to claims: each claim gets a job of its warm task
    /// or, if that task has no job left, of the task with the fewest leases. Removes served claims
    /// from `pending`. Returns the grants with the indices of their claims.
    pub(super) async fn choose(
        &mut self,
        campaign: &Campaign,
        pending: &mut Vec<PendingClaim<'_>>,
        room: usize,
    ) -> Result<Vec<(usize, Grant)>, StoreError> {
        let avoided = self.avoided(campaign).await?;
        let mut grants: Vec<(usize, Grant)> = Vec::new();
        let mut taken: BTreeSet<JobId> = BTreeSet::new();
        let mut tasks: Option<Vec<WaitingTask>> = None;
        for claim in pending.iter_mut() {
            claim.exhausted.clear();
        }
        while grants.len() < room && !pending.is_empty() {
            let is_warm = |claim: &PendingClaim<'_>| claim.warm().is_some();
            if tasks.is_none() && !pending.iter().all(is_warm) {
                tasks = Some(claims::waiting_tasks(&mut self.tx, campaign.id, self.now).await?);
            }
            let mut chosen: Vec<Option<Asked>> = Vec::with_capacity(pending.len());
            let mut open = room - grants.len();
            for claim in pending.iter() {
                let tasks = tasks.as_deref_mut().unwrap_or_default();
                let task = (open > 0).then(|| claim.choose(tasks)).flatten();
                open -= usize::from(task.is_some());
                chosen.push(task.map(|task| avoided.ask(&task, claim.machine)));
            }
            let demand: BTreeSet<Asked> = chosen.iter().flatten().cloned().collect();
            if demand.is_empty() {
                break;
            }
            let limit = chosen.len() + taken.len();
            let mut candidates =
                claims::candidates(&mut self.tx, campaign.id, &demand, limit, self.now).await?;
            let mut unserved = Vec::new();
            for (mut claim, asked) in pending.drain(..).zip(chosen) {
                let Some(asked) = asked else {
                    unserved.push(claim);
                    continue;
                };
                let waiting = candidates.get_mut(&asked).into_iter();
                let mut waiting = waiting.flat_map(|jobs| std::iter::from_fn(|| jobs.pop_front()));
                let Some(job) = waiting.find(|job| taken.insert(job.id)) else {
                    claim.exhausted.insert(asked.0);
                    unserved.push(claim);
                    continue;
                };
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
        let avoided = self.avoided(campaign).await?;
        let tasks = claims::waiting_tasks(&mut self.tx, campaign.id, self.now).await?;
        let asked_by = |claim: &PendingClaim<'_>| -> Vec<Asked> {
            let tasks = tasks.iter().map(|waiting| waiting.task.as_str());
            let runnable = tasks.filter(|task| claim.request.means.suffice_for(task));
            runnable.map(|task| avoided.ask(task, claim.machine)).collect()
        };
        let demand: BTreeSet<Asked> = pending.iter().flat_map(asked_by).collect();
        let limit = room.min(pending.len());
        let candidates =
            claims::candidates(&mut self.tx, campaign.id, &demand, limit, self.now).await?;
        let mut taken: BTreeSet<JobId> = BTreeSet::new();
        let mut grants: Vec<(usize, Grant)> = Vec::new();
        let mut unserved = Vec::new();
        for claim in pending.drain(..) {
            let asked = asked_by(&claim);
            let lists = asked.iter().filter_map(|asked| candidates.get(asked));
            let open = lists.filter_map(|jobs| jobs.iter().find(|job| !taken.contains(&job.id)));
            match open.min_by_key(|job| job.unit_order) {
                Some(job) if grants.len() < room => {
                    taken.insert(job.id);
                    grants.push((claim.place, self.grant(job.id, claim.request)));
                }
                _ => unserved.push(claim),
            }
        }
        *pending = unserved;
        Ok(grants)
    }

    /// Assigns a job of these tasks that must run alone to one of the claims. Returns the index of
    /// the claim, the grant, and the reason why the job runs alone; `None` if no such job suits any
    /// of the claims.
    pub(super) async fn choose_lone(
        &mut self,
        campaign: &Campaign,
        tasks: &[&str],
        pending: &mut Vec<PendingClaim<'_>>,
    ) -> Result<Option<(usize, Grant, String)>, StoreError> {
        let avoided = self.avoided(campaign).await?;
        let mut asked = Vec::new();
        for (place, claim) in pending.iter().enumerate() {
            let runnable = tasks.iter().filter(|task| claim.request.means.suffice_for(task));
            asked.extend(runnable.map(|task| {
                let avoids = avoided.contains(task, claim.machine);
                (*task, avoids.then_some(claim.machine), place)
            }));
        }
        let Some(chosen) = claims::lone(&mut self.tx, campaign.id, &asked, self.now).await? else {
            return Ok(None);
        };
        let claim = pending.remove(chosen.place as usize);
        let reason = format!(
            "rollout `{}` runs alone, because {} of its attempts lost the policy",
            chosen.rollout_id, chosen.losses
        );
        Ok(Some((claim.place, self.grant(chosen.id, claim.request), reason)))
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
        warm.filter(|task| self.is_open(task))
    }

    fn is_open(&self, task: &str) -> bool {
        !self.exhausted.contains(task) && self.request.means.suffice_for(task)
    }

    /// Returns the task to serve this claim from: its warm task, or else the task that
    /// [`choose_task`] chooses, whose number of leases is then incremented.
    fn choose(&self, tasks: &mut [WaitingTask]) -> Option<String> {
        if let Some(warm) = self.warm() {
            return Some(warm.to_owned());
        }
        let is_open = |task: &&WaitingTask| self.is_open(&task.task);
        let open: Vec<WaitingTask> = tasks.iter().filter(is_open).cloned().collect();
        let chosen = choose_task(&open)?.task.clone();
        let counted = tasks.iter_mut().find(|task| task.task == chosen);
        counted.into_iter().for_each(|task| task.leased += 1);
        Some(chosen)
    }
}
