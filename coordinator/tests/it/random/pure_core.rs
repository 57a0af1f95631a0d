//! The pure core with a table in memory in place of the store.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use coordinator::campaign::{CampaignState, Change};
use coordinator::clock::UnixMillis;
use coordinator::ids::{Attempt, JobId, LeaseRef, WorkerId};
use coordinator::lease::{
    AfterFailure, CommitJudgement, FailureReason, Job, JobState, MAX_CHARGED_ATTEMPTS, OutcomeKey,
    Suspicion, may_retry, strike,
};
use coordinator::outage::{Allowance, PolicyHealth, PolicyState};
use coordinator::plan::{Decision, ExpiredLease, SweepState, plan};
use proptest::prelude::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::{Event, JOBS, WORKERS, event};

const LEASE: Duration = Duration::from_secs(30);

struct World {
    now: UnixMillis,
    last_sweep: UnixMillis,
    rng: ChaCha8Rng,
    campaign: CampaignState,
    jobs: Vec<Job>,
    policy: PolicyHealth,
    granted: Vec<LeaseRef>,
    failed_on: BTreeMap<JobId, Vec<WorkerId>>,
    in_a_row: BTreeMap<WorkerId, u32>,
    results: BTreeMap<JobId, OutcomeKey>,
}

impl World {
    fn new() -> World {
        let now = UnixMillis(0);
        let job = |number: usize| Job {
            id: JobId(number as i64),
            attempt: Attempt(0),
            charged_attempts: 0,
            state: JobState::Queued { not_before: now },
        };
        World {
            now,
            last_sweep: now,
            rng: ChaCha8Rng::seed_from_u64(3),
            campaign: CampaignState::Running { since: now },
            jobs: (0..JOBS).map(job).collect(),
            policy: PolicyHealth::new(now),
            granted: Vec::new(),
            failed_on: BTreeMap::new(),
            in_a_row: BTreeMap::new(),
            results: BTreeMap::new(),
        }
    }

    fn happen(&mut self, event: &Event) {
        match event {
            Event::Claim { worker, job } => self.claim(&format!("w{worker}"), *job),
            Event::Pass { secs } => self.pass(*secs),
            Event::Operate { change } => self.operate(*change),
            Event::Retry { job } => self.retry(*job),
            Event::Restart => self.restart(),
            Event::Heartbeat { lease, steps } => {
                if let Some(lease) = self.lease(*lease) {
                    self.heartbeat(&lease, *steps);
                }
            }
            Event::Commit { lease, success } => {
                if let Some(lease) = self.lease(*lease) {
                    self.commit(&lease, *success);
                }
            }
            Event::Release { lease, reason } => {
                if let Some(lease) = self.lease(*lease) {
                    self.release(&lease, *reason);
                }
            }
        }
    }

    fn lease(&self, number: usize) -> Option<LeaseRef> {
        let newest_first = self.granted.iter().rev();
        newest_first
            .cycle()
            .nth(number % self.granted.len().max(1))
            .cloned()
    }

    fn job(&mut self, id: JobId) -> &mut Job {
        &mut self.jobs[id.0 as usize]
    }

    /// What the claiming statement does to one row.
    fn claim(&mut self, worker: &str, number: usize) {
        let now = self.now;
        let allowance = self.policy.allowance(now);
        let job = &mut self.jobs[number];
        let waits = matches!(job.state, JobState::Queued { not_before } if not_before <= now);
        if !waits || allowance == Allowance::Nothing || !self.campaign.may_lease() {
            return;
        }
        let owner = WorkerId(worker.to_owned());
        job.attempt = job.attempt.next();
        job.state = JobState::Leased {
            owner: owner.clone(),
            granted: now,
            expires: now.plus(LEASE),
        };
        let lease = LeaseRef {
            worker: owner,
            job: job.id,
            attempt: job.attempt,
        };
        if allowance == Allowance::Probe {
            self.policy = self.policy.with_probe(lease.job, lease.attempt);
            assert_eq!(
                self.policy.allowance(now),
                Allowance::Nothing,
                "one probe at a time"
            );
        }
        self.granted.push(lease);
    }

    fn heartbeat(&mut self, lease: &LeaseRef, steps: u32) {
        let until = self.now.plus(LEASE);
        let job = self.job(lease.job);
        if !job.is_held_by(lease) {
            return;
        }
        if let JobState::Leased { expires, .. } = &mut job.state {
            *expires = until;
        }
        if steps > 10 {
            self.policy = self
                .policy
                .after_answer((lease.job, lease.attempt), self.now);
        }
    }

    fn commit(&mut self, lease: &LeaseRef, success: bool) {
        let reported = OutcomeKey { success, steps: 9 };
        let stored = self.results.get(&lease.job).copied();
        let job = self.job(lease.job);
        let newest = job.attempt;
        let was_held = job.is_held_by(lease);
        match job.judge_commit(lease, true, reported, stored) {
            CommitJudgement::Accept => {
                assert!(
                    was_held && lease.attempt == newest,
                    "a stale attempt never commits"
                );
                job.state = JobState::Committed;
                let before = self.results.insert(lease.job, reported);
                assert_eq!(before, None, "one result per job");
                self.in_a_row.remove(&lease.worker);
                self.policy = self
                    .policy
                    .after_commit((lease.job, lease.attempt), self.now);
            }
            CommitJudgement::Duplicate => assert_eq!(stored, Some(reported)),
            CommitJudgement::Divergent => assert!(stored.is_some() && stored != Some(reported)),
            CommitJudgement::Stale => assert!(!was_held),
        }
    }

    fn release(&mut self, lease: &LeaseRef, reason: FailureReason) {
        let job = self.job(lease.job).clone();
        if !job.is_held_by(lease) {
            return;
        }
        let suspicion = self.suspicion(lease);
        let then = job.after_failure(reason, suspicion, self.now, &mut self.rng);
        if reason.is_charged() {
            let in_a_row = self.in_a_row.entry(lease.worker.clone()).or_default();
            *in_a_row = strike(*in_a_row).in_a_row;
        }
        let attempt = (lease.job, lease.attempt);
        self.policy = match (&job.state, reason) {
            (JobState::Leased { granted, .. }, FailureReason::PolicyUnavailable) => self
                .policy
                .after_outage(attempt, *granted, "down", self.now, &mut self.rng),
            _ => self.policy.after_other_failure(attempt, self.now),
        };
        self.fail(lease, reason, then);
    }

    fn pass(&mut self, secs: u64) {
        self.now = self.now.plus(Duration::from_secs(secs));
        let overdue = self.jobs.iter().filter_map(|job| match &job.state {
            JobState::Leased { owner, expires, .. } if *expires <= self.now => {
                let lease = LeaseRef {
                    worker: owner.clone(),
                    job: job.id,
                    attempt: job.attempt,
                };
                Some(ExpiredLease {
                    job: job.clone(),
                    control_steps: 0,
                    owner_failures_in_a_row: self.in_a_row.get(owner).copied().unwrap_or(0),
                    suspicion: self.suspicion(&lease),
                    lease,
                })
            }
            _ => None,
        });
        let state = SweepState {
            last_sweep: self.last_sweep,
            lease: LEASE,
            expired: overdue.collect(),
        };
        let decisions = plan(&state, self.now, &mut self.rng);
        self.last_sweep = self.now;
        for decision in decisions {
            match decision {
                Decision::Fail {
                    lease,
                    reason,
                    then,
                    ..
                } => {
                    let attempt = (lease.job, lease.attempt);
                    self.policy = self.policy.after_other_failure(attempt, self.now);
                    self.fail(&lease, reason, then);
                }
                Decision::Strike { worker, strike } => {
                    self.in_a_row.insert(worker, strike.in_a_row);
                }
                Decision::ExtendLeases { .. } => panic!("sweeps came often enough"),
            }
        }
    }

    fn operate(&mut self, change: Change) {
        let before = self.campaign;
        let Ok(after) = before.after(change, self.now) else {
            assert!(matches!(before, CampaignState::Cancelled { .. }));
            return;
        };
        self.campaign = after;
        if change != Change::Cancel || after == before {
            return;
        }
        for lease in self.granted.clone() {
            if self.job(lease.job).is_held_by(&lease) {
                let attempt = (lease.job, lease.attempt);
                self.policy = self.policy.after_other_failure(attempt, self.now);
                let not_before = self.now;
                let then = AfterFailure::Requeue { not_before };
                self.fail(&lease, FailureReason::Cancelled, then);
            }
        }
    }

    /// What taking a job out of quarantine does to its row.
    fn retry(&mut self, number: usize) {
        let now = self.now;
        let job = &mut self.jobs[number];
        if may_retry(&job.state) {
            job.state = JobState::Queued { not_before: now };
            job.charged_attempts = 0;
            self.failed_on.remove(&job.id);
        }
    }

    /// What a new coordinator does: every lease gets its full time again.
    fn restart(&mut self) {
        let until = self.now.plus(LEASE);
        for job in &mut self.jobs {
            if let JobState::Leased { expires, .. } = &mut job.state {
                *expires = until;
            }
        }
        self.last_sweep = self.now;
    }

    fn fail(&mut self, lease: &LeaseRef, reason: FailureReason, then: AfterFailure) {
        let now = self.now;
        let charged = reason.is_charged();
        if charged {
            self.failed_on
                .entry(lease.job)
                .or_default()
                .push(lease.worker.clone());
        }
        let workers = self.suspicion(lease).failed_on_workers;
        let job = self.job(lease.job);
        job.charged_attempts += u32::from(charged);
        job.state = match then {
            AfterFailure::Requeue { not_before } => {
                let backoff = not_before.since(now);
                assert!(backoff <= Duration::from_secs(60), "{backoff:?}");
                assert_eq!(charged, backoff >= Duration::from_secs(1), "{backoff:?}");
                JobState::Queued { not_before }
            }
            AfterFailure::Quarantine => {
                assert!(charged && job.charged_attempts >= MAX_CHARGED_ATTEMPTS);
                assert!(workers >= 2, "one machine does not condemn a rollout");
                JobState::Quarantined
            }
        };
    }

    fn suspicion(&self, lease: &LeaseRef) -> Suspicion {
        let others = self.failed_on.get(&lease.job).into_iter().flatten();
        let distinct: BTreeSet<&WorkerId> = others.chain([&lease.worker]).collect();
        Suspicion {
            failed_on_workers: distinct.len() as u32,
            able_workers: WORKERS as u32,
        }
    }

    fn check(&self, before: &[Job]) {
        for (old, new) in before.iter().zip(&self.jobs) {
            assert!(new.attempt >= old.attempt, "attempts only rise");
            assert!(new.charged_attempts <= new.attempt.0);
            let was_committed = old.state == JobState::Committed;
            assert!(!was_committed || old == new, "committed is final");
            let is_leased = matches!(new.state, JobState::Leased { .. });
            let is_cancelled = matches!(self.campaign, CampaignState::Cancelled { .. });
            assert!(
                !(is_leased && is_cancelled),
                "a cancelled campaign holds nothing"
            );
            let is_new_lease = new.attempt > old.attempt;
            assert!(
                !is_new_lease || self.campaign.may_lease(),
                "only what runs is leased"
            );
            let is_committed = new.state == JobState::Committed;
            assert_eq!(is_committed, self.results.contains_key(&new.id));
        }
        if let PolicyState::Probing { job, attempt, .. } = &self.policy.state {
            let probe = &self.jobs[job.0 as usize];
            assert!(
                matches!(probe.state, JobState::Leased { .. }),
                "a probe is out"
            );
            assert_eq!(probe.attempt, *attempt);
        }
    }

    /// Sound workers take over: everything must come to an end.
    fn finish(&mut self) {
        self.operate(Change::Resume);
        for round in 0..200 {
            for number in 0..JOBS {
                self.claim(&format!("w{}", round % WORKERS), number);
            }
            for lease in self.granted.clone() {
                self.commit(&lease, true);
            }
            self.pass(10);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, ..ProptestConfig::default() })]

    #[test]
    fn every_job_of_the_pure_core_ends_exactly_once(
        events in prop::collection::vec(event(), 0..60)
    ) {
        let mut world = World::new();
        for event in &events {
            let before = world.jobs.clone();
            world.happen(event);
            world.check(&before);
        }
        world.finish();
        for job in &world.jobs {
            let ended = matches!(job.state, JobState::Committed | JobState::Quarantined);
            prop_assert!(ended || !world.campaign.may_lease(), "{job:?}");
        }
    }
}
