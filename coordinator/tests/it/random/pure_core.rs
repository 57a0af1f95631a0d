//! Runs the events on the pure rules, with a table in memory in place of the store.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use benchmark::attempt::AttemptId;
use proptest::prelude::*;
use queue::clock::UnixMillis;
use queue::ids::{AttemptNumber, JobId, WorkerId};
use queue::rules::campaign::{CampaignState, Change};
use queue::rules::lease::{
    AfterFailure, CommitJudgement, FailureReason, Job, JobState, Lease, MAX_CHARGED_ATTEMPTS,
    MAX_LOSSES, MAX_SILENCES, OutcomeKey, Party, Suspicion, strike, was_suspended,
};
use queue::rules::outage::{Allowance, PolicyHealth, PolicyState};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::{Event, JOBS, WORKERS, event};

/// Durations of a lease without heartbeats, and of the longest attempt.
const LEASE: Duration = Duration::from_secs(30);
const CEILING: Duration = Duration::from_secs(90);

/// An attempt that was granted, whether or not it still holds its lease.
#[derive(Clone, Debug)]
struct Granted {
    job: JobId,
    attempt: AttemptId,
    worker: WorkerId,
}

struct Model {
    now: UnixMillis,
    last_sweep: UnixMillis,
    rng: ChaCha8Rng,
    campaign: CampaignState,
    jobs: Vec<Job>,
    policy: PolicyHealth,
    granted: Vec<Granted>,
    failed_on: BTreeMap<JobId, Vec<WorkerId>>,
    silences: BTreeMap<JobId, u32>,
    in_a_row: BTreeMap<WorkerId, u32>,
    results: BTreeMap<JobId, OutcomeKey>,
}

impl Model {
    fn new() -> Model {
        let now = UnixMillis(0);
        let job = |number: usize| Job {
            id: JobId(number as i64),
            attempt: AttemptNumber(0),
            charged_attempts: 0,
            losses: 0,
            state: JobState::Queued { not_before: now },
        };
        Model {
            now,
            last_sweep: now,
            rng: ChaCha8Rng::seed_from_u64(3),
            campaign: CampaignState::Running { since: now },
            jobs: (0..JOBS).map(job).collect(),
            policy: PolicyHealth::new(now),
            granted: Vec::new(),
            failed_on: BTreeMap::new(),
            silences: BTreeMap::new(),
            in_a_row: BTreeMap::new(),
            results: BTreeMap::new(),
        }
    }

    fn apply(&mut self, event: &Event) {
        match event {
            Event::Claim { worker, job, .. } => self.claim(&format!("w{worker}"), *job),
            Event::Pass { secs } => self.pass(*secs),
            Event::Operate { change } => self.operate(*change),
            Event::Retry { job } => self.retry(*job),
            Event::Restart => self.restart(),
            Event::Together(events) => events.iter().for_each(|event| self.apply(event)),
            // A repeated claim grants no further lease.
            Event::ClaimAgain { .. } => {}
            Event::Heartbeat { lease, steps } => {
                if let Some(granted) = self.granted(*lease) {
                    self.heartbeat(&granted, *steps);
                }
            }
            Event::Commit { lease, success } => {
                if let Some(granted) = self.granted(*lease) {
                    self.commit(&granted, *success);
                }
            }
            Event::Release { lease, reason } => {
                if let Some(granted) = self.granted(*lease) {
                    self.end(&granted, *reason);
                }
            }
        }
    }

    fn granted(&self, number: usize) -> Option<Granted> {
        let newest_first = self.granted.iter().rev();
        newest_first.cycle().nth(number % self.granted.len().max(1)).cloned()
    }

    fn job(&mut self, id: JobId) -> &mut Job {
        &mut self.jobs[id.0 as usize]
    }

    /// Leases a job to a worker, if the job is due, and its policy and its campaign allow it.
    fn claim(&mut self, worker: &str, number: usize) {
        let now = self.now;
        let allowance = self.policy.allowance(now);
        let job = &mut self.jobs[number];
        let is_due = matches!(job.state, JobState::Queued { not_before } if not_before <= now);
        if !is_due || allowance == Allowance::Nothing || !self.campaign.may_lease() {
            return;
        }
        let owner = WorkerId(worker.to_owned());
        let mut bits = [0; 16];
        self.rng.fill_bytes(&mut bits);
        let attempt = AttemptId::from_random(bits);
        job.attempt = AttemptNumber(job.attempt.0 + 1);
        job.state = JobState::Leased(Lease {
            attempt,
            owner: owner.clone(),
            granted: now,
            expires: now.plus(LEASE),
            ceiling: now.plus(CEILING),
            is_acknowledged: false,
        });
        let granted = Granted { job: job.id, attempt, worker: owner };
        if allowance == Allowance::Probe {
            self.policy = self.policy.with_probe(attempt);
            assert_eq!(self.policy.allowance(now), Allowance::Nothing, "one probe at a time");
        }
        self.granted.push(granted);
    }

    fn heartbeat(&mut self, granted: &Granted, steps: u32) {
        let until = self.now.plus(LEASE);
        match &mut self.job(granted.job).state {
            JobState::Leased(lease) if lease.attempt == granted.attempt => {
                lease.expires = until.min(lease.ceiling);
                lease.is_acknowledged = true;
            }
            _ => return,
        }
        // The ten settling steps need no policy.
        if steps > 10 {
            self.policy = self.policy.after_answer(granted.attempt, self.now);
        }
    }

    fn commit(&mut self, granted: &Granted, success: bool) {
        let reported = OutcomeKey { success, steps: 9 };
        let stored = self.results.get(&granted.job).copied();
        let job = self.job(granted.job);
        let was_held = job.lease_of(granted.attempt).is_some();
        match job.judge_commit(granted.attempt, reported, stored) {
            CommitJudgement::Accept => {
                assert!(was_held, "a stale attempt never commits");
                job.state = JobState::Committed;
                let before = self.results.insert(granted.job, reported);
                assert_eq!(before, None, "one result per job");
                self.in_a_row.remove(&granted.worker);
                self.policy = self.policy.after_commit(granted.attempt, self.now);
            }
            CommitJudgement::Duplicate => assert_eq!(stored, Some(reported)),
            CommitJudgement::Divergent => assert!(stored.is_some() && stored != Some(reported)),
            CommitJudgement::Stale => assert!(!was_held),
        }
    }

    /// Ends an attempt without a result, if it holds its lease.
    fn end(&mut self, granted: &Granted, reason: FailureReason) {
        let job = self.job(granted.job).clone();
        let Some(lease) = job.lease_of(granted.attempt) else {
            return;
        };
        if reason == FailureReason::WorkerSilent {
            *self.silences.entry(granted.job).or_default() += 1;
        }
        let suspicion = self.suspicion(granted);
        let consequence = job.after_failure(reason, &suspicion, self.now, &mut self.rng);
        if reason.blames() == Some(Party::Machine) {
            let in_a_row = self.in_a_row.entry(granted.worker.clone()).or_default();
            *in_a_row = strike(*in_a_row).in_a_row;
        }
        self.policy = match reason {
            FailureReason::PolicyUnavailable | FailureReason::PolicyLost => self
                .policy
                .after_outage(granted.attempt, lease.granted, "down", self.now, &mut self.rng),
            FailureReason::PolicyMisbehaved => self.policy.after_misbehaviour(
                granted.attempt,
                "misbehaved",
                self.now,
                &mut self.rng,
            ),
            _ => self.policy.after_other_failure(granted.attempt, self.now),
        };
        self.fail(granted, reason, consequence);
    }

    /// Advances the clock, and ends the attempts whose leases expire.
    fn pass(&mut self, secs: u64) {
        self.now = self.now.plus(Duration::from_secs(secs));
        assert!(
            !was_suspended(self.now.since(self.last_sweep), LEASE),
            "sweeps are too frequent to mean a suspension"
        );
        self.last_sweep = self.now;
        for granted in self.granted.clone() {
            let job = self.job(granted.job).clone();
            if let Some(lease) = job.lease_of(granted.attempt)
                && lease.expires <= self.now
            {
                self.end(&granted, lease.expiry_reason(None, LEASE));
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
        for granted in self.granted.clone() {
            self.end(&granted, FailureReason::Cancelled);
        }
    }

    /// Requeues a job, if it is in quarantine, and resets its counts.
    fn retry(&mut self, number: usize) {
        let now = self.now;
        let job = &mut self.jobs[number];
        if job.state == JobState::Quarantined {
            job.state = JobState::Queued { not_before: now };
            job.charged_attempts = 0;
            job.losses = 0;
            self.silences.remove(&job.id);
            self.failed_on.remove(&job.id);
        }
    }

    /// Simulates a restart: every lease gets its full duration again.
    fn restart(&mut self) {
        let until = self.now.plus(LEASE);
        for job in &mut self.jobs {
            if let JobState::Leased(lease) = &mut job.state {
                lease.expires = until.min(lease.ceiling);
            }
        }
        self.last_sweep = self.now;
    }

    fn fail(&mut self, granted: &Granted, reason: FailureReason, consequence: AfterFailure) {
        let now = self.now;
        let charged = reason.is_charged();
        if charged {
            self.failed_on.entry(granted.job).or_default().push(granted.worker.clone());
        }
        let silences = self.suspicion(granted).silences;
        let workers = self.suspicion(granted).failed_on.len();
        let job = self.job(granted.job);
        job.charged_attempts += u32::from(charged);
        job.losses += u32::from(reason.is_loss());
        job.state = match consequence {
            AfterFailure::Requeue { not_before } => {
                let backoff = not_before.since(now);
                assert!(backoff <= Duration::from_secs(60), "{backoff:?}");
                let waits = backoff >= Duration::from_secs(1);
                let may_wait_uncharged = reason.is_loss() || reason == FailureReason::WorkerSilent;
                assert!(charged == waits || may_wait_uncharged && waits, "{reason:?}: {backoff:?}");
                JobState::Queued { not_before }
            }
            AfterFailure::Quarantine => {
                match reason.stored_reason(consequence) {
                    FailureReason::TakesPolicyDown => assert!(job.losses >= MAX_LOSSES),
                    FailureReason::TakesWorkerDown => assert!(silences >= MAX_SILENCES),
                    _ => {
                        assert!(charged && job.charged_attempts >= MAX_CHARGED_ATTEMPTS);
                        let blamed = reason.blames();
                        assert!(
                            workers >= 2 || blamed == Some(Party::Policy),
                            "failures on one machine do not quarantine a rollout"
                        );
                    }
                }
                JobState::Quarantined
            }
        };
    }

    fn suspicion(&self, granted: &Granted) -> Suspicion {
        let others = self.failed_on.get(&granted.job).into_iter().flatten();
        let failed_on: BTreeSet<String> =
            others.chain([&granted.worker]).map(|worker| worker.0.clone()).collect();
        Suspicion {
            silent_on: failed_on.clone(),
            failed_on,
            able: (0..WORKERS).map(|number| format!("w{number}")).collect(),
            silences: self.silences.get(&granted.job).copied().unwrap_or(0),
        }
    }

    fn check(&self, before: &[Job]) {
        for (old, new) in before.iter().zip(&self.jobs) {
            assert!(new.attempt >= old.attempt, "attempts only rise");
            assert!(new.charged_attempts <= new.attempt.0);
            let was_committed = old.state == JobState::Committed;
            assert!(!was_committed || old == new, "committed is final");
            let is_leased = matches!(new.state, JobState::Leased(_));
            let is_cancelled = matches!(self.campaign, CampaignState::Cancelled { .. });
            assert!(!(is_leased && is_cancelled), "a cancelled campaign holds no lease");
            let is_new_lease = new.attempt > old.attempt;
            assert!(
                !is_new_lease || self.campaign.may_lease(),
                "only a running campaign leases jobs"
            );
            let is_committed = new.state == JobState::Committed;
            assert_eq!(is_committed, self.results.contains_key(&new.id));
        }
        if let PolicyState::Probing { attempt, .. } = &self.policy.state {
            let is_probe = |job: &Job| job.lease_of(*attempt).is_some();
            assert!(self.jobs.iter().any(is_probe), "a probe holds a lease");
        }
    }

    /// Lets workers without faults finish all jobs.
    fn finish(&mut self) {
        self.operate(Change::Resume);
        for round in 0..200 {
            for number in 0..JOBS {
                self.claim(&format!("w{}", round % WORKERS), number);
            }
            for granted in self.granted.clone() {
                self.commit(&granted, true);
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
        let mut model = Model::new();
        for event in &events {
            let before = model.jobs.clone();
            model.apply(event);
            model.check(&before);
        }
        model.finish();
        for job in &model.jobs {
            let ended = matches!(job.state, JobState::Committed | JobState::Quarantined);
            prop_assert!(ended || !model.campaign.may_lease(), "{job:?}");
        }
    }
}
